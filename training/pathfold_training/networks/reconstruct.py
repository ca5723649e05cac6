"""The reconstruction operators in torch, equal to the SDK's (tested): predicted kernels applied to radiance."""

from __future__ import annotations

import torch
import torch.nn.functional as functional
from torch import Tensor

STRIP_TAPS = 1 << 25  # taps per strip: bounds the memory of the unfolded patches


def gather(
    logits: Tensor,
    radiance: Tensor,
    size: int,
    lattice: int = 1,
    offset: tuple[int, int] = (0, 0),
    trust: Tensor | None = None,
) -> Tensor:
    """out(p) = sum over the K x K taps of softmax(logits(p) + trust(p + tap)) * radiance(p + tap).

    logits B x K*K x h x w, taps row-major (dy, dx); radiance B x C x H x W; trust B x 1 x H x W, None for 0. With
    `lattice` n, logits belong to the pixels offset + n * (i, j). Taps outside the image or on non-finite radiance are
    masked, the rest renormalised; a pixel without a valid tap is 0.
    """
    radius = size // 2
    valid = torch.isfinite(radiance).all(1, keepdim=True)
    source = torch.cat([torch.where(valid, radiance, 0.0), valid.to(radiance.dtype)], 1)
    shift = torch.where(valid, torch.zeros_like(radiance[:, :1]) if trust is None else trust, float("-inf"))
    edge = (radius, radius, radius, radius)
    source = functional.pad(source, edge)[:, :, offset[0] :, offset[1] :]
    shift = functional.pad(shift, edge, value=float("-inf"))[:, :, offset[0] :, offset[1] :]
    rows = max(1, STRIP_TAPS // (logits.shape[0] * size * size * logits.shape[3] * source.shape[1]))
    strips = []
    for top in range(0, logits.shape[2], rows):
        part = logits[:, :, top : top + rows]
        window = slice(top * lattice, top * lattice + (part.shape[2] - 1) * lattice + size)
        strips.append(gather_strip(part, source[:, :, window], shift[:, :, window], size, lattice))
    return torch.cat(strips, 2)


def gather_strip(logits: Tensor, source: Tensor, shift: Tensor, size: int, lattice: int) -> Tensor:
    batch, taps, height, width = logits.shape

    def patches(x: Tensor) -> Tensor:
        unfolded = x.unfold(2, size, lattice).unfold(3, size, lattice)[:, :, :height, :width]  # B C h w K K
        return unfolded.permute(0, 2, 3, 4, 5, 1).reshape(batch * height * width, taps, -1)

    rows = logits.permute(0, 2, 3, 1).reshape(batch * height * width, 1, taps) + patches(shift).transpose(1, 2)
    peak = torch.clamp(rows.amax(-1, keepdim=True).detach(), min=torch.finfo(rows.dtype).min)
    sums = torch.bmm(torch.exp(rows - peak), patches(source)).squeeze(1)  # the last column is the sum of weights
    out = sums[:, :-1] / torch.clamp(sums[:, -1:], min=1e-30)
    return out.reshape(batch, height, width, -1).permute(0, 3, 1, 2)
