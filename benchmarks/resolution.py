"""Error against OIDN at production size: windows of frames 1280 pixels wide (960 where the film is square or upright).

    python benchmarks/resolution.py SCENES/validation CROPS [--spp 2 8 32 --seeds 3 --model pathfold-balanced ...]

CROPS/NAME.npz belongs to SCENES/validation/NAME/scene.xml: `size`, width and height of the frame, `depth` of its paths
(Mitsuba's max_depth), `boxes`, the upper left corner (y, x) of each window, and `a` and `b`, the windows of two
independent references (N x H x W x 3, linear). The whole frame is rendered and denoised, by models with its paths, and
the windows are scored by RelL2 free of the references' own noise. Pictures show the three windows where
pathfold-balanced stands worst against OIDN (quality high).
"""

import argparse
import gc
import sys
from collections.abc import Iterator, Sequence
from hashlib import sha256
from pathlib import Path
from statistics import fmean, median
from typing import Any

import numpy as np
import pages
from numpy.typing import NDArray
from pathfold import metrics
from pathfold.bench import candidates, peers, subjects
from pathfold.bench.candidates import NOISY, PEERS, Candidate, Run
from pathfold.bench.results import FLOOR, geometric
from pathfold.buffers import BUFFERS
from pathfold.images import replacing
from pathfold.pixels import jpeg
from pathfold.rendering import Renderer
from pathfold.report.tables import markdown

SHOWN = (NOISY, "oidn", "pathfold-balanced")  # of a picture; then the reference
SHOWN_SPP, PICTURES = 8, 3

Image = NDArray[Any]
Methods = dict[str, tuple[Candidate, Run]]


class Frame:
    """A scene at the size of its windows, and what these should be."""

    def __init__(self, scene: Path, crops: Path) -> None:
        with np.load(crops) as found:
            self.boxes, self.depth = found["boxes"].tolist(), int(found["depth"])
            self.halves = [found[name].astype(np.float64) for name in "ab"]
            self.size: tuple[int, int] = tuple(found["size"].tolist())
        self.scene, self.name = scene, crops.stem
        self.inputs = sha256(scene.read_bytes() + crops.read_bytes()).hexdigest()[:12]
        self._renderer: Renderer | None = None

    def windows(self, spp: int, seed: int, methods: Methods) -> Iterator[tuple[str, list[Image]]]:
        """Render, and give what each method makes of the frame: its windows, H x W x 3."""
        self._renderer = self._renderer or Renderer(self.scene, subjects.VARIANT, 0, self.size)
        recorded = max(candidate.path_samples for candidate, _ in methods.values())
        wanted = {*BUFFERS, "samples.descriptor", "samples.density"}
        buffers, block, _ = self._renderer.trace(spp, seed, self.depth, None, wanted, lambda done: None, recorded)
        buffers |= {f"samples.{name}": pixels for name, pixels in block.items()}
        height, width = self.halves[0].shape[1:3]
        for name, (candidate, run) in methods.items():
            image = run({n: buffers[n] for n in candidate.reads & buffers.keys()}, None, spp)
            yield name, [image[y : y + height, x : x + width] for y, x in self.boxes]

    def release(self) -> None:
        """Forget the scene; it is read again where it is needed again."""
        self._renderer = None

    def errors(self, spp: int, seed: int, methods: Methods) -> dict[str, Any]:
        """RelL2 of every window by every method."""
        found = {}
        for name, windows in self.windows(spp, seed, methods):
            found[name] = [metrics.rell2_halves(x, a, b) for x, a, b in zip(windows, *self.halves, strict=True)]
        print(f"{self.name}, {spp} spp, seed {seed}", file=sys.stderr, flush=True)
        return {"windows": found}

    def picture(self, path: Path, number: int, methods: Methods) -> None:
        """A window as it came, by OIDN and by us, and the reference, side by side, as a JPEG."""
        reference = (self.halves[0][number] + self.halves[1][number]) / 2
        made = dict(self.windows(SHOWN_SPP, 0, {name: methods[name] for name in SHOWN}))
        scale = metrics.exposure(reference)
        row = [metrics.display(image, scale) for image in (*(made[name][number] for name in SHOWN), reference)]
        with replacing(path) as unfinished:
            unfinished.write_bytes(jpeg(np.concatenate(row, 1), 90))


Errors = dict[tuple[str, int], dict[str, list[float]]]  # scene, spp -> method -> windows


def over_seeds(rows: Sequence[pages.Row]) -> Errors:
    """The mean error of each window; what came out below its own noise counts as FLOOR."""
    groups: dict[tuple[str, int], list[dict[str, list[float]]]] = {}
    for row in rows:
        groups.setdefault((row["scene"], row["spp"]), []).append(row["windows"])
    return {
        key: {
            name: [max(FLOOR, fmean(w)) for w in zip(*(seed[name] for seed in seeds), strict=True)] for name in seeds[0]
        }
        for key, seeds in groups.items()
    }


def ratios(errors: Errors, spp: int, model: str, peer: str) -> list[float]:
    """The model's error over the peer's, window by window, of all scenes."""
    pairs = [zip(found[model], found[peer], strict=True) for (_, level), found in errors.items() if level == spp]
    return [own / other for windows in pairs for own, other in windows]


def tables(rows: Sequence[pages.Row]) -> str:
    errors = over_seeds(rows)
    spps = sorted({spp for _, spp in errors})
    names = list(rows[0]["windows"])
    against = [name for name in names if name in PEERS]
    head = ["method", "spp", *(f"/ {peer}" for peer in against), *(f"windows won of {peer}" for peer in against)]
    over = [head]
    for model in (name for name in names if name not in (NOISY, *PEERS)):
        for spp in spps:
            found = [ratios(errors, spp, model, peer) for peer in against]
            cells = [f"{median(each):.3f}" for each in found]
            cells += [f"{sum(ratio < 1 for ratio in each)} of {len(each)}" for each in found]
            over.append([model, str(spp), *cells])
    seeds = ", ".join(map(str, sorted({row["seed"] for row in rows})))
    parts = [f"Medians over windows of the quotients of errors; render seeds {seeds}:", markdown(over)]
    for spp in spps:
        own = {scene: found for (scene, level), found in errors.items() if level == spp}
        table = [["scene", *names]]
        table += [[scene, *(f"{geometric(found[n]):.5f}" for n in names)] for scene, found in own.items()]
        means = [geometric(each for found in own.values() for each in found[name]) for name in names]
        table.append(["geometric mean", *(f"{mean:.5f}" for mean in means)])
        parts += [f"RelL2 at {spp} spp, geometric means over windows:", markdown(table)]
    return "\n\n".join(part.strip() for part in [*parts, *shown(errors)])


def worst(errors: Errors) -> list[tuple[str, int, float]]:
    """Scene, number and quotient of the windows where SHOWN's last stands worst against OIDN."""
    found = [
        (scene, number, own / other)
        for (scene, spp), methods in errors.items()
        if spp == SHOWN_SPP and set(SHOWN) <= methods.keys()
        for number, (own, other) in enumerate(zip(methods[SHOWN[-1]], methods["oidn"], strict=True))
    ]
    return sorted(found, key=lambda window: -window[2])[:PICTURES]


def shown(errors: Errors) -> list[str]:
    """The pictures, as the page shows them."""
    windows = worst(errors)
    if not windows:
        return []
    order = ", ".join(SHOWN)
    parts = [f"Where {SHOWN[-1]} stands worst at {SHOWN_SPP} spp; from left to right {order}, the reference:"]
    for scene, number, quotient in windows:
        title = f"{scene}, window {number + 1}"
        parts.append(f"{title}: {quotient:.2f} times OIDN's error\n\n![{title}]({file(scene, number)})")
    return parts


def file(scene: str, number: int) -> str:
    return f"{PAGE.name}/{scene}-{number + 1}.jpg"


PAGE = pages.Page(
    "resolution",
    "Error at production size",
    "Three windows of 224x224 pixels in the frame of each validation scene, which is rendered and denoised whole, 1280 "
    "pixels wide (960 where square or upright); RelL2 on the windows, free of their references' own noise.",
    tables,
)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("scenes", type=Path)
    parser.add_argument("crops", type=Path)
    parser.add_argument("--spp", type=int, nargs="+", default=[2, 8, 32])
    parser.add_argument("--seeds", type=int, default=3)
    parser.add_argument("--model", nargs="+", help="names or folders; default: the pathfold family's that are shipped")
    parser.add_argument("-o", "--output", type=Path, default=pages.RESULTS, help="folder for the page and its data")
    options = parser.parse_args()
    frames = [Frame(options.scenes / path.stem / "scene.xml", path) for path in sorted(options.crops.glob("*.npz"))]
    if not frames:
        parser.error(f"{options.crops} holds no NAME.npz")
    peers.keep_torch_out()
    chosen = candidates.find_all([NOISY, *PEERS, *(options.model or pages.family())])
    methods = {candidate.name: (candidate, candidate.load()) for candidate in chosen}
    identities = {candidate.name: candidate.identity for candidate in chosen}
    findings = pages.Findings(PAGE, options.output, chosen)
    for frame in frames:
        for spp in options.spp:
            for seed in range(options.seeds):
                key = {"scene": frame.name, "spp": spp, "seed": seed, "inputs": frame.inputs, "methods": identities}
                findings.row(key, lambda frame=frame, spp=spp, seed=seed: frame.errors(spp, seed, methods))
        frame.release()
        gc.collect()  # one scene at a time
    findings.finish()
    for scene, number, _ in worst(over_seeds(findings.rows)):
        path = options.output / file(scene, number)
        if findings.fresh or not path.exists():
            path.parent.mkdir(exist_ok=True)
            next(frame for frame in frames if frame.name == scene).picture(path, number, methods)


if __name__ == "__main__":
    main()
