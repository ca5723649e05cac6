"""Samples reduced to the buffers of a frame, and frames to a batch."""

from __future__ import annotations

import torch

from ..networks.batch import Batch, Inputs
from ..networks.features import OPTIONAL

PATH_NAMES = ("samples.descriptor", "samples.density")


def reduce_samples(samples: Inputs) -> Inputs:
    """Per-pixel buffers of a block of samples: means, and the unbiased variance of the radiance means."""
    n = samples["samples.radiance"].shape[0]
    radiance, diffuse = samples["samples.radiance"], samples["samples.diffuse"]
    out = {}
    for name, value in (
        ("color", radiance),
        ("diffuse", diffuse),
        ("specular", (radiance - diffuse).clamp(min=0.0)),
    ):
        out[name] = value.mean(0)
        # torch's own var is several times as slow along the first dimension
        variance = (value - out[name]).square().sum(0) / (max(1, n - 1) * n)
        out["variance" if name == "color" else f"{name}.variance"] = variance
    for name in ("diffuse.albedo", "albedo", "normal", "depth"):
        out[name] = samples[f"samples.{name}"].mean(0)
    return out


def frame_inputs(samples: Inputs, exposure: float, depth_scale: float) -> Inputs:
    """Everything a frame offers the networks, all optional inputs present."""
    n = samples["samples.radiance"].shape[0]
    inputs = reduce_samples(samples)
    inputs |= {name: samples[name].float() for name in PATH_NAMES if name in samples}
    inputs["samples.valid"] = torch.ones_like(samples.get("samples.density", samples["samples.depth"]))
    inputs["exposure"], inputs["depth_scale"] = torch.tensor(exposure), torch.tensor(depth_scale)
    for name in OPTIONAL:
        inputs[f"{name}.present"] = torch.tensor(0.0 if name == "variance" and n < 2 else 1.0)
    inputs["paths.present"] = torch.tensor(1.0 if "samples.descriptor" in samples else 0.0)
    return inputs


def without_paths(inputs: Inputs) -> Inputs:
    """What the networks see of one frame without path descriptors: a sample that is not valid, and presence 0."""
    absent = {name: torch.zeros_like(inputs[name][:1]) for name in (*PATH_NAMES, "samples.valid") if name in inputs}
    return inputs | absent | {"paths.present": torch.zeros_like(inputs["paths.present"])}


def collate(frames: list[tuple[Inputs, Inputs]]) -> Batch:
    counts = [inputs["samples.valid"].shape[0] for inputs, _ in frames]
    names = frames[0][0]
    joined = {n: (torch.cat if n.startswith("samples.") else torch.stack)([i[n] for i, _ in frames]) for n in names}
    return Batch(joined, {n: torch.stack([r[n] for _, r in frames]) for n in frames[0][1]}, counts)
