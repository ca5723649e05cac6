"""What each of KPCN's branches filters, and what it should become."""

from __future__ import annotations

from dataclasses import dataclass

import torch
from torch import Tensor

from ..batch import Inputs
from ..features import DEMODULATION_EPSILON


@dataclass
class Target:
    """What one branch is to filter, and against what: exposed radiance B x 3 x H x W."""

    radiance: Tensor  # the branch's noisy radiance, demodulated
    remodulate: Tensor  # noisy factor of the result
    truth: Tensor  # remodulated
    label: Tensor  # the manifold's: the truth before remodulation


def branch_inputs(inputs: Inputs, branch: str) -> Inputs:
    """A branch graph's own inputs: `radiance` and `variance` are the branch's, or color's in frames without a split."""
    split = inputs["split.present"].reshape(-1, 1, 1, 1)
    own, unsplit = (
        inputs[branch],
        inputs["color"] if branch == "specular" else torch.zeros_like(inputs["color"]),
    )
    own_variance, variance = inputs[f"{branch}.variance"], inputs["variance"]
    return inputs | {
        "radiance": own * split + unsplit * (1.0 - split),
        "variance": own_variance * split + variance * (1.0 - split),
    }


def branch_target(inputs: Inputs, truth: Inputs, branch: str) -> Target:
    exposure = inputs["exposure"].reshape(-1, 1, 1, 1)
    split = inputs["split.present"].reshape(-1, 1, 1, 1)
    radiance = branch_inputs(inputs, branch)["radiance"] * exposure
    total, diffuse = truth["color"] * exposure, truth["diffuse"] * exposure
    if branch == "diffuse":
        factor = inputs["diffuse.albedo"] + DEMODULATION_EPSILON
        clean = truth["diffuse.albedo"] + DEMODULATION_EPSILON
        return Target(radiance / factor, factor, diffuse * split, diffuse / clean)
    wanted = total - diffuse * split
    return Target(radiance, torch.ones_like(radiance), wanted, wanted)


def on_lattice(x: Tensor, lattice: int, offset: tuple[int, int]) -> Tensor:
    return x[:, :, offset[0] :: lattice, offset[1] :: lattice]
