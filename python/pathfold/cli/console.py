"""What the commands share: talking to the terminal, progress, errors in one line and their exit codes."""

import re
import signal
import sys
import threading
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from typing import Any

import typer
from rich.console import Console
from rich.progress import BarColumn, Progress, TextColumn, TimeRemainingColumn

from pathfold._core import PathfoldError
from pathfold.images import ImageError, OutputError
from pathfold.rendering import SceneError

FAILED, USAGE, INPUT, MODEL, OUTPUT, INTERRUPTED = 1, 2, 3, 4, 5, 130
_CODES = {
    "invalid-argument": INPUT,
    "not-found": MODEL,
    "invalid-model": MODEL,
    "engine": MODEL,
    "unsupported": MODEL,
    "cancelled": INTERRUPTED,
}


class InputError(RuntimeError):
    """An input that a command cannot use; the message names it and the cure."""


class StoppedError(RuntimeError):
    """Ctrl-C; the message says what there is and how to go on."""


_interrupts: list[int] = []  # signals that came: Dr.Jit now and then drops the exception that stands for one


@contextmanager
def _noting_interrupts() -> Iterator[None]:
    def note(number: int, _frame: Any) -> None:
        _interrupts.append(number)
        raise KeyboardInterrupt

    _interrupts.clear()
    before = signal.getsignal(signal.SIGINT)
    main = threading.current_thread() is threading.main_thread()  # which alone gets signals
    if not main or before is not signal.default_int_handler:  # a job in a shell's background is to ignore it
        yield
        return
    signal.signal(signal.SIGINT, note)
    try:
        yield
    finally:
        signal.signal(signal.SIGINT, before)


# Names in files and models are anybody's: what would steer a terminal or turn its text around is shown by its code.
_STEERING = re.compile("[\x00-\x1f\x7f-\x9f\u061c\u200e\u200f\u2028-\u202e\u2066-\u2069\ud800-\udfff]")


def harmless(text: str) -> str:
    """The text with control characters, lone surrogates and marks of direction written as escapes."""
    return _STEERING.sub(lambda found: found.group().encode("unicode_escape").decode(), text)


def say(text: str) -> None:
    """One line on stdout."""
    print(harmless(text), flush=True)


def complain(error: object, program: str = "pathfold") -> None:
    """One line on stderr; nothing where typer has said it all by printing the help."""
    text = error.format_message() if hasattr(error, "format_message") else str(error) or type(error).__name__
    if text:
        print(f"{program}: {harmless(' '.join(text.split()))}", file=sys.stderr, flush=True)


def exit_code(error: Exception) -> int | None:
    """The exit code of an error that is expected to happen; None for a fault of the program itself."""
    if isinstance(error, typer.Abort | StoppedError):
        return INTERRUPTED
    if hasattr(error, "format_message"):  # typer's own usage errors
        return USAGE
    if isinstance(error, PathfoldError):
        return _CODES.get(error.code, FAILED)
    kinds: dict[type[Exception], int] = {
        ImageError: INPUT,
        InputError: INPUT,
        SceneError: INPUT,
        OutputError: OUTPUT,
        ModuleNotFoundError: MODEL,
        MemoryError: FAILED,
    }
    return next((code for kind, code in kinds.items() if isinstance(error, kind)), None)


def run(app: typer.Typer, program: str = "pathfold", mendable: tuple[type[Exception], ...] = ()) -> int:
    """Run a typer application and return its exit code; expected errors become one line on stderr.

    Besides those that `exit_code` knows these are the `mendable` ones, whose code is FAILED.
    """
    try:
        with _noting_interrupts():
            code = app(standalone_mode=False) or 0  # typer makes INTERRUPTED of most interrupts
    except KeyboardInterrupt:
        code = INTERRUPTED
    except Exception as error:
        known = exit_code(error)
        if known is None and not isinstance(error, mendable):
            raise
        complain(error, program)
        return FAILED if known is None else known
    if code == INTERRUPTED:
        complain("interrupted; no file was left half written", program)
    return code


def check_exposure(value: float | None) -> float | None:
    """Callback of --exposure: refuses what no run could use, before any work."""
    if value is not None and not 0 < value < float("inf"):
        raise typer.BadParameter(f"{value:g} is not > 0 and finite; leave --exposure away to take it from the picture")
    return value


def check_model(name: str | None) -> str | None:
    """Callback of options that name a model: refuses an empty name, which would stand for none given."""
    if name == "":
        raise typer.BadParameter("is empty; name a model or a folder, or leave the option away")
    return name


@contextmanager
def usage() -> Iterator[None]:
    """Around what is given options alone: those that the SDK refuses are wrong usage, not an input."""
    try:
        yield
    except PathfoldError as error:
        if error.code != "invalid-argument":
            raise
        raise typer.BadParameter(str(error)) from error


@contextmanager
def progress(title: str, quiet: bool = False) -> Iterator[Callable[[float], None]]:
    """A bar on stderr that is told the fraction done; silent where stderr is no terminal."""
    terminal = Console(stderr=True)
    columns: tuple[Any, ...] = (TextColumn("{task.description}", markup=False), BarColumn(), TimeRemainingColumn())
    with Progress(*columns, console=terminal, transient=True, disable=quiet or not terminal.is_terminal) as bar:
        task = bar.add_task(harmless(title), total=1.0)

        def tell(done: float) -> None:
            if _interrupts:
                raise KeyboardInterrupt
            bar.update(task, completed=done)

        yield tell
