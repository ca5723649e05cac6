"""The demo: make demo, or PYTHONPATH=tools python -m demo [--out DIR] [--spp 8].

Renders the still life of scene.py with path descriptors, denoises it with the shipped models and with Open Image
Denoise, renders a reference with Mitsuba's own path tracer, and writes table.md, results.json, picture.png and
index.html. Times are medians after a warm-up; the denoisers take turns.
"""

import json
import sys
from collections.abc import Callable
from functools import partial
from importlib.util import find_spec
from pathlib import Path
from statistics import median
from time import perf_counter
from typing import Annotated, Any

import numpy as np
import typer
from numpy.typing import NDArray
from pathfold import metrics
from pathfold.bench import candidates, reference
from pathfold.bench.candidates import Candidate, Run
from pathfold.bench.machine import machine, versions
from pathfold.bench.reference import Reference
from pathfold.bench.run import make_folder
from pathfold.bench.shot import Shot
from pathfold.bench.timing import in_turns
from pathfold.cli import console
from pathfold.cli.render import parse_size
from pathfold.rendering import load_mitsuba

from demo import page, picture, table
from demo.method import Method

DEFAULT = "pathfold-balanced"
MODELS = ("kpcn-manifold", "pathfold-fast", DEFAULT, "pathfold-high")
DENOISERS = {"OIDN": "oidn", "OIDN, prefiltered": "oidn-prefiltered"} | {name: name for name in MODELS}  # by title
ROUNDS = 5
# Where to look closely, as shares of the frame: left, top, width (the height follows).
CROPS = ((0.15, 0.27, 0.16), (0.54, 0.38, 0.16), (0.71, 0.48, 0.16))
SEED = 1

Image = NDArray[np.float32]


def demo(
    out: Annotated[Path, typer.Option(help="Folder for the results.")] = Path("out/demo"),
    spp: Annotated[int, typer.Option(min=2, help="Samples per pixel of the noisy picture.")] = 8,
    size: Annotated[str, typer.Option(metavar="WxH")] = "384x256",
    reference_spp: Annotated[int, typer.Option(min=2, help="Of both halves together, at most.")] = 4096,
    seconds: Annotated[float, typer.Option(help="The reference ends when so much time has passed.")] = 240,
) -> None:
    """Render, denoise, compare; write a table, a picture and a page."""
    start = perf_counter()
    make_folder(out)
    check_packages()
    found = {title: candidates.find(argument) for title, argument in DENOISERS.items()}
    runs = {title: candidate.load() for title, candidate in found.items()}
    load_mitsuba("llvm_ad_rgb")
    from demo.scene import MAX_DEPTH, still_life  # needs the variant

    width, height = parse_size(size) or (384, 256)
    scene = still_life(width, height)
    console.say(f"rendering {width}x{height} at {spp} spp")
    shot = shoot(scene, spp, MAX_DEPTH, {min(spp, candidate.path_samples) for candidate in found.values()})
    plain_ms = median(shot.render_ms[0])

    console.say("denoising")
    denoised = [
        Method(title, image, render_ms=median(shot.rendering_for(found[title])), denoise_ms=ms)
        for title, (ms, image) in turns({t: denoising(found[t], runs[t], shot) for t in found}, ROUNDS).items()
    ]
    same_time = equal_time(scene, spp, next(method.total_ms or 0 for method in denoised if method.name == DEFAULT))
    noisy = Method(f"{spp} spp", shot.buffers["color"], render_ms=plain_ms)
    methods = [noisy, same_time, *denoised]

    console.say("rendering the reference")
    with console.progress("reference") as bar:
        right = reference.render(scene, reference_spp, start + seconds - perf_counter(), bar)
    for method in methods:
        method.errors = right.errors(method.image)
    last = Method("reference", right.mean, note=f"{right.spp} spp")
    write(out, [*methods, last], spp, notes_of(methods, right), facts_of(scene, spp, MAX_DEPTH))
    show(methods, out, perf_counter() - start)


def shoot(scene: Any, spp: int, max_depth: int, recorded: set[int]) -> Shot:
    """The noisy frame with the most recorded paths; the times to render it with each number of them, and with none."""
    renders: dict[Any, Callable[[], Any]] = {
        count: partial(traced, scene, spp, max_depth, count) for count in sorted({0, *recorded})
    }
    rendered = {count: render() for count, render in renders.items()}
    return Shot(rendered[max(rendered)], spp, in_turns(renders, 3))


def traced(scene: Any, spp: int, max_depth: int, recorded: int) -> dict[str, Any]:
    """Per-pixel buffers and the block of the first `recorded` samples."""
    from pathfold.mitsuba import trace  # needs the variant

    samples = trace(scene, spp, SEED, max_depth, recorded=recorded)
    buffers = samples.reduce()
    buffers.pop("dropped")
    block = {"samples.descriptor": samples.descriptor, "samples.density": samples.density} if recorded else {}
    return buffers | block


def denoising(candidate: Candidate, run: Run, shot: Shot) -> Callable[[], Image]:
    read = {name: pixels for name, pixels in shot.buffers.items() if name in candidate.reads}
    return lambda: run(read, None, shot.spp)


def turns(calls: dict[Any, Callable[[], Any]], rounds: int) -> dict[Any, tuple[float, Any]]:
    """Median milliseconds of every call after a warm-up, and what that gave."""
    results = {name: call() for name, call in calls.items()}
    took = in_turns(calls, rounds)
    return {name: (median(took[name]), results[name]) for name in calls}


def equal_time(scene: Any, spp: int, budget_ms: float) -> Method:
    """Mitsuba's own path tracer with as many samples as take `budget_ms`, what rendering and DEFAULT took."""
    import mitsuba as mi

    def render(count: int) -> Image:
        return np.array(mi.render(scene, spp=count, seed=mi.UInt32(SEED)), np.float32)[..., :3]

    ((ms, _),) = turns({spp: lambda: render(spp)}, 3).values()
    count = max(1, round(spp * budget_ms / ms))
    start = perf_counter()
    image = render(count)
    return Method(f"{count} spp, as long as {DEFAULT}", image, render_ms=1000 * (perf_counter() - start))


def notes_of(methods: list[Method], reference: Reference) -> list[str]:
    """What a reader must know to judge the table."""
    own_error = reference.own_error or 0
    notes = [
        f"RelL2 is taken against two independent halves of the reference ({reference.spp} spp together), whose own "
        f"noise drops out; the reference's own RelL2 is {own_error:.5f}. The other three see the whole reference.",
        "Rendering for the OIDN rows gives buffers alone; for the rows of models it gives path "
        "descriptors as well; the second row is Mitsuba's own path tracer with its usual Russian roulette, in the time "
        f"of {DEFAULT}. OIDN runs at quality high: with the noisy guides, and with guides prefiltered and "
        "cleanAux.",
    ]
    best = min(method.errors["rell2"] for method in methods)
    if best < 20 * own_error:
        notes.append("The best method comes within 20 times the reference's own error: small differences are noise.")
    return notes


def facts_of(scene: Any, spp: int, max_depth: int) -> dict[str, str]:
    """How and on what it was made."""
    width, height = scene.sensors()[0].film().size()
    return {
        "Scene": "a still life made of formulas, CC0 1.0 (tools/demo/scene.py)",
        "Picture": f"{width}x{height}, {spp} samples per pixel, paths of up to {max_depth} segments, seed {SEED}",
        "Machine": machine(),
        "Software": ", ".join(f"{name} {number}" for name, number in versions().items()),
        "Display": "(s x / (1 + s x))^(1/2.2), the reference's log-average luminance at 0.18",
        "Made by": "make demo",
    }


def check_packages() -> None:
    """Find out now, not after minutes, what is not installed."""
    for package in ("mitsuba", "pyoidn", "flip_evaluator", "skimage", "jinja2", "matplotlib"):
        if find_spec(package) is None:
            raise ModuleNotFoundError(f"the demo needs {package}: pip install 'pathfold[mitsuba,bench]'")


def write(out: Path, methods: list[Method], spp: int, notes: list[str], facts: dict[str, str]) -> None:
    """Write the four files into a folder; `methods` ends with the reference."""
    measured, last = methods[:-1], methods[-1]
    scale = metrics.exposure(last.image)
    height, width = last.image.shape[:2]
    crops = [(int(x * width), int(y * height), int(w * width), int(w * width)) for x, y, w in CROPS]
    picture.save(out / "picture.png", methods, crops, scale)
    page.save(
        out / "index.html",
        methods,
        scale,
        title=f"A still life at {spp} samples per pixel",
        lead="Traced with Mitsuba 3 and denoised on the CPU. Left and right are yours to choose; "
        "drag the divider, or use the arrow keys on the slider.",
        notes=notes,
        facts=facts,
        before=methods[0].name,
        after=measured[-1].name,
    )
    text = "\n\n".join([table.markdown(measured), *notes, *(f"{name}: {value}" for name, value in facts.items())])
    (out / "table.md").write_text(text + "\n", encoding="utf-8")
    data = {"methods": table.records(measured), "notes": notes, "facts": facts}
    (out / "results.json").write_text(json.dumps(data, indent=2) + "\n", encoding="utf-8")


def show(methods: list[Method], out: Path, seconds: float) -> None:
    from rich.console import Console

    Console(width=112).print(table.terminal(methods, ""))
    console.say(f"{seconds:.0f} s; see {out / 'index.html'}, {out / 'picture.png'}, {out / 'table.md'}")


if __name__ == "__main__":
    program = typer.Typer(add_completion=False, pretty_exceptions_enable=False)
    program.command()(demo)
    sys.exit(console.run(program))
