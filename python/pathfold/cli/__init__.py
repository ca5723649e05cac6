"""The `pathfold` command.

Exit codes: 0 done; 1 something failed; 2 wrong usage; 3 an input cannot be used; 4 a model, a package or an
execution provider is missing or broken; 5 the output cannot be written; 130 interrupted. Every error is one
line on stderr. Progress goes to stderr, and only where that is a terminal.
"""

import signal
import sys
from typing import Annotated

import typer

from pathfold._core import version
from pathfold.cli import console
from pathfold.cli.bench import bench
from pathfold.cli.check import check
from pathfold.cli.compare import compare
from pathfold.cli.denoise import denoise
from pathfold.cli.info import info
from pathfold.cli.plan import plan
from pathfold.cli.render import render

app = typer.Typer(
    add_completion=False,
    no_args_is_help=True,
    pretty_exceptions_enable=False,
    context_settings={"help_option_names": ["-h", "--help"]},
    epilog="Exit codes: 0 done, 1 failed, 2 usage, 3 input, 4 model or package, 5 output, 130 interrupted.",
)
for command in (denoise, render, info, compare, bench, plan, check):
    app.command(no_args_is_help=command not in (info, check))(command)


def _version(wanted: bool) -> None:
    if wanted:
        console.say(f"pathfold {version()}")
        raise typer.Exit


@app.callback()
def _root(
    version: Annotated[
        bool, typer.Option("--version", callback=_version, is_eager=True, help="Print the version and leave.")
    ] = False,
) -> None:
    """Denoise Monte Carlo renderings with what their paths tell."""


def main() -> None:
    """Run the command line and leave with its exit code."""
    # Asked to end, unwind: an unfinished output is removed on the way.
    signal.signal(signal.SIGTERM, lambda number, _: sys.exit(128 + number))
    sys.exit(console.run(app))
