"""KPCN with a path embedding: one network per radiance branch, each predicting K x K gather kernels."""

from __future__ import annotations

from itertools import pairwise
from typing import NamedTuple

import torch
from torch import Tensor, nn

from ..embedding import PathEmbedding, path_features, pixel_embedding, sample_mean
from ..features import BRANCH_CHANNELS, OPTIONAL, branch_features, density_features
from .sizes import KpcnSizes

BRANCHES = ("diffuse", "specular")
SAMPLE_INPUTS = ("samples.descriptor", "samples.density", "samples.valid")


class Prediction(NamedTuple):
    """What a branch predicts."""

    logits: Tensor  # B x K*K x h x w
    trust: Tensor | None  # B x 1 x H x W, added to the logit of every tap that falls on the pixel
    paths: Tensor | None  # F's output N x C x H x W, for the manifold loss


class Branch(nn.Module):
    """R (and F) of one branch. `demodulate` is set for the diffuse one."""

    def __init__(self, sizes: KpcnSizes, demodulate: bool) -> None:
        super().__init__()
        self.demodulate = demodulate
        self.pointwise = sizes.last_kernel == 1
        self.paths = PathEmbedding(sizes.embedding, sizes.embedding_width) if sizes.embedding else None
        extra = 1 + sizes.embedding + 1 if sizes.embedding else 0  # log q, the embedding's mean and variance
        widths = [BRANCH_CHANNELS + extra] + [sizes.width] * (sizes.layers - 1)
        layers: list[nn.Module] = []
        for inputs, outputs in pairwise(widths):
            layers += [nn.Conv2d(inputs, outputs, 5, padding=2), nn.ReLU()]
        self.trunk = nn.Sequential(*layers)
        # a kernel of K*K taps from `width` numbers by one linear layer is of rank `width`: a wider 1x1 layer between
        wide = nn.Conv2d(sizes.width, sizes.head, 1) if sizes.head else None
        self.wide = nn.Identity() if wide is None else nn.Sequential(wide, nn.ReLU())
        channels, last = sizes.head or sizes.width, sizes.last_kernel
        self.kernels = nn.Conv2d(channels, sizes.kernel_size**2, last, padding=last // 2)
        # shuts out a light or a firefly by one number of its own, not by one logit in each of 441 kernels around it
        self.trust = nn.Conv2d(channels, 1, last, padding=last // 2) if sizes.trust else None
        for layer in [*self.trunk, wide]:
            if isinstance(layer, nn.Conv2d):  # torch's default halves the signal with every layer
                nn.init.kaiming_normal_(layer.weight, nonlinearity="relu")
                layer.bias.data.zero_()  # type: ignore[union-attr]
        if wide is not None:  # starts as the identity and some: weights of a network without this layer fit
            wide.weight.data[: sizes.width] = torch.eye(sizes.width)[: sizes.head, :, None, None]
        if self.trust is not None:
            nn.init.zeros_(self.trust.weight)
            nn.init.zeros_(self.trust.bias)  # type: ignore[arg-type]

    def input_names(self) -> list[str]:
        """Graph inputs in order; B = 1 when exported."""
        names = ["radiance", "variance", "albedo", "normal", "depth"]
        names += ["diffuse.albedo"] if self.demodulate else []
        names += list(SAMPLE_INPUTS) if self.paths else []
        return names + ["exposure", "depth_scale"] + [f"{name}.present" for name in OPTIONAL]

    def features(self, inputs: dict[str, Tensor], counts: list[int] | None) -> tuple[Tensor, Tensor | None]:
        """R's input B x C x H x W, and F's output N x C x H x W."""
        x = branch_features(inputs, self.demodulate)
        if self.paths is None:
            return x, None
        valid = inputs["samples.valid"]
        descriptor = inputs.get("samples.features")  # training computes them once for both branches
        paths = self.paths(path_features(inputs, counts) if descriptor is None else descriptor, valid, counts)
        density = sample_mean(density_features(inputs["samples.density"]), valid, counts)
        return torch.cat([x, density, pixel_embedding(paths, valid, counts)], 1), paths

    def forward(
        self,
        inputs: dict[str, Tensor],
        counts: list[int] | None = None,
        lattice: int = 1,
        offset: tuple[int, int] = (0, 0),
    ) -> Prediction:
        """Logits are on the lattice (all pixels by default), trust is everywhere."""
        x, paths = self.features(inputs, counts)
        hidden = self.wide(self.trunk(x.contiguous(memory_format=torch.channels_last)))
        trust = None if self.trust is None else self.trust(hidden)
        if lattice > 1 and self.pointwise:  # a 1x1 layer needs no neighbours
            return Prediction(self.kernels(hidden[:, :, offset[0] :: lattice, offset[1] :: lattice]), trust, paths)
        return Prediction(self.kernels(hidden)[:, :, offset[0] :: lattice, offset[1] :: lattice], trust, paths)
