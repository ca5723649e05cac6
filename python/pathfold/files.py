"""Denoising picture files: frames and layers of an EXR through a `Denoiser`, all else kept."""

from collections.abc import Callable, Mapping, Sequence
from fnmatch import fnmatchcase
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from pathfold import channels
from pathfold.channels import BUFFERS, Frame, samples
from pathfold.denoising import Denoiser, Result
from pathfold.images import ImageError, ImageFile, Layer

_DISPLAY_REFERRED = ("uint8", "int8", "uint16", "int16")
# Where the parts of `image.hdr.exr` lie in the convention of Open Image Denoise's tools.
_SIBLINGS = {"albedo": "alb", "normal": "nrm"}

Image = NDArray[np.float32]
Buffers = dict[str, NDArray[Any]]


def denoise_file(
    source: Path,
    target: Path,
    denoiser: Denoiser,
    *,
    mapping: Mapping[str, str] | None = None,
    layers: Sequence[str] = (),
    guides: Mapping[str, Path] | None = None,
    exposures: Sequence[float] = (),
    keep_samples: bool = False,
    progress: Callable[[float], None] | None = None,
) -> list[tuple[Frame, Result]]:
    """Denoise every frame of a file and write it again; all else is kept, but for the noisy samples.

    `mapping` names layers for buffers, `layers` are patterns of further radiance layers to filter alike,
    `guides` are files that hold the albedo or the normal, `exposures` one factor per frame (or one for all).
    Raises ImageError, OutputError or PathfoldError; the target appears whole or not at all.
    """
    file = open_linear(source)
    done: list[tuple[Frame, Result]] = []
    changed: dict[tuple[int, int], Image] = {}
    for number, frame in enumerate(channels.match(file, mapping)):
        buffers = read(file, frame, denoiser.model.requires, denoiser.model.uses, guides or siblings(source))
        extra = _extra(file, frame, layers)
        result = denoiser.run_buffers(
            buffers,
            layers={layer.name: {"color": file.read(layer.part, at)} for layer, at in extra},
            exposure=exposures[min(number, len(exposures) - 1)] if exposures else None,
            progress=progress,
        )
        changed |= _changes(frame, result)
        for layer, at in extra:
            changed |= _places(layer.part, at, result.layers[layer.name])
        done.append((frame, result))
    part = samples.find(file)
    notes = {
        "pathfold:model": denoiser.model.name,
        "pathfold:exposure": f"{done[0][1].report['exposure']:.7g}",
    }
    leave_out = [part] if part and not keep_samples else []
    file.save_as(target, changed, leave_out=leave_out, metadata=notes)
    return done


def open_linear(path: Path) -> ImageFile:
    """Open a picture that can hold linear radiance; ImageError for one that is meant for a display."""
    file = ImageFile(path)
    kind = str(file.parts[0].format)
    if kind in _DISPLAY_REFERRED:
        raise ImageError(f"{path}: holds {kind} display values; linear floating point is needed (EXR)")
    return file


def read(
    file: ImageFile,
    frame: Frame,
    requires: Sequence[str],
    uses: Sequence[str],
    guides: Mapping[str, Path] | None = None,
) -> Buffers:
    """The buffers of a frame that a model reads, and its alpha.

    Raises ImageError that names what the file has where it lacks a required one.
    """
    wanted = {"color", "alpha", *requires, *uses}
    buffers: Buffers = {name: channels.load(file, frame, name) for name in frame.sources if name in wanted}
    for name, path in (guides or {}).items():
        if name in wanted:
            buffers[name] = _guide(path, name, frame)
    if any(name.startswith("samples.") for name in wanted) and samples.find(file) is not None:
        block = samples.load(file)
        buffers |= {f"samples.{name}": pixels for name, pixels in block.items()}
    if missing := sorted(set(requires) - set(buffers)):
        raise ImageError(
            f"{file.path}: {', '.join(missing)} required by the model is not there; "
            f"found {', '.join(frame.sources)} ({frame.preset.title}); the file has {channels.describe(file)}"
        )
    return buffers


def siblings(source: Path) -> dict[str, Path]:
    """The albedo and normal files beside `image.hdr.exr`, where there are any."""
    if ".hdr" not in source.suffixes:
        return {}
    found = {name: source.with_name(source.name.replace(".hdr", f".{tag}")) for name, tag in _SIBLINGS.items()}
    return {name: path for name, path in found.items() if path.is_file()}


def _guide(path: Path, name: str, frame: Frame) -> Image:
    """A guide from a file of its own: its main picture."""
    file = ImageFile(path)
    layer = file.layer("") or file.layer(name) or file.layers[0]
    at = layer.pick(BUFFERS[name])
    if at is None:
        raise ImageError(f"{path}: no {name} found; it has {channels.describe(file)}")
    if layer.size != frame.size:
        width, height = frame.size
        raise ImageError(f"{path}: {layer.size[0]}x{layer.size[1]}, the picture is {width}x{height}")
    return file.read(layer.part, at)


def _extra(file: ImageFile, frame: Frame, patterns: Sequence[str]) -> list[tuple[Layer, list[int]]]:
    """The further radiance layers that shall be filtered alike, with their channel numbers."""
    found: list[tuple[Layer, list[int]]] = []
    for pattern in patterns:
        layers = [layer for layer in file.layers if any(fnmatchcase(name, pattern) for name in layer.names)]
        if not layers:
            raise ImageError(f"{file.path}: --layer {pattern}: no such layer; it has {channels.describe(file)}")
        fitting = ((layer, layer.pick(3)) for layer in layers if layer.size == frame.size)
        found += [(layer, at) for layer, at in fitting if at and layer != frame.color_layer]
    return found


def _changes(frame: Frame, result: Result) -> dict[tuple[int, int], Image]:
    """What a result changes in the file: the beauty, and the buffers that stand in it as they are."""
    color = frame.color_layer
    changed = _places(color.part, color.pick(3) or [], result.color)
    for name, pixels in result.images().items():
        source = frame.sources.get(name)
        if name != "color" and source and source.direct:
            layer = source.layers[0]
            changed |= _places(layer.part, source.numbers(layer, BUFFERS[name]) or [], pixels)
    return changed


def _places(part: int, at: Sequence[int], pixels: Image) -> dict[tuple[int, int], Image]:
    return {(part, number): pixels[..., index] for index, number in enumerate(at)}
