"""Picture files opened for reading: headers at once, pixels on demand."""

import os
import re
from collections.abc import Iterator, Sequence
from contextlib import suppress
from functools import cached_property
from pathlib import Path
from typing import Any

import numpy as np
import OpenImageIO as oiio  # noqa: N813
from numpy.typing import NDArray

from pathfold.images.errors import ImageError, as_text, why
from pathfold.images.layers import Layer, declared_views, layers
from pathfold.images.window import Window, lay

BAND = 64  # rows read or written at a time; a multiple of every scanline compression's block
_KEPT_BYTES = 2 << 30  # a larger part is read layer by layer
_SAMPLE = re.compile(r"samples\.(\d+)\..+")
# A 64-sample file has thousands of channels, more than OpenImageIO opens by itself.
oiio.attribute("limits:channels", 1 << 16)
# PFMs begin with the lowest row; without this they would be read upside down.
_UPRIGHT = oiio.ImageSpec()
_UPRIGHT.attribute("pnm:pfmflip", 1)


class ImageFile:
    """A picture opened for reading: headers now, pixels on demand.

    Raises ImageError where the file is missing, no picture, or has no pixels.
    """

    def __init__(self, path: str | os.PathLike[str]) -> None:
        self.path = Path(path)
        self.input = _open(self.path)
        self._kept: tuple[int, NDArray[np.float32]] | None = None
        self.parts: list[oiio.ImageSpec] = []
        while self.input.seek_subimage(len(self.parts), 0):
            self.parts.append(self.input.spec().copy())
        for spec in self.parts:
            if spec.width < 1 or spec.height < 1 or spec.nchannels < 1:
                raise ImageError(f"{self.path}: has no pixels ({spec.width}x{spec.height}, {spec.nchannels} channels)")
        try:
            self.layers = layers(self.parts)
            self.views = declared_views(self.parts)
        except UnicodeDecodeError as error:
            raise ImageError(f"{self.path}: damaged: a name in its header is not UTF-8") from error

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
        """The first part's header entries, but those whose text is not UTF-8: they are only copied."""
        found: dict[str, object] = {}
        for entry in self.parts[0].extra_attribs:
            with suppress(UnicodeDecodeError):
                found[entry.name] = entry.value
        return found

    def called(self, name: str) -> list[Layer]:
        """The layers that go by this name: upper and lower case as given first, then alike."""
        wanted = name.casefold()
        alike = [layer for layer in self.layers if wanted in (known.casefold() for known in layer.names)]
        return sorted(alike, key=lambda layer: name not in layer.names)

    def layer(self, name: str) -> Layer | None:
        """The first layer that goes by this name."""
        return next(iter(self.called(name)), None)

    def display(self, part: int) -> Window:
        """The display window of a part: what the frame shows, wherever there are pixels."""
        spec = self.parts[part]
        return Window(spec.full_x, spec.full_y, spec.full_width, spec.full_height)

    def read(self, part: int, channels: Sequence[int]) -> NDArray[np.float32]:
        """Channels of a part, height x width x len(channels), float32."""
        spec = self.parts[part]
        if 4 * spec.width * spec.height * spec.nchannels > _KEPT_BYTES:
            first, last = min(channels), max(channels) + 1
            pixels = self._checked(self.input.read_image(part, 0, first, last, oiio.FLOAT))
            return np.ascontiguousarray(pixels[..., [number - first for number in channels]])
        return np.ascontiguousarray(self._whole(part)[..., list(channels)])

    def read_into(self, layer: Layer, channels: Sequence[int], window: Window, outside: float) -> NDArray[np.float32]:
        """Channels of a layer as they lie in a window, height x width x len(channels); `outside` where it has none."""
        return lay(self.read(layer.part, channels), layer.window, window, outside)

    def _whole(self, part: int) -> NDArray[np.float32]:
        # All channels of a part are decompressed together, so the layers of one part are read in one go.
        if self._kept is None or self._kept[0] != part:
            count = self.parts[part].nchannels
            self._kept = part, self._checked(self.input.read_image(part, 0, 0, count, oiio.FLOAT))
        return self._kept[1]

    def bands(self, part: int) -> Iterator[tuple[int, NDArray[np.float32]]]:
        """A part from top to bottom, all channels: (first row, rows x width x channels), float32."""
        spec = self.parts[part]
        self.input.seek_subimage(part, 0)
        if spec.tile_width:
            yield 0, self.read(part, range(spec.nchannels))
            return
        for row in range(0, spec.height, BAND):
            last = min(row + BAND, spec.height)
            rows = self.input.read_scanlines(
                part, 0, spec.y + row, spec.y + last, spec.z, 0, spec.nchannels, oiio.FLOAT
            )
            yield row, self._checked(rows).reshape(last - row, spec.width, spec.nchannels)

    def _checked(self, pixels: NDArray[Any] | None) -> NDArray[np.float32]:
        if pixels is None:
            raise ImageError(f"{self.path}: damaged: {why(self.input)}")
        return pixels


def _open(path: Path) -> oiio.ImageInput:
    if not path.is_file():
        raise ImageError(f"{path}: no such file" if not path.exists() else f"{path}: is not a file")
    if not os.access(path, os.R_OK):
        raise ImageError(f"{path}: may not be read (permission denied)")
    try:
        opened = oiio.ImageInput.open(as_text(path), _UPRIGHT)
    except ValueError as error:
        raise ImageError(str(error)) from error
    if opened is None:
        raise ImageError(f"{path}: not a picture that can be read: {why()}")
    return opened
