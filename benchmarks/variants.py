"""Networks of the pathfold family with one thing changed, for training alone: what ablation.py compares."""

from __future__ import annotations

from unittest import mock

import torch
import torch.nn.functional as functional
from pathfold_training.networks.batch import Batch
from pathfold_training.networks.features import DESCRIPTOR_CHANNELS
from pathfold_training.networks.losses import RELATIVE_EPSILON, Draw, Loss
from pathfold_training.networks.pathfold import network
from pathfold_training.networks.pathfold.network import Pathfold
from pathfold_training.networks.pathfold.sizes import PathfoldSizes
from pathfold_training.networks.pathfold.unet import (
    ALBEDO_EPSILON,
    RADIANCE_CEILING,
    Filtered,
    Prediction,
    aligned,
    by_level,
    clean_factor,
    demodulator,
    embedding_moments,
    exact,
    pixel_features,
    presence,
    reconstruct,
)
from pathfold_training.networks.reconstruct import bounded_exp, gather_pyramid, normalised, weigh_taps
from torch import Tensor, nn

SIDE = 11
TAPS = [(dy, dx) for dy in range(SIDE) for dx in range(SIDE)]


class SingleKernel(Pathfold):
    """The same trunk and trust, but one 11x11 kernel per pixel instead of the pyramid."""

    def __init__(self, sizes: PathfoldSizes) -> None:
        super().__init__(sizes)
        self.heads = nn.ModuleList([empty_head(sizes.widths[0], 4 * SIDE * SIDE)])

    def predict(self, entrance: Tensor) -> Prediction:
        trust, cleaning, (finest, *_) = self.features(entrance)
        return Prediction(trust, [exact(self.heads[0](finest))], cleaning)

    def filter(self, inputs: dict[str, Tensor], counts: list[int] | None = None) -> Filtered:
        predicted, paths = self(inputs, counts)
        factor = clean_factor(predicted, inputs["radiance"], demodulator(inputs))
        image = self.weigh(predicted, inputs["radiance"] / factor)
        return Filtered(image * factor, predicted.logits, paths, factor)

    @staticmethod
    def weigh(predicted: Prediction, image: Tensor) -> Tensor:
        height, width = image.shape[-2:]
        weight = torch.exp(functional.pixel_shuffle(predicted.trust, 2))
        source = aligned(torch.cat([image, torch.ones_like(image[:, :1])], 1)) * weight
        kernel = bounded_exp(functional.pixel_shuffle(predicted.logits[0], 2))
        return normalised(weigh_taps(kernel, source, TAPS, SIDE // 2))[0][:, :, :height, :width]


class SplitKernels(Pathfold):
    """Diffuse and specular filtered by kernels of their own, from one trunk that sees the diffuse part too."""

    def __init__(self, sizes: PathfoldSizes) -> None:
        super().__init__(sizes)
        self.diffuse = nn.Conv2d(4 * 3, sizes.widths[0], 3, padding=1, bias=False)  # beside self.first
        self.heads = nn.ModuleList(empty_head(head.in_channels, 2 * head.out_channels) for head in self.heads)

    def entrance(self, inputs: dict[str, Tensor], sums: Tensor) -> Tensor:
        diffuse, _, factor = self.parts(inputs)
        exposed = diffuse / factor * inputs["exposure"].reshape(-1, 1, 1, 1)
        return super().entrance(inputs, sums) + self.diffuse(
            functional.pixel_unshuffle(aligned(torch.log1p(exposed)), 2)
        )

    def filter(self, inputs: dict[str, Tensor], counts: list[int] | None = None) -> Filtered:
        predicted, paths = self(inputs, counts)
        logits = [exact(level) for level in predicted.logits]
        diffuse, specular, factor = self.parts(inputs)
        own, other = zip(*(level.chunk(2, 1) for level in logits), strict=True)
        image, _ = reconstruct(predicted._replace(logits=list(own)), diffuse, factor)
        rest = gather_pyramid(functional.pixel_shuffle(predicted.trust, 2), by_level(list(other)), specular)
        return Filtered(image + rest, logits, paths, factor)

    @staticmethod
    def parts(inputs: dict[str, Tensor]) -> tuple[Tensor, Tensor, Tensor]:
        """Diffuse radiance, the rest, and what the first is divided by; in frames without a split all is the rest."""
        split = inputs["split.present"].reshape(-1, 1, 1, 1)
        diffuse = inputs["diffuse"] * split
        return diffuse, torch.relu(inputs["radiance"] - diffuse), inputs["diffuse.albedo"] + ALBEDO_EPSILON


class Uncleaned(Pathfold):
    """Radiance is divided by the albedo as it comes."""

    def __init__(self, sizes: PathfoldSizes) -> None:
        super().__init__(sizes)
        self.albedo_heads = nn.ModuleList()

    def filter(self, inputs: dict[str, Tensor], counts: list[int] | None = None) -> Filtered:
        predicted, paths = self(inputs, counts)
        factor = self.factor(inputs)
        trust, levels = functional.pixel_shuffle(predicted.trust, 2), by_level(predicted.logits)
        image = gather_pyramid(trust, levels, inputs["radiance"] / factor) * factor
        return Filtered(image, predicted.logits, paths, factor)

    def factor(self, inputs: dict[str, Tensor]) -> Tensor:
        return demodulator(inputs)


class Modulated(Uncleaned):
    """Radiance is filtered, and seen by the network, as it is."""

    def factor(self, inputs: dict[str, Tensor]) -> Tensor:
        return torch.ones_like(inputs["radiance"])

    def entrance(self, inputs: dict[str, Tensor], sums: Tensor) -> Tensor:
        exposed = torch.clamp(inputs["radiance"] * inputs["exposure"].reshape(-1, 1, 1, 1), max=RADIANCE_CEILING)
        features = torch.cat([torch.log1p(exposed), pixel_features(inputs)[:, 3:]], 1)
        x = torch.cat([functional.pixel_unshuffle(aligned(features), 2), embedding_moments(sums)], 1)
        x = x.contiguous(memory_format=torch.channels_last)
        return self.first(x) + self.presence(presence(inputs))[:, :, None, None]


class Unscaled(Pathfold):
    """Descriptors enter the embedding as they are."""

    def __init__(self, sizes: PathfoldSizes) -> None:
        super().__init__(sizes)
        first = nn.Conv2d(DESCRIPTOR_CHANNELS, self.sample[0].out_channels, 1)  # type: ignore[arg-type]
        nn.init.kaiming_normal_(first.weight, nonlinearity="relu")
        nn.init.zeros_(first.bias)  # type: ignore[arg-type]
        self.sample[0] = first


class Unbiased(Pathfold):
    """Learns by the unbiased loss."""

    def loss(self, batch: Batch, weights: Loss, draw: Draw) -> tuple[Tensor, dict[str, Tensor]]:
        def unbiased(output: Tensor, truth: Tensor, scale: Tensor) -> Tensor:
            return unbiased_relative(output, truth)

        with mock.patch.object(network, "robust_relative", unbiased):
            return super().loss(batch, weights, draw)


def unbiased_relative(output: Tensor, reference: Tensor) -> Tensor:
    """Each image's mean [B] of ((x - r) / sqrt(x^2 + eps))^2 with the x below held fixed (Noise2Noise's HDR loss).
    Exposed radiance B x 3 x H x W.

    Its minimum is the true mean however noisy the reference r is, which no other loss here has; the price is
    heavy-tailed gradients, so clip their norm.
    """
    return ((output - reference).square() / (output.detach().square() + RELATIVE_EPSILON)).mean((1, 2, 3))


def empty_head(inputs: int, outputs: int) -> nn.Conv2d:
    """A 1x1 layer that begins at 0, as the family's heads do: uniform kernels."""
    head = nn.Conv2d(inputs, outputs, 1)
    nn.init.zeros_(head.weight)
    nn.init.zeros_(head.bias)  # type: ignore[arg-type]
    return head
