"""What rendering and denoising only what is needed saves: `render --auto` and the default against everything.

    python benchmarks/lean_render.py [SCENES/validation] [--model A B ... --spp 8 --width 320 --rounds 5]

The scenes are those of tests/lean_scenes.py, each of which needs less in another way, and those of the folder.
`full` makes all that any shipped model reads and leaves nothing out; `lean` is `render --auto` for the model and
`leave_out="all"`. Times are medians by turns; `difference` is the largest of |lean - full| / (|full| + 0.01 mean), to
be below 1e-5.
"""

import argparse
import sys
import tempfile
import time
from collections.abc import Callable, Sequence
from functools import partial
from pathlib import Path
from statistics import median
from typing import Any

import numpy as np
import pages
from pathfold import Denoiser, lean, models
from pathfold.bench import candidates
from pathfold.rendering import Renderer
from pathfold.report.tables import markdown

SEED, MAX_DEPTH = 1, 8


def lean_scenes(folder: Path) -> dict[str, tuple[Path, int | None]]:
    """The scenes of the tests by name, written into a folder, and the samples per pixel that they are about."""
    sys.path.insert(0, str(Path(__file__).parent.parent / "tests"))
    from lean_scenes import SCENES, make_scene

    found = {}
    for number, (name, (things, spp, _)) in enumerate(SCENES.items()):
        found[name] = make_scene(folder / f"{number}.xml", things), 1 if spp == 1 else None
    return found


def in_turn(calls: dict[str, Callable[[], None]], rounds: int) -> dict[str, float]:
    """Median seconds of each call, the calls in turn after one to warm up."""
    took: dict[str, list[float]] = {name: [] for name in calls}
    for turn in range(rounds + 1):
        for name, call in calls.items():
            start = time.perf_counter()
            call()
            if turn:
                took[name].append(time.perf_counter() - start)
    return {name: median(times) for name, times in took.items()}


def measure(path: Path, model: str, spp: int, width: int, rounds: int) -> dict[str, Any]:
    """One scene with one model: median seconds, the difference of the pictures, and what `render --auto` left out."""
    renderer = Renderer(path, "llvm_ad_rgb", 0, None)
    renderer.use(0, (width, max(1, round(width * renderer.size[1] / renderer.size[0]))))
    reads, everything = models.inputs(model), models.shipped_inputs()
    settings = (spp, SEED, MAX_DEPTH, None)
    frames: dict[str, lean.LeanFrame] = {}

    def trace(name: str) -> None:
        frames.pop(name, None)  # one block of samples at a time
        if name == "lean":
            frames[name] = lean.trace(renderer, *settings, reads, lambda done: None, models.path_samples(model))
        else:
            frames[name] = lean.LeanFrame(
                *renderer.trace(*settings, everything, lambda done: None, models.shipped_path_samples()), "", []
            )

    render = in_turn({name: lambda name=name: trace(name) for name in ("full", "lean")}, rounds)
    ready = {"full": Denoiser(model, leave_out="none"), "lean": Denoiser(model)}
    buffers = {}
    for name, frame in frames.items():
        whole = lean.restore_split(frame.buffers, frame.all_light, reads) if frame.all_light else frame.buffers
        buffers[name] = whole | {f"samples.{kind}": block for kind, block in frame.samples.items()}
    shown = {}

    def denoise(name: str) -> None:
        shown[name] = ready[name].run_buffers(buffers[name], samples_per_pixel=spp).color

    denoised = in_turn({name: lambda name=name: denoise(name) for name in ready}, rounds)
    full = shown["full"]
    difference = (np.abs(shown["lean"] - full) / (np.abs(full) + 0.01 * full.mean() + 1e-12)).max()
    said = "; ".join(line.partition(":")[0].removeprefix("left out ") for line in frames["lean"].lines)
    return {"render": render, "denoise": denoised, "difference": float(difference), "said": said}


def tables(rows: Sequence[pages.Row]) -> str:
    table = [["scene", "model", "render full ms", "lean", "denoise full ms", "lean", "lean / full", "difference"]]
    table[0].append("left out by --auto")
    for row in rows:
        times = [1000 * row[step][name] for step in ("render", "denoise") for name in ("full", "lean")]
        cells = [*(f"{ms:.0f}" for ms in times), f"{(times[1] + times[3]) / (times[0] + times[2]):.3f}"]
        table.append([row["scene"], row["model"], *cells, f"{row['difference']:.0e}", row["said"]])
    settings = f"{rows[0]['width']} pixels wide, medians of {rows[0]['rounds']} rounds"
    return f"{settings}:\n\n{markdown(table)}"


PAGE = pages.Page(
    "lean_render",
    "What rendering and denoising less saves",
    "Everything that any model reads, with nothing left out, against `render --auto` and the default of `denoise`; by "
    "turns. Ratios within 10 % of 1 are noise.",
    tables,
)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("scenes", type=Path, nargs="?")
    parser.add_argument("--model", nargs="+", default=["kpcn-manifold", "pathfold-balanced"], help="names or folders")
    parser.add_argument("--spp", type=int, default=8)
    parser.add_argument("--width", type=int, default=320)
    parser.add_argument("--rounds", type=int, default=5)
    parser.add_argument("-o", "--output", type=Path, default=pages.RESULTS, help="folder for the page and its data")
    options = parser.parse_args()
    found = candidates.find_all(options.model)
    findings = pages.Findings(PAGE, options.output, found)
    with tempfile.TemporaryDirectory() as folder:
        scenes = lean_scenes(Path(folder))
        if options.scenes:
            scenes |= {path.parent.name: (path, None) for path in sorted(options.scenes.glob("*/scene.xml"))}
        for name, (path, spp) in scenes.items():
            for model in found:
                key = {"scene": name, "model": model.name, "identity": model.identity, "spp": spp or options.spp}
                key |= {"width": options.width, "rounds": options.rounds}
                arguments = (path, model.argument, spp or options.spp, options.width, options.rounds)
                findings.row(key, partial(measure, *arguments))
    findings.finish()


if __name__ == "__main__":
    main()
