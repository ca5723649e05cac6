"""What the pathfold networks cost: every size with random weights in the SDK against OIDN high, in one process.

    python benchmarks/sizes.py [--width 960 --height 540 --runs 5]

Prints a Markdown table: medians of interleaved runs after a warm-up, as ratios to OIDN high with noisy guides.
"""

import argparse
import json
import tempfile
import time
from collections.abc import Callable
from pathlib import Path
from statistics import median

import numpy as np
import torch
from pathfold import Denoiser
from pathfold.report.peers import oidn
from pathfold_training.config import load_preset
from pathfold_training.export import macs_per_pixel, write_pyramid
from pathfold_training.networks.pathfold import Pathfold
from pathfold_training.task import Denoising

SIZES = ("fast", "balanced", "high")


def write_model(name: str, folder: Path) -> Pathfold:
    """A model folder with random weights."""
    torch.manual_seed(0)
    config = load_preset(name)
    model = Denoising(config).eval().model
    assert isinstance(model, Pathfold)
    for head in (model.trust, *model.heads):
        torch.nn.init.normal_(head.weight, std=0.1)  # type: ignore[arg-type]
    folder.mkdir(parents=True)
    manifest = {"format": 1, "name": name, "license": "Apache-2.0", **write_pyramid(model, folder)}
    manifest |= {"exposure": {"rule": "log-average", "key": 0.18}, "samples_per_pixel": {"min": 1, "max": 32}}
    (folder / "manifest.json").write_text(json.dumps(manifest | {"precision": "fp32"}))
    return model


def buffers(height: int, width: int, samples: int) -> dict[str, np.ndarray]:
    rng = np.random.default_rng(0)
    shape = (height, width, 3)
    images = {"color": rng.exponential(1.0, shape), "albedo": rng.random(shape), "normal": rng.random(shape)}
    images |= {"depth": rng.random((height, width, 1)) + 1, "variance": rng.random(shape)}
    if samples:
        images["samples.descriptor"] = rng.random((samples, height, width, 36))
    return {name: image.astype(np.float32) for name, image in images.items()}


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--width", type=int, default=960)
    parser.add_argument("--height", type=int, default=540)
    parser.add_argument("--runs", type=int, default=5)
    parser.add_argument("--samples", type=int, default=0, help="path descriptors per pixel")
    options = parser.parse_args()
    images = buffers(options.height, options.width, options.samples)
    parts: dict[str, dict[str, float]] = {}

    def run_model(name: str, denoiser: Denoiser) -> None:
        parts[name] = denoiser.run_buffers(images, exposure=1.0).report["ms"]

    with tempfile.TemporaryDirectory() as scratch:
        methods: dict[str, Callable[[], object]] = {}
        costs = {}
        for size in SIZES:
            name = f"pathfold-{size}"
            costs[name] = macs_per_pixel(write_model(name, Path(scratch) / name), options.samples) / 1e3
            denoiser = Denoiser(Path(scratch) / name)
            methods[name] = lambda name=name, denoiser=denoiser: run_model(name, denoiser)
        methods["OIDN high"] = lambda: oidn(images["color"], images["albedo"], images["normal"])
        times: dict[str, list[float]] = {name: [] for name in methods}
        for turn in range(options.runs + 1):
            for name, method in methods.items():
                start = time.perf_counter()
                method()
                if turn > 0:
                    times[name].append(1e3 * (time.perf_counter() - start))
    reference = median(times["OIDN high"])
    print(f"{options.width}x{options.height}, {options.samples} samples per pixel, {options.runs} runs\n")
    print("| model | kMAC per pixel | ms | OIDN high = 1 | network | embedding | reconstruction | the rest |")
    print("|---|---|---|---|---|---|---|---|")
    for name, taken in times.items():
        row = f"| {name} | {costs[name]:.0f} |" if name in costs else f"| {name} | 125 |"
        row += f" {median(taken):.0f} | {median(taken) / reference:.2f} |"
        shares = parts.get(name)
        if shares:
            total = shares["total"]
            named = [shares[stage] / total for stage in ("network", "embedding", "reconstruct")]
            row += "".join(f" {share:.0%} |" for share in (*named, 1 - sum(named)))
        print(row if shares else row + " | | | |")


if __name__ == "__main__":
    main()
