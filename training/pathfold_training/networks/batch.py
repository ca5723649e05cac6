"""What the networks are given: a batch of frames with what they should become."""

from __future__ import annotations

from dataclasses import dataclass

import torch
from torch import Tensor

Inputs = dict[str, Tensor]


@dataclass
class Batch:
    """Buffers B x C x H x W (samples N x C x H x W, `counts` per image), scalars [B], the truth B x 3 x H x W."""

    inputs: Inputs
    truth: Inputs
    counts: list[int]

    def to(self, device: torch.device) -> Batch:
        move = {k: v.to(device) for k, v in self.inputs.items()}
        return Batch(move, {k: v.to(device) for k, v in self.truth.items()}, self.counts)
