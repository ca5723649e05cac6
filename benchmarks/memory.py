"""Peak memory of denoising one made-up frame: OIDN and models, each in a process of its own.

    python benchmarks/memory.py [--size 1920x1080 --model pathfold-balanced ... --samples 2 --runs 1]

Every method is loaded and run once in a fresh process that holds its inputs already (all per-pixel buffers that it
reads; with paths, descriptors of `--samples` samples per pixel too). `above inputs` is the most memory that was
resident at a time less what was before it was loaded, the output included; `total` the whole process, interpreter and
inputs too. torch is in none of them. Of several runs the median counts. Prints a Markdown table. Linux only.
"""

import argparse
from statistics import median

import numpy as np
from pathfold import memory, models
from pathfold.channels import BUFFERS
from pathfold.report import candidates, cold
from pathfold.report.candidates import PEERS

MEBIBYTE = 2**20
DESCRIPTOR = 36


def frame(width: int, height: int, samples: int) -> dict[str, np.ndarray]:
    """Noise in every per-pixel buffer, so that nothing can be left out; descriptors where `samples` is not 0."""
    rng = np.random.default_rng(0)
    made = {}
    for name, channels in BUFFERS.items():
        made[name] = rng.random((height, width, channels), np.float32) + np.float32(0.1)
    made["color"] = made["diffuse"] + made["specular"]
    if samples:
        block = rng.random((samples, height, width, DESCRIPTOR), np.float32)
        made["samples.descriptor"] = (6 * block - 4).astype(np.float16)
        made["samples.density"] = 5 * rng.random((samples, height, width, 1), np.float32)
    return made


def row(candidate: candidates.Candidate, buffers: dict[str, np.ndarray], runs: int) -> tuple[float, float, float]:
    """MB of what the method reads, above it, and in total."""
    inputs = sum(buffers[name].nbytes for name in candidate.reads & buffers.keys()) / MEBIBYTE
    taken = [cold.first_frame(candidate, buffers) for _ in range(runs)]
    above, total = (median(run[name] for run in taken) for name in ("mb", "total_mb"))
    return inputs, above, total


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--size", default="1920x1080")
    parser.add_argument("--model", nargs="+", help="names or folders; default: the pathfold family's that are shipped")
    parser.add_argument("--samples", type=int, default=2, help="per pixel, for models that read paths; 0: none")
    parser.add_argument("--runs", type=int, default=1)
    options = parser.parse_args()
    if not memory.can_be_watched():
        raise SystemExit("this system does not say what a process held at most: run it on Linux")
    width, height = map(int, options.size.split("x"))
    shipped = [name for name in models.available(models.shipped_directories()) if name.startswith("pathfold")]
    methods = candidates.find_all([*PEERS, *(options.model or shipped)])
    buffers = frame(width, height, options.samples)
    pixels = {name: values for name, values in buffers.items() if not name.startswith("samples.")}
    print(f"{width}x{height}, MB, peak of {options.runs} run(s) in a fresh process each\n")
    print("| method | reads | inputs | above inputs | OIDN high = 1 | total | OIDN high = 1 |")
    print("|---|---|---|---|---|---|---|", flush=True)
    high: tuple[float, float] | None = None
    for candidate in methods:
        cases = {"pixels": pixels}
        if candidate.reads_paths and options.samples:
            cases[f"pixels and paths, {options.samples} spp"] = buffers
        for reads, given in cases.items():
            try:
                inputs, above, total = row(candidate, given, options.runs)
            except cold.ColdError as error:  # too large for this machine, say: the others still count
                print(f"| {candidate.name} | {reads} | {error} | | | | |", flush=True)
                continue
            high = high or (above, total)  # `oidn` comes first
            cells = [
                f"{inputs:.0f}",
                f"{above:.0f}",
                f"{above / high[0]:.2f}",
                f"{total:.0f}",
                f"{total / high[1]:.2f}",
            ]
            print(f"| {candidate.name} | {reads} | " + " | ".join(cells) + " |", flush=True)


if __name__ == "__main__":
    main()
