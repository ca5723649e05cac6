"""What a data set holds: figures and a contact sheet."""

from __future__ import annotations

from collections import Counter
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from .store import Store


def info(folder: Path) -> dict[str, Any]:
    """Views by split and content, spp, reference spp and RelL2 (of the exposed picture), licences, origins, bytes."""
    lines = Store(folder).lines
    error = np.array([line["reference_rell2"] for line in lines])
    reference = np.array([line["reference_spp"] for line in lines])
    return {
        "views": len(lines),
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
        "licences": dict(Counter(line["licence"] for line in lines)),
        "origins": {line["scene"]: line["origin"] for line in lines if line["kind"] == "library"},
        "bytes": sum(line["bytes"] for line in lines),
    }


def sheet(folder: Path, picture: Path, columns: int = 12, noisy: bool = False) -> int:
    """Writes all references (or the samples' means), exposed, in order of their ids; returns how many."""
    store = Store(folder)
    names = ["samples.radiance"] if noisy else ["reference.color"]
    tiles = []
    for line in sorted(store.lines, key=lambda line: line["id"]):
        color = store.view(line["id"], names)[names[0]]
        tiles.append(_display(np.nan_to_num(color).reshape(-1, *color.shape[-3:]).mean(0), store.exposure(line["id"])))
    height, width = (max(tile.shape[i] for tile in tiles) for i in (0, 1))
    rows = -(-len(tiles) // columns)
    canvas = np.zeros((rows * height, columns * width, 3), np.uint8)
    for i, tile in enumerate(tiles):
        y, x = i // columns * height, i % columns * width
        canvas[y : y + tile.shape[0], x : x + tile.shape[1]] = tile
    _write(picture, canvas)
    return len(tiles)


def _display(color: NDArray[np.float32], exposure: float) -> NDArray[np.uint8]:
    """[3, H, W] linear to H x W x 3 for the eye: the curve that the metrics use too."""
    exposed = exposure * np.maximum(np.moveaxis(color, 0, -1), 0)
    return (255 * (exposed / (1 + exposed)) ** (1 / 2.2) + 0.5).astype(np.uint8)


def _write(picture: Path, pixels: NDArray[np.uint8]) -> None:
    import OpenImageIO as oiio  # noqa: N813

    spec = oiio.ImageSpec(pixels.shape[1], pixels.shape[0], 3, "uint8")
    output = oiio.ImageOutput.create(str(picture))
    if output is None or not output.open(str(picture), spec):
        raise OSError(f"cannot write {picture}: {oiio.geterror()}; give a .jpg or .png in a folder that exists")
    output.write_image(pixels)
    output.close()
