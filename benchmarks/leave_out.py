"""What leaving out costs and saves: one model on frames that need everything, and on frames that need less.

    python benchmarks/leave_out.py [MODEL] [--size WxH] [--rounds N]
    python benchmarks/leave_out.py --rendered [--scenes DIR] [--models A,B] [--spp 8] [--width 320] [--rounds N]

Every frame is denoised with `leave_out="none"` and with what its row names, by turns in one process. `ratio` is the
median time with leaving out over that without; `needs` the share of the run that went into looking; `said` what the
report says it saved, in milliseconds, beside what was `saved` by the medians.

With --rendered scenes are rendered and denoised: those of tests/lean_scenes.py, each of which needs less in another
way, or every DIR/NAME/scene.xml. `full` makes all that any shipped model reads and leaves nothing out; `lean` is
`render --auto` for the model and `leave_out="all"`. Times are medians by turns; `difference` is the largest of
|lean - full| / (|full| + 0.01 mean), to be below 1e-5. A table in Markdown.
"""

import argparse
import sys
import tempfile
import time
from collections.abc import Callable
from pathlib import Path
from statistics import median

import numpy as np
from pathfold import Denoiser, models, needs
from pathfold.rendering import Camera

TILE = 64
SEED, MAX_DEPTH = 1, 8
SPP = 16  # of the made-up frames


def frames(width: int, height: int) -> dict[str, tuple[str, dict[str, np.ndarray]]]:
    """By what they do not need: the names to leave out, and the buffers."""
    rng = np.random.default_rng(0)

    def noise() -> np.ndarray:
        return rng.exponential(1.0, (height, width, 3)).astype(np.float32)

    full = {"diffuse": noise(), "specular": noise(), "diffuse_albedo": np.clip(noise(), 0, 1)}
    dark = {name: pixels.copy() for name, pixels in full.items()}
    for name in ("diffuse", "specular"):
        dark[name][:, : width // 2] = 0
    variance = np.full((height, width, 3), 1e-6, np.float32)
    descriptors = rng.normal(-2, 3, (SPP, height, width, 36)).astype(np.float32)
    return {
        "nothing": ("all", full),
        "the specular branch": ("all", {**full, "specular": np.zeros_like(full["specular"])}),
        "half of the tiles": ("all", dark),
        "color and variance": ("all", {**full, "color": full["diffuse"] + full["specular"], "variance": variance}),
        "converged tiles": ("all,converged", {"color": 1 + noise(), "variance": variance}),
        "path descriptors": ("all,paths", {"color": 1 + noise(), "samples": {"descriptor": descriptors}}),
    }


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


def rendered(path: Path, model: str, spp: int, width: int, rounds: int) -> str:
    """A row of the table: one scene with one model."""
    camera = Camera(path, "llvm_ad_rgb", 0, None)
    camera.use(0, (width, max(1, round(width * camera.size[1] / camera.size[0]))))
    reads, everything = models.inputs(model), models.shipped_inputs()
    settings = (spp, SEED, MAX_DEPTH, None)
    frames: dict[str, needs.LeanFrame] = {}

    def trace(name: str) -> None:
        frames.pop(name, None)  # one block of samples at a time
        if name == "lean":
            frames[name] = needs.trace(camera, *settings, reads, lambda done: None, models.path_samples(model))
        else:
            frames[name] = needs.LeanFrame(
                *camera.trace(*settings, everything, lambda done: None, models.shipped_path_samples()), "", []
            )

    render = in_turn({name: lambda name=name: trace(name) for name in ("full", "lean")}, rounds)
    ready = {"full": Denoiser(model, leave_out="none"), "lean": Denoiser(model)}
    buffers = {}
    for name, frame in frames.items():
        whole = needs.restore_split(frame.buffers, frame.all_light, reads) if frame.all_light else frame.buffers
        buffers[name] = whole | {f"samples.{kind}": block for kind, block in frame.samples.items()}
    shown = {}

    def denoise(name: str) -> None:
        shown[name] = ready[name].run_buffers(buffers[name], samples_per_pixel=spp).color

    denoised = in_turn({name: lambda name=name: denoise(name) for name in ready}, rounds)
    full = shown["full"]
    difference = (np.abs(shown["lean"] - full) / (np.abs(full) + 0.01 * full.mean() + 1e-12)).max()
    total = {name: render[name] + denoised[name] for name in ready}
    said = "; ".join(line.partition(":")[0].removeprefix("left out ") for line in frames["lean"].lines)
    times = (render["full"], render["lean"], denoised["full"], denoised["lean"])
    cells = [f"{1000 * seconds:.0f}" for seconds in times]
    return " | ".join(["", *cells, f"{total['lean'] / total['full']:.3f}", f"{difference:.0e}", said, ""])


def render_table(options: argparse.Namespace) -> None:
    columns = ["scene", "model", "render full ms", "lean", "denoise full ms", "lean", "lean / full", "difference"]
    columns.append("left out by --auto")
    print(f"| {' | '.join(columns)} |", "|---" * len(columns) + "|", sep="\n")
    with tempfile.TemporaryDirectory() as folder:
        if options.scenes:
            found = {path.parent.name: (path, None) for path in sorted(options.scenes.glob("*/scene.xml"))}
        else:
            found = lean_scenes(Path(folder))
        for name, (path, spp) in found.items():
            for model in options.models.split(","):
                row = rendered(path, model, spp or options.spp, options.width, options.rounds)
                print(f"| {name} | {model}{row}".rstrip(), flush=True)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("model", nargs="?", default="kpcn-vanilla")
    parser.add_argument("--size", default="320x192")
    parser.add_argument("--rounds", type=int, default=5)
    parser.add_argument("--rendered", action="store_true")
    parser.add_argument("--scenes", type=Path)
    parser.add_argument("--models", default="kpcn-manifold,pathfold-balanced")
    parser.add_argument("--spp", type=int, default=8)
    parser.add_argument("--width", type=int, default=320)
    options = parser.parse_args()
    if options.rendered or options.scenes:
        render_table(options)
        return
    width, height = map(int, options.size.split("x"))
    ready = {
        names: Denoiser(options.model, tile=TILE, leave_out=names)
        for names in ("none", "all", "all,converged", "all,paths")
    }
    print(f"{options.model}, {width}x{height}, tiles of {TILE}, median of {options.rounds}")
    print(f"{'not needed':22}{'none ms':>10}{'lean ms':>10}{'ratio':>8}{'needs':>9}{'saved':>9}{'said':>9}")
    for what, (names, buffers) in frames(width, height).items():
        took: dict[str, list[float]] = {"none": [], names: []}
        for turn in range(options.rounds + 1):
            for chosen, times in took.items():
                start = time.perf_counter()
                result = ready[chosen].run(**buffers, samples_per_pixel=SPP)
                if turn:  # the first one warms up
                    times.append(1e3 * (time.perf_counter() - start))
        without, lean = median(took["none"]), median(took[names])
        said = sum(line.get("saved_ms", 0) for line in result.report["left_out"])
        share = result.report["ms"]["needs"] / result.report["ms"]["total"]
        print(f"{what:22}{without:10.0f}{lean:10.0f}{lean / without:8.3f}{share:9.3%}{without - lean:9.1f}{said:9.1f}")


if __name__ == "__main__":
    main()
