"""Feature transforms: what the networks see of the linear buffers. They are part of the exported graphs.

All tensors are B x C x H x W; `exposure`, `depth_scale` and `<name>.present` are [B]. Inputs are sanitised by the
SDK (finite, radiance >= 0), linear and unexposed.
"""

from __future__ import annotations

import torch
import torch.nn.functional as functional
from pathfold._core import DEAD_LOG, Layout
from torch import Tensor

# Optional inputs of a branch, each with a presence plane
OPTIONAL = ("variance", "albedo", "normal", "depth", "split")
BRANCH_CHANNELS = 3 + 1 + 6 + 3 + 6 + 1 + 2 + 3 + 6 + len(OPTIONAL)  # 36
DEMODULATION_EPSILON = 0.00316  # KPCN: keeps division by a black albedo bounded

LAYOUT = Layout()  # of path descriptors
DESCRIPTOR_CHANNELS = LAYOUT.channels
LOG_FLOOR_RADIANCE, LOG_FLOOR_LIGHT, LOG_FLOOR_ATTENUATION, LOG_FLOOR_DENSITY = (
    -13.8155,
    -18.4207,
    -13.8155,
    -13.8155,
)
LOG_CEILING = 87.0  # ln(1e38), the paper's cap
DESCRIPTOR_SCALES = (
    [30.0] * (LAYOUT.light - LAYOUT.radiance)
    + [10.0] * (LAYOUT.attenuation - LAYOUT.light)
    + [30.0] * (LAYOUT.kind - LAYOUT.attenuation)
    + [19.0] * (LAYOUT.roughness - LAYOUT.kind)
    + [1.0] * (LAYOUT.channels - LAYOUT.roughness)
)
SENTINEL = DEAD_LOG + 1  # logs below it stand for raw 0: exposure is not added to them


def plane(value: Tensor, like: Tensor) -> Tensor:
    """A per-image scalar [B] as a constant plane B x 1 x H x W."""
    return value.reshape(-1, 1, 1, 1).to(like.dtype) + torch.zeros_like(like[:, :1])


def gradients(x: Tensor) -> Tensor:
    """Backward differences in x, then y, 0 in the first column and row (KPCN). C -> 2C channels."""
    dx = functional.pad(x[:, :, :, 1:] - x[:, :, :, :-1], (1, 0, 0, 0))
    dy = functional.pad(x[:, :, 1:, :] - x[:, :, :-1, :], (0, 0, 1, 0))
    return torch.cat([dx, dy], 1)


def branch_features(inputs: dict[str, Tensor], demodulate: bool) -> Tensor:
    """R's input without paths: B x 36 x H x W. `demodulate` divides radiance by `diffuse.albedo` + 0.00316.

    Radiance enters as ln(1 + exposed radiance) in both branches and its deviation relative to the mean, so that a
    firefly stays of order ten; KPCN's linear diffuse branch is unbounded (a deviation from the paper).
    """
    scale = inputs["exposure"].reshape(-1, 1, 1, 1)
    deviation = torch.sqrt(inputs["variance"].mean(1, keepdim=True)) * scale
    mean = inputs["radiance"] * scale
    relative = torch.clamp(deviation / (mean.mean(1, keepdim=True) + 0.01), max=10.0)
    if demodulate:
        mean = mean / (inputs["diffuse.albedo"] + DEMODULATION_EPSILON)
    color = torch.log1p(mean)
    far = inputs["depth"] * inputs["depth_scale"].reshape(-1, 1, 1, 1)
    depth = 1.0 - 1.0 / (1.0 + far)  # [0, 1), whatever the scene's unit; stays exact where far overflows
    albedo = torch.clamp(inputs["albedo"], 0.0, 1.0)
    normal = inputs["normal"]
    present = [plane(inputs[f"{name}.present"], color) for name in OPTIONAL]
    parts = [color, relative, gradients(color), normal, gradients(normal)]
    parts += [depth, gradients(depth), albedo, gradients(albedo)]
    return torch.cat(parts + present, 1)


def descriptor_logs(descriptor: Tensor, log_exposure: Tensor) -> Tensor:
    """Path descriptors N x 36 x H x W (docs/architecture.md#buffers), exposed and bounded; `log_exposure` [N] or [1].

    Natural logs cross the API; exposure is an addition to the six radiance-like channels; a raw 0 stays at the floor.
    """
    shift = log_exposure.reshape(-1, 1, 1, 1).to(descriptor.dtype)
    at = LAYOUT
    light = descriptor[:, at.radiance : at.attenuation]
    light = light + shift * (light > SENTINEL)
    radiance = torch.clamp(light[:, : at.light], LOG_FLOOR_RADIANCE, LOG_CEILING)
    energy = torch.clamp(light[:, at.light :], LOG_FLOOR_LIGHT, LOG_CEILING)
    attenuation = torch.clamp(descriptor[:, at.attenuation : at.kind], LOG_FLOOR_ATTENUATION, LOG_CEILING)
    kind = torch.clamp(descriptor[:, at.kind : at.roughness], 0.0, 19.0)
    roughness = torch.sqrt(torch.clamp(descriptor[:, at.roughness : at.channels], 0.0, 1.0))
    return torch.cat([radiance, energy, attenuation, kind, roughness], 1)


def descriptor_features(descriptor: Tensor, log_exposure: Tensor) -> Tensor:
    """F's input: descriptor_logs, each channel divided by about the width of its range."""
    logs = descriptor_logs(descriptor, log_exposure)
    return logs / torch.tensor(DESCRIPTOR_SCALES, dtype=logs.dtype, device=logs.device).reshape(1, -1, 1, 1)


def density_features(density: Tensor) -> Tensor:
    """R's log sampling density, N x 1 x H x W: ln q / 90, floor 1e-6, cap 1e38."""
    return torch.clamp(density, LOG_FLOOR_DENSITY, LOG_CEILING) / 90.0
