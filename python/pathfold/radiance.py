"""Which further layers of a file are filtered alike with its pictures: those that are radiance."""

import re
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, field
from fnmatch import fnmatchcase

import numpy as np
import OpenImageIO as oiio  # noqa: N813
from numpy.typing import NDArray

from pathfold import channels
from pathfold.channels import Frame, samples, words
from pathfold.images import ImageError, ImageFile, Layer

_LIGHT = ("color", "diffuse", "specular")  # buffers that are radiance
_LUMINANCE = np.array([0.2126, 0.7152, 0.0722])
_NEGATIVE = 0.05  # of the positive light; more is no filter's ringing
_FAR = 1e30  # what renderers write for "nothing there", or the bits of an id
_FEW = 0.01  # of all pixels


@dataclass
class Alike:
    """What is filtered with one frame's kernels, with channel numbers, and what a pattern met and left as it is."""

    layers: list[tuple[Layer, list[int]]] = field(default_factory=list)
    left: dict[str, str] = field(default_factory=dict)  # label: what it seems to be


def alike(file: ImageFile, frames: Sequence[Frame], patterns: Sequence[str]) -> list[Alike]:
    """The further radiance layers to filter alike, for each frame those of its own view and view layer.

    A pattern means radiance: what is something else by its role, its name, the header or its values is left out. A
    layer that is named exactly must be radiance. Raises ImageError for that, and for a pattern that finds nothing to
    filter, and says why.
    """
    found = [Alike() for _ in frames]
    for pattern in patterns:
        layers = [layer for layer in file.layers if _matches(layer, pattern)]
        if not layers:
            raise ImageError(f"{file.path}: --layer {pattern}: no such layer; it has {channels.describe(file)}")
        refused = []
        for layer in layers:
            owner, at = _owner(frames, layer), layer.pick(3) or layer.pick(1)
            if owner is None:
                refused.append(f"{layer.label} belongs to none of the file's pictures")
            elif reason := _misfit(file, frames[owner], layer, at):
                refused.append(f"{layer.label} {reason}")
            elif other := _other(file, frames, frames[owner], layer, at or [], exact=pattern in layer.names):
                if pattern in layer.names:
                    raise ImageError(f"{file.path}: --layer {pattern}: is no radiance but {other}; leave it out")
                refused.append(f"{layer.label} is no radiance but {other}")
                found[owner].left[layer.label] = other
            elif (layer, at) not in found[owner].layers:
                found[owner].layers.append((layer, at or []))
        if len(refused) == len(layers):
            raise ImageError(f"{file.path}: --layer {pattern}: nothing to filter: {'; '.join(refused[:3])}")
    return found


def _matches(layer: Layer, pattern: str) -> bool:
    return any(name == pattern or fnmatchcase(name, pattern) for name in layer.names)


def _misfit(file: ImageFile, frame: Frame, layer: Layer, at: list[int] | None) -> str | None:
    """Why a layer cannot be filtered with this frame, whatever it holds."""
    if layer == frame.color_layer:
        return "is the picture itself"
    if layer.window.common(frame.window) is None:
        return f"is {layer.window}, beside the picture, {frame.window}"
    if layer.part == samples.find(file) or not at:
        return f"has {', '.join(layer.channels)}; R, G, B or one channel can be filtered"
    return None


def _other(
    file: ImageFile, frames: Sequence[Frame], frame: Frame, layer: Layer, at: list[int], exact: bool
) -> str | None:
    """What a layer seems to be that is no radiance; None where it may be some."""
    if role := _role(frames, layer):
        return role
    if any(_is_crypto(layer, known) for known in _cryptomattes(file)):
        return "cryptomatte"
    # a channel may say itself what it is: "RenderLayer.Depth"
    said = [layer.name.removeprefix(f"{frame.view_layer}."), *(one for one in layer.channels if len(one) > 1)]
    name = ".".join(said)
    if guide := words.guide(name):
        return guide
    lit = words.light(name)
    if words.unlit(name):
        return "data by its name"
    kinds = {_kind(file, layer.part, number) for number in at}
    if any("int" in kind for kind in kinds):
        return "integers"
    if reason := _by_values(file.read(layer.part, at), file, frame, layer, exact or lit):
        return reason
    color = frame.color_layer
    halves = all(_kind(file, color.part, number) == "half" for number in color.pick(3) or [])
    return "32-bit values beside a half beauty" if halves and "float" in kinds and not (exact or lit) else None


def _role(frames: Sequence[Frame], layer: Layer) -> str | None:
    """The buffer that a layer is used as in any of the frames, where that is no radiance."""
    for frame in frames:
        for name, source in frame.sources.items():
            if source.side is None and name not in _LIGHT and layer in source.read and not source.component:
                return name
            if source.side is None and layer == source.factor:
                return "an albedo"
    return None


def _cryptomattes(file: ImageFile) -> Iterator[str]:
    """The names that `cryptomatte/ID/name` of the header gives."""
    for spec in file.parts:
        for entry in spec.extra_attribs:
            if entry.name.startswith("cryptomatte/") and entry.name.endswith("/name"):
                yield str(spec.get_string_attribute(entry.name))


def _is_crypto(layer: Layer, known: str) -> bool:
    """Layers of a cryptomatte are its name and two digits; a view layer may stand before either."""
    plain = known.rpartition(".")[2].casefold()
    sections = {name.rpartition(".")[2].casefold() for name in layer.names}
    return any(re.fullmatch(rf"{re.escape(plain)}\d*", section) for section in sections)


def _kind(file: ImageFile, part: int, number: int) -> str:
    spec: oiio.ImageSpec = file.parts[part]
    return str(spec.channelformats[number] if spec.channelformats else spec.format)


def _by_values(pixels: NDArray[np.float32], file: ImageFile, frame: Frame, layer: Layer, assured: bool) -> str | None:
    """What values say that no light has; `assured`: the name says that it is light, so a few odd pixels are faults."""
    odd = (~np.isfinite(pixels) | (np.abs(pixels) > _FAR)).any(-1)
    if odd.any() and layer.window == frame.window:  # light that is not finite is none in the beauty either
        odd &= np.isfinite(file.read(frame.color_layer.part, frame.color_layer.pick(3) or [])).all(-1)
    if odd.mean() > (_FEW if assured else 0.0):
        return "values that are not finite, or beyond 1e30"
    light = np.where(np.abs(pixels) < _FAR, pixels, 0).astype(np.float64)
    light = light @ _LUMINANCE if light.shape[-1] == 3 else light[..., 0]
    if -light[light < 0].sum() > _NEGATIVE * light[light > 0].sum():
        return "partly negative"
    return None


def _owner(frames: Sequence[Frame], layer: Layer) -> int | None:
    """The number of the frame that a layer is a part of: that of its view and its view layer."""

    def fits(frame: Frame) -> bool:
        if len(frames) == 1:
            return layer.view in ("", frame.color_layer.view)
        within = not frame.view_layer or layer.name.casefold().startswith(f"{frame.view_layer}.".casefold())
        return layer.view == frame.color_layer.view and within

    fitting = [number for number, frame in enumerate(frames) if fits(frame)]
    return max(fitting, key=lambda number: len(frames[number].view_layer), default=None)
