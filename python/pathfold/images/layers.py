"""What a picture file's channels are called: layers, by name, part and view.

A *layer* is what shares a name up to the last dot ("albedo.R", "albedo.G", "albedo.B"); bare R, G, B, A are
the main picture, whose layer is "". In a file of several parts a layer may also be named by its part.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field

import OpenImageIO as oiio  # noqa: N813

_COMPONENTS = {"red": "R", "green": "G", "blue": "B", "alpha": "A"}


@dataclass(frozen=True)
class Layer:
    """Channels of one part that belong together; `names` are all it can be called, its own first."""

    part: int
    names: tuple[str, ...]
    view: str
    size: tuple[int, int]  # width, height
    channels: Mapping[str, int] = field(hash=False)  # component (R G B A X Y Z ...) -> channel number

    @property
    def name(self) -> str:
        return self.names[0]

    def pick(self, count: int) -> list[int] | None:
        """The channel numbers of a buffer with `count` channels, None where the layer has too few."""
        for wanted in ("RGB", "XYZ"):
            if all(component in self.channels for component in wanted):
                return [self.channels[component] for component in wanted][:count]
        rest = [number for component, number in self.channels.items() if component != "A"]
        return rest[:count] if len(rest) == count else None


def layers(parts: Sequence[oiio.ImageSpec]) -> list[Layer]:
    found = []
    for number, spec in enumerate(parts):
        if spec.deep:
            continue
        grouped: dict[str, dict[str, int]] = {}
        # Bare X, Y, Z are a part's own components, but a bare Z beside R, G, B is a depth of its own.
        bare = "RGBA" if len(parts) == 1 or "R" in spec.channelnames else "RGBAXYZ"
        for channel, full in enumerate(spec.channelnames):
            layer, component = _split(full, bare)
            grouped.setdefault(layer, {}).setdefault(component, channel)
        part = spec.get_string_attribute("oiio:subimagename") if len(parts) > 1 else ""
        view = spec.get_string_attribute("view")
        found += [
            Layer(number, _names(number, part, layer), view, (spec.width, spec.height), channels)
            for layer, channels in grouped.items()
        ]
    return found


def _split(channel: str, bare: str) -> tuple[str, str]:
    """Layer and component of a full channel name; without a dot it is a layer unless a letter of `bare`."""
    layer, dot, component = channel.rpartition(".")
    component = _COMPONENTS.get(component.lower(), component.upper() if len(component) == 1 else component)
    return (layer, component) if dot or component in set(bare) else (channel, "Y")


def _names(number: int, part: str, layer: str) -> tuple[str, ...]:
    if not part or layer == part or layer.startswith(f"{part}."):
        return (layer,)
    qualified = f"{part}.{layer}" if layer else part
    # Bare channels are the main picture in the first part only; elsewhere the part says what they are.
    return (layer, qualified) if layer or number == 0 else (qualified,)
