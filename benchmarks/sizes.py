"""What the pathfold networks cost: every size with random weights in the SDK against OIDN high, in one process.

    python benchmarks/sizes.py [--width 960 --height 540 --runs 5 --samples 0]

Medians of interleaved runs after a warm-up, as ratios to OIDN high with noisy guides.
"""

import argparse
import json
import tempfile
import time
from collections.abc import Callable, Sequence
from functools import partial
from pathlib import Path
from statistics import median
from typing import Any

import numpy as np
import pages
import torch
from pathfold import Denoiser
from pathfold._core import Layout
from pathfold.bench.peers import oidn
from pathfold.report.tables import markdown
from pathfold_training.fit.preset import load_preset
from pathfold_training.fit.task import Denoising
from pathfold_training.networks.pathfold.network import Pathfold
from pathfold_training.release.export import write_graph

SIZES = ("fast", "balanced", "high")
PEER, PEER_COST = "OIDN high", 125  # kMAC per pixel of its network
STAGES = ("network", "embedding", "reconstruct")


def write_model(name: str, folder: Path) -> Pathfold:
    """A model folder with random weights."""
    torch.manual_seed(0)
    config = load_preset(name)
    model = Denoising(config).eval().model
    assert isinstance(model, Pathfold)
    for head in (model.trust, *model.heads):
        torch.nn.init.normal_(head.weight, std=0.1)  # type: ignore[arg-type]
    folder.mkdir(parents=True)
    graphs = {part: write_graph(graph, folder / f"{part}.onnx") for part, graph in model.graphs().items()}
    manifest = {"format": 1, "name": name, "license": "Apache-2.0", **model.describe(), "graphs": graphs}
    manifest |= {"exposure": {"rule": "log-average", "key": 0.18}, "samples_per_pixel": {"min": 1, "max": 32}}
    (folder / "manifest.json").write_text(json.dumps(manifest | {"precision": "fp32"}))
    return model


def buffers(height: int, width: int, samples: int) -> dict[str, np.ndarray]:
    rng = np.random.default_rng(0)
    shape = (height, width, 3)
    images = {"color": rng.exponential(1.0, shape), "albedo": rng.random(shape), "normal": rng.random(shape)}
    images |= {"depth": rng.random((height, width, 1)) + 1, "variance": rng.random(shape)}
    if samples:
        images["samples.descriptor"] = rng.random((samples, height, width, Layout().channels))
    return {name: image.astype(np.float32) for name, image in images.items()}


def measure(width: int, height: int, samples: int, runs: int) -> dict[str, Any]:
    """By method: kMAC per pixel, median milliseconds, and of ours the share of each stage in the last run."""
    images = buffers(height, width, samples)
    parts: dict[str, dict[str, float]] = {}
    costs: dict[str, float] = {}

    def run_model(name: str, denoiser: Denoiser) -> None:
        parts[name] = denoiser.run_buffers(images, exposure=1.0).report["ms"]

    with tempfile.TemporaryDirectory() as scratch:
        methods: dict[str, Callable[[], object]] = {}
        for size in SIZES:
            name = f"pathfold-{size}"
            costs[name] = write_model(name, Path(scratch) / name).macs(samples) / 1e3
            denoiser = Denoiser(Path(scratch) / name)
            methods[name] = lambda name=name, denoiser=denoiser: run_model(name, denoiser)
        methods[PEER] = lambda: oidn(images["color"], images["albedo"], images["normal"])
        times: dict[str, list[float]] = {name: [] for name in methods}
        for turn in range(runs + 1):
            for name, method in methods.items():
                start = time.perf_counter()
                method()
                if turn > 0:
                    times[name].append(1e3 * (time.perf_counter() - start))
    shares = {name: {stage: ms[stage] / ms["total"] for stage in STAGES} for name, ms in parts.items()}
    kmac = costs | {PEER: PEER_COST}
    return {"kmac": kmac, "ms": {name: median(taken) for name, taken in times.items()}, "shares": shares}


def tables(rows: Sequence[pages.Row]) -> str:
    parts = []
    for row in rows:
        parts.append(f"{row['size']}, {row['samples']} samples with paths per pixel, medians of {row['runs']} runs:")
        table = [["model", "kMAC per pixel", "ms", f"{PEER} = 1", "network", "embedding", "reconstruction", "the rest"]]
        for name, ms in row["ms"].items():
            shares = [row["shares"][name][stage] for stage in STAGES] if name in row["shares"] else []
            cells = [f"{share:.0%}" for share in (*shares, 1 - sum(shares))] if shares else [""] * 4
            table.append([name, f"{row['kmac'][name]:.0f}", f"{ms:.0f}", f"{ms / row['ms'][PEER]:.2f}", *cells])
        parts.append(markdown(table))
    return "\n\n".join(part.strip() for part in parts)


PAGE = pages.Page(
    "sizes",
    "What the pathfold networks cost",
    "Networks with random weights in fp32 against OIDN high, color, albedo, normal, depth and variance given; runs by "
    "turns in one process. Of times on a busy machine the ratios tell most.",
    tables,
)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--width", type=int, default=960)
    parser.add_argument("--height", type=int, default=540)
    parser.add_argument("--runs", type=int, default=5)
    parser.add_argument("--samples", type=int, nargs="+", default=[0], help="path descriptors per pixel")
    parser.add_argument("-o", "--output", type=Path, default=pages.RESULTS, help="folder for the page and its data")
    options = parser.parse_args()
    findings = pages.Findings(PAGE, options.output, [])
    for samples in options.samples:
        key = {"size": f"{options.width}x{options.height}", "samples": samples, "runs": options.runs}
        findings.row(key, partial(measure, options.width, options.height, samples, options.runs))
    findings.finish()


if __name__ == "__main__":
    main()
