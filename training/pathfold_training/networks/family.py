"""What the training tools ask of a network, whatever its family."""

from __future__ import annotations

from typing import Any, ClassVar, NamedTuple, Protocol

from torch import Tensor, nn

from .batch import Batch, Inputs
from .features import DESCRIPTOR_CHANNELS
from .losses import Draw, Loss
from .sizes import Sizes

CHANNELS = {"radiance": 3, "variance": 3, "albedo": 3, "normal": 3, "depth": 1, "diffuse.albedo": 3}
CHANNELS |= {"samples.descriptor": DESCRIPTOR_CHANNELS, "samples.density": 1, "samples.valid": 1}

Shape = list[int | str]
Shapes = dict[str, Shape]  # by name, in the graph's order


def input_shape(name: str) -> Shape:
    """The shape of a graph's input that is a buffer or a scalar, as the manifest states it."""
    if name in ("exposure", "depth_scale") or name.endswith(".present"):
        return [1]
    return ["S" if name.startswith("samples.") else 1, CHANNELS[name], "H", "W"]


class Graph(NamedTuple):
    """A graph to export: a module with positional inputs, and the shapes of both sides by name."""

    module: nn.Module
    inputs: Shapes
    outputs: Shapes


class Network(Protocol):
    """A torch module. Images are B x C x H x W, linear and unexposed."""

    sizes: Any  # the family's Sizes
    # Layers of the graph `network` in int8, by how their names begin; () for none. It then reads a graph `embedding`.
    quantised: ClassVar[tuple[str, ...]]

    def __init__(self, sizes: Any) -> None: ...

    def loss(self, batch: Batch, weights: Loss, draw: Draw) -> tuple[Tensor, dict[str, Tensor]]:
        """What a training step minimises, and its terms by name, for the log."""

    def denoise(self, batch: Batch) -> Tensor:
        """The whole frames, B x 3 x H x W."""

    def filter_branch(self, graph: str, inputs: Inputs, radiance: Tensor, factor: Tensor) -> tuple[Tensor, float]:
        """A branch of a frame as pathfold.check prepares it, 1 x 3 x H x W, and the largest |logit| (with trust).

        `radiance` is not finite where a pixel takes no part; `factor` is what it is divided by while it is filtered.
        """

    def graphs(self) -> dict[str, Graph]:
        """The graphs of a model folder by name."""

    def standalone_graphs(self) -> dict[str, Graph]:
        """Graphs with the reconstruction inside. Raises ValueError where there are none."""

    def describe(self) -> dict[str, Any]:
        """The family's part of the manifest but for the graphs: requires, uses, reconstruction, tile."""

    def macs(self, spp: int) -> float:
        """Multiply-adds per pixel of a frame with so many samples per pixel."""

    def round_weights(self) -> None:
        """Round in place what is stored as 16-bit floats."""

    def may_widen(self, weight: str) -> bool:
        """Whether a weight may get further outputs when the network begins as a narrower one."""

    @staticmethod
    def weights_of(graphs: dict[str, dict[str, Tensor]], reconstruction: dict[str, Any]) -> dict[str, Tensor]:
        """A network's weights by name from those of its exported graphs. Raises KeyError or TypeError for others."""


class Family(NamedTuple):
    """A row of the table."""

    sizes: type[Sizes]
    network: type[Network]
