"""`pathfold plan`: which spp and which method reach an error at the least cost, or the least error in a time."""

import json
import sys
from math import isfinite
from pathlib import Path
from typing import Annotated, Any

import typer
from rich.box import SIMPLE_HEAD
from rich.console import Console
from rich.table import Table

from pathfold.bench.about import command
from pathfold.bench.candidates import NOISY, PEERS
from pathfold.cli import console
from pathfold.cli.console import InputError
from pathfold.cli.render import parse_size
from pathfold.plan import check as checking
from pathfold.plan import choose, curves
from pathfold.plan.choose import Advice, Plan
from pathfold.plan.curves import Sample
from pathfold.plan.prediction import Estimate, Prediction, held

WIDTH = 100  # where the output is no terminal
MARKS = (("\N{RIGHTWARDS ARROW}", "bold"), ("\N{MULTIPLICATION SIGN}", "dim"))


def positive(value: float | None) -> float | None:
    if value is not None and not 0 < value < float("inf"):
        raise typer.BadParameter(f"{value:g} is not > 0 and finite")
    return value


def plan(
    scene: Annotated[Path | None, typer.Argument(metavar="SCENE.xml", help="A Mitsuba 3 scene.")] = None,
    error: Annotated[
        float | None, typer.Option(metavar="E", callback=positive, help="Reach this RelL2 in the least time.")
    ] = None,
    seconds: Annotated[
        float | None, typer.Option(metavar="T", callback=positive, help="The least error in this time.")
    ] = None,
    measurements: Annotated[
        Path | None,
        typer.Option(metavar="DIR", help="What `bench` wrote: its folder, or a file of it. Default: ours."),
    ] = None,
    size: Annotated[str | None, typer.Option(metavar="WxH", help="Instead of the film's own size.")] = None,
    check: Annotated[
        bool, typer.Option("--check", help="No scene: predict each measured one from the others.")
    ] = False,
    as_json: Annotated[bool, typer.Option("--json", help="Print one JSON object.")] = False,
) -> None:
    """Tell the spp, method and engine to render a scene with, from a small rendering of it and from measured scenes.

    Without --error and --seconds: all that no other beats in both.
    """
    if check == (scene is not None):
        raise typer.BadParameter("either name a SCENE.xml to plan for, or give --check and no scene")
    if error is not None and seconds is not None:
        raise typer.BadParameter("give --error or --seconds, not both")
    if check and (as_json or size is not None or error is not None or seconds is not None):
        raise typer.BadParameter("--check takes --measurements alone")
    measured = load(measurements)
    if check:
        for line in checking.markdown(measured, command(["pathfold", *sys.argv[1:]])).splitlines():
            console.say(line)
        return
    assert scene is not None
    film = parse_size(size)
    try:
        with console.progress(f"look at {scene.name}", quiet=as_json):
            found = choose.look(scene, measured, film)
        advice = target(found, error, seconds)
    except choose.PlanError as problem:
        raise InputError(f"{scene}: {problem}") from problem
    if as_json:
        console.say(json.dumps(record(found, advice)))
    else:
        show(scene, found, advice)


def load(path: Path | None) -> list[Sample]:
    """The measurements to plan from; those that come with the package where none are named."""
    if path is None and not curves.SHIPPED.is_file():
        raise InputError(
            "no measurements come with this pathfold; name a folder of `pathfold bench`: --measurements DIR"
        )
    return curves.read(path or curves.SHIPPED)


def target(found: Plan, error: float | None, seconds: float | None) -> Advice:
    if error is not None:
        return choose.cheapest(found, error)
    if seconds is not None:
        return choose.best(found, seconds)
    return choose.front(found)


def show(scene: Path, found: Plan, advice: Advice) -> None:
    width, height = found.size
    console.say(f"{scene}: {width}x{height}; its noise at one sample per pixel is RelL2 {found.noise:.3g}")
    terminal = Console()
    terminal = terminal if terminal.is_terminal else Console(width=WIDTH)
    terminal.print(table(advice))
    for sentence in words(found, advice):
        console.say(sentence)


def table(advice: Advice) -> Table:
    """A rich table; the chosen row in bold with an arrow, methods that miss the target dim with a cross."""
    made = Table(box=SIMPLE_HEAD, padding=(0, 1, 0, 0))
    for title in ("", "method", "engine"):
        made.add_column(title, no_wrap=True)
    for title in ("spp", "RelL2", "may be", "seconds", "may be"):
        made.add_column(title, justify="right", no_wrap=True)
    for point in [*advice.reached, *advice.missed]:
        mark, style = MARKS[0] if point is advice.chosen else MARKS[1] if point in advice.missed else ("", None)
        costs = [text for value in (point.rell2, point.seconds) for text in (figure(value.value, 3), span(value))]
        made.add_row(mark, console.harmless(point.method), engine(point.method), str(point.spp), *costs, style=style)
    if advice.missed:
        made.caption, made.caption_justify = f"{MARKS[1][0]} misses the target; its nearest", "left"
    return made


def span(value: Estimate) -> str:
    return f"{figure(value.low)} to {figure(value.high)}" if isfinite(value.factor) else "?"


def figure(value: float, digits: int = 2) -> str:
    """So many digits, and no exponent where the number is large."""
    return f"{value:,.0f}" if value >= 10**digits else f"{value:.{digits}g}"


def engine(method: str) -> str:
    return "" if method == NOISY else "OIDN" if method in PEERS else "onnxruntime"


def words(found: Plan, advice: Advice) -> list[str]:
    """The advice, and how sure it is."""
    said = []
    chosen, safe = advice.chosen, advice.safe
    if chosen:
        way = f"denoise with {chosen.method}" if engine(chosen.method) else "leave it noisy"
        said.append(
            f"Render {chosen.spp} spp and {way}: RelL2 about {figure(chosen.rell2.value)} "
            f"in about {figure(chosen.seconds.value)} s."
        )
        if safe:
            said.append(
                f"To stay below it at the upper end of the range: {safe.method} at {safe.spp} spp, "
                f"about {figure(safe.seconds.value)} s."
            )
    said.append(sure(chosen or advice.reached[-1]))
    low, high = found.measured_noise
    if not low <= found.noise <= high:
        said.append(
            f"Less sure than that: no measured scene is so {'noisy' if found.noise > high else 'clean'} "
            f"(RelL2 {low:.2g} to {high:.2g} at one sample per pixel)."
        )
    said += [f"Left out: {method}: {why}" for method, why in found.left_out.items()]
    return said


def sure(point: Prediction) -> str:
    if not isfinite(point.rell2.factor):
        return "How sure cannot be told: it takes two measured scenes to predict one from another."
    return (
        f"How sure: of {point.scenes} measured scenes, each predicted from the others, {held(point.scenes)} came "
        f"within a factor of {point.rell2.factor:.2f} of the error and as many within {point.seconds.factor:.2f} of "
        f"the time of {point.method} at such an spp."
    )


def record(found: Plan, advice: Advice) -> dict[str, Any]:
    """A plan as plain data; where a range is not known, it is null."""
    return {
        "size": list(found.size),
        "noise": found.noise,
        "measured_noise": list(found.measured_noise),
        "chosen": advice.chosen and point_record(advice.chosen),
        "safe": advice.safe and point_record(advice.safe),
        "reached": [point_record(point) for point in advice.reached],
        "missed": [point_record(point) for point in advice.missed],
        "left_out": found.left_out,
    }


def point_record(point: Prediction) -> dict[str, Any]:
    def ends(value: Estimate) -> list[float] | None:
        return [value.low, value.high] if isfinite(value.factor) else None

    return {
        "method": point.method,
        "engine": engine(point.method) or None,
        "spp": point.spp,
        "rell2": point.rell2.value,
        "rell2_range": ends(point.rell2),
        "seconds": point.seconds.value,
        "seconds_range": ends(point.seconds),
        "scenes": point.scenes,
    }
