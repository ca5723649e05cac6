"""What leaving out costs and saves: one model on frames that need everything, and on frames that need less.

    python benchmarks/leave_out.py [MODEL] [--size 320x192 --rounds 5]

Every frame is denoised with `leave_out="none"` and with what its row names, by turns in one process. `ratio` is the
median time with leaving out over that without; `looking` the share of the run that went into it; `said` what the
report says it saved, in milliseconds, beside what was `saved` by the medians.
"""

import argparse
import time
from collections.abc import Sequence
from functools import partial
from pathlib import Path
from statistics import median
from typing import Any

import numpy as np
import pages
from pathfold import Denoiser
from pathfold._core import Layout
from pathfold.bench import candidates
from pathfold.report.tables import markdown

TILE = 64
PATHS = "path descriptors"
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
    descriptors = rng.normal(-2, 3, (SPP, height, width, Layout().channels)).astype(np.float32)
    return {
        "nothing": ("all", full),
        "the specular branch": ("all", {**full, "specular": np.zeros_like(full["specular"])}),
        "half of the tiles": ("all", dark),
        "converged tiles": ("all,converged", {"color": 1 + noise(), "variance": variance}),
        PATHS: ("all,paths", {"color": 1 + noise(), "samples": {"descriptor": descriptors}}),
    }


def measure(model: str, size: tuple[int, int], what: str, rounds: int) -> dict[str, Any]:
    """Median milliseconds without leaving out and with, and what the last report says of it."""
    names, buffers = frames(*size)[what]
    ready = {chosen: Denoiser(model, tile=TILE, leave_out=chosen) for chosen in ("none", names)}
    took: dict[str, list[float]] = {chosen: [] for chosen in ready}
    for turn in range(rounds + 1):
        for chosen, times in took.items():
            start = time.perf_counter()
            report = ready[chosen].run(**buffers, samples_per_pixel=SPP).report
            if turn:  # the first one warms up
                times.append(1e3 * (time.perf_counter() - start))
    said = sum(line.get("saved_ms", 0) for line in report["left_out"])
    looking = report["ms"]["needs"] / report["ms"]["total"]
    return {"without": median(took["none"]), "lean": median(took[names]), "looking": looking, "said": said}


def tables(rows: Sequence[pages.Row]) -> str:
    table = [["not needed", "ms without leaving out", "with", "ratio", "looking", "saved", "said"]]
    for row in rows:
        without, lean = row["without"], row["lean"]
        cells = [f"{without:.0f}", f"{lean:.0f}", f"{lean / without:.2f}", f"{100 * row['looking']:.2g} %"]
        table.append([row["what"], *cells, f"{without - lean:.0f}", f"{row['said']:.0f}"])
    head = f"{rows[0]['model']}, {rows[0]['size']}, tiles of {TILE} pixels, medians of {rows[0]['rounds']} rounds"
    return f"{head}; converged tiles and path descriptors are left out by name only:\n\n{markdown(table)}"


PAGE = pages.Page(
    "leave_out",
    "What leaving out costs and saves",
    "Made-up frames of which parts are not needed, denoised with nothing left out and with what their row names.",
    tables,
)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("model", nargs="?", default="kpcn-vanilla")
    parser.add_argument("--size", default="320x192")
    parser.add_argument("--rounds", type=int, default=5)
    parser.add_argument("-o", "--output", type=Path, default=pages.RESULTS, help="folder for the page and its data")
    options = parser.parse_args()
    width, height = map(int, options.size.split("x"))
    model = candidates.find(options.model)
    findings = pages.Findings(PAGE, options.output, [model])
    for what in frames(width, height):
        if what == PATHS and not model.reads_paths:
            continue
        key = {"what": what, "model": model.name, "identity": model.identity, "size": options.size}
        key["rounds"] = options.rounds
        findings.row(key, partial(measure, model.argument, (width, height), what, options.rounds))
    findings.finish()


if __name__ == "__main__":
    main()
