"""Error over total time, log-log: one curve per method, the Pareto front marked. PNG and SVG, sized for a paper."""

from collections.abc import Mapping, Sequence
from math import ceil
from pathlib import Path
from typing import Any

from pathfold.bench.results import ALL, FLAG, FLOOR, Point, names
from pathfold.images import replacing
from pathfold.report.pareto import pareto, timed

COLUMN = 3.5  # inches: one column of a two-column page
# Okabe and Ito's colours, told apart by the colour-blind, without yellow, too light on paper, and with Tol's wine.
COLORS = ("#000000", "#0072B2", "#56B4E9", "#D55E00", "#009E73", "#CC79A7", "#E69F00", "#882255")
MARKERS = "osD^vPXh"
_STYLE: dict[Any, Any] = {
    "font.size": 8,
    "axes.labelsize": 8,
    "axes.titlesize": 8,
    "xtick.labelsize": 7,
    "ytick.labelsize": 7,
    "legend.fontsize": 7,
    "axes.linewidth": 0.6,
    "axes.spines.top": False,
    "axes.spines.right": False,
    "svg.hashsalt": "pathfold",  # equal data, equal files
    "svg.fonttype": "none",  # text stays text: a third of the size, and it can be edited
}


def color(methods: Sequence[str], method: str) -> str:
    return COLORS[methods.index(method) % len(COLORS)]


def save(folder: Path, means: Sequence[Point], points: Sequence[Point], own_errors: dict[str, float | None]) -> None:
    """Write mean.png/.svg, scenes.png/.svg (all scenes side by side) and one pair per scene into `folder`.

    `own_errors`: scene -> RelL2 of its reference; below FLAG times that a plot is shaded. Scenes without a time of
    rendering have no plot.
    """
    folder.mkdir(parents=True, exist_ok=True)
    methods = names(points, "method")
    panels = {scene: [p for p in points if p.scene == scene] for scene in names(points, "scene")}
    panels = {scene: own for scene, own in panels.items() if timed(own)}
    for scene, own in panels.items():
        _figure(folder / scene, {scene: own}, methods, own_errors)
    if len(panels) > 1:
        if timed(means):
            scenes = max(p.scenes for p in means)
            _figure(folder / "mean", {f"{ALL.capitalize()} of {scenes} scenes": means}, methods, {})
        _figure(folder / "scenes", panels, methods, own_errors)


def _figure(
    path: Path, panels: Mapping[str, Sequence[Point]], methods: Sequence[str], own_errors: dict[str, float | None]
) -> None:
    import matplotlib as mpl
    from matplotlib.backends.backend_agg import FigureCanvasAgg
    from matplotlib.figure import Figure

    columns = min(len(panels), 4)
    rows = ceil(len(panels) / columns)
    single = len(panels) == 1
    width, height = (COLUMN, 3.4) if single else (1.85 * columns, 1.65 * rows + 0.4)
    with mpl.rc_context(_STYLE):
        figure = Figure(figsize=(width, height), layout="constrained")
        FigureCanvasAgg(figure)
        grid = figure.subplots(rows, columns, squeeze=False)
        for index, axes in enumerate(grid.flat):
            if index >= len(panels):
                axes.set_axis_off()
                continue
            title, points = list(panels.items())[index]
            _panel(axes, points, methods, own_errors.get(title), labels=single)
            axes.set_title(title, pad=4)
            if index + columns >= len(panels):
                axes.set_xlabel("render + denoise time (s)")
            if index % columns == 0:
                axes.set_ylabel("RelL2")
        _legend(figure, grid, max(3, columns + 1))
        with replacing(path.with_name(f"{path.name}.svg")) as unfinished:
            figure.savefig(unfinished, format="svg", metadata={"Date": None, "Creator": None})
        with replacing(path.with_name(f"{path.name}.png")) as unfinished:
            _save_png(figure, unfinished)


def _save_png(figure: Any, path: Path) -> None:
    """At 300 dpi, in 256 colours: a third of the size, and nobody sees it."""
    from io import BytesIO

    from PIL import Image

    buffer = BytesIO()
    figure.savefig(buffer, format="png", dpi=300)
    with Image.open(buffer) as image:
        image.convert("RGB").quantize(256).save(path, format="png", optimize=True, dpi=(300, 300))


def _panel(axes: Any, points: Sequence[Point], methods: Sequence[str], own: float | None, labels: bool) -> None:
    from matplotlib.ticker import LogLocator, NullFormatter

    axes.set_xscale("log")
    axes.set_yscale("log")
    axes.grid(which="major", color="#dddddd", linewidth=0.5)
    axes.set_axisbelow(True)
    front = pareto(points)
    steps_x = [p.total_ms / 1000 for p in front if p.total_ms]
    steps_y = [max(p.rell2, FLOOR) for p in front]
    for method in names(points, "method"):
        _curve(axes, [p for p in points if p.method == method], methods, method, labels)
    axes.step(steps_x, steps_y, where="post", color="#c8c8c8", linewidth=1.8, zorder=1, label="Pareto front")
    axes.plot(
        steps_x,
        steps_y,
        "o",
        color="none",
        markeredgecolor="#909090",
        markeredgewidth=0.6,
        markersize=6.5 if labels else 5,
    )
    if own:
        _shade(axes, FLAG * own, labels)
    for axis in (axes.xaxis, axes.yaxis):
        axis.set_major_locator(LogLocator(numticks=12))
        axis.set_minor_formatter(NullFormatter())
        axis.set_major_formatter("{x:g}")
    _decades(axes.xaxis)
    _decades(axes.yaxis)


def _shade(axes: Any, error: float, labels: bool) -> None:
    """What lies below an error, where the reference's own noise counts."""
    lowest = axes.get_ylim()[0]
    if error <= lowest:
        return
    text = f"within {FLAG}\N{MULTIPLICATION SIGN} of the reference's own error"
    axes.axhspan(lowest, error, color="#888888", alpha=0.12, linewidth=0, zorder=0, label=None if labels else text)
    axes.set_ylim(bottom=lowest)
    if labels:
        axes.annotate(text, (0.015, 0.015), xycoords="axes fraction", fontsize=6, color="#555555")


def _legend(figure: Any, grid: Any, columns: int) -> None:
    handles: dict[str, Any] = {}
    for axes in grid.flat:
        handles |= {label: handle for handle, label in zip(*axes.get_legend_handles_labels(), strict=True)}
    last = [label for label in handles if label.startswith(("Pareto", "within"))]
    order = [label for label in handles if label not in last] + last
    figure.legend(
        [handles[label] for label in order],
        order,
        loc="outside lower center",
        ncols=min(len(order), columns),
        frameon=False,
        columnspacing=1.4,
        handlelength=1.6,
    )


def _decades(axis: Any) -> None:
    """Name 2 and 5 as well where an axis spans about two decades or less, so that two numbers at least can be read."""
    from math import log10

    from matplotlib.ticker import LogLocator

    low, high = axis.get_view_interval()
    if log10(high / low) < 2.2:
        axis.set_major_locator(LogLocator(subs=(1, 2, 5), numticks=12))


def _curve(axes: Any, points: Sequence[Point], methods: Sequence[str], method: str, labels: bool) -> None:
    entries = timed(points)
    if not entries:
        return
    spread = [p.errors["rell2"] for _, _, p in entries]
    bars = (
        [max(error - max(s.low, FLOOR), 0) for (_, error, _), s in zip(entries, spread, strict=True)],
        [max(s.high - error, 0) for (_, error, _), s in zip(entries, spread, strict=True)],
    )
    number = methods.index(method)
    axes.errorbar(
        [seconds for seconds, _, _ in entries],
        [error for _, error, _ in entries],
        bars,
        color=color(methods, method),
        marker=MARKERS[number % len(MARKERS)],
        markersize=3.2 if labels else 2.4,
        linewidth=1.1 if labels else 0.9,
        elinewidth=0.6,
        capsize=1.2,
        zorder=3,
        label=method,
    )
    if labels and number == 0:  # the spp along one curve; the others have theirs in the same order
        for seconds, error, point in entries:
            axes.annotate(
                f"{point.spp} spp" if point is entries[0][2] else str(point.spp),
                (seconds, error),
                xytext=(4, 2),
                textcoords="offset points",
                fontsize=6,
                color="#444444",
            )
