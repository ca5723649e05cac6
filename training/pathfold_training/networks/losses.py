"""The training losses: a robust relative image loss and WCMC's manifold loss."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Literal

import torch
import torch.nn.functional as functional
from torch import Tensor

from .sizes import Count, Strict, Weight

RELATIVE_EPSILON = 0.01  # RelL2's, in exposed units
GEOMETRIC_FLOOR = 1e-3  # an image's error below which it counts less: references are no better
GEOMETRIC_WEIGHT = 0.03  # about an image's error, so that the terms beside it weigh as much as beside a plain mean
ENERGY_BLOCK = 16  # pixels
ENERGY_EPSILON = 0.03  # exposed radiance below which a block's error counts less
GAMMA = 1 / 2.2
LOGIT_LIMIT = 10.0


class Loss(Strict):
    """Weights of the terms."""

    image: Literal["robust", "geometric"] = "robust"  # geometric: each image's relative change counts alike
    energy: Weight = 0.0  # error of block means, against darkening
    albedo: Weight = 0.0  # error of the cleaned albedo, for networks that clean it
    branch: Weight = 0.5  # per-branch terms beside the recombined image
    logits: Weight = 1.0e-4  # excess of |logit| over 10
    manifold: Weight = (
        0.0  # lambda of the slides' formula; the paper's 0.1 is 0.0125 here (its code is 1/8 of the formula)
    )
    manifold_pairs: Count = 16384  # local and non-local pairs drawn per image, each

    def over_images(self, errors: Tensor) -> Tensor:
        """Errors [B] as one number."""
        return geometric(errors) if self.image == "geometric" else errors.mean()


@dataclass(frozen=True)
class Draw:
    """What a step draws at random, and which of how many processes that share its batch draws it.

    `gather` makes processes x ... of every process's tensor, with the gradients; None for one process.
    """

    generator: torch.Generator
    process: int = 0
    processes: int = 1
    gather: Callable[[Tensor], Tensor] | None = None


def error_scale(reference: Tensor, noisy: bool = True) -> Tensor:
    """The radiance that errors are measured against: sqrt(r^2 + eps) of the exposed reference, B x 3 x H x W.

    r is the median of 3x3 pixels where the reference is noisy. Dividing by the pixel's own noisy reference would punish
    just the pixels it underestimates; dividing by a mean would excuse light that leaks
    from an emitter into the dark pixels beside it, which makes most of RelL2. Without noise r is the pixel's own, as
    in RelL2: a median would excuse what leaks onto a dark line one pixel wide.
    """
    return torch.sqrt((median3x3(reference) if noisy else reference).square() + RELATIVE_EPSILON)


def median3x3(image: Tensor) -> Tensor:
    """Median of the 3x3 pixels around each, B x C x H x W, edges repeated; much faster than torch.median of nine.

    Of columns that are sorted it is the median of three: the largest least, the median median, the least largest.
    """
    padded = functional.pad(image, (1, 1, 1, 1), mode="replicate")
    a, b, c = padded[:, :, :-2], padded[:, :, 1:-1], padded[:, :, 2:]
    low, high = torch.minimum(a, b), torch.maximum(a, b)
    columns = torch.minimum(low, c), torch.maximum(low, torch.minimum(high, c)), torch.maximum(high, c)
    (l0, l1, l2), middles, (h0, h1, h2) = ((x[..., :-2], x[..., 1:-1], x[..., 2:]) for x in columns)
    return middle(torch.maximum(torch.maximum(l0, l1), l2), middle(*middles), torch.minimum(torch.minimum(h0, h1), h2))


def middle(a: Tensor, b: Tensor, c: Tensor) -> Tensor:
    """The median of three, element by element."""
    return torch.maximum(torch.minimum(a, b), torch.minimum(torch.maximum(a, b), c))


def robust_relative(output: Tensor, reference: Tensor, scale: Tensor) -> Tensor:
    """Each image's mean [B] of a robust function of the relative error d: d^2 up to |d| = 2, then 4 + 8 ln(|d| / 2).
    Exposed radiance B x 3 x H x W.

    The tail is a logarithm: with a linear one, light leaking from emitters (|d| in the hundreds) outweighs all else and
    drives a branch to the identity before it has learned to tell pixels apart.
    """
    d = ((output - reference) / scale).abs()
    return torch.where(d < 2.0, d.square(), 4.0 + 8.0 * torch.log(torch.clamp(d, min=2.0) / 2.0)).mean((1, 2, 3))


def halves_error(image: Tensor, a: Tensor, b: Tensor) -> Tensor:
    """RelL2 without the reference's noise, of its halves: mean of (x - a)(x - b) / (r^2 + eps).

    Exposed radiance B x 3 x H x W, one number for the whole batch, as metrics.rell2_halves is for a picture. At least
    a tenth of what it is against the mean r of both, as chance can make the product's mean negative.
    """
    reference = (a + b) / 2
    weight = 1.0 / (reference.square() + RELATIVE_EPSILON)
    least = 0.1 * ((image - reference).square() * weight).mean()
    return torch.maximum(((image - a) * (image - b) * weight).mean(), least)


def geometric(errors: Tensor) -> Tensor:
    """The errors [B] of images as one number, which falls with their geometric mean.

    By their plain mean the few images with the largest errors, of few samples, are all that is learned from; what is
    reported is the geometric mean over scenes.
    """
    return GEOMETRIC_WEIGHT * torch.log(errors / GEOMETRIC_FLOOR + 1.0).mean()


def energy_error(output: Tensor, reference: Tensor) -> Tensor:
    """robust_relative [B] of means over blocks of 16 x 16 pixels (what is left at the edges apart), exposed radiance.

    Pixel by pixel, a network that is unsure of a bright value, or sees it seldom, does best by staying below it, and a
    robust loss forgives what is left out altogether. In a block's mean these errors do not cancel, and noise does.
    """
    means, right = (functional.avg_pool2d(x, ENERGY_BLOCK, ceil_mode=True) for x in (output, reference))
    return robust_relative(means, right, torch.sqrt(right.square() + ENERGY_EPSILON**2))


def albedo_error(cleaned: Tensor, target: Tensor, present: Tensor) -> Tensor:
    """Mean of ((c - t) / sqrt(c^2 + eps))^2 with the c below held fixed (Noise2Noise); both B x 3 x H x W.

    So the target may be noisy as long as its noise is not the input's. Images without an albedo (`present` [B] of 0 and
    1), or without such a target (NaN), count as 0.
    """
    known = present * torch.isfinite(target).all(-1).all(-1).all(-1).to(present.dtype)
    error = (cleaned - torch.nan_to_num(target)).square() / (cleaned.detach().square() + RELATIVE_EPSILON)
    return (known * error.mean((1, 2, 3))).mean()


def logit_excess(logits: Tensor) -> Tensor:
    """Mean over pixels of the summed squared excess of |logit| over 10, logits B x K*K x h x w.

    Keeps softmax kernels from saturating, where no gradient leads back. Summed over the taps: a kernel collapses to
    the identity by one logit alone, which a mean over 441 taps would hardly see.
    """
    excess = functional.softshrink(logits, LOGIT_LIMIT)
    return excess.to(torch.promote_types(excess.dtype, torch.float32)).square().sum(1).mean()


def tone_map(radiance: Tensor) -> Tensor:
    """The manifold's label: (I / (1 + I))^(1/2.2) per channel, in [0, 1)."""
    radiance = torch.clamp(radiance, min=0.0)
    return (radiance / (1.0 + radiance)) ** GAMMA


def manifold_loss(
    embedding: Tensor,
    label: Tensor,
    counts: list[int],
    pairs: int,
    draw: Draw,
) -> Tensor:
    """L_m, local plus non-local: mean of (|f_x - f_y|^2 - |tau_x - tau_y|^2)^2 (the formula of the authors' slides).

    embedding N x C x H x W (all samples of B images, image after image), label B x 3 x H x W (tone-mapped reference;
    every sample of a pixel shares it), `pairs` drawn per image for each of the two terms. Local pairs join samples of
    one image, non-local ones samples anywhere in the batch. In fp32. Where processes share a batch, each has B images
    of it and gets the loss of the whole.
    """
    images, first = draw.processes * len(counts), draw.process * len(counts)
    places = torch.rand(images, 2 * pairs, dtype=torch.float64, generator=draw.generator)[first : first + len(counts)]
    chosen, labels = [], []
    for part, tau, place in zip(torch.split(embedding.float(), counts), label, places, strict=True):
        samples, channels, height, width = part.shape
        index = (place * (samples * height * width)).long().to(part.device)
        pixel = index % (height * width)
        chosen.append(part.permute(1, 0, 2, 3).reshape(channels, -1)[:, index])  # C x 2 pairs
        labels.append(tau.reshape(3, -1)[:, pixel])
    f, t = torch.stack(chosen), torch.stack(labels)  # B x C x 2P, B x 3 x 2P
    if draw.gather is not None:
        f, t = draw.gather(f), draw.gather(t)
        if f.requires_grad:  # torch 2.13 mixes up the values of a gathered tensor's gradient unless it is contiguous
            f.register_hook(torch.Tensor.contiguous)
        f, t = f.flatten(0, 1), t.flatten(0, 1)
    local = pair_error(f[..., :pairs], f[..., pairs:], t[..., :pairs], t[..., pairs:])
    flat_f, flat_t = f.transpose(0, 1).flatten(1), t.transpose(0, 1).flatten(1)
    order = torch.randperm(flat_f.shape[1], generator=draw.generator).to(f.device)
    a, b = order.chunk(2)
    return local + pair_error(flat_f[:, a], flat_f[:, b], flat_t[:, a], flat_t[:, b])


def pair_error(fx: Tensor, fy: Tensor, tx: Tensor, ty: Tensor) -> Tensor:
    axis = -2
    return ((fx - fy).square().sum(axis) - (tx - ty).square().sum(axis)).square().mean()
