"""The page of a bench: one HTML file with the answers, a plot to point at, a before/after slider, a table."""

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from pathfold.bench.measurement import ERRORS
from pathfold.bench.results import ALL, FLAG, Point, names
from pathfold.pixels import ERROR_GAIN, error_map, jpeg
from pathfold.report import tables
from pathfold.report.answers import Answer
from pathfold.report.html import data_uri, write_page
from pathfold.report.plots import COLORS

MOST_BYTES = 2_000_000  # of pictures, before base64
WIDEST = 960  # wider pictures are halved until they fit
QUALITY, ERROR_QUALITY = 82, 70


def save(
    path: Path,
    means: Sequence[Point],
    points: Sequence[Point],
    answers: Sequence[Answer],
    pictures: Path,
    own_errors: Mapping[str, float | None],
    *,
    title: str,
    lead: str,
    notes: Sequence[str],
    facts: Mapping[str, str],
) -> None:
    """Write the page. `means` may be empty (one scene); `pictures` is what bench.run.keep_pictures filled."""
    shown = [*means, *points] if len(names(points, "scene")) > 1 else list(points)
    views, left_out = choose(points, pictures)
    if left_out:
        notes = [
            *notes,
            f"To keep the page small it holds pictures at {left_out} only; all lie in the results' folder.",
        ]
    rows = [tables.cells(point) for point in shown]
    told = [column for column in range(len(rows[0])) if any(row[column] for row in rows)]
    write_page(
        path,
        Path(__file__).with_name("page.html"),
        title=title,
        lead=lead,
        answers=answers,
        notes=notes,
        facts=facts,
        gain=ERROR_GAIN,
        header=[tables.HEADER[column] for column in told],
        data={
            "all": ALL,
            "scenes": names(shown, "scene"),
            "methods": names(points, "method"),
            "colors": COLORS,
            "points": [record(point, told) for point in shown],
            "flagged": {scene: FLAG * own for scene, own in own_errors.items() if own},
            "views": views,
        },
    )


def record(point: Point, columns: Sequence[int]) -> dict[str, Any]:
    """A point for the script: errors as [mean, low, high], and those columns of its table row."""
    times = {
        "total": point.total_ms,
        "cold": point.cold_total_ms,
        "render": point.render_ms,
        "denoise": point.denoise_ms,
    }
    return {
        "scene": point.scene,
        "method": point.method,
        "spp": point.spp,
        "errors": {n: [_short(v) for v in (s.mean, s.low, s.high)] for n, s in point.errors.items() if n in ERRORS},
        "seconds": {name: _short(ms / 1000) for name, ms in times.items() if ms},
        "row": [tables.cells(point)[column] for column in columns],
    }


def choose(points: Sequence[Point], pictures: Path) -> tuple[dict[str, list[dict[str, Any]]], str]:
    """Scene -> pictures and error maps as data URIs, the reference first; and, where not all spp fitted, which did.

    Whole spp levels are taken, a middle one first, then the ends, as long as they fit into MOST_BYTES.
    """
    scenes = [scene for scene in names(points, "scene") if (pictures / scene / "reference.png").is_file()]
    views = {scene: [_view("reference", 0, pictures / scene / "reference.png")] for scene in scenes}
    levels = sorted({point.spp for point in points})
    order = dict.fromkeys([levels[len(levels) // 2], levels[0], levels[-1], *levels]) if levels else {}
    left = MOST_BYTES
    taken: list[int] = []
    for spp in order:
        level = {scene: _level(scene, spp, points, pictures / scene) for scene in scenes}
        size = sum(len(view["image"]) + len(view["error"]) for found in level.values() for view in found) * 3 // 4
        if taken and size > left:
            continue
        left -= size
        taken.append(spp)
        for scene, found in level.items():
            views[scene] += found
    for found in views.values():
        found[1:] = sorted(found[1:], key=lambda view: (view["spp"], names(points, "method").index(view["method"])))
    partial = "" if len(taken) == len(levels) or not scenes else f"{', '.join(map(str, sorted(taken)))} spp"
    return views, partial


def _level(scene: str, spp: int, points: Sequence[Point], folder: Path) -> list[dict[str, Any]]:
    paths = [(p.method, folder / f"{p.method}-{spp}spp.png") for p in points if (p.scene, p.spp) == (scene, spp)]
    return [_view(method, spp, path) for method, path in paths if path.is_file()]


def _view(method: str, spp: int, path: Path) -> dict[str, Any]:
    from matplotlib.image import imread

    image = _fitting(imread(path)[..., :3])
    error_path = path.with_suffix(".flip.png")
    errors = _fitting(imread(error_path)[..., :3])[..., 0] if error_path.is_file() else np.zeros(image.shape[:2])
    return {
        "method": method,
        "spp": spp,
        "image": data_uri(jpeg(image, QUALITY), "jpeg"),
        "error": data_uri(jpeg(error_map(errors), ERROR_QUALITY), "jpeg"),
        "size": [image.shape[1], image.shape[0]],
    }


def _fitting(pixels: NDArray[Any]) -> NDArray[Any]:
    while pixels.shape[1] > WIDEST:
        even = pixels[: pixels.shape[0] // 2 * 2, : pixels.shape[1] // 2 * 2]
        pixels = (even[::2, ::2] + even[1::2, ::2] + even[::2, 1::2] + even[1::2, 1::2]) / 4
    return pixels


def _short(value: float) -> float:
    return float(f"{value:.5g}")
