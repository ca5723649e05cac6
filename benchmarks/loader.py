"""How many batches a second the loader makes, over how many the training step takes: below 1 it would starve.

    python benchmarks/loader.py [PRESET ...] [--data DIR] [--batches 10]

Without --data it writes a data set of noise into a temporary folder, 8 views of 128 x 128 pixels at 16 spp: what a
loader does depends on sizes alone. Batches and steps are timed in turns and medians compared, so that a busy machine
slows both alike; one thread, as in docs/training.md. The file system's cache is warm.
"""

from __future__ import annotations

import argparse
import tempfile
import time
from collections.abc import Callable, Sequence
from functools import partial
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pages
import torch
from pathfold._core import Layout
from pathfold.report.tables import markdown
from pathfold_training.dataset import store
from pathfold_training.dataset.clean import clean
from pathfold_training.fit.crops import Crops
from pathfold_training.fit.preset import Config, load_preset
from pathfold_training.fit.task import Denoising
from pathfold_training.fit.views import Stored
from pathfold_training.networks.batch import Batch

SIDE, SPP = 128, 16


def write_noise(folder: Path, views: int = 8) -> Path:
    rng = np.random.default_rng(0)
    channels = {"radiance": 3, "diffuse": 3, "depth": 1, "density": 1}
    half = {"diffuse.albedo": 3, "albedo": 3, "normal": 3, "descriptor": Layout().channels}
    folder.mkdir(exist_ok=True)
    for number in range(views):
        tensors: store.Arrays = {}
        for names, kind in ((channels, np.float32), (half, np.float16)):
            for name, count in names.items():
                tensors[f"samples.{name}"] = rng.random((1, SPP, count, SIDE, SIDE), np.float32).astype(kind)
        for name in ("color", "diffuse", "diffuse.albedo", "half_a.color", "half_b.color"):
            tensors[f"reference.{name}"] = rng.random((3, SIDE, SIDE), np.float32)
        tensors["importance"] = np.ones((SIDE, SIDE), np.float32)
        line = {"id": str(number), "split": "train" if number else "val", "spp": SPP, "described": SPP}
        line |= {"scene": str(number), "exposure": 1.0, "depth_scale": 1.0, "crop": SIDE, "crops": [[0, 0]]}
        store.append_line(folder, store.write(folder, line, tensors))
    return folder


def seconds(run: Callable[[], Any]) -> tuple[float, Any]:
    start = time.perf_counter()
    result = run()
    return time.perf_counter() - start, result


def measure(config: Config, data: Path, batches: int) -> dict[str, float]:
    """Medians in seconds for a batch and for a step of training on it, and megabytes of tensors a second."""
    if config.data.cleaned:
        clean(data)
    stored = Stored(data)
    crops = Crops(stored, config.data, seed=0, paths=config.network.path_samples, albedo=config.loss.albedo > 0.0)
    stream = iter(crops)
    task = Denoising(config)
    task.log = lambda *_, **__: None  # type: ignore[method-assign]
    task.trainer = SimpleNamespace(world_size=1, global_rank=0, global_step=0)  # type: ignore[assignment]
    adam = torch.optim.Adam(task.parameters())
    bf16 = config.optimiser.precision == "bf16"

    def step(batch: Batch) -> None:
        with torch.autocast("cpu", torch.bfloat16, enabled=bf16):
            loss = task.training_step(batch, 0)
        adam.zero_grad()
        loss.backward()
        adam.step()

    times, size = [], 0
    for _ in range(batches + 1):
        loading, batch = seconds(lambda: next(stream))
        size = sum(t.numel() * t.element_size() for t in (*batch.inputs.values(), *batch.truth.values()))
        times.append((loading, seconds(lambda batch=batch: step(batch))[0], size / loading / 1e6))
    loading, training, rate = np.median(times[1:], 0)  # the first opens files
    return {"batch": float(loading), "step": float(training), "ratio": float(training / loading), "MB/s": float(rate)}


def tables(rows: Sequence[pages.Row]) -> str:
    table = [["preset", "a batch, ms", "MB/s", "a step, ms", "batches a step"]]
    for row in rows:
        cells = [f"{1e3 * row['batch']:.0f}", f"{row['MB/s']:.0f}", f"{1e3 * row['step']:.0f}", f"{row['ratio']:.1f}"]
        table.append([row["preset"], *cells])
    return markdown(table)


PAGE = pages.Page(
    "loader",
    "Whether training waits for its data",
    "Time that the loader takes for a batch and training for a step on it, by turns on one thread, medians.",
    tables,
)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("presets", nargs="*", default=["kpcn-vanilla", "kpcn-manifold"])
    parser.add_argument("--data", type=Path, help="data set made by 'pathfold-train render'")
    parser.add_argument("--batches", type=int, default=10)
    parser.add_argument("-o", "--output", type=Path, default=pages.RESULTS, help="folder for the page and its data")
    options = parser.parse_args()
    torch.set_num_threads(1)
    findings = pages.Findings(PAGE, options.output, [])
    with tempfile.TemporaryDirectory() as folder:
        data = options.data or write_noise(Path(folder))
        for name in options.presets:
            key = {"preset": name, "data": options.data and options.data.name, "batches": options.batches}
            findings.row(key, partial(measure, load_preset(name), data, options.batches))
    findings.finish()


if __name__ == "__main__":
    main()
