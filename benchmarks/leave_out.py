"""What leaving out costs and saves: one model on frames that need everything, and on frames that need less.

    python benchmarks/leave_out.py [MODEL] [--size WxH] [--rounds N]

Every frame is denoised with `leave_out="none"` and with what its row names, by turns in one process. `ratio` is the
median time with leaving out over that without; `needs` the share of the run that went into looking; `said` what the
report says it saved, in milliseconds, beside what was `saved` by the medians.
"""

import argparse
import time
from statistics import median

import numpy as np
from pathfold import Denoiser

TILE = 64


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
    return {
        "nothing": ("all", full),
        "the specular branch": ("all", {**full, "specular": np.zeros_like(full["specular"])}),
        "half of the tiles": ("all", dark),
        "color and variance": ("all", {**full, "color": full["diffuse"] + full["specular"], "variance": variance}),
        "converged tiles": ("all,converged", {"color": 1 + noise(), "variance": variance}),
    }


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("model", nargs="?", default="kpcn-vanilla")
    parser.add_argument("--size", default="320x192")
    parser.add_argument("--rounds", type=int, default=5)
    options = parser.parse_args()
    width, height = map(int, options.size.split("x"))
    ready = {names: Denoiser(options.model, tile=TILE, leave_out=names) for names in ("none", "all", "all,converged")}
    print(f"{options.model}, {width}x{height}, tiles of {TILE}, median of {options.rounds}")
    print(f"{'not needed':22}{'none ms':>10}{'lean ms':>10}{'ratio':>8}{'needs':>9}{'saved':>9}{'said':>9}")
    for what, (names, buffers) in frames(width, height).items():
        took: dict[str, list[float]] = {"none": [], names: []}
        for turn in range(options.rounds + 1):
            for chosen, times in took.items():
                start = time.perf_counter()
                result = ready[chosen].run(**buffers, samples_per_pixel=16)
                if turn:  # the first one warms up
                    times.append(1e3 * (time.perf_counter() - start))
        without, lean = median(took["none"]), median(took[names])
        said = sum(line.get("saved_ms", 0) for line in result.report["left_out"])
        share = result.report["ms"]["needs"] / result.report["ms"]["total"]
        print(f"{what:22}{without:10.0f}{lean:10.0f}{lean / without:8.3f}{share:9.3%}{without - lean:9.1f}{said:9.1f}")


if __name__ == "__main__":
    main()
