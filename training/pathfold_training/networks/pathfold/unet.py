"""A U-Net at half resolution that predicts a trusted gather pyramid, and what is made of its prediction.

Feature maps of level l have 1 / 2^l of the frame's resolution; level 0 is predicted at level 1, four pixels at a time
(pixel shuffle). Everything is padded to whole 16 x 16 blocks inside the network.
"""

from __future__ import annotations

from itertools import pairwise
from typing import NamedTuple

import torch
import torch.nn.functional as functional
from torch import Tensor, nn

from ..embedding import Standardised, path_features, sample_sum
from ..reconstruct import COARSEST_LOGITS, KERNEL_TAPS, LEVEL_LOGITS, gather_factor, gather_pyramid
from .sizes import ALIGNMENT, PathfoldSizes

OPTIONAL = ("variance", "albedo", "normal", "depth", "paths")
PIXEL_CHANNELS = 3 + 1 + 3 + 3 + 1
ALBEDO_EPSILON = 0.01  # of the demodulator albedo + epsilon: bounds what a black albedo can amplify to a hundredfold
RADIANCE_CEILING = 1000.0  # of what the network sees, exposed and demodulated: a firefly widens no range of int8
SAMPLE_WIDTH = 32
HEADS = [4 * LEVEL_LOGITS + LEVEL_LOGITS, LEVEL_LOGITS, LEVEL_LOGITS, COARSEST_LOGITS]  # channels from 1/2 to 1/16
TRUST_START = -2.0  # sigmoid(-2) * -9 = -1.1: room on both sides of the initial trust
ALBEDO_HEADS = [4 * LEVEL_LOGITS + LEVEL_LOGITS, COARSEST_LOGITS]  # of its own pyramid of three levels, at 1/2 and 1/4
ALBEDO_CENTRE = 6.0  # logit of the finest kernel's centre at first: 0.94 of the albedo stays as it is
ALBEDO_BLEND = -4.0  # and of the coarser levels' share, 0.02


class Prediction(NamedTuple):
    """What the network says of B frames whose H and W are rounded up to multiples of 16."""

    trust: Tensor  # B x 4 x H/2 x W/2 in [-9, 0], four pixels in the channels as pixel_shuffle orders them
    logits: list[
        Tensor
    ]  # from 1/2 to 1/16; at 1/2 level 0's, four pixels as above, then level 1's: B x 150 x H/2 x W/2
    cleaning: list[Tensor]  # likewise of the albedo's own pyramid, at 1/2 and 1/4

    def flat(self) -> list[Tensor]:
        """All of it, in the order of output_shapes."""
        return [self.trust, *self.logits, *self.cleaning]


class Filtered(NamedTuple):
    """Frames that were denoised, and what the losses need of how."""

    image: Tensor  # radiance B x 3 x H x W, linear and unexposed
    logits: list[Tensor]
    paths: Tensor  # embeddings N x C x H x W
    cleaned: Tensor  # B x 3 x H x W, the cleaned factor that it was multiplied by


def block(inputs: int, width: int, count: int) -> nn.Sequential:
    """`count` 3x3 convolutions with ReLU."""
    layers: list[nn.Module] = []
    for a, b in pairwise([inputs] + [width] * count):
        layers += [nn.Conv2d(a, b, 3, padding=1), nn.ReLU(inplace=True)]
    return nn.Sequential(*layers)


class UNet(nn.Module):
    """Buffers of B frames (and their samples, image after image) -> trust and kernel logits of every level."""

    def __init__(self, sizes: PathfoldSizes) -> None:
        super().__init__()
        self.sizes = sizes
        widths, counts = sizes.widths, sizes.convolutions
        self.sample = nn.Sequential(
            Standardised(SAMPLE_WIDTH),
            nn.ReLU(inplace=True),
            nn.Conv2d(SAMPLE_WIDTH, SAMPLE_WIDTH, 1),
            nn.ReLU(inplace=True),
            nn.Conv2d(SAMPLE_WIDTH, sizes.embedding, 1),
        )
        self.presence = nn.Linear(len(OPTIONAL), widths[0])  # presence planes, folded into the first layer's bias
        self.first = nn.Conv2d(4 * PIXEL_CHANNELS + 2 * sizes.embedding, widths[0], 3, padding=1)
        self.down = nn.ModuleList([block(widths[0], widths[0], counts[0] - 1)])
        self.down.extend(block(a, b, n) for (a, b), n in zip(pairwise(widths), counts[1:], strict=True))
        self.project = nn.ModuleList(nn.Conv2d(b, a, 1) for a, b in pairwise(widths))
        self.up = nn.ModuleList(block(a, a, n) for a, n in zip(widths[:-1], counts[:-1], strict=True))
        self.trust = nn.Conv2d(widths[0], 4, 1)
        self.albedo_heads = nn.ModuleList(nn.Conv2d(w, n, 1) for w, n in zip(widths, ALBEDO_HEADS, strict=False))
        self.heads = nn.ModuleList(nn.Conv2d(w, n, 1) for w, n in zip(widths, HEADS, strict=True))
        for module in self.modules():
            if isinstance(module, nn.Conv2d):
                nn.init.kaiming_normal_(module.weight, nonlinearity="relu")
                module.bias.data.zero_()  # type: ignore[union-attr]
        for head in (self.trust, *self.heads, *self.albedo_heads, self.presence):  # start from uniform kernels
            head.weight.data.zero_()
            head.bias.data.zero_()
        self.trust.bias.data.fill_(TRUST_START)  # type: ignore[union-attr]
        finest = self.albedo_heads[0].bias.data[: 4 * LEVEL_LOGITS].view(LEVEL_LOGITS, 4)  # type: ignore[index]
        finest[len(KERNEL_TAPS) // 2], finest[-1] = ALBEDO_CENTRE, ALBEDO_BLEND

    def forward(self, inputs: dict[str, Tensor], counts: list[int] | None = None) -> tuple[Prediction, Tensor]:
        """What is predicted, and the embeddings N x C x H x W of the samples."""
        paths = self.embed(inputs, counts)
        sums = embedding_sums(paths, inputs["samples.valid"], counts)
        return self.predict(self.entrance(inputs, sums)), paths

    def embed(self, inputs: dict[str, Tensor], counts: list[int] | None = None) -> Tensor:
        """Each sample's descriptor by itself -> N x C x H x W."""
        features = path_features(inputs, counts)
        if torch.is_autocast_enabled(features.device.type):  # before the convolutions' own cast, a copy more
            features = features.to(torch.get_autocast_dtype(features.device.type))
        return self.sample(features.contiguous(memory_format=torch.channels_last))

    def entrance(self, inputs: dict[str, Tensor], sums: Tensor) -> Tensor:
        """Buffers and embedding_sums -> the first layer's result at half resolution, before its ReLU."""
        pixels = functional.pixel_unshuffle(aligned(pixel_features(inputs)), 2)
        x = torch.cat([pixels, embedding_moments(sums)], 1).contiguous(memory_format=torch.channels_last)
        return self.first(x) + self.presence(presence(inputs))[:, :, None, None]

    def features(self, entrance: Tensor) -> tuple[Tensor, list[Tensor], list[Tensor]]:
        """The U-Net: trust and cleaning as in Prediction, and what the heads read, B x width x H/2 x W/2 down to 1/16.

        Trust and cleaning are wanted for every pixel that a kernel reaches, so they look at few pixels around it.
        """
        x = torch.relu(entrance)
        skips = []
        for level, down in enumerate(self.down):
            x = down(functional.max_pool2d(x, 2) if level > 0 else x)
            skips.append(x)
        trust = -9.0 * torch.sigmoid(exact(self.trust(skips[0])))
        cleaning = [exact(head(x)) for head, x in zip(self.albedo_heads, skips, strict=False)]
        decoded = [x]
        for level in reversed(range(len(self.up))):
            decoded.insert(0, self.up[level](skips[level] + upsample(self.project[level](decoded[0]))))
        return trust, cleaning, decoded

    def predict(self, entrance: Tensor) -> Prediction:
        """The U-Net and its heads."""
        trust, cleaning, decoded = self.features(entrance)
        return Prediction(trust, [head(x) for head, x in zip(self.heads, decoded, strict=True)], cleaning)

    def output_shapes(self) -> dict[str, list[int | str]]:
        """Graph outputs in the order of Prediction; "H/4" is a quarter of H rounded up to a multiple of 16."""
        shapes: dict[str, list[int | str]] = {"trust": [1, 4, "H/2", "W/2"]}
        for level, channels in enumerate(HEADS, 1):
            shapes[f"logits.{1 << level}"] = [1, channels, f"H/{1 << level}", f"W/{1 << level}"]
        for level, head in enumerate(self.albedo_heads, 1):
            shapes[f"cleaning.{1 << level}"] = [1, head.out_channels, f"H/{1 << level}", f"W/{1 << level}"]  # type: ignore[list-item]
        return shapes

    def filter(self, inputs: dict[str, Tensor], counts: list[int] | None = None) -> Filtered:
        """Predict, and apply it to the frames."""
        predicted, paths = self(inputs, counts)
        with torch.autocast(paths.device.type, enabled=False):
            image, cleaned = reconstruct(predicted, inputs["radiance"], demodulator(inputs))
            return Filtered(image, predicted.logits, paths, cleaned)


def reconstruct(predicted: Prediction, radiance: Tensor, factor: Tensor) -> tuple[Tensor, Tensor]:
    """What was predicted, applied to radiance B x 3 x H x W, and what it was multiplied by.

    It is divided, while it is filtered, by what a pyramid of its own makes of `factor`: where a mirror's share of the
    samples carries another albedo, dividing by the noisy one brings its noise in.
    """
    trust, levels = functional.pixel_shuffle(predicted.trust, 2), by_level(predicted.logits)
    cleaned = clean_factor(predicted, radiance, factor)
    return gather_pyramid(trust, levels, radiance / cleaned) * cleaned, cleaned


def clean_factor(predicted: Prediction, radiance: Tensor, factor: Tensor) -> Tensor:
    """What radiance is divided and multiplied by, B x 3 x H x W: pixels whose radiance is not finite take no part."""
    return gather_factor(by_level(predicted.cleaning), factor, torch.isfinite(radiance).all(1, keepdim=True))


def by_level(maps: list[Tensor]) -> list[Tensor]:
    """A Prediction's logits or cleaning, from 1/2 on, as a pyramid's levels: B x 30 x H/2^l x W/2^l from l = 0 on."""
    # rearranged while they are in half precision, and plane by plane: half the time
    fine, half = torch.split(maps[0].contiguous(), [4 * LEVEL_LOGITS, LEVEL_LOGITS], 1)
    return [exact(level) for level in (functional.pixel_shuffle(fine, 2), half, *maps[1:])]


def demodulator(inputs: dict[str, Tensor]) -> Tensor:
    """What radiance is divided by while it is filtered: albedo + 0.01, or 1 in frames without an albedo."""
    present = inputs["albedo.present"].reshape(-1, 1, 1, 1)
    return present * (inputs["albedo"] + ALBEDO_EPSILON) + (1.0 - present)


def pixel_features(inputs: dict[str, Tensor]) -> Tensor:
    """The network's view of the buffers, B x 11 x H x W: logs of exposed radiance and its deviation, guides."""
    scale = inputs["exposure"].reshape(-1, 1, 1, 1)
    mean = inputs["radiance"] * scale
    deviation = torch.sqrt(inputs["variance"].mean(1, keepdim=True)) * scale
    relative = torch.clamp(deviation / (mean.mean(1, keepdim=True) + 0.01), max=10.0)
    far = inputs["depth"] * inputs["depth_scale"].reshape(-1, 1, 1, 1)
    depth = 1.0 - 1.0 / (1.0 + far)  # [0, 1), whatever the scene's unit
    albedo = torch.clamp(inputs["albedo"], 0.0, 1.0)
    color = torch.clamp(mean / demodulator(inputs), max=RADIANCE_CEILING)
    return torch.cat([torch.log1p(color), torch.log1p(16.0 * relative), albedo, inputs["normal"], depth], 1)


def presence(inputs: dict[str, Tensor]) -> Tensor:
    """Which optional inputs there are, B x 5 of 0 and 1."""
    return torch.stack([inputs[f"{name}.present"].reshape(-1) for name in OPTIONAL], 1)


def embedding_sums(paths: Tensor, valid: Tensor, counts: list[int] | None = None) -> Tensor:
    """Sums over each image's valid samples, averaged over 2x2 pixels: B x (2C + 1) x H/2 x W/2.

    Of N embeddings, of their squares and of `valid`, N x 1 x H x W. Sums of parts of the samples add up. H and W are
    rounded up to multiples of 16.
    """
    paths = exact(paths) * valid
    sums = torch.cat([sample_sum(x, counts) for x in (paths, paths.square(), valid)], 1)
    return functional.avg_pool2d(aligned(sums), 2)


def embedding_moments(sums: Tensor) -> Tensor:
    """Mean and deviation, B x 2C x H/2 x W/2, from embedding_sums; where no sample is valid both are 0."""
    channels = sums.shape[1] // 2
    some = sums[:, -1:]
    moments = sums[:, :-1] / torch.clamp(some, min=0.25)  # one valid sample of the four pixels' makes a quarter
    mean, square = moments[:, :channels], moments[:, channels:]
    # the epsilon keeps the root's slope, and with it rounding errors of the difference, bounded
    deviation = torch.sqrt(torch.relu(square - mean.square()) + 1e-4) - 1e-2
    return torch.cat([mean, deviation], 1)


def exact(x: Tensor) -> Tensor:
    """float32 of what autocast left in half precision; what is wider stays, or a graph would copy it."""
    return x if x.dtype in (torch.float32, torch.float64) else x.float()


def aligned(x: Tensor) -> Tensor:
    """Zeros below and on the right, up to whole blocks of 16 x 16 pixels."""
    height, width = x.shape[-2:]
    below, right = (ALIGNMENT - height % ALIGNMENT) % ALIGNMENT, (ALIGNMENT - width % ALIGNMENT) % ALIGNMENT
    return functional.pad(x, (0, right, 0, below))


def upsample(x: Tensor) -> Tensor:
    return functional.interpolate(x, scale_factor=2.0, mode="nearest")
