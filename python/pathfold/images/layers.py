"""What a picture file's channels are called: layers, by name, part and view, and where they lie.

A *layer* is what shares a name up to the last dot ("albedo.R", "albedo.G", "albedo.B"); bare R, G, B, A are the main
picture of their part. In a file of several parts they are called as the part, and any other layer may be named with
its part before it. A *view* is said by the part's `view` attribute, by a channel's name where `multiView` lists it
("albedo.right.R"), or by the part's name ("rgba.left"); what has none serves every view.
"""

import re
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from shlex import quote

import OpenImageIO as oiio  # noqa: N813

from pathfold.images.window import Window

_COMPONENTS = {"red": "R", "green": "G", "blue": "B", "alpha": "A"}
_EYES = frozenset({"left", "right"})  # views though nothing declares them, where a file has both


@dataclass(frozen=True)
class Layer:
    """Channels of one part that belong together; `names` are all it can be called, its own first."""

    part: int
    names: tuple[str, ...]
    view: str
    window: Window
    channels: Mapping[str, int] = field(hash=False)  # component (R G B A X Y Z ...) -> channel number
    bare: bool = False  # the channels have no other name than the part's

    @property
    def name(self) -> str:
        return self.names[0]

    @property
    def option(self) -> str:
        """What names this very layer on a command line."""
        return ([name for name in self.names if name] or [self.label])[-1 if self.bare else 0]

    def mapped(self, buffer: str) -> str:
        """The option that takes this very layer for a buffer, as a shell reads it."""
        return f"--map {quote(f'{buffer}={self.option}')}"

    @property
    def size(self) -> tuple[int, int]:
        """Width, height."""
        return self.window.size

    @property
    def label(self) -> str:
        """The name for people; the channels of a layer without one."""
        main = [letter for letter in "RGB" if letter in self.channels]
        return self.name or ",".join(main or self.channels)

    def pick(self, count: int) -> list[int] | None:
        """The channel numbers of a buffer with `count` channels, None where the layer has too few."""
        for wanted in ("RGB", "XYZ"):
            if all(component in self.channels for component in wanted):
                return [self.channels[component] for component in wanted][:count]
        rest = [number for component, number in self.channels.items() if component != "A"]
        return rest[:count] if len(rest) == count else None


def layers(parts: Sequence[oiio.ImageSpec]) -> list[Layer]:
    """All layers of a file but those of deep parts, in its order."""
    views = declared_views(parts)
    found = []
    for number, spec in enumerate(parts):
        if not spec.deep:
            found += _of_part(number, spec, len(parts), views)
    found = _of_first_view(found, parts)
    pictures = [layer for layer in found if layer.bare and set("RGB") <= set(layer.channels)]
    if len(pictures) == 1:  # what "" means where nothing else can be meant
        only = pictures[0]
        found[found.index(only)] = replace(only, names=tuple(dict.fromkeys((*only.names, ""))))
    return found


def declared_views(parts: Sequence[oiio.ImageSpec]) -> list[str]:
    """All views that a file speaks of, in the order of `multiView` and the parts."""
    said = [view for spec in parts for view in (*_multi_view(spec), spec.get_string_attribute("view")) if view]
    sections = {section.casefold() for spec in parts for section in _all_sections(spec)}
    return list(dict.fromkeys([*said, *(sorted(_EYES) if sections >= _EYES else ())]))


def views(layers: Iterable[Layer]) -> list[str]:
    """The views of layers in their order; "" is none."""
    return list(dict.fromkeys(layer.view for layer in layers))


def _of_part(number: int, spec: oiio.ImageSpec, parts: int, views: Sequence[str]) -> list[Layer]:
    title = _title(spec) or (f"part {number}" if parts > 1 else "")
    part, own_view = _without_view(title, views)
    own_view = spec.get_string_attribute("view") or own_view
    declared = _multi_view(spec)
    # Bare X, Y, Z are a part's own components, but a bare Z beside R, G, B is a depth of its own.
    letters = "RGBA" if parts == 1 or "R" in spec.channelnames else "RGBAXYZ"
    alone = parts > 1 and spec.nchannels == 1
    grouped: dict[tuple[str, str], dict[str, int]] = {}
    written: dict[tuple[str, str], str] = {}
    for channel, full in enumerate(spec.channelnames):
        layer, component = _split(full, letters)
        if alone and "." not in full:
            layer, component = "", "Y"
        plain, view = _sections_without_view(layer, views)
        view = view or own_view or (declared[0] if declared and not layer else "")
        grouped.setdefault((plain, view), {}).setdefault(component, channel)
        written.setdefault((plain, view), layer)
    window = Window(spec.x, spec.y, spec.width, spec.height)
    return [
        Layer(number, _names(part, title, plain, written[plain, view], parts), view, window, channels, bare=not plain)
        for (plain, view), channels in grouped.items()
    ]


def _names(part: str, title: str, layer: str, written: str, parts: int) -> tuple[str, ...]:
    """All that a layer is called: without view and with it, without its part and with it."""
    if not layer:
        own = part if parts > 1 else ""
        return tuple(dict.fromkeys((own, part, title, *([written] if written else []))))
    if not part or layer == part or layer.startswith(f"{part}."):
        return tuple(dict.fromkeys((layer, written)))
    return tuple(dict.fromkeys((layer, f"{part}.{layer}", written, f"{title}.{layer}")))


def _split(channel: str, bare: str) -> tuple[str, str]:
    """Layer and component of a full channel name; without a dot it is a layer unless a letter of `bare`."""
    layer, dot, component = channel.rpartition(".")
    component = _COMPONENTS.get(component.lower(), component.upper() if len(component) == 1 else component)
    return (layer, component) if dot or component in set(bare) else (channel, "Y")


def _title(spec: oiio.ImageSpec) -> str:
    return str(spec.get_string_attribute("oiio:subimagename"))


def _multi_view(spec: oiio.ImageSpec) -> tuple[str, ...]:
    said = spec.getattribute("multiView")
    return () if not said else (said,) if isinstance(said, str) else tuple(map(str, said))


def _all_sections(spec: oiio.ImageSpec) -> Iterable[str]:
    yield from re.split(r"[._-]", _title(spec))
    for channel in spec.channelnames:
        yield from channel.split(".")[:-1]


def _without_view(title: str, views: Sequence[str]) -> tuple[str, str]:
    """A part's name and the view that it begins or ends with."""
    for view in views:
        at = re.escape(view)
        for pattern in (rf"(?P<name>.+)[._-]{at}", rf"{at}[._-](?P<name>.+)"):
            if found := re.fullmatch(pattern, title, re.IGNORECASE):
                return found["name"], view
    return title, ""


def _sections_without_view(layer: str, views: Sequence[str]) -> tuple[str, str]:
    """A layer's name and the view among its sections: the last one by the EXR's convention, else the first one."""
    sections = layer.split(".")
    known = {view.casefold(): view for view in views}
    for at in (len(sections) - 1, 0):
        if view := known.get(sections[at].casefold()):
            return ".".join(sections[:at] + sections[at + 1 :]), view
    return layer, ""


def _of_first_view(found: Sequence[Layer], parts: Sequence[oiio.ImageSpec]) -> list[Layer]:
    """Layers without a view that others have one of beside them are those of the first view, whose name may be left
    away.
    """
    twins = {(layer.part, layer.name) for layer in found if layer.view}
    return [
        replace(layer, view=_multi_view(parts[layer.part])[0])
        if not layer.view and (layer.part, layer.name) in twins and _multi_view(parts[layer.part])
        else layer
        for layer in found
    ]
