"""Picture files written: a file again with some channels changed, or a new one."""

import os
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import OpenImageIO as oiio  # noqa: N813
from numpy.typing import NDArray

from pathfold.images.errors import OutputError, why
from pathfold.images.read import BAND, ImageFile
from pathfold.images.replace import replacing
from pathfold.images.storage import Storage, storage

HALF_MAX = 65504.0
MAX_CHANNELS = 4096  # of one part, as OpenImageIO writes EXRs
_FLOAT_EXACT = 1 << 23  # integers up to here survive OpenImageIO's way through float


def writing_mb(file: ImageFile, part: int) -> float:
    """What `save_as` holds at a time to write a part with changes: its pixels in float, twice, and a bit."""
    spec = file.parts[part]
    return 1.2 * 2 * 4 * spec.nchannels * spec.width * spec.height / 2**20


def save_as(
    file: ImageFile,
    path: str | os.PathLike[str],
    changed: Mapping[tuple[int, int], NDArray[np.float32]],
    *,
    leave_out: Sequence[int] = (),
    metadata: Mapping[str, str] | None = None,
) -> list[str]:
    """Write the file again with some channels changed, everything else as it was; a line for all that is not so.

    `changed`: (part, channel number) -> height x width; pixel types stay, so half channels are capped at 65504.
    Parts without a change are stored without loss, and so is a part whose compression would make a value infinite.
    `leave_out`: parts that are not copied. `metadata` is added to the first part.
    Raises OutputError; the file appears whole or not at all.
    """
    kept = [number for number in range(len(file.parts)) if number not in leave_out]
    for number in kept:
        if file.parts[number].deep:
            raise OutputError(
                f"{file.path}: part '{file.part_name(number)}' is deep, which cannot be written beside "
                "flat parts; have it written to a file of its own"
            )
    if len(kept) > 1 and not _holds_parts(path):
        raise OutputError(f"{path}: this format holds one picture, {file.path} has {len(kept)}; name it .exr")
    touched = {part for part, _ in changed}
    suffix = Path(path).suffix.lower()
    parts = {number: storage(file.parts[number], number in touched, suffix) for number in kept}
    for name, value in (metadata or {}).items():
        parts[kept[0]].spec.attribute(name, value)
    with replacing(path) as unfinished:
        finite = _write(file, unfinished, parts, changed)
        if any(part.rings for part in parts.values()):
            for at, (number, part) in enumerate(parts.items()):
                if part.rings and _finite(ImageFile(unfinished), at) < finite[number]:
                    parts[number] = part.without_loss("values near the largest would become infinite")
            if any(not part.rings and number in finite for number, part in parts.items()):
                _write(file, unfinished, parts, changed)
    several = len(parts) > 1
    return [f"part {number}: {line}" if several else line for number, part in parts.items() for line in part.lines]


def _write(
    file: ImageFile, path: Path, parts: Mapping[int, Storage], changed: Mapping[tuple[int, int], NDArray[np.float32]]
) -> dict[int, int]:
    """Write the parts by number; returns how many values of each are finite whose compression may ring."""
    finite = {}
    with _Writer(path, [part.spec for part in parts.values()]) as writer:
        for number, part in parts.items():
            writer.next_part()
            if any(touched == number for touched, _ in changed):
                pixels = _merged(file, number, changed)
                writer.write(pixels)
                if part.rings:
                    finite[number] = int(np.isfinite(pixels).sum())
            else:
                file.input.seek_subimage(number, 0)
                writer.copy(file.input)
    return finite


def _finite(file: ImageFile, part: int) -> int:
    return sum(int(np.isfinite(rows).sum()) for _, rows in file.bands(part))


def _merged(file: ImageFile, part: int, changed: Mapping[tuple[int, int], NDArray[np.float32]]) -> NDArray[np.float32]:
    spec = file.parts[part]
    pixels = file.read(part, range(spec.nchannels))
    formats = spec.channelformats or (spec.format,) * spec.nchannels
    for number, kind in enumerate(formats):
        new = changed.get((part, number))
        if new is not None:
            pixels[..., number] = np.clip(new, -HALF_MAX, HALF_MAX) if kind == oiio.TypeHalf else new
        elif kind == oiio.TypeUInt and pixels[..., number].max() * 4294967295.0 > _FLOAT_EXACT:
            raise OutputError(
                f"{file.path}: channel '{spec.channelnames[number]}' holds integers above "
                f"{_FLOAT_EXACT}, which cannot be kept in a part that is denoised; "
                "have it written to a part of its own"
            )
    return pixels


def _holds_parts(path: str | os.PathLike[str]) -> bool:
    output = oiio.ImageOutput.create(str(path))
    return output is not None and bool(output.supports("multiimage"))


@dataclass(frozen=True)
class NewPart:
    """A part to write: `rows(first, last)` gives rows x width x channels."""

    name: str
    channels: Sequence[str]
    formats: Sequence[str]  # "half" or "float", one per channel
    size: tuple[int, int]  # width, height
    rows: Callable[[int, int], NDArray[np.floating]]


def write_parts(
    path: str | os.PathLike[str], parts: Sequence[NewPart], metadata: Mapping[str, str | int | float]
) -> None:
    """Write a new EXR, ZIP-compressed. Raises OutputError; the file appears whole or not at all."""
    specs = []
    for part in parts:
        # OpenImageIO takes the formats of the channels only where they differ.
        spec = oiio.ImageSpec(*part.size, len(part.channels), oiio.TypeDesc(part.formats[0]))
        spec.channelnames = tuple(part.channels)
        spec.channelformats = tuple(oiio.TypeDesc(kind) for kind in part.formats)
        spec.attribute("compression", "zip")
        spec.attribute("oiio:subimagename", part.name)
        for name, value in metadata.items():
            spec.attribute(name, value)
        specs.append(spec)
    with replacing(path) as unfinished, _Writer(unfinished, specs) as writer:
        for part in parts:
            writer.next_part()
            for row in range(0, part.size[1], BAND):
                last = min(row + BAND, part.size[1])
                writer.write_rows(row, last, np.ascontiguousarray(part.rows(row, last), np.float32))


class _Writer:
    """One output file, its parts in order; every failure of OpenImageIO becomes an OutputError."""

    def __init__(self, path: Path, specs: Sequence[oiio.ImageSpec]) -> None:
        self._path, self._specs, self._part = path, specs, -1
        self._output: Any = oiio.ImageOutput.create(str(path))
        if self._output is None:
            raise OutputError(f"{path}: {why()}")

    def __enter__(self) -> "_Writer":
        return self

    def __exit__(self, kind: object, *_: object) -> None:
        closed = self._output.close()
        if kind is None:
            self._check(closed)

    def next_part(self) -> None:
        self._part += 1
        if self._part:
            self._check(self._output.open(str(self._path), self._specs[self._part], "AppendSubimage"))
        elif len(self._specs) == 1:
            self._check(self._output.open(str(self._path), self._specs[0]))
        else:
            self._check(self._output.open(str(self._path), tuple(self._specs)))

    def write(self, pixels: NDArray[np.float32]) -> None:
        self._check(self._output.write_image(pixels))

    def write_rows(self, first: int, last: int, rows: NDArray[np.float32]) -> None:
        self._check(self._output.write_scanlines(first, last, 0, rows))

    def copy(self, source: oiio.ImageInput) -> None:
        self._check(self._output.copy_image(source))

    def _check(self, done: bool) -> None:
        if not done:
            reason = why(self._output) or "the disk may be full"
            raise OutputError(f"{self._path}: cannot be written: {reason}")
