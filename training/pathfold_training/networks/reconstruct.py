"""The reconstruction operators in torch, equal to the SDK's (tested): predicted kernels applied to radiance."""

from __future__ import annotations

import torch
import torch.nn.functional as functional
from torch import Tensor

STRIP_TAPS = 1 << 25  # taps per strip: bounds the memory of the unfolded patches


def gather(logits: Tensor, radiance: Tensor, size: int, lattice: int = 1, offset: tuple[int, int] = (0, 0)) -> Tensor:
    """out(p) = sum over the K x K taps of softmax(logits(p)) * radiance(p + tap).

    logits B x K*K x h x w, taps row-major (dy, dx); radiance B x C x H x W. With `lattice` n, logits belong to the
    pixels offset + n * (i, j). Taps outside the image or on non-finite radiance are masked, the rest renormalised;
    a pixel without a valid tap is 0.
    """
    radius = size // 2
    valid = torch.isfinite(radiance).all(1, keepdim=True)
    source = torch.cat([torch.where(valid, radiance, 0.0), valid.to(radiance.dtype)], 1)
    source = functional.pad(source, (radius, radius, radius, radius))
    source = source[:, :, offset[0] :, offset[1] :]
    rows = max(1, STRIP_TAPS // (logits.shape[0] * size * size * logits.shape[3] * source.shape[1]))
    strips = []
    for top in range(0, logits.shape[2], rows):
        part = logits[:, :, top : top + rows]
        high = (part.shape[2] - 1) * lattice + size
        strips.append(gather_strip(part, source[:, :, top * lattice : top * lattice + high], size, lattice))
    return torch.cat(strips, 2)


def gather_strip(logits: Tensor, source: Tensor, size: int, lattice: int) -> Tensor:
    batch, taps, height, width = logits.shape
    patches = source.unfold(2, size, lattice).unfold(3, size, lattice)[:, :, :height, :width]  # B C+1 h w K K
    patches = patches.permute(0, 2, 3, 4, 5, 1).reshape(batch * height * width, taps, -1)
    rows = logits.permute(0, 2, 3, 1).reshape(batch * height * width, 1, taps)
    masked = rows.masked_fill(patches[:, :, -1].unsqueeze(1) == 0.0, float("-inf"))
    peak = torch.clamp(masked.amax(-1, keepdim=True).detach(), min=torch.finfo(rows.dtype).min)
    weights = torch.exp(masked - peak)
    sums = torch.bmm(weights, patches).squeeze(1)  # the last column is the sum of weights
    out = sums[:, :-1] / torch.clamp(sums[:, -1:], min=1e-30)
    return out.reshape(batch, height, width, -1).permute(0, 3, 1, 2)
