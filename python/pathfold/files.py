"""Denoising picture files: frames and layers of an EXR through a `Denoiser`, all else kept."""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from time import perf_counter
from typing import Any

import numpy as np
from numpy.typing import NDArray

from pathfold import channels
from pathfold.budget import Budget
from pathfold.buffers import BUFFERS
from pathfold.channels import Frame, samples
from pathfold.denoiser import Denoiser, Result
from pathfold.images import ImageError, ImageFile, Layer, Window, lay, save_as, writing_mb
from pathfold.radiance import alike

_DISPLAY_REFERRED = ("uint8", "int8", "uint16", "int16")
# Where the parts of `image.hdr.exr` lie in the convention of Open Image Denoise's tools.
_SIBLINGS = {"albedo": "alb", "normal": "nrm"}

Image = NDArray[np.float32]
Buffers = dict[str, NDArray[Any]]


@dataclass(frozen=True)
class Denoised:
    """One frame of a file after its run; `layers` are those that were filtered alike, by name."""

    frame: Frame
    result: Result
    layers: tuple[str, ...] = ()
    lost: int = 0  # the number of pixels where not one has finite color: the result is black
    budget: tuple[str, ...] = ()  # what was chosen to stay inside a budget, and what was given up for it
    converted: tuple[str, ...] = ()  # what was made of the file's buffers at reading
    left: Mapping[str, str] = field(default_factory=dict)  # layers that a pattern met, no radiance, and what they are
    written: tuple[str, ...] = ()  # what of the file is stored otherwise than it was, or with loss; of its last frame


def denoise_file(
    source: Path,
    target: Path,
    denoiser: Denoiser | Budget,
    *,
    mapping: Mapping[str, str] | None = None,
    layers: Sequence[str] = (),
    guides: Mapping[str, Path] | None = None,
    exposures: Sequence[float] = (),
    keep_samples: bool = False,
    progress: Callable[[float], None] | None = None,
) -> list[Denoised]:
    """Denoise every frame of a file and write it again; all else is kept, but for the noisy samples.

    `mapping` names layers for buffers, `layers` are patterns of further radiance layers to filter alike,
    `guides` are files by the buffer that each holds, `exposures` one factor per frame (or one for all).
    A Budget in place of a denoiser chooses one; its clock runs from here, and writing counts as much as reading.
    Raises ImageError, OutputError or PathfoldError; the target appears whole or not at all.
    """
    begin = perf_counter()
    file = open_linear(source)
    frames = channels.match(file, mapping, guides or siblings(source))
    done: list[Denoised] = []
    changed: dict[tuple[int, int], Image] = {}
    for number, (frame, also) in enumerate(zip(frames, alike(file, frames, layers), strict=True)):
        extra = also.layers
        lines: list[str] = []
        if isinstance(denoiser, Budget):
            buffers, converted = read(file, frame, ["color"], sorted(denoiser.reads))
            reading = perf_counter() - begin
            choice = denoiser.choose(
                buffers,
                start=begin - reading,
                samples_per_pixel=_samples_per_pixel(file),
                later_mb=writing_mb(file, frame.color_layer.part),
            )
            ready, buffers, lines = choice.denoiser, dict(choice.buffers), choice.lines
        else:
            ready = denoiser
            buffers, converted = read(file, frame, ready.model.requires, ready.model.uses)
        result = ready.run_buffers(
            buffers,
            layers={_key(layer): {"color": file.read_into(layer, at, frame.window, 0.0)} for layer, at in extra},
            samples_per_pixel=_samples_per_pixel(file),
            exposure=exposures[min(number, len(exposures) - 1)] if exposures else None,
            progress=progress,
        )
        finite = np.isfinite(buffers["color"]).all(-1)
        lost = 0 if finite.any() or result.color.any() else finite.size
        changed |= _changes(file, frame, result)
        for layer, at in extra:
            changed |= _places(file, layer, at, result.layers[_key(layer)], frame.window)
        converted += _beyond([frame.color_layer, *(layer for layer, _ in extra)], frame.window)
        names = tuple(layer.label for layer, _ in extra)
        done.append(Denoised(frame, result, names, lost, tuple(lines), tuple(converted), left=also.left))
        begin = perf_counter()
    part = samples.find(file)
    notes = {
        "pathfold:model": done[0].result.report["model"],
        "pathfold:precision": done[0].result.report["precision"],
        "pathfold:exposure": f"{done[0].result.report['exposure']:.7g}",
    }
    leave_out = [part] if part and not keep_samples else []
    written = save_as(file, target, changed, leave_out=leave_out, metadata=notes)
    return [*done[:-1], replace(done[-1], written=tuple(written))]


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
) -> tuple[Buffers, list[str]]:
    """The buffers of a frame that a model reads, and its alpha; and what was made of them, a line each.

    Raises ImageError that names what the file has where it lacks a required one.
    """
    wanted = {"color", "alpha", *requires, *uses}
    told_by = {"normal", "depth"} if "albedo" in wanted else set()  # what is covered
    buffers: Buffers = {name: channels.load(file, frame, name) for name in frame.sources if name in wanted | told_by}
    converted = []
    if "albedo" in buffers and (made := channels.complete_albedo(buffers, frame.writer("albedo").miss_albedo)):
        buffers["albedo"], line = made
        converted.append(line)
    buffers = {name: pixels for name, pixels in buffers.items() if name in wanted}
    if any(name.startswith("samples.") for name in wanted) and samples.find(file) is not None:
        block = samples.load(file, frame.window)
        buffers |= {f"samples.{name}": pixels for name, pixels in block.items()}
    if missing := sorted(set(requires) - set(buffers)):
        raise ImageError(
            f"{file.path}: {', '.join(missing)} required by the model is not there; "
            f"found {', '.join(frame.sources)} ({frame.preset.title}); the file has {channels.describe(file)}"
        )
    return buffers, converted


def siblings(source: Path) -> dict[str, Path]:
    """The albedo and normal files beside `image.hdr.exr`, where there are any."""
    if ".hdr" not in source.suffixes:
        return {}
    found = {name: source.with_name(source.name.replace(".hdr", f".{tag}")) for name, tag in _SIBLINGS.items()}
    return {name: path for name, path in found.items() if path.is_file()}


def _samples_per_pixel(file: ImageFile) -> int:
    """What our own header says of it; 0: nothing."""
    said = file.metadata().get("pathfold:spp")
    return said if isinstance(said, int) and said > 0 else 0


def _key(layer: Layer) -> str:
    """Names a layer in a run: two parts may hold layers of one name."""
    return f"{layer.part}:{layer.name}"


def _changes(file: ImageFile, frame: Frame, result: Result) -> dict[tuple[int, int], Image]:
    """What a result changes in the file: the beauty, and the buffers that stand in it as they are."""
    color = frame.color_layer
    changed = _places(file, color, color.pick(3) or [], result.color, frame.window)
    for name, pixels in result.images().items():
        source = frame.sources.get(name)
        if name != "color" and source and source.direct:
            layer = source.layers[0]
            changed |= _places(file, layer, source.numbers(layer, BUFFERS[name]) or [], pixels, frame.window)
    return changed


def _beyond(layers: Sequence[Layer], window: Window) -> list[str]:
    """A line for each layer that has pixels where the picture has none."""
    return [
        f"{layer.label} is {layer.window}, the picture {window}: beyond it the layer stays as noisy as before"
        for layer in layers
        if layer.window.common(window) != layer.window
    ]


def _places(
    file: ImageFile, layer: Layer, at: Sequence[int], pixels: Image, window: Window
) -> dict[tuple[int, int], Image]:
    """Pixels over a window as the layer's channels, which stay as they are where the layer reaches beyond it."""
    if layer.window != window:
        pixels = lay(pixels, window, layer.window, file.read(layer.part, at))
    # One channel may stand for all three colours: then it becomes their mean.
    sharing = {number: [index for index, one in enumerate(at) if one == number] for number in at}
    return {(layer.part, number): pixels[..., those].mean(-1) for number, those in sharing.items()}
