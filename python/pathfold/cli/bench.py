"""`pathfold bench`: error against run time, of every method on your scenes."""

import sys
from importlib.util import find_spec
from pathlib import Path
from typing import Annotated

import typer
from rich.console import Console
from rich.progress import BarColumn, Progress, TextColumn, TimeElapsedColumn, TimeRemainingColumn

from pathfold.bench import candidates, run, subjects
from pathfold.bench.about import About, command
from pathfold.cli import console
from pathfold.cli.console import InputError
from pathfold.plan import curves
from pathfold.report import write


def bench(
    scenes: Annotated[
        list[Path],
        typer.Argument(metavar="SCENE...", help="scene.xml, a folder with one, a folder of EXRs, or frames.####.exr."),
    ],
    out: Annotated[Path, typer.Option("-o", "--output", metavar="DIR", help="Folder for the results.")],
    spp: Annotated[str, typer.Option(metavar="N,N,...", help="Samples per pixel to render.")] = "1,2,4,8,16,32,64",
    methods: Annotated[
        str | None,
        typer.Option(
            metavar="NAME,...",
            help="noisy, oidn, oidn-fast, oidn-prefiltered, models (MODEL, MODEL:int8); default: all but oidn-fast.",
        ),
    ] = None,
    seeds: Annotated[int, typer.Option(min=1, help="Renderings of each scene and spp.")] = 3,
    reference_spp: Annotated[
        int, typer.Option(min=2, metavar="N", help="Of a reference that has to be rendered, at most.")
    ] = 4096,
    reference_seconds: Annotated[float, typer.Option(min=0, metavar="T", help="Time for a reference, at most.")] = 600,
    quiet: Annotated[bool, typer.Option("-q", "--quiet", help="Print errors only.")] = False,
) -> None:
    """Measure error, time and memory of every method, and write a table, plots and a page.

    Scenes are rendered here; a reference.exr beside a scene is used, else one is rendered. A folder of EXRs needs a
    reference.exr. What DIR holds already is kept, so the same command goes on after an interruption.
    """
    check_packages()
    options = subjects.Options(
        spps=parse_numbers(spp),
        seeds=seeds,
        reference_spp=reference_spp,
        reference_seconds=reference_seconds,
        references=out / run.REFERENCES,
    )
    names = [name.strip() for name in methods.split(",") if name.strip()] if methods else candidates.default_arguments()
    if not names:
        raise typer.BadParameter("names none; leave it away to measure all", param_hint="'--methods'")
    chosen = candidates.find_all(names)
    try:
        found = subjects.find_all(scenes, options)
    except subjects.SubjectError as error:
        raise InputError(str(error)) from error
    run.make_folder(out)
    pictures = out / run.PICTURES
    try:
        with Bar(quiet) as bar:
            measurements, problems = run.measure(found, chosen, out, pictures, bar.tell)
    except KeyboardInterrupt:
        said = f"interrupted; what was measured is in {out / run.RESULTS}: the same command goes on"
        raise console.StoppedError(said) from None
    if not measurements:
        raise InputError(f"nothing could be measured: {problems[0] if problems else 'there is no scene'}")
    About(command(["pathfold", *sys.argv[1:]]), tuple(map(str, problems))).save(out)
    write.write(out, pictures)
    curves.save(out / curves.FILE, curves.samples(measurements))
    if not quiet:
        show(out, write.said(measurements))
    if problems:
        raise typer.Exit(console.FAILED)


class Bar:
    """Tells of a bench while it runs: a bar with the time left on a terminal; problems at once."""

    def __init__(self, quiet: bool) -> None:
        terminal = Console(stderr=True)
        columns = (TextColumn("{task.description}"), BarColumn(), TimeElapsedColumn(), TextColumn("left"))
        self._bar = Progress(
            *columns,
            TimeRemainingColumn(),
            console=terminal,
            transient=True,
            disable=quiet or not terminal.is_terminal,
            speed_estimate_period=1800,
        )
        self._task = self._bar.add_task("bench", total=None)

    def __enter__(self) -> "Bar":
        self._bar.start()
        return self

    def __exit__(self, *_: object) -> None:
        self._bar.stop()

    def tell(self, event: run.Progress | run.Problem, total: float) -> None:
        if isinstance(event, run.Problem):
            console.complain(f"left out: {event}")
        else:
            self._bar.update(self._task, advance=event.work, total=total, description=event.text)


def parse_numbers(text: str) -> tuple[int, ...]:
    """ "1,2,4" as (1, 2, 4), ascending."""
    try:
        numbers = sorted({int(part) for part in text.split(",")})
    except ValueError:
        numbers = [0]
    if numbers[0] < 1:
        raise typer.BadParameter(f"--spp {text}: write whole numbers above 0 with commas between them, say 1,4,16")
    return tuple(numbers)


def check_packages() -> None:
    """Find out now, not after hours, what is not installed."""
    for package in ("flip_evaluator", "skimage", "jinja2", "matplotlib"):
        if find_spec(package) is None:
            raise ModuleNotFoundError(f"bench needs {package}: pip install 'pathfold[mitsuba,bench]'")


def show(out: Path, sentences: list[str]) -> None:
    for sentence in sentences:
        console.say(sentence)
    console.say(f"see {out / 'index.html'}, {out / 'table.md'}, {out / 'plots'}")
