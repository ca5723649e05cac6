"""The table of the demo: for the terminal, as Markdown and as data."""

from typing import Any

from pathfold.report import tables

from demo.method import METRICS, TITLES, Method, best

HEADER = ("", *(TITLES[metric] for metric in METRICS), "render ms", "denoise ms", "total ms")


def cells(methods: list[Method]) -> list[list[str]]:
    """One row of text per method, in the order of HEADER."""
    return [
        [
            method.name,
            *(figure(method.errors.get(metric)) for metric in METRICS),
            *(tables.whole(value) for value in (method.render_ms, method.denoise_ms, method.total_ms)),
        ]
        for method in methods
    ]


def markdown(methods: list[Method]) -> str:
    """A Markdown table; the best value of each metric in bold."""
    rows = cells(methods)
    for column, metric in enumerate(METRICS, start=1):
        winner = best(methods, metric)
        for row, method in zip(rows, methods, strict=True):
            row[column] = f"**{row[column]}**" if method is winner else row[column]
    return tables.markdown([list(HEADER), *rows])


def terminal(methods: list[Method], title: str) -> Any:
    """A rich table."""
    from rich.table import Table

    table = Table(title=title, title_justify="left")
    for number, name in enumerate(HEADER):
        table.add_column(name, justify="right" if number else "left", no_wrap=True)
    for row in cells(methods):
        table.add_row(*row)
    return table


def records(methods: list[Method]) -> list[dict[str, Any]]:
    """The table as plain data, for JSON."""
    return [
        {
            "name": method.name,
            **method.errors,
            "render_ms": method.render_ms,
            "denoise_ms": method.denoise_ms,
            "note": method.note,
        }
        for method in methods
    ]


def figure(value: float | None) -> str:
    return "" if value is None else f"{value:.4f}"
