"""Error against OIDN at several resolutions of the same pictures: the more pixels, the smoother what they show.

    python benchmarks/resolution.py SCENES... [--model pathfold-balanced ... --width 128 320 640 --spp 8]

SCENES are Mitsuba scenes as `pathfold bench` takes them, in the aspect of their own film; of a camera path the first
frame counts. It is rendered at `--spp` with seed 0, and twice more with others, at `--reference-spp` in all: the error
is RelL2 by these two halves, free of their noise. A Markdown table of each method's error over OIDN's (quality high);
models are pathfold-balanced where none is named.
"""

import argparse
import gc
import math
from pathlib import Path

import numpy as np
from numpy.typing import NDArray
from pathfold import metrics
from pathfold.report import candidates, peers, subjects
from pathfold.report.subjects import MitsubaSubject

ROUND = 16  # samples of a pixel that are rendered at once for a reference
FIRST_SEED = 1000  # of the reference


def halves(subject: MitsubaSubject, size: tuple[int, int], spp: int) -> list[NDArray[np.float64]]:
    """Two independent means, together of `spp` samples, or up to a round more each."""
    rounds = math.ceil(spp / 2 / ROUND)
    means = []
    for half in range(2):
        total = np.zeros((size[1], size[0], 3))
        for number in range(rounds):
            seed = FIRST_SEED + half * rounds + number
            total += subject.shoot(0, ROUND, seed, (), size, False).buffers["color"]
        means.append(total / rounds)
    return means


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("scenes", type=Path, nargs="+")
    parser.add_argument("--model", nargs="+", default=["pathfold-balanced"], help="names or folders")
    parser.add_argument("--width", type=int, nargs="+", default=[128, 320, 640])
    parser.add_argument("--spp", type=int, default=8)
    parser.add_argument("--reference-spp", type=int, default=96)
    options = parser.parse_args()
    peers.keep_torch_out()
    found = candidates.find_all(["oidn", *options.model])
    methods = [(candidate, candidate.load()) for candidate in found]
    recorded = {candidate.path_samples for candidate in found}
    print("| scene | size | oidn | " + " | ".join(f"{c.name} / oidn" for c in found[1:]) + " |")
    print("|---|---|---|" + "---|" * len(found[1:]), flush=True)
    ratios: dict[int, list[list[float]]] = {width: [] for width in options.width}
    for subject in subjects.find_all(options.scenes, subjects.Options((options.spp,), 1)):
        if not isinstance(subject, MitsubaSubject):
            parser.error(f"{subject.name}: holds pictures; a scene is wanted, which can be rendered at any size")
        film = subject.size
        for width in options.width:
            size = (width, round(width * film[1] / film[0]))
            a, b = halves(subject, size, options.reference_spp)
            shot = subject.shoot(0, options.spp, 0, recorded, size, False)
            errors = []
            for candidate, run in methods:
                read = {name: shot.buffers[name] for name in candidate.reads & shot.buffers.keys()}
                errors.append(metrics.rell2_halves(run(read, None, options.spp), a, b))
            if min(errors) <= 0:
                parser.error(f"{subject.name}: too noisy a reference; give more --reference-spp")
            over = [each / errors[0] for each in errors[1:]]
            ratios[width].append(over)
            cells = " | ".join(f"{ratio:.3f}" for ratio in over)
            print(f"| {subject.name} | {size[0]}x{size[1]} | {errors[0]:.5f} | {cells} |", flush=True)
        gc.collect()  # one scene at a time
    for width, rows in ratios.items():
        means = " | ".join(f"{np.exp(np.log(column).mean()):.3f}" for column in np.array(rows).T)
        print(f"| geometric mean | {width} wide | | {means} |")


if __name__ == "__main__":
    main()
