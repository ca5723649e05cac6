"""The page of the demo: one HTML file that needs nothing else, with a before/after slider and a magnifier."""

from collections.abc import Mapping, Sequence
from pathlib import Path

from pathfold import metrics
from pathfold.pixels import ERROR_GAIN, error_map, png
from pathfold.report.html import data_uri, write_page

from demo import table
from demo.method import METRICS, Method, best
from demo.picture import caption_of


def save(
    path: Path,
    methods: Sequence[Method],
    scale: float,
    *,
    title: str,
    lead: str,
    notes: Sequence[str],
    facts: Mapping[str, str],
    before: str,
    after: str,
) -> None:
    """Write the page. `methods` ends with the reference; `before` and `after` name what the slider starts with."""
    reference = methods[-1].image
    views = [
        {
            "name": method.name,
            "caption": caption_of(method),
            "image": data_uri(png(metrics.display(method.image, scale))),
            "error": data_uri(png(error_map(metrics.flip_map(method.image, reference)))),
        }
        for method in methods
    ]
    measured = list(methods[:-1])
    rows = [
        [(text, column in _wins(measured, method)) for column, text in enumerate(row)]
        for method, row in zip(measured, table.cells(measured), strict=True)
    ]
    names = [method.name for method in methods]
    height, width = reference.shape[:2]
    write_page(
        path,
        Path(__file__).with_name("page.html"),
        title=title,
        lead=lead,
        notes=notes,
        facts=facts,
        views=views,
        header=table.HEADER,
        rows=rows,
        gain=ERROR_GAIN,
        width=width,
        height=height,
        before=names.index(before),
        after=names.index(after),
    )


def _wins(methods: list[Method], method: Method) -> set[int]:
    """The table columns in which a method is the best one."""
    return {column for column, metric in enumerate(METRICS, start=1) if best(methods, metric) is method}
