"""Peak memory of denoising one made-up frame: OIDN and models, each in a process of its own.

    python benchmarks/memory.py [--size 1920x1080 --model pathfold-balanced ... --samples 2 --runs 1]

Every method is loaded and run once in a fresh process that holds its inputs already (all per-pixel buffers that it
reads; with paths, descriptors of `--samples` samples per pixel too). `above inputs` is the most memory that was
resident at a time less what was before it was loaded, the output included; `total` the whole process, interpreter and
inputs too. torch is in none of them. Of several runs the median counts. Linux only.
"""

import argparse
from collections.abc import Mapping, Sequence
from functools import partial
from pathlib import Path
from statistics import median
from typing import Any

import numpy as np
import pages
from pathfold import memory
from pathfold._core import Layout
from pathfold.bench import candidates, cold
from pathfold.bench.candidates import PEERS
from pathfold.buffers import BUFFERS
from pathfold.report.tables import markdown

MEBIBYTE = 2**20
DESCRIPTOR = Layout().channels


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


def measure(candidate: candidates.Candidate, buffers: Mapping[str, np.ndarray], runs: int) -> dict[str, Any]:
    """MB of what the method reads, above it, and in total; or what became of its process."""
    inputs = sum(buffers[name].nbytes for name in candidate.reads & buffers.keys()) / MEBIBYTE
    try:
        taken = [cold.first_frame(candidate, buffers) for _ in range(runs)]
    except cold.ColdError as error:  # too large for this machine, say: the others still count
        return {"error": str(error)}
    return {
        "inputs": inputs,
        "above": median(run["mb"] for run in taken),
        "total": median(r["total_mb"] for r in taken),
    }


def tables(rows: Sequence[pages.Row]) -> str:
    high = rows[0]  # OIDN comes first
    table = [["method", "reads", "inputs", "above inputs", "OIDN high = 1", "total", "OIDN high = 1"]]
    for row in rows:
        if "error" in row:
            cells = [row["error"], "", "", "", ""]
        else:
            cells = [f"{row['inputs']:.0f}"]
            cells += [text for n in ("above", "total") for text in (f"{row[n]:.0f}", f"{row[n] / high[n]:.2f}")]
        table.append([row["method"], row["reads"], *cells])
    return f"{high['size']}, MB, peak of {high['runs']} run(s):\n\n{markdown(table)}"


PAGE = pages.Page(
    "memory",
    "Peak memory",
    "One made-up frame, denoised in a fresh process for each method: the most memory that it held above its inputs, "
    "and in all. A run differs from the next by some 5 %.",
    tables,
)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--size", default="1920x1080")
    parser.add_argument("--model", nargs="+", help="names or folders; default: the pathfold family's that are shipped")
    parser.add_argument("--samples", type=int, default=2, help="per pixel, for models that read paths; 0: none")
    parser.add_argument("--runs", type=int, default=1)
    parser.add_argument("-o", "--output", type=Path, default=pages.RESULTS, help="folder for the page and its data")
    options = parser.parse_args()
    if not memory.can_be_watched():
        raise SystemExit("this system does not say what a process held at most: run it on Linux")
    width, height = map(int, options.size.split("x"))
    methods = candidates.find_all([*PEERS, *(options.model or pages.family())])
    buffers = frame(width, height, options.samples)
    pixels = {name: values for name, values in buffers.items() if not name.startswith("samples.")}
    findings = pages.Findings(PAGE, options.output, methods)
    for candidate in methods:
        cases = {"pixels": pixels}
        if candidate.reads_paths and options.samples:
            cases[f"pixels and paths, {options.samples} spp"] = buffers
        for reads, given in cases.items():
            key = {"method": candidate.name, "identity": candidate.identity, "reads": reads}
            key |= {"size": options.size, "runs": options.runs}
            findings.row(key, partial(measure, candidate, given, options.runs))
    findings.finish()


if __name__ == "__main__":
    main()
