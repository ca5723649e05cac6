"""A tiny model of the pathfold family for the tests of export, and frames for it."""

import json
from pathlib import Path

import numpy as np
import torch
from pathfold_training.fit.preset import Config, Data, Optimiser
from pathfold_training.fit.task import Denoising
from pathfold_training.fit.train import fit
from pathfold_training.networks.pathfold.sizes import PathfoldSizes
from pathfold_training.release.export import export, load_task
from training_data import write_data_set

CONFIG = Config(
    name="tiny-pathfold",
    description="a network for tests",
    network=PathfoldSizes(widths=(16, 16, 16, 16), convolutions=(2, 1, 1, 1), embedding=4),
    data=Data(crop=32, batch=1, spp_max=4, drop_paths=0.5),
    optimiser=Optimiser(steps=2, average=0.5),
)
Buffers = dict[str, np.ndarray]


def export_tiny(folder: Path) -> tuple[Path, Denoising]:
    """A trained checkpoint whose heads, close to zero after two steps, are made random: its model folder and task."""
    checkpoint = fit(CONFIG, write_data_set(folder / "data"), folder / "run", validate_every=1000, threads=1)
    state = torch.load(checkpoint, weights_only=True)
    g = torch.Generator().manual_seed(0)
    for name, value in state["state_dict"].items():
        if "heads" in name or "trust.weight" in name:
            value += 0.2 * torch.randn(value.shape, generator=g)
    torch.save(state, checkpoint)
    record = json.loads((folder / "run" / "record.json").read_text())
    return export(checkpoint, folder / "model", record), load_task(checkpoint)[0]


def frame(height: int, width: int, samples: int, seed: int) -> Buffers:
    """Heavy-tailed radiance and guides in host layout."""
    rng = np.random.default_rng(seed)
    shape = (height, width, 3)
    buffers = {"color": rng.exponential(0.5, shape) ** 3, "albedo": rng.uniform(0, 1, shape)}
    buffers |= {"normal": rng.uniform(-1, 1, shape), "depth": rng.uniform(0.5, 50, (height, width, 1))}
    buffers["variance"] = rng.exponential(0.1, shape)
    logs = rng.normal(-2, 6, (samples, height, width, 24))
    logs[rng.random(logs.shape) < 0.3] = -100
    tags = rng.choice([0, 5, 9, 17, 6, 10, 18, 3], (samples, height, width, 6))
    roughness = rng.uniform(0, 1, (samples, height, width, 6))
    buffers["samples.descriptor"] = np.concatenate([logs, tags, roughness], -1)
    return {name: value.astype(np.float32) for name, value in buffers.items()}
