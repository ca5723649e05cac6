"""The reconstruction operators in torch, equal to the SDK's (tested): predicted kernels applied to radiance."""

from __future__ import annotations

import torch
import torch.nn.functional as functional
from torch import Tensor
from torch.autograd.function import FunctionCtx, once_differentiable

from .. import _taps

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


LEVEL_LOGITS = 25 + 4 + 1  # of a pyramid level: 5 x 5 kernel, 2 x 2 upsampling, blend; in this order
COARSEST_LOGITS = 25
LOGIT_LIMIT = 10.0  # logits are clamped to it: no weight vanishes, no sum overflows
LEAST_TRUST = -9.0
KERNEL_TAPS = [(dy, dx) for dy in range(5) for dx in range(5)]
UPSAMPLING_TAPS = [(dy, dx) for dy in (0, 2) for dx in (0, 2)]  # one fine pixel up or down meets the next coarse one
TAPS = KERNEL_TAPS, UPSAMPLING_TAPS  # in the order of a level's logits


def gather_pyramid(trust: Tensor, levels: list[Tensor], radiance: Tensor) -> Tensor:
    """The trusted gather pyramid: B x C x H x W filtered radiance, a convex combination of the valid pixels.

    trust B x 1 x H' x W' and levels[l] B x (30, the last one 25) x H'/2^l x W'/2^l, where H', W' are H, W rounded up
    to a multiple of 2^(L - 1). With s = exp(trust), trust in [-9, 0], and D the 2 x 2 average:
    N_0 = s * radiance, W_0 = s (0 outside the image and where radiance is not finite), N_l+1 = D N_l, W_l+1 = D W_l;
    F_l(p) = sum_d k_l(p, d) N_l(p + d) / sum_d k_l(p, d) W_l(p + d) over 5 x 5 taps, k = exp(logit), |logit| <= 10;
    O_l = (1 - a_l) F_l + a_l * (weighted mean of the 2 x 2 nearest cells of O_l+1), a = sigmoid(logit).
    A side without a valid tap leaves the result to the other one; without any, the result is 0.
    """
    valid = torch.isfinite(radiance).all(1, keepdim=True)
    return gather_levels(levels, trusted(trust, radiance, valid), radiance.shape[-2:])[0]


def gather_factor(levels: list[Tensor], values: Tensor, valid: Tensor) -> Tensor:
    """gather_pyramid without trust, of finite `values` B x C x H x W; where no tap is valid, the value itself.

    `levels` as of gather_pyramid, of any number; `valid` B x 1 x H x W.
    """
    result, known = gather_levels(levels, trusted(torch.zeros_like(levels[0][:, :1]), values, valid), values.shape[-2:])
    return torch.where(known > 0.0, result, values)


def gather_levels(levels: list[Tensor], source: Tensor, size: torch.Size) -> tuple[Tensor, Tensor]:
    """O_0 of gather_pyramid from N_0 and W_0, B x (C + 1) x H' x W', cut to `size` H, W; and 1 where it is known."""
    sources = [source]
    for _ in levels[1:]:
        sources.append(functional.avg_pool2d(sources[-1], 2))
    result, known = normalised(level_sums(levels[-1], sources[-1])[0])
    for logits, source in zip(levels[-2::-1], sources[-2::-1], strict=True):
        below = torch.cat([result, known], 1).repeat_interleave(2, -1).repeat_interleave(2, -2)
        own_sums, coarse_sums, blend = level_sums(logits, source, below)
        own, own_known = normalised(own_sums)
        coarse, coarse_known = normalised(coarse_sums)
        # the odds a / (1 - a): in 1 - a itself a small share would lose most of its digits
        odds = torch.exp(torch.clamp(blend, -LOGIT_LIMIT, LOGIT_LIMIT)) * coarse_known
        result, known = normalised(torch.cat([own_known * own + odds * coarse, own_known + odds], 1))
    height, width = size
    return result[:, :, :height, :width], known[:, :, :height, :width]


def trusted(trust: Tensor, values: Tensor, valid: Tensor) -> Tensor:
    """N_0 and, as the last channel, W_0 of gather_pyramid."""
    source = torch.cat([torch.where(valid, values, 0.0), valid.to(values.dtype)], 1)
    source = functional.pad(source, (0, trust.shape[-1] - values.shape[-1], 0, trust.shape[-2] - values.shape[-2]))
    return source * torch.exp(torch.clamp(trust, LEAST_TRUST, 0.0))


def bounded_exp(logits: Tensor) -> Tensor:
    # the constant cancels; it keeps sums of the largest radiance finite
    return torch.exp(torch.clamp(logits, -LOGIT_LIMIT, LOGIT_LIMIT) - 0.5 * LOGIT_LIMIT)


def normalised(sums: Tensor) -> tuple[Tensor, Tensor]:
    """Weighted sums with the sum of weights as the last channel -> means, and 1 where there was any weight."""
    known = sums[:, -1:] > 0.0
    means = sums[:, :-1] / torch.where(known, sums[:, -1:], 1.0)
    return torch.where(known, means, 0.0), known.to(sums.dtype)


def level_sums(logits: Tensor, source: Tensor, below: Tensor | None = None) -> tuple[Tensor, ...]:
    """Sums over a level's taps, B x (C + 1) x h x w: weigh_taps of `source` by its 25 kernel logits.

    Where there is a coarser level, `below` at this one's resolution and logits B x 30 x h x w, also of that by the four
    of the upsampling, and the blend logits B x 1 x h x w.
    """
    if logits.device.type == "cpu" and logits.dtype == source.dtype == torch.float32 and source.shape[1] == 4:
        padded = [functional.pad(x, (r,) * 4).contiguous() for x, r in ((source, 2), (below, 1)) if x is not None]
        return _LevelSums.apply(logits.contiguous(), *padded)  # several times as fast
    if below is None:
        return (weigh_taps(bounded_exp(logits), source, KERNEL_TAPS, 2),)
    kernel, upsampling, blend = torch.split(logits, [25, 4, 1], 1)
    coarse = weigh_taps(bounded_exp(upsampling), below, UPSAMPLING_TAPS, 1)
    return weigh_taps(bounded_exp(kernel), source, KERNEL_TAPS, 2), coarse, blend


def weigh_taps(weights: Tensor, source: Tensor, taps: list[tuple[int, int]], radius: int) -> Tensor:
    """sum_t weights[:, t] * source shifted by taps[t] - radius: B x T x h x w, B x C x h x w -> B x C x h x w."""
    # plane by plane: of weights in channels_last every tap would be strided, which is much slower
    return _WeighTaps.apply(weights.contiguous(), functional.pad(source, (radius,) * 4).contiguous(), taps)


class _WeighTaps(torch.autograd.Function):
    """By hand, so that the shifted products of a tap are never kept (tested with gradcheck)."""

    @staticmethod
    def forward(ctx: FunctionCtx, weights: Tensor, source: Tensor, taps: list[tuple[int, int]]) -> Tensor:
        ctx.save_for_backward(weights, source)
        ctx.taps = taps  # type: ignore[attr-defined]
        height, width = weights.shape[-2:]
        out = torch.zeros_like(source[:, :, :height, :width], memory_format=torch.contiguous_format)
        for t, (dy, dx) in enumerate(taps):
            out.addcmul_(weights[:, t : t + 1], source[:, :, dy : dy + height, dx : dx + width])
        return out

    @staticmethod
    def backward(ctx: FunctionCtx, gradient: Tensor) -> tuple[Tensor, Tensor, None]:
        weights, source = ctx.saved_tensors  # type: ignore[attr-defined]
        height, width = weights.shape[-2:]
        gradient = gradient.contiguous()
        of_weights, of_source = torch.zeros_like(weights), torch.zeros_like(source)
        for t, (dy, dx) in enumerate(ctx.taps):  # type: ignore[attr-defined]
            window = (slice(None), slice(None), slice(dy, dy + height), slice(dx, dx + width))
            for channel, shifted in zip(gradient.unbind(1), source[window].unbind(1), strict=True):
                of_weights[:, t].addcmul_(channel, shifted)  # faster than the sum of their product
            of_source[window].addcmul_(weights[:, t : t + 1], gradient)
        return of_weights, of_source, None


class _LevelSums(torch.autograd.Function):
    """level_sums on a CPU, by training/bindings/taps.h."""

    @staticmethod
    def forward(ctx: FunctionCtx, logits: Tensor, *padded: Tensor) -> tuple[Tensor, ...]:
        ctx.save_for_backward(logits, *padded)
        first, sums = 0, []
        for values, taps in zip(padded, TAPS, strict=False):
            part = _taps.sum_taps(logits.numpy(), first, values.numpy(), taps, torch.get_num_threads())
            sums.append(torch.from_numpy(part))
            first += len(taps)
        return tuple(sums) if len(sums) == 1 else (*sums, logits[:, first:].clone())

    @staticmethod
    @once_differentiable
    def backward(ctx: FunctionCtx, *gradients: Tensor) -> tuple[Tensor, ...]:
        logits, *padded = ctx.saved_tensors  # type: ignore[attr-defined]
        first, of_logits, of_values = 0, torch.empty_like(logits), []
        for values, taps, gradient in zip(padded, TAPS, gradients, strict=False):
            given = (logits.numpy(), first, values.numpy(), gradient.contiguous().numpy(), of_logits.numpy())
            of_values.append(torch.from_numpy(_taps.spread_taps(*given, taps, torch.get_num_threads())))
            first += len(taps)
        if len(padded) == 2:
            of_logits[:, first:] = gradients[2]
        return of_logits, *of_values
