"""Which channels of a file are which buffer, by the rows of a preset."""

import re
from collections.abc import Mapping
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from pathfold.buffers import BUFFERS
from pathfold.channels.presets import Preset, detect, presets
from pathfold.images import ImageError, ImageFile, Layer

# Header entry: "diffuse" or "specular", the part of the radiance that is all of color; the other part is 0.
ALL_LIGHT = "pathfold:all_light"
_SPLIT = ("diffuse", "specular", "diffuse.albedo", "diffuse.variance", "specular.variance")


@dataclass(frozen=True)
class Source:
    """Where one buffer comes from: the sum of `layers`, times `factor`, divided by `divisor`."""

    layers: tuple[Layer, ...]
    component: str = ""  # a single channel by its letter: alpha
    factor: Layer | None = None
    divisor: float = 1.0
    subtract: tuple["Source", ...] = ()

    @property
    def direct(self) -> bool:
        """The buffer stands in the file as it is, so that a result can be written back in its place."""
        return len(self.layers) == 1 and self.factor is None and self.divisor == 1.0 and not self.subtract

    def numbers(self, layer: Layer, count: int) -> list[int] | None:
        if not self.component:
            return layer.pick(count)
        return [layer.channels[self.component]] if self.component in layer.channels else None

    def __str__(self) -> str:
        text = " + ".join(_label(layer, self.component) for layer in self.layers)
        text = f"({text})" if len(self.layers) > 1 and self.factor else text
        text += f" * {_label(self.factor)}" if self.factor else ""
        text += f" / {self.divisor:g}" if self.divisor != 1.0 else ""
        return text + "".join(f" - ({part})" for part in self.subtract)


@dataclass(frozen=True)
class Frame:
    """One picture of a file (a file may hold several view layers or stereo views) and its buffers."""

    preset: Preset
    sources: Mapping[str, Source]
    color_layer: Layer  # where the result goes
    view_layer: str = ""  # what the star of the preset's patterns stands for

    @property
    def size(self) -> tuple[int, int]:
        return self.color_layer.size

    def lines(self) -> list[str]:
        """The mapping, one line per buffer, for people."""
        return [f"{name} <- {self.sources[name]}" for name in BUFFERS if name in self.sources]


def match(file: ImageFile, overrides: Mapping[str, str] | None = None) -> list[Frame]:
    """Find the frames of a file and their buffers.

    `overrides`: buffer -> layer name, or "none" for a buffer that shall not be used.
    Raises ImageError that names what the file has where no beauty is found or an override names nothing.
    """
    overrides = dict(overrides or {})
    if unknown := sorted(set(overrides) - set(BUFFERS)):
        raise ImageError(f"unknown buffer '{unknown[0]}' in the mapping; there are {', '.join(BUFFERS)}")
    for preset in (detect(file), presets()[-1]):
        if colors := _colors(file, preset, overrides):
            return [_frame(file, preset, overrides, layer, star) for layer, star in colors]
    main = file.layer("")
    lacks = [letter for letter in "RGB" if main and letter not in main.channels]
    missing = f" and lacks {','.join(lacks)}" if len(lacks) in (1, 2) else ""
    raise ImageError(f"{file.path}: no color found; it has {describe(file)}{missing}; name it with --map color=LAYER")


def load(file: ImageFile, frame: Frame, name: str) -> NDArray[np.float32]:
    """A buffer's pixels, height x width x channels, float32."""
    pixels = _evaluate(file, frame.sources[name], BUFFERS[name])
    if name == "depth":
        pixels[pixels >= frame.preset.farthest] = 0
    # Half-float passes need not add up to the last bit; a difference is radiance, never negative.
    return np.maximum(pixels, 0) if frame.sources[name].subtract else pixels


def describe(file: ImageFile) -> str:
    """The layers of a file in one line, for messages."""
    names = sorted({_label(layer) for layer in file.layers if "samples." not in layer.name})
    shown = ", ".join(names[:24])
    return shown + (f" and {len(names) - 24} more layers" if len(names) > 24 else "")


def _colors(file: ImageFile, preset: Preset, overrides: Mapping[str, str]) -> list[tuple[Layer, str]]:
    """Every beauty layer with the text that the star stands for."""
    if "color" in overrides:
        if overrides["color"].lower() == "none":
            raise ImageError(
                f"{file.path}: --map color=none: color is what is denoised; name its layer, or leave it away"
            )
        layer = _named(file, "color", overrides["color"])
        patterns = preset.buffers["color"]
        return [(layer, next((star for p in patterns if (star := _star(p, layer)) is not None), ""))]
    found: dict[tuple[str, str], tuple[Layer, str]] = {}
    for pattern in preset.buffers["color"]:
        for layer, star in _matches(file, pattern):
            if layer.pick(3):
                found.setdefault((star, layer.view), (layer, star))
        if found and "*" not in pattern:
            break
    return list(found.values())


def _frame(file: ImageFile, preset: Preset, overrides: Mapping[str, str], color: Layer, star: str) -> Frame:
    sources = {"color": Source((color,))}
    for name, count in list(BUFFERS.items())[1:]:
        if name in overrides:
            if overrides[name].lower() != "none":
                sources[name] = _check(file, name, Source((_named(file, name, overrides[name]),)), color)
            continue
        entries = preset.buffers.get(name, [])
        if name == "alpha":
            entries = [*entries, color.name]
        for entry in entries:
            source = _resolve(file, entry, star, color.view, "A" if name == "alpha" else "")
            if source and all(source.numbers(layer, count) for layer in source.layers):
                sources.setdefault(name, _check(file, name, source, color))
                break
    if told := _all_light(file):
        sources = {name: source for name, source in _told(told, sources).items() if name not in overrides} | sources
    target = _lookup(file, preset.output["color"], star, color.view) if "color" in preset.output else None
    return Frame(preset, _complete_split(sources), target or color, star)


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


def _resolve(file: ImageFile, entry: Any, star: str, view: str, component: str) -> Source | None:
    if isinstance(entry, str):
        layer = _lookup(file, entry, star, view)
        return Source((layer,), component) if layer else None
    names = entry["sum"] if "sum" in entry else [entry["layer"]]
    layers = [_lookup(file, name, star, view) for name in names]
    factor = _lookup(file, entry["times"], star, view) if "times" in entry else None
    divisor = file.metadata().get(entry["divide_by"]) if "divide_by" in entry else 1
    if None in layers or ("times" in entry and not factor) or not isinstance(divisor, int | float) or divisor <= 0:
        return None
    return Source(tuple(layer for layer in layers if layer), component, factor, float(divisor))


def _check(file: ImageFile, name: str, source: Source, color: Layer) -> Source:
    for layer in (*source.layers, *([source.factor] if source.factor else [])):
        if layer.size != color.size:
            raise ImageError(
                f"{file.path}: {name} ({_label(layer)}) is {layer.size[0]}x{layer.size[1]}, color is "
                f"{color.size[0]}x{color.size[1]}; leave it out with --map {name}=none"
            )
    if not source.numbers(source.layers[0], BUFFERS[name]):
        raise ImageError(
            f"{file.path}: {name} needs {BUFFERS[name]} channel(s); {_label(source.layers[0])} has "
            f"{', '.join(source.layers[0].channels)}"
        )
    return source


def _evaluate(file: ImageFile, source: Source, count: int) -> NDArray[np.float32]:
    def pixels(layer: Layer) -> NDArray[np.float32]:
        return file.read(layer.part, source.numbers(layer, count) or [])

    total = pixels(source.layers[0])
    for layer in source.layers[1:]:
        total = total + pixels(layer)
    if source.factor:
        total = total * pixels(source.factor)
    for part in source.subtract:
        total = total - _evaluate(file, part, count)
    return total / np.float32(source.divisor) if source.divisor != 1 else total


def _named(file: ImageFile, buffer: str, name: str) -> Layer:
    layer = file.layer("" if name.upper() in ("R,G,B", "RGB", "RGBA", "R,G,B,A") else name)
    if layer is None:
        raise ImageError(f"{file.path}: --map {buffer}={name}: no such layer; it has {describe(file)}")
    return layer


def _lookup(file: ImageFile, pattern: str, star: str, view: str) -> Layer | None:
    wanted = pattern.replace("*", star).casefold()
    for layer in file.layers:
        if layer.view == view and wanted in (name.casefold() for name in layer.names):
            return layer
    return None


def _matches(file: ImageFile, pattern: str) -> list[tuple[Layer, str]]:
    return [(layer, star) for layer in file.layers if (star := _star(pattern, layer)) is not None]


def _star(pattern: str, layer: Layer) -> str | None:
    """What the star of a pattern stands for in one of the layer's names; None where none fits."""
    expression = re.escape(pattern).replace(r"\*", "(.*)", 1)
    for name in layer.names:
        if found := re.fullmatch(expression, name, re.IGNORECASE):
            return found.group(1) if found.groups() else ""
    return None


def _label(layer: Layer, component: str = "") -> str:
    if component:
        return f"{layer.name}.{component}" if layer.name else component
    return layer.name or ",".join(letter for letter in "RGB" if letter in layer.channels) or ",".join(layer.channels)
