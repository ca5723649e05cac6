"""F: the path embedding network (WCMC). Each path becomes C numbers; pixels share a U-Net context."""

from __future__ import annotations

from itertools import pairwise

import torch
import torch.nn.functional as functional
from torch import Tensor, nn
from torch.nn.utils.parametrizations import weight_norm

from .features import DESCRIPTOR_CHANNELS, descriptor_features

ALIGNMENT = 4  # two 2x2 poolings
# mean and deviation of F's inputs over generated and library views: undivided radiance, photon energy, attenuations;
# tags and roughness by vertex. Unscaled, most inputs vary by 0.2 and F learns slowly
INPUT_MEAN = (
    [-0.21] * 3 + [-0.6] * 3 + [-0.28] * 18 + [0.33, 0.19, 0.16, 0.13, 0.12, 0.05, 0.74, 0.47, 0.39, 0.34, 0.31, 0.14]
)
INPUT_DEVIATION = [0.23] * 3 + [1.0] * 3 + [0.2] * 18 + [0.2] * 6 + [0.45] * 6
RADIUS = 40  # pixels: convolutions reach 30, pooling and upsampling add up to 9, rounded to the alignment


def convolution(inputs: int, outputs: int, kernel: int) -> nn.Module:
    layer = nn.Conv2d(inputs, outputs, kernel, padding=kernel // 2)
    # torch's default halves the signal with every layer: 20 deep, F's output hardly varies and no gradient arrives
    nn.init.kaiming_normal_(layer.weight, nonlinearity="relu")
    nn.init.zeros_(layer.bias)  # type: ignore[arg-type]
    return weight_norm(layer)


def stack(*widths: int, kernel: int = 3) -> nn.Sequential:
    """Convolutions with ReLU after each."""
    layers: list[nn.Module] = []
    for inputs, outputs in pairwise(widths):
        layers += [convolution(inputs, outputs, kernel), nn.ReLU()]
    return nn.Sequential(*layers)


class Context(nn.Module):
    """U-Net of three levels, widths m, 2m, 4m: B x m x H x W -> B x m x H x W, any H and W."""

    def __init__(self, m: int) -> None:
        super().__init__()
        self.top_down = stack(m, m, m, m)
        self.middle_down = stack(m, 2 * m, 2 * m, 2 * m)
        self.bottom = stack(2 * m, 4 * m, 4 * m, 4 * m)
        self.middle_up = stack(6 * m, 2 * m, 2 * m, 2 * m)
        self.top_up = nn.Sequential(stack(3 * m, m, m), convolution(m, m, 3), nn.LeakyReLU(0.01))

    def forward(self, x: Tensor) -> Tensor:
        height, width = x.shape[-2:]
        x = functional.pad(
            x,
            (0, (ALIGNMENT - width % ALIGNMENT) % ALIGNMENT, 0, (ALIGNMENT - height % ALIGNMENT) % ALIGNMENT),
        )
        top = self.top_down(x)
        middle = self.middle_down(functional.max_pool2d(top, 2))
        bottom = self.bottom(functional.max_pool2d(middle, 2))
        middle = self.middle_up(torch.cat([upsample(bottom), middle], 1))
        return self.top_up(torch.cat([upsample(middle), top], 1))[:, :, :height, :width]


def upsample(x: Tensor) -> Tensor:
    return functional.interpolate(x, scale_factor=2.0, mode="bilinear", align_corners=False)


class PathEmbedding(nn.Module):
    """Descriptor features N x 36 x H x W of B images, image after image -> embeddings N x C x H x W, non-negative.

    `counts` gives each image's number of samples (they sum to N); None means one image. The paper's last ReLU is a
    softplus here: with C = 3 a channel that dies takes a third of the embedding with it.
    """

    mean: Tensor
    deviation: Tensor

    def __init__(self, channels: int, width: int) -> None:
        super().__init__()
        self.register_buffer("mean", torch.tensor(INPUT_MEAN).reshape(1, -1, 1, 1), persistent=False)
        self.register_buffer("deviation", torch.tensor(INPUT_DEVIATION).reshape(1, -1, 1, 1), persistent=False)
        self.sample = nn.Sequential(stack(DESCRIPTOR_CHANNELS, width, width, kernel=1), convolution(width, width, 1))
        self.context = Context(width)
        # the head's first layer sees [sample, context]; as two layers, the context's half is computed once per pixel
        self.head_sample = convolution(width, 2 * width, 1)
        self.head_context = convolution(width, 2 * width, 1)
        self.head = convolution(2 * width, channels, 1)

    def forward(self, features: Tensor, valid: Tensor, counts: list[int] | None = None) -> Tensor:
        sample = self.sample((features - self.mean) / self.deviation)
        context = self.head_context(self.context(sample_mean(sample, valid, counts)))
        hidden = torch.relu(self.head_sample(sample) + per_sample(context, counts))
        embedding = self.head(hidden)
        return functional.softplus(embedding.to(torch.promote_types(embedding.dtype, torch.float32)))


class Standardised(nn.Conv2d):
    """A 1x1 convolution of descriptors that are brought to mean 0 and deviation 1 first: it learns them sooner.

    `weight` and `bias` belong to the scaled inputs; `folded` gives those for inputs as they are.
    """

    mean: Tensor
    deviation: Tensor

    def __init__(self, outputs: int) -> None:
        super().__init__(DESCRIPTOR_CHANNELS, outputs, 1)
        for name, values in (("mean", INPUT_MEAN), ("deviation", INPUT_DEVIATION)):
            self.register_buffer(name, torch.tensor(values).reshape(1, -1, 1, 1), persistent=False)

    def folded(self) -> tuple[Tensor, Tensor]:
        """Weight O x 36 x 1 x 1 and bias O."""
        assert self.bias is not None
        weight = self.weight / self.deviation
        return weight, self.bias - (weight * self.mean).sum((1, 2, 3))

    def unfold(self, weight: Tensor, bias: Tensor) -> None:
        """The reverse: takes what `folded` is to give."""
        with torch.no_grad():
            self.weight.copy_(weight * self.deviation)
            self.bias.copy_(bias + (weight * self.mean).sum((1, 2, 3)))  # type: ignore[union-attr]

    def forward(self, x: Tensor) -> Tensor:
        return functional.conv2d(x, *self.folded())


def sample_sum(x: Tensor, counts: list[int] | None = None) -> Tensor:
    """Sum over each image's samples: N x C x H x W -> B x C x H x W."""
    if counts is None:
        return x.sum(0, keepdim=True)
    return torch.stack([part.sum(0) for part in torch.split(x, counts)])


def sample_mean(x: Tensor, valid: Tensor, counts: list[int] | None = None) -> Tensor:
    """Mean over each image's valid samples: N x C x H x W -> B x C x H x W; 0 where no sample is valid."""
    return sample_sum(x * valid, counts) / torch.clamp(sample_sum(valid, counts), min=1.0)


def per_sample(x: Tensor, counts: list[int] | None = None) -> Tensor:
    """The reverse: each image's row for each of its samples. One image broadcasts."""
    if counts is None:
        return x
    # expand, not repeat_interleave: its backward is a sum instead of a slow scatter
    return torch.cat([row.expand(n, *row.shape) for row, n in zip(x, counts, strict=True)])


def pixel_embedding(embedding: Tensor, valid: Tensor, counts: list[int] | None = None) -> Tensor:
    """The P-buffer R reads: mean over samples (C channels) and the variance of that mean, averaged over channels (1).

    No gradient passes the variance, as in the paper; it is 0 for fewer than two valid samples.
    """
    mean = sample_mean(embedding, valid, counts)
    with torch.no_grad():
        deviation = (embedding - per_sample(mean, counts)).square().mean(1, keepdim=True)
        count = sample_sum(valid, counts)
        variance = sample_mean(deviation, valid, counts) / torch.clamp(count - 1.0, min=1.0)
    return torch.cat([mean, variance], 1)


def path_features(inputs: dict[str, Tensor], counts: list[int] | None = None) -> Tensor:
    """F's input N x 36 x H x W of a frame or batch."""
    log_exposure = torch.log(per_sample(inputs["exposure"], counts))
    features = descriptor_features(inputs["samples.descriptor"], log_exposure)
    return features.contiguous(memory_format=torch.channels_last)
