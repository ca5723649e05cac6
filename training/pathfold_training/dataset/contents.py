"""What a data set holds: figures, faults and a contact sheet."""

from __future__ import annotations

from collections import Counter
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray
from pathfold.images import why

from ..scenes.faults import Gallery
from . import store


def info(folder: Path, check: bool = False) -> dict[str, Any]:
    """Views by split and content, spp, reference spp and RelL2 (of the exposed picture), licences, origins, bytes.

    `faults` says which references `render` would refuse today, and why; `without_samples` counts the views whose
    samples are yet to be rendered. With `check` every byte is read: `damaged` lists files that have been altered, and
    references that are gone.
    """
    lines = _lines(folder)
    error = np.array([line["reference_rell2"] for line in lines])
    reference = np.array([line["reference_spp"] for line in lines])
    facts: dict[str, Any] = {
        "views": len(lines),
        "without_samples": sum(not store.present(folder, line, store.SAMPLES) for line in lines),
        "scenes": len({line["scene"] for line in lines}),
        "splits": dict(Counter(line["split"] for line in lines)),
        "contents": dict(Counter(line["content"] for line in lines)),
        "spp": sorted({line["spp"] for line in lines}),
        "reference_spp": {
            "median": int(np.median(reference)),
            "min": int(reference.min()),
            "max": int(reference.max()),
        },
        "reference_rell2": {
            "median": float(np.median(error)),
            "p90": float(np.percentile(error, 90)),
            "max": float(error.max()),
        },
        "cpu_hours": round(sum(line["cpu_seconds"] for line in lines) / 3600, 2),
        "licences": dict(Counter(line["licence"] for line in lines)),
        "origins": {line["scene"]: line["origin"] for line in lines if line["kind"] == "library"},
        "bytes": {
            kind: sum(line["files"][kind]["bytes"] for line in lines if store.present(folder, line, kind))
            for kind in store.KINDS
        },
        "faults": faults(folder, lines),
    }
    return facts | (
        {"damaged": [str(path) for path in store.damaged(folder, store.read_index(folder))]} if check else {}
    )


def faults(folder: Path, lines: list[store.Line]) -> dict[str, str]:
    """Views that are black, blown out or flat, or repeat one before them, each with the reason."""
    gallery, found = Gallery(), {}
    for line in lines:
        color = store.reference_color(folder, line["id"])
        if fault := gallery.fault(color, "window" in line):
            found[line["id"]] = fault
        else:
            gallery.add(line["id"], color)
    return found


def sheet(folder: Path, picture: Path, columns: int = 12) -> int:
    """Writes all references, exposed, in order of their ids; returns how many."""
    lines = sorted(_lines(folder), key=lambda line: line["id"])
    tiles = [_display(store.reference_color(folder, line["id"]), line["exposure"]) for line in lines]
    height, width = (max(tile.shape[i] for tile in tiles) for i in (0, 1))
    columns = min(columns, len(tiles))
    canvas = np.zeros((-(-len(tiles) // columns) * height, columns * width, 3), np.uint8)
    for i, tile in enumerate(tiles):
        y, x = i // columns * height, i % columns * width
        canvas[y : y + tile.shape[0], x : x + tile.shape[1]] = tile
    _write(picture, canvas)
    return len(tiles)


def _lines(folder: Path) -> list[store.Line]:
    """The views whose reference is there. Raises FileNotFoundError if there is none."""
    lines = [line for line in store.read_index(folder) if store.present(folder, line, store.REFERENCES)]
    if not lines:
        raise FileNotFoundError(f"no whole view in {folder}; 'pathfold-train render --out {folder}' makes some")
    return lines


def _display(color: NDArray[np.float32], exposure: float) -> NDArray[np.uint8]:
    """[3, H, W] linear to H x W x 3 for the eye: the curve that the metrics use too."""
    exposed = exposure * np.maximum(np.moveaxis(color, 0, -1), 0)
    return (255 * (exposed / (1 + exposed)) ** (1 / 2.2) + 0.5).astype(np.uint8)


def _write(picture: Path, pixels: NDArray[np.uint8]) -> None:
    import OpenImageIO as oiio  # noqa: N813

    spec = oiio.ImageSpec(pixels.shape[1], pixels.shape[0], 3, "uint8")
    output = oiio.ImageOutput.create(str(picture))
    if output is None or not output.open(str(picture), spec):
        reason = why(output or oiio)
        raise OSError(f"cannot write {picture}: {reason.strip()}; give a .jpg or .png in a folder that exists")
    output.write_image(pixels)
    output.close()
