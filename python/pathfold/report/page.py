"""The page of a report: one HTML file that needs nothing else, with a before/after slider and a magnifier."""

from base64 import b64encode
from collections.abc import Mapping, Sequence
from importlib.resources import files
from pathlib import Path
from typing import Any

from pathfold import metrics
from pathfold.images import replacing
from pathfold.pixels import png
from pathfold.report import tables
from pathfold.report.method import METRICS, Method, best
from pathfold.report.picture import caption_of

ERROR_GAIN = 4  # FLIP errors of denoised pictures are small; the map is white from 1/4 on


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
    from matplotlib import colormaps

    reference = methods[-1].image
    views = [
        {
            "name": method.name,
            "caption": caption_of(method),
            "image": data_uri(png(metrics.display(method.image, scale))),
            "error": data_uri(png(colormaps["magma"](ERROR_GAIN * metrics.flip_map(method.image, reference))[..., :3])),
        }
        for method in methods
    ]
    measured = list(methods[:-1])
    rows = [
        [(text, column in _wins(measured, method)) for column, text in enumerate(row)]
        for method, row in zip(measured, tables.cells(measured), strict=True)
    ]
    names = [method.name for method in methods]
    height, width = reference.shape[:2]
    write_page(
        path,
        "page.html",
        title=title,
        lead=lead,
        notes=notes,
        facts=facts,
        views=views,
        header=tables.HEADER,
        rows=rows,
        gain=ERROR_GAIN,
        width=width,
        height=height,
        before=names.index(before),
        after=names.index(after),
    )


def write_page(path: Path, template: str, **values: Any) -> None:
    """Fill in a template of this package, with what it includes, and write it."""
    from jinja2 import Environment, FunctionLoader

    loader = FunctionLoader(lambda name: (files(__package__) / name).read_text(encoding="utf-8"))
    environment = Environment(autoescape=True, trim_blocks=True, lstrip_blocks=True, loader=loader)
    with replacing(path) as unfinished:
        unfinished.write_text(environment.get_template(template).render(**values), encoding="utf-8")


def _wins(methods: list[Method], method: Method) -> set[int]:
    """The table columns in which a method is the best one."""
    return {column for column, metric in enumerate(METRICS, start=1) if best(methods, metric) is method}


def data_uri(content: bytes, kind: str = "png") -> str:
    return f"data:image/{kind};base64,{b64encode(content).decode('ascii')}"
