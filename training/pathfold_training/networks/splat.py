"""The operators of sample-based networks in torch: each sample spreads its radiance over the pixels around it.

SBMC (Gharbi et al. 2019) splats every sample by a kernel of its own. LBMC (Munkberg and Hasselgren 2020) first gathers
a pixel's samples into two layers, splats these and composites them. Kernels are exponentials of logits that are clamped
to [-10, 10], as the gather pyramid's: no running maximum is needed, no weight vanishes, no sum overflows.
"""

from __future__ import annotations

import torch
import torch.nn.functional as functional
from torch import Tensor
from torch.autograd.function import FunctionCtx, once_differentiable

from .. import _taps
from .embedding import sample_sum
from .reconstruct import bounded_exp

PLANES = 4  # of a source: what the compiled loops take at once


def splat(logits: Tensor, radiance: Tensor, valid: Tensor, counts: list[int] | None = None) -> Tensor:
    """out(q) = sum_s sum_d w_s(q - d, d) L_s(q - d) / sum_s sum_d w_s(q - d, d), w = exp(logit): B x 3 x H x W.

    logits N x K*K x H x W, taps row-major by target offset (dy, dx) from -K//2 on; radiance N x 3 x H x W, linear;
    valid N x 1 x H x W, 1 or 0: other samples take no part. A pixel that nothing valid reaches is 0.
    """
    planes = torch.cat([torch.where(valid > 0, radiance, 0.0), valid.to(radiance.dtype)], 1)
    return ratio(sample_sum(splat_sums(logits, planes), counts), 3)


def composite(
    logits: tuple[Tensor, Tensor], radiance: tuple[Tensor, Tensor], weight: tuple[Tensor, Tensor], any_valid: Tensor
) -> Tensor:
    """LBMC's picture B x 3 x H x W of a front and a back layer: c_0 + (1 - alpha_0) c_1.

    With S_j the splat by the layer's kernels, c_0 = S_0[L_0] / S_0[N_0], alpha_0 = S_0[W_0] / S_0[N_0] and
    c_1 = S_1[L_1] / S_1[W_1]. logits B x K*K x H x W; `radiance` L_j is the sum over a pixel's samples of their share
    in the layer times their radiance, `weight` W_j of their shares, W_0 + W_1 = N_0 = `any_valid`, 1 where a pixel has
    a valid sample.
    """
    front = splat_sums(logits[0], torch.cat([radiance[0], any_valid], 1))
    cover = splat_sums(logits[0], functional.pad(weight[0], (0, 0, 0, 0, 0, PLANES - 1)))[:, :1]
    behind = ratio(splat_sums(logits[1], torch.cat([radiance[1], weight[1]], 1)), 3)
    alpha = ratio(torch.cat([cover, front[:, 3:]], 1), 1)
    return ratio(front, 3) + (1.0 - alpha) * behind


def ratio(sums: Tensor, channels: int) -> Tensor:
    """The first channels over the last one, 0 where that is 0."""
    known = sums[:, channels:] > 0.0
    return torch.where(known, sums[:, :channels] / torch.where(known, sums[:, channels:], 1.0), 0.0)


def splat_sums(logits: Tensor, planes: Tensor) -> Tensor:
    """out(q) = sum_d exp(logit_d(q - d)) * planes(q - d), but for one factor: N x K*K and N x 4 -> N x 4 x H x W.

    What falls outside the image is lost.
    """
    size = round(logits.shape[1] ** 0.5)
    if size * size != logits.shape[1] or size % 2 == 0 or planes.shape[1] != PLANES:
        raise ValueError(
            f"{logits.shape[1]} logits and {planes.shape[1]} planes; give the square of an odd kernel size and {PLANES}"
        )
    if logits.device.type == "cpu" and logits.dtype == planes.dtype == torch.float32:
        return _Splat.apply(logits.contiguous(), planes.contiguous(), size)
    return spread(bounded_exp(logits), planes, size)


def spread(weights: Tensor, planes: Tensor, size: int) -> Tensor:
    """splat_sums of weights, by torch's own operations."""
    radius, (height, width) = size // 2, planes.shape[-2:]
    out = planes.new_zeros(*planes.shape[:2], height + 2 * radius, width + 2 * radius)
    for tap, (dy, dx) in enumerate(offsets(size)):
        edges = (dx, 2 * radius - dx, dy, 2 * radius - dy)
        out = out + functional.pad(weights[:, tap : tap + 1] * planes, edges)
    return out[..., radius : radius + height, radius : radius + width]


def offsets(size: int) -> list[tuple[int, int]]:
    return [(dy, dx) for dy in range(size) for dx in range(size)]


class _Splat(torch.autograd.Function):
    """splat_sums on a CPU by training/bindings/taps.h: a splat is the gradient of a gather."""

    @staticmethod
    def forward(ctx: FunctionCtx, logits: Tensor, planes: Tensor, size: int) -> Tensor:
        ctx.save_for_backward(logits, planes)
        ctx.size = size  # type: ignore[attr-defined]
        radius, (height, width) = size // 2, planes.shape[-2:]
        nothing = torch.zeros(*planes.shape[:2], height + 2 * radius, width + 2 * radius)
        arrays = logits.numpy(), 0, nothing.numpy(), planes.numpy(), torch.empty_like(logits).numpy()
        out = torch.from_numpy(_taps.spread_taps(*arrays, offsets(size), torch.get_num_threads()))
        return out[..., radius : radius + height, radius : radius + width].contiguous()

    @staticmethod
    @once_differentiable
    def backward(ctx: FunctionCtx, gradient: Tensor) -> tuple[Tensor, Tensor, None]:
        logits, planes = ctx.saved_tensors  # type: ignore[attr-defined]
        size, threads = ctx.size, torch.get_num_threads()  # type: ignore[attr-defined]
        padded = functional.pad(gradient, (size // 2,) * 4).contiguous().numpy()
        of_logits = torch.empty_like(logits)
        _taps.spread_taps(logits.numpy(), 0, padded, planes.numpy(), of_logits.numpy(), offsets(size), threads)
        of_planes = _taps.sum_taps(logits.numpy(), 0, padded, offsets(size), threads)
        return of_logits, torch.from_numpy(of_planes), None
