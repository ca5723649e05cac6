"""A KPCN branch as an ONNX graph, with or without the reconstruction inside."""

from __future__ import annotations

import copy

import torch
import torch.nn.functional as functional
from torch import Tensor, nn

from ..family import Shapes, input_shape
from ..features import DEMODULATION_EPSILON
from .branch import Branch


class BranchGraph(nn.Module):
    """A branch with positional inputs, as the exporter wants them."""

    def __init__(self, branch: Branch) -> None:
        super().__init__()
        self.branch = branch

    def input_shapes(self) -> Shapes:
        return {name: input_shape(name) for name in self.branch.input_names()}

    def forward(self, *tensors: Tensor) -> Tensor:
        return self.branch(dict(zip(self.branch.input_names(), tensors, strict=True))).logits


def with_trust_as_last_logit(branch: Branch) -> Branch:
    """A copy whose last layer predicts kernels and trust at once: joining two outputs would copy 441 channels."""
    if branch.trust is None:
        return branch
    joined = copy.deepcopy(branch)
    for name in ("weight", "bias"):
        both = torch.cat([getattr(branch.kernels, name), getattr(branch.trust, name)])
        setattr(joined.kernels, name, nn.Parameter(both, requires_grad=False))
    joined.trust = None
    return joined


class Standalone(BranchGraph):
    """The branch's filtered radiance [1, 3, H, W]: the graph with the reconstruction inside, linear and unexposed."""

    def __init__(self, branch: Branch, size: int) -> None:
        super().__init__(branch)
        self.size = size

    def forward(self, *tensors: Tensor) -> Tensor:
        inputs = dict(zip(self.branch.input_names(), tensors, strict=True))
        predicted, radiance = self.branch(inputs), inputs["radiance"]
        factor = (
            inputs["diffuse.albedo"] + DEMODULATION_EPSILON if self.branch.demodulate else torch.ones_like(radiance)
        )
        # one exponential and one division; onnxruntime's Softmax over channels is six times as slow
        weights = torch.exp(predicted.logits - predicted.logits.amax(1, keepdim=True))
        height, width = radiance.shape[2], radiance.shape[3]
        source = torch.cat([radiance / factor, torch.ones_like(radiance[:, :1])], 1)
        if predicted.trust is not None:  # clamped so that its exponential neither overflows nor vanishes
            source = source * torch.exp(torch.clamp(predicted.trust, -30.0, 30.0))
        source = functional.pad(source, [self.size // 2] * 4)
        total = torch.zeros_like(source[:, :, :height, :width])
        for tap in range(self.size**2):
            dy, dx = divmod(tap, self.size)
            total = total + weights[:, tap : tap + 1] * source[:, :, dy : dy + height, dx : dx + width]
        return total[:, :3] / torch.clamp(total[:, 3:], min=1e-30) * factor
