"""Where a buffer comes from in a file, and its pixels, laid where the picture lies."""

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from pathfold.channels.presets import Preset
from pathfold.images import ImageFile, Layer, Window

# What stands where a buffer was not rendered, outside its window: what a ray that hits nothing gives, as models are
# trained, 0 where it is not said here. The noise of what was not rendered is not known.
MISS = {
    "albedo": 1.0,
    "variance": float("nan"),
    "diffuse.variance": float("nan"),
    "specular.variance": float("nan"),
}


@dataclass(frozen=True)
class Source:
    """Where one buffer comes from: the sum of `layers`, times `factor`, divided by `divisor`."""

    layers: tuple[Layer, ...]
    component: str = ""  # a single channel by its letter: alpha
    factor: Layer | None = None
    divisor: float = 1.0
    subtract: tuple["Source", ...] = ()
    side: ImageFile | None = None  # the file that holds it, where that is not the picture's own
    preset: Preset | None = None  # whose row told it

    @property
    def direct(self) -> bool:
        """The buffer stands in the picture's file as it is, so that a result can be written back in its place."""
        plain = self.factor is None and self.divisor == 1.0 and not self.subtract
        return len(self.layers) == 1 and plain and self.side is None

    @property
    def read(self) -> tuple[Layer, ...]:
        """All layers that are read, but those subtracted."""
        return (*self.layers, *([self.factor] if self.factor else ()))

    def numbers(self, layer: Layer, count: int) -> list[int] | None:
        if not self.component:
            return layer.pick(count)
        return [layer.channels[self.component]] if self.component in layer.channels else None

    def __str__(self) -> str:
        text = " + ".join(_channel(layer, self.component) for layer in self.layers)
        text = f"({text})" if len(self.layers) > 1 and self.factor else text
        text += f" * {self.factor.label}" if self.factor else ""
        text += f" / {self.divisor:g}" if self.divisor != 1.0 else ""
        return text + "".join(f" - ({part})" for part in self.subtract)

    def line(self, several: bool) -> str:
        """For people: with the file where it is another, and with its parts; `several`: the picture's file has such."""
        parts = sorted({layer.part for layer in self.read})
        text = f"{self.side.path.name}: {self}" if self.side else str(self)
        if not (len(self.side.parts) > 1 if self.side else several):
            return text
        return f"{text} (part{'s' if len(parts) > 1 else ''} {', '.join(map(str, parts))})"


def evaluate(file: ImageFile, source: Source, name: str, count: int, window: Window) -> NDArray[np.float32]:
    """A buffer's pixels as they lie in a window, height x width x count; MISS outside its own."""
    holds, outside = source.side or file, MISS.get(name, 0.0)

    def pixels(layer: Layer) -> Any:
        return holds.read_into(layer, source.numbers(layer, count) or [], window, outside)

    total = pixels(source.layers[0])
    for layer in source.layers[1:]:
        total = total + pixels(layer)
    if source.factor:
        total = total * pixels(source.factor)
    for part in source.subtract:
        total = total - evaluate(file, part, name, count, window)
    return total / np.float32(source.divisor) if source.divisor != 1 else total


def _channel(layer: Layer, component: str) -> str:
    if component:
        return f"{layer.name}.{component}" if layer.name else component
    return layer.label
