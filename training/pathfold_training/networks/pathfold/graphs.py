"""A pathfold network as its two ONNX graphs: the same function, arranged so that onnxruntime makes few copies.

`embedding` sees samples, and `network` what is left of them per pixel, so that a frame without paths runs the second
alone, and a renderer that streams samples needs no other weights.
"""

from __future__ import annotations

import copy

import torch
import torch.nn.functional as functional
from torch import Tensor, nn

from ..embedding import Standardised
from ..features import DESCRIPTOR_SCALES, descriptor_logs
from .unet import OPTIONAL, PIXEL_CHANNELS, UNet, aligned, embedding_moments, pixel_features, presence


class EmbeddingGraph(nn.Module):
    """Descriptors S x 36 x H x W, their validity and exposure -> embedding_sums, 1 x (2C + 1) x H/2 x W/2."""

    input_names = ("samples.descriptor", "samples.valid", "exposure")

    def __init__(self, model: UNet) -> None:
        super().__init__()
        self.sample = copy.deepcopy(model.sample)
        own = self.sample[0]
        assert isinstance(own, Standardised)
        weight, bias = own.folded()
        first = nn.Conv2d(own.in_channels, own.out_channels, 1)
        first.weight.data = weight.detach() / torch.tensor(DESCRIPTOR_SCALES).reshape(1, -1, 1, 1)
        first.bias.data = bias.detach()  # type: ignore[union-attr]
        self.sample[0] = first
        self.channels = 2 * model.sizes.embedding + 1

    def forward(self, descriptor: Tensor, valid: Tensor, exposure: Tensor) -> Tensor:
        paths = self.sample(descriptor_logs(descriptor, torch.log(exposure))) * valid
        # pooled before they are summed: a quarter of the work
        parts = [functional.avg_pool2d(aligned(x), 2) for x in (paths, paths.square(), valid)]
        return torch.cat([x.sum(0, keepdim=True) for x in parts], 1)

    def output_shapes(self) -> dict[str, list[int | str]]:
        return {"embedding": [1, self.channels, "H/2", "W/2"]}


class NetworkGraph(nn.Module):
    """Buffers and the embedding of their samples -> the parts of a Prediction, for B = 1."""

    input_names = ("radiance", "variance", "albedo", "normal", "depth", "embedding", "exposure", "depth_scale",
                   *(f"{name}.present" for name in OPTIONAL))  # fmt: skip

    def __init__(self, model: UNet) -> None:
        super().__init__()
        self.model = model
        pixels, moments = model.first.weight.detach().split([4 * PIXEL_CHANNELS, 2 * model.sizes.embedding], 1)
        # 3x3 on 2x2 unshuffled pixels is 6x6 of stride 2 on the pixels themselves: no transposed copy
        blocks = pixels.unflatten(1, (PIXEL_CHANNELS, 2, 2))  # O, C, y, x in the block, y, x of the kernel
        self.pixels = nn.Parameter(blocks.permute(0, 1, 4, 2, 5, 3).flatten(4, 5).flatten(2, 3).contiguous())
        # presence as planes seen by the centre alone: adding a vector would leave onnxruntime's blocked layout
        planes = functional.pad(model.presence.weight.detach()[:, :, None, None], [1] * 4)
        self.moments = nn.Parameter(torch.cat([moments, planes], 1))
        assert model.first.bias is not None
        self.bias = nn.Parameter((model.first.bias + model.presence.bias).detach())

    def forward(self, *tensors: Tensor) -> tuple[Tensor, ...]:
        inputs = dict(zip(self.input_names, tensors, strict=True))
        features = aligned(pixel_features(inputs))
        moments = embedding_moments(inputs["embedding"])
        present = presence(inputs)[:, :, None, None].expand(-1, -1, *moments.shape[-2:])
        entrance = functional.conv2d(features, self.pixels, self.bias, stride=2, padding=2)
        entrance = entrance + functional.conv2d(torch.cat([moments, present], 1), self.moments, padding=1)
        return tuple(self.model.predict(entrance).flat())

    def output_shapes(self) -> dict[str, list[int | str]]:
        return self.model.output_shapes()


def trained_weights(embedding: dict[str, Tensor], network: dict[str, Tensor]) -> dict[str, Tensor]:
    """The weights of a network by name, scales folded, from the parameters of its EmbeddingGraph and NetworkGraph.

    Raises KeyError where one of those that were rearranged is missing.
    """
    weights = {name.removeprefix("model."): value for name, value in network.items() if name.startswith("model.")}
    blocks = network["pixels"].unflatten(2, (3, 2)).unflatten(4, (3, 2))  # O, C, and of y and of x: kernel, block
    pixels = blocks.permute(0, 1, 3, 5, 2, 4).flatten(1, 3)
    moments, planes = network["moments"].split([network["moments"].shape[1] - len(OPTIONAL), len(OPTIONAL)], 1)
    weights |= {"first.weight": torch.cat([pixels, moments], 1), "first.bias": network["bias"]}
    weights |= {"presence.weight": planes[:, :, 1, 1], "presence.bias": torch.zeros_like(network["bias"])}
    weights |= embedding
    scales = torch.tensor(DESCRIPTOR_SCALES).reshape(1, -1, 1, 1)
    return weights | {"sample.0.weight": embedding["sample.0.weight"] * scales}
