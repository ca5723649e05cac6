"""The picture of the demo: the whole frame, and the same crops of every method side by side."""

from collections.abc import Sequence
from pathlib import Path
from typing import Any

from numpy.typing import NDArray
from pathfold.images import replacing
from pathfold.metrics import display

from demo.method import METRICS, TITLES, Method

Crop = tuple[int, int, int, int]  # left, top, width, height
_COLORS = ("#e8a33d", "#4fb3bf", "#d8567a")


def save(path: Path, methods: Sequence[Method], crops: Sequence[Crop], scale: float) -> None:
    """Write a PNG: the last method's whole frame (the reference) above a row of crops per box."""
    from matplotlib.backends.backend_agg import FigureCanvasAgg
    from matplotlib.figure import Figure
    from matplotlib.patches import Rectangle

    height, width = methods[0].image.shape[:2]
    columns, rows = len(methods), len(crops)
    cell, gap, caption = 1.85, 0.06, 0.62  # inches
    cell_height = cell * crops[0][3] / crops[0][2]
    figure_width = columns * (cell + gap) + gap
    whole_height = figure_width * height / width
    figure_height = whole_height + caption + rows * (cell_height + gap) + 2 * gap
    figure = Figure(figsize=(figure_width, figure_height), facecolor="white", dpi=84)
    FigureCanvasAgg(figure)

    def panel(left: float, top: float, w: float, h: float, image: NDArray[Any], smooth: bool) -> Any:
        axes = figure.add_axes(
            (left / figure_width, 1 - (top + h) / figure_height, w / figure_width, h / figure_height)
        )
        axes.imshow(display(image, scale), interpolation="lanczos" if smooth else "nearest", aspect="auto")
        axes.set_axis_off()
        return axes

    whole = panel(0, 0, figure_width, whole_height, methods[-1].image, True)
    for (left, top, w, h), color in zip(crops, _COLORS, strict=False):
        whole.add_patch(Rectangle((left, top), w, h, fill=False, edgecolor=color, linewidth=2))
    for column, method in enumerate(methods):
        x = gap + column * (cell + gap)
        figure.text(
            (x + cell / 2) / figure_width,
            1 - (whole_height + caption / 2 + gap) / figure_height,
            f"{method.name}\n{caption_of(method)}",
            ha="center",
            va="center",
            fontsize=8.5,
            linespacing=1.5,
        )
        for row, (left, top, w, h) in enumerate(crops):
            y = whole_height + caption + gap + row * (cell_height + gap)
            axes = panel(x, y, cell, cell_height, method.image[top : top + h, left : left + w], False)
            axes.add_patch(
                Rectangle((-0.5, -0.5), w, h, fill=False, edgecolor=_COLORS[row % len(_COLORS)], linewidth=2.5)
            )
    with replacing(path) as unfinished:
        figure.savefig(unfinished, format="png")


def caption_of(method: Method) -> str:
    """The headline figures of a method in one line."""
    shown = [f"{TITLES[metric]} {method.errors[metric]:.3f}" for metric in METRICS[:1] if metric in method.errors]
    shown += [f"{method.total_ms / 1000:.2f}\u00a0s"] if method.total_ms is not None else []
    return ", ".join(shown) or method.note
