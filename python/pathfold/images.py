"""Picture files: the parts, layers and channels of an EXR, read as arrays and written back with the rest
untouched.

A *layer* is what shares a name up to the last dot ("albedo.R", "albedo.G", "albedo.B"); bare R, G, B, A are
the main picture, whose layer is "". In a file of several parts a layer may also be named by its part.
"""

import os
import re
import tempfile
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager, suppress
from dataclasses import dataclass, field
from functools import cached_property
from pathlib import Path
from typing import Any

import numpy as np
import OpenImageIO as oiio  # noqa: N813
from numpy.typing import NDArray

HALF_MAX = 65504.0
_FLOAT_EXACT = 1 << 23  # integers up to here survive OpenImageIO's way through float
_BAND = 64  # rows read or written at a time; a multiple of every scanline compression's block
_KEPT_BYTES = 2 << 30  # a larger part is read layer by layer
_LINEAR = (".exr", ".hdr", ".pfm", ".tif", ".tiff")  # what holds linear floats; others take 8 or 16 bits for a display
MAX_CHANNELS = 4096  # of one part, as OpenImageIO writes EXRs
_SAMPLE = re.compile(r"samples\.(\d+)\..+")
_COMPONENTS = {"red": "R", "green": "G", "blue": "B", "alpha": "A"}
# A 64-sample file has thousands of channels, more than OpenImageIO opens by itself.
oiio.attribute("limits:channels", 1 << 16)


class ImageError(RuntimeError):
    """A file that cannot be read; the message names it and says why."""


class OutputError(RuntimeError):
    """A file that cannot be written; nothing of it is left behind."""


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


class ImageFile:
    """A picture opened for reading: headers now, pixels on demand.

    Raises ImageError where the file is missing, no picture, or has no pixels.
    """

    def __init__(self, path: str | os.PathLike[str]) -> None:
        self.path = Path(path)
        self._input = _open(self.path)
        self._kept: tuple[int, NDArray[np.float32]] | None = None
        self.parts: list[oiio.ImageSpec] = []
        while self._input.seek_subimage(len(self.parts), 0):
            self.parts.append(self._input.spec().copy())
        for spec in self.parts:
            if spec.width < 1 or spec.height < 1 or spec.nchannels < 1:
                raise ImageError(f"{self.path}: has no pixels ({spec.width}x{spec.height}, {spec.nchannels} channels)")
        self.layers = _layers(self.parts)

    def part_name(self, part: int) -> str:
        return str(self.parts[part].get_string_attribute("oiio:subimagename"))

    @cached_property
    def samples(self) -> tuple[int, list[str]] | None:
        """The part that holds camera samples, and their numbers as channels write them; None where there are none."""
        for part, spec in enumerate(self.parts):
            if found := [match.group(1) for name in spec.channelnames if (match := _SAMPLE.fullmatch(name))]:
                return part, sorted(set(found), key=int)
        return None

    def metadata(self) -> dict[str, object]:
        """The first part's header entries."""
        return {entry.name: entry.value for entry in self.parts[0].extra_attribs}

    def layer(self, name: str) -> Layer | None:
        """The first layer that goes by this name, upper and lower case alike."""
        wanted = name.casefold()
        return next((at for at in self.layers if wanted in (known.casefold() for known in at.names)), None)

    def read(self, part: int, channels: Sequence[int]) -> NDArray[np.float32]:
        """Channels of a part, height x width x len(channels), float32."""
        spec = self.parts[part]
        if 4 * spec.width * spec.height * spec.nchannels > _KEPT_BYTES:
            first, last = min(channels), max(channels) + 1
            pixels = self._checked(self._input.read_image(part, 0, first, last, oiio.FLOAT))
            return np.ascontiguousarray(pixels[..., [number - first for number in channels]])
        return np.ascontiguousarray(self._whole(part)[..., list(channels)])

    def _whole(self, part: int) -> NDArray[np.float32]:
        # All channels of a part are decompressed together, so the layers of one part are read in one go.
        if self._kept is None or self._kept[0] != part:
            count = self.parts[part].nchannels
            self._kept = part, self._checked(self._input.read_image(part, 0, 0, count, oiio.FLOAT))
        return self._kept[1]

    def bands(self, part: int) -> Iterator[tuple[int, NDArray[np.float32]]]:
        """A part from top to bottom, all channels: (first row, rows x width x channels), float32."""
        spec = self.parts[part]
        self._input.seek_subimage(part, 0)
        if spec.tile_width:
            yield 0, self.read(part, range(spec.nchannels))
            return
        for row in range(0, spec.height, _BAND):
            last = min(row + _BAND, spec.height)
            rows = self._input.read_scanlines(
                part, 0, spec.y + row, spec.y + last, spec.z, 0, spec.nchannels, oiio.FLOAT
            )
            yield row, self._checked(rows).reshape(last - row, spec.width, spec.nchannels)

    def _checked(self, pixels: NDArray[Any] | None) -> NDArray[np.float32]:
        if pixels is None:
            raise ImageError(f"{self.path}: damaged: {_first_line(self._input.geterror())}")
        return pixels

    def writing_mb(self, part: int) -> float:
        """What `save_as` holds at a time to write a part with changes: its pixels in float, twice, and a bit."""
        spec = self.parts[part]
        return 1.2 * 2 * 4 * spec.nchannels * spec.width * spec.height / 2**20

    def save_as(
        self,
        path: str | os.PathLike[str],
        changed: Mapping[tuple[int, int], NDArray[np.float32]],
        *,
        leave_out: Sequence[int] = (),
        metadata: Mapping[str, str] | None = None,
    ) -> None:
        """Write the file again with some channels changed, everything else as it was.

        `changed`: (part, channel number) -> height x width; pixel types stay, so half channels are capped
        at 65504.
        `leave_out`: parts that are not copied. `metadata` is added to the first part.
        Raises OutputError; the file appears whole or not at all.
        """
        kept = [number for number in range(len(self.parts)) if number not in leave_out]
        for number in kept:
            if self.parts[number].deep:
                raise OutputError(
                    f"{self.path}: part '{self.part_name(number)}' is deep, which cannot be written beside "
                    "flat parts; have it written to a file of its own"
                )
        specs = [self.parts[number].copy() for number in kept]
        for name, value in (metadata or {}).items():
            specs[0].attribute(name, value)
        with replacing(path) as unfinished, _Writer(unfinished, specs) as writer:
            for number in kept:
                writer.next_part()
                if any(part == number for part, _ in changed):
                    writer.write(self._merged(number, changed))
                else:
                    self._input.seek_subimage(number, 0)
                    writer.copy(self._input)

    def _merged(self, part: int, changed: Mapping[tuple[int, int], NDArray[np.float32]]) -> NDArray[np.float32]:
        spec = self.parts[part]
        pixels = self.read(part, range(spec.nchannels))
        formats = spec.channelformats or (spec.format,) * spec.nchannels
        for number, kind in enumerate(formats):
            new = changed.get((part, number))
            if new is not None:
                pixels[..., number] = np.minimum(new, HALF_MAX) if kind == oiio.TypeHalf else new
            elif kind == oiio.TypeUInt and pixels[..., number].max() * 4294967295.0 > _FLOAT_EXACT:
                raise OutputError(
                    f"{self.path}: channel '{spec.channelnames[number]}' holds integers above "
                    f"{_FLOAT_EXACT}, which cannot be kept in a part that is denoised; "
                    "have it written to a part of its own"
                )
        return pixels


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
            for row in range(0, part.size[1], _BAND):
                last = min(row + _BAND, part.size[1])
                writer.write_rows(row, last, np.ascontiguousarray(part.rows(row, last), np.float32))


@contextmanager
def replacing(path: str | os.PathLike[str]) -> Iterator[Path]:
    """A temporary path beside `path` that takes its place on success and is removed on failure."""
    final = Path(path)
    unfinished = _placeholder(final)
    try:
        yield unfinished
        unfinished.chmod(0o666 & ~_umask())
        unfinished.replace(final)
    except OSError as error:
        raise OutputError(f"{final}: cannot be written: {error.strerror}") from error
    except OutputError as error:
        raise OutputError(str(error).replace(str(unfinished), str(final))) from error
    finally:
        with suppress(FileNotFoundError):
            unfinished.unlink()


def check_output(path: str | os.PathLike[str]) -> None:
    """Raise OutputError now, not after long work, where a picture could not be written to `path`."""
    if oiio.ImageOutput.create(str(path)) is None:
        raise OutputError(f"{path}: {_first_line(oiio.geterror())}; name it .exr")
    if Path(path).suffix.lower() not in _LINEAR:
        raise OutputError(f"{path}: linear radiance needs an EXR; name it {Path(path).with_suffix('.exr').name}")
    check_writable(path)


def check_writable(path: str | os.PathLike[str]) -> None:
    """Raise OutputError where a file of any kind could not be written to `path`."""
    _placeholder(Path(path)).unlink()


def _placeholder(final: Path) -> Path:
    """An empty file beside `final`, of the same type."""
    if final.is_dir():
        raise OutputError(f"{final}: is a folder; name a file")
    try:
        handle, name = tempfile.mkstemp(prefix=f".{final.stem}-", suffix=final.suffix, dir=final.parent)
    except OSError as error:
        raise OutputError(f"{final}: cannot be written: {error.strerror}: '{final.parent}'") from error
    os.close(handle)
    return Path(name)


class _Writer:
    """One output file, its parts in order; every failure of OpenImageIO becomes an OutputError."""

    def __init__(self, path: Path, specs: Sequence[oiio.ImageSpec]) -> None:
        self._path, self._specs, self._part = path, specs, -1
        self._output: Any = oiio.ImageOutput.create(str(path))
        if self._output is None:
            raise OutputError(f"{path}: {_first_line(oiio.geterror())}")

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
            reason = _first_line(self._output.geterror()) or "the disk may be full"
            raise OutputError(f"{self._path}: cannot be written: {reason}")


def _open(path: Path) -> oiio.ImageInput:
    if not path.is_file():
        raise ImageError(f"{path}: no such file" if not path.exists() else f"{path}: is not a file")
    if not os.access(path, os.R_OK):
        raise ImageError(f"{path}: may not be read (permission denied)")
    opened = oiio.ImageInput.open(str(path))
    if opened is None:
        raise ImageError(f"{path}: not a picture that can be read: {_first_line(oiio.geterror())}")
    return opened


def _layers(parts: Sequence[oiio.ImageSpec]) -> list[Layer]:
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


def _umask() -> int:
    mask = os.umask(0o022)
    os.umask(mask)
    return mask


def _first_line(text: str) -> str:
    return text.strip().splitlines()[0] if text.strip() else ""
