"""Which channels of a file, and of files beside it, are which buffer, by the rows of a preset.

A layer has one role: what is the beauty is never a guide, and no guide is two. An explicit name comes before a row.
"""

from collections import Counter
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from pathfold.buffers import BUFFERS
from pathfold.channels import words
from pathfold.channels.beside import from_file
from pathfold.channels.find import named, resolve, serves
from pathfold.channels.pictures import Picture, main, none_found, pictures
from pathfold.channels.presets import Preset, detect, in_view_layers, presets
from pathfold.channels.source import Source, evaluate
from pathfold.images import ImageError, ImageFile, Layer, Window, views

# Header entry: "diffuse" or "specular", the part of the radiance that is all of color; the other part is 0.
ALL_LIGHT = "pathfold:all_light"
_GUIDES = ("albedo", "normal", "depth", "variance")
_SPLIT = ("diffuse", "specular", "diffuse.albedo", "diffuse.variance", "specular.variance")
_TOLD = 8  # layers named in one line
# What a layer is used as; what divides radiance may divide all of it and its diffuse part.
_ROLE = {
    "diffuse": "light",
    "specular": "light",
    "diffuse.albedo": "albedo",
    "diffuse.variance": "variance",
    "specular.variance": "variance",
}


@dataclass(frozen=True)
class Frame:
    """One picture of a file (a file may hold several view layers or stereo views) and its buffers.

    `notes`: what a person should know of the mapping, a line each.
    """

    preset: Preset
    sources: Mapping[str, Source]
    color_layer: Layer  # where the result goes
    view_layer: str = ""  # what the names of its layers begin with
    several_parts: bool = False  # in the file
    notes: tuple[str, ...] = ()

    @property
    def window(self) -> Window:
        """Where the noisy picture lies; all buffers are laid there."""
        return self.sources["color"].layers[0].window

    @property
    def size(self) -> tuple[int, int]:
        """Width, height."""
        return self.window.size

    def writer(self, name: str) -> Preset:
        """The conventions of the file that a buffer stands in."""
        source = self.sources.get(name)
        return source.preset if source and source.preset else self.preset

    def lines(self) -> list[str]:
        """The mapping, one line per buffer, for people."""
        return [f"{name} <- {self.sources[name].line(self.several_parts)}" for name in BUFFERS if name in self.sources]


def match(
    file: ImageFile, overrides: Mapping[str, str] | None = None, guides: Mapping[str, Path] | None = None
) -> list[Frame]:
    """Find the frames of a file and their buffers.

    `overrides`: buffer -> layer name or channels ("X,Y,Z"), or "none" for a buffer that shall not be used.
    `guides`: buffer -> a file that holds it, in which `overrides` then names the layer.
    Raises ImageError that names what the file has where no beauty is found, where two layers could be it, where an
    override names nothing, or where a layer would be two things.
    """
    overrides, guides = dict(overrides or {}), dict(guides or {})
    if unknown := sorted({*overrides, *guides} - set(BUFFERS)):
        raise ImageError(f"unknown buffer '{unknown[0]}' in the mapping; there are {', '.join(BUFFERS)}")
    for name in guides:
        if overrides.get(name, "").lower() == "none":
            raise ImageError(f"{guides[name]}: --map {name}=none leaves it out; give one of them")
    opened = {name: ImageFile(path) for name, path in guides.items()}
    common = presets()[-1]
    for preset in (detect(file), common, *([in_view_layers(common)] if _in_view_layers(file) else [])):
        if found := pictures(file, preset, overrides.get("color")):
            frames = [_Mapper(file, preset, overrides, picture).frame(opened) for picture in found]
            return _with_notes(file, frames, overrides)
    raise none_found(file)


def _in_view_layers(file: ImageFile) -> bool:
    """Whether the names of all layers begin with that of one of several layers each."""
    names = [layer.name for layer in file.layers]
    begin = Counter(name.partition(".")[0] for name in names)
    return all("." in name and begin[name.partition(".")[0]] > 1 for name in names)


def load(file: ImageFile, frame: Frame, name: str) -> NDArray[np.float32]:
    """A buffer's pixels as they lie in the frame's window, height x width x channels, float32."""
    source = frame.sources[name]
    pixels = evaluate(file, source, name, BUFFERS[name], frame.window)
    if name == "depth":
        pixels[pixels >= frame.writer(name).farthest] = 0
    # Half-float passes need not add up to the last bit; a difference is radiance, never negative.
    return np.maximum(pixels, 0) if source.subtract else pixels


class _Mapper:
    """The buffers of one picture, found one after another; each takes its channels from the others."""

    def __init__(self, file: ImageFile, preset: Preset, overrides: Mapping[str, str], picture: Picture) -> None:
        self._file, self._preset, self._overrides = file, preset, overrides
        self._color, self._star = picture
        self._main = main(file, self._color.view) or main(file, "")
        self._sources = {"color": Source((self._color,))}
        self._notes: list[str] = []

    def frame(self, opened: Mapping[str, ImageFile]) -> Frame:
        rest = [name for name in BUFFERS if name != "color"]
        chosen = [name for name in rest if name in opened or name in self._overrides]
        for name in (*chosen, *(name for name in rest if name not in chosen)):
            if name in opened:
                text = self._overrides.get(name)
                self._add(name, from_file(opened[name], name, text, self._color, self._star, self._display()))
            elif name not in chosen:
                self._by_rows(name)
            elif self._overrides[name].lower() != "none":
                self._by_name(name, self._overrides[name])
        sources = self._sources
        if told := _all_light(self._file):
            more = _told(told, sources)
            sources = {name: source for name, source in more.items() if name not in self._overrides} | sources
        output = self._preset.output.get("color")
        target = resolve(self._file, output, self._star, self._color, self._main, "") if output else None
        result = target.layers[0] if target and "color" not in self._overrides else self._color
        several = len(self._file.parts) > 1
        within = self._star if self._color.name.casefold().startswith(f"{self._star}.".casefold()) else ""
        return Frame(self._preset, _complete_split(sources), result, within, several, tuple(self._notes))

    def _display(self) -> Window | None:
        return self._file.display(self._color.part)

    def _by_rows(self, name: str) -> None:
        component = "A" if name == "alpha" else ""
        for preset, row in self._rows(name):
            source = resolve(self._file, row, self._star, self._color, self._main, component)
            fits = source and all(source.numbers(layer, BUFFERS[name]) for layer in source.layers)
            if source and fits and not self._taken(name, source):
                self._add(name, replace(source, preset=preset))
                return
        bare = (layer for layer in self._file.layers if layer.bare and layer.part == self._color.part)
        for layer in (self._color, *bare) if name == "alpha" else ():
            if "A" in layer.channels and layer.view == self._color.view:
                self._add(name, Source((layer,), "A"))
                return

    def _rows(self, name: str) -> Iterator[tuple[Preset, Any]]:
        """The rows of the writer, then, for guides, those that mean the same with everybody."""
        common = [presets()[-1]] if name in _GUIDES and self._preset != presets()[-1] else []
        for preset in (self._preset, *common):
            yield from ((preset, row) for row in preset.buffers.get(name, ()))

    def _by_name(self, name: str, text: str) -> None:
        found = named(self._file, name, text)
        fitting = [layer for layer in found if serves(layer, self._color.view, self._file)]
        if not fitting:
            self._notes.append(f"{name}: {text} is of view {found[0].view} and not used here")
            return
        layer = min(fitting, key=lambda one: (one.view != self._color.view, one.part != self._color.part))
        source = Source((layer,))
        if not source.numbers(layer, BUFFERS[name]):
            has = ", ".join(layer.channels)
            raise ImageError(f"{self._file.path}: {name} needs {BUFFERS[name]} channel(s); {layer.label} has {has}")
        if other := self._taken(name, source):
            raise ImageError(
                f"{self._file.path}: --map {name}={text}: {layer.label} is {other} already; name another layer, "
                f"or leave it out with --map {name}=none"
            )
        self._add(name, source)

    def _taken(self, name: str, source: Source) -> str | None:
        """The buffer of another role that has a channel of this one."""
        wanted = {channel for layer in source.layers for channel in _channels(source, layer, name)}
        for other, held in self._sources.items():
            alike = _ROLE.get(other, other) == _ROLE.get(name, name)
            if not alike and not held.side and any(wanted & _channels(held, layer, other) for layer in held.layers):
                return other
        return None

    def _add(self, name: str, source: Source) -> None:
        """Take a source for a buffer, if it lies where the picture does."""
        picture = self._color.window
        for layer in source.read:
            common = layer.window.common(picture)
            if common is None:
                where = f"{source.line(len(self._file.parts) > 1)} is {layer.window}, the picture {picture}"
                self._notes.append(f"{name} is not used, it lies beside the picture: {where}")
                return
            if common != picture:
                self._notes.append(f"{name} ({layer.label}) is {layer.window}, the picture {picture}: a miss outside")
        self._sources[name] = source


def _channels(source: Source, layer: Layer, name: str) -> set[tuple[int, int]]:
    return {(layer.part, number) for number in source.numbers(layer, BUFFERS[name]) or ()}


def _all_light(file: ImageFile) -> str:
    """The part of the radiance that is all of color, where the file's header says so."""
    said = file.metadata().get(ALL_LIGHT, "")
    if said not in ("", "diffuse", "specular"):
        raise ImageError(f"{file.path}: {ALL_LIGHT} is {said!r}; it must be diffuse or specular")
    return str(said)


def _told(all_light: str, sources: Mapping[str, Source]) -> dict[str, Source]:
    """The buffers of the split that color and variance tell, where `all_light` is all of the radiance."""
    other = {"diffuse": "specular", "specular": "diffuse"}[all_light]
    told = {}
    for whole, suffix in (("color", ""), ("variance", ".variance")):
        if whole in sources:
            told[all_light + suffix] = sources[whole]
            told[other + suffix] = replace(sources[whole], subtract=(sources[whole],))
    if all_light == "specular":
        told["diffuse.albedo"] = told["diffuse"]
    return told


def _complete_split(sources: dict[str, Source]) -> dict[str, Source]:
    """Specular is all that is not diffuse; a split that lacks a piece is no split."""
    if "diffuse" in sources and "diffuse.albedo" in sources:
        sources.setdefault("specular", replace(sources["color"], subtract=(sources["diffuse"],)))
        return sources
    return {name: source for name, source in sources.items() if name not in _SPLIT}


def _with_notes(file: ImageFile, frames: Sequence[Frame], overrides: Mapping[str, str]) -> list[Frame]:
    """The frames, each told what looks like a guide of its own and is not used; the first one the rest."""
    used = {
        channel
        for frame in frames
        for layer in (frame.color_layer, *(one for source in frame.sources.values() for one in _all_read(source)))
        for channel in _all_channels(layer)
    }
    seen = {frame.color_layer.view for frame in frames}
    notes = [list(frame.notes) for frame in frames]
    for view in views(file.layers):
        if view and view not in seen:
            notes[0].append(
                f"view {view} has no picture that is known: it stays as it is; name it with --map color=LAYER"
            )
    for layer in file.layers:
        if layer.name.casefold() in ("left", "right") and layer.pick(3) and not used & _all_channels(layer):
            notes[0].append(f"{layer.label} is no view by the header and stays as it is; {layer.mapped('color')}")
    unused: list[list[str]] = [[] for _ in frames]
    for layer in file.layers:
        buffer = None if used & _all_channels(layer) or "samples." in layer.name else _seems(layer)
        if buffer and overrides.get(buffer, "").lower() != "none":
            owner = next((at for at, frame in enumerate(frames) if serves(layer, frame.color_layer.view, file)), 0)
            overlaps = layer.window.common(frames[owner].window)
            why = layer.mapped(buffer) if overlaps else "beside the picture"
            unused[owner].append(f"{layer.label} ({why})")
    for at, lines in enumerate(unused):
        more = f" and {len(lines) - _TOLD} more" if len(lines) > _TOLD else ""
        notes[at] += [f"not used: {', '.join(lines[:_TOLD])}{more}"] if lines else []
    for at, frame in enumerate(frames):
        if set("XYZ") <= {name.upper() for name in frame.sources["color"].layers[0].name.split(",")}:
            notes[at].append("color is CIE XYZ, which is filtered as it stands; convert it to RGB for the best result")
    return [replace(frame, notes=tuple(lines)) for frame, lines in zip(frames, notes, strict=True)]


def _all_channels(layer: Layer) -> set[tuple[int, int]]:
    return {(layer.part, number) for number in layer.channels.values()}


def _all_read(source: Source) -> set[Layer]:
    own = () if source.side else source.read
    return {*own, *(layer for part in source.subtract for layer in _all_read(part))}


def _seems(layer: Layer) -> str | None:
    """The buffer that an unused layer seems to be."""
    names = [name for name in layer.names if name]
    buffer = next((found for name in names if (found := words.guide(name))), None)
    if buffer is None and any(map(words.beauty, names)) and not any(map(words.data, names)):
        buffer = "color"
    return buffer if buffer and layer.pick(BUFFERS[buffer]) else None
