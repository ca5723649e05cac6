"""`pathfold check`: is a model numerically stable?"""

import json
from typing import Annotated

import typer
from rich.console import Console
from rich.table import Table
from rich.text import Text

from pathfold import models
from pathfold._core import version
from pathfold.check import NOT_CHECKED, Report, check_model
from pathfold.check.outcome import Row
from pathfold.cli import console

WIDTH = 110  # where the output is no terminal


def check(
    model: Annotated[
        list[str] | None,
        typer.Option(
            "-m", "--model", help="A model's name or folder; repeat for more. Default: all that can be named."
        ),
    ] = None,
    provider: Annotated[str, typer.Option("--provider", help="The onnxruntime execution provider.")] = "cpu",
    as_json: Annotated[bool, typer.Option("--json", help="Print one JSON object.")] = False,
) -> None:
    """Run stiff and extreme frames through models: against float64 references, and as properties.

    A model with an int8 variant is run in both: in int8 frames are compared with fp32.

    Exit code 0 if everything passes, else 1.
    """
    reports = []
    for name in model or list(models.available()):
        for precision in models.precisions(name):
            with console.progress(f"{name}, {precision}") as bar:
                reports.append(check_model(name, provider, precision, bar))
            if not as_json:
                say(reports[-1])
    passed = all(report.passed for report in reports)
    if as_json:
        records = [report.record() for report in reports]
        head = {"pathfold": version(), "provider": provider, "passed": passed, "not_checked": NOT_CHECKED}
        console.say(json.dumps({**head, "models": records}))
    else:
        for what in NOT_CHECKED:
            console.say(f"not checked: {what}")
    if not passed:
        raise typer.Exit(console.FAILED)


def say(report: Report) -> None:
    """The table of one model, and what it does not show."""
    terminal = Console()
    terminal = terminal if terminal.is_terminal else Console(width=WIDTH)
    terminal.print(table(report))
    failed = sum(bool(row.reason) for row in report.rows)
    total = len(report.rows)
    console.say(f"{report.model}, {report.precision}: {f'{failed} of {total} fail' if failed else f'all {total} pass'}")
    if report.note:
        console.say(f"  {report.note}")
    if report.skipped:
        console.say(f"  left out, as the model reads no such buffer: {', '.join(report.skipped)}")


def table(report: Report) -> Table:
    """A rich table, a row for each case and property."""
    made = Table(title=plain(f"{report.model}, {report.precision}"), title_justify="left")
    made.add_column("case", no_wrap=True)
    made.add_column(f"relative\nerror, {report.precision}", justify="right", no_wrap=True)
    made.add_column("worst\npixel", justify="right", no_wrap=True)
    made.add_column("finite", no_wrap=True)
    made.add_column("within\nwindow", no_wrap=True)
    made.add_column("verdict")
    for row in report.rows:
        made.add_row(*map(plain, cells(row)), style="red" if row.reason else None)
    return made


def plain(text: str) -> Text:
    """Text of files and models as it is: neither markup nor control characters."""
    return Text(console.harmless(text))


def cells(row: Row) -> list[str]:
    error = "" if row.error is None else f"{row.error:.1e}" if row.error else "0"
    worst = f"{row.worst[1]}, {row.worst[0]}" if row.worst else ""
    told = row.error is not None and row.allowed is None  # a figure that is held to nothing
    return [row.name, error, worst, yes(row.finite), yes(row.bounded), row.reason or ("told" if told else "pass")]


def yes(value: bool) -> str:
    return "yes" if value else "no"
