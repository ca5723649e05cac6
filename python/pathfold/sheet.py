"""A contact sheet of a file's layers: a thumbnail of each, with its name and what it was taken for."""

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cache
from pathlib import Path
from typing import Any

import numpy as np
import OpenImageIO as oiio  # noqa: N813
from numpy.typing import NDArray

from pathfold.channels.convert import encoded
from pathfold.channels.presets import FARTHEST
from pathfold.images import OutputError, check_writable, replacing, why

UNUSED = "unused"
_WIDTH, _GAP, _LINE, _MARGIN, _COLUMNS = 320, 20, 22, 32, 4
_LABEL = 3 * _LINE + 10  # height of what stands below a thumbnail
_BOLD, _PLAIN = "DroidSans-Bold", "DroidSans"
_PAPER, _BLANK, _CARD, _INK, _FAINT = (
    (0.085, 0.09, 0.105),
    (0.105, 0.11, 0.13),
    (0.13, 0.14, 0.16),
    (0.93, 0.93, 0.94),
    (0.58, 0.6, 0.64),
)
_BEAUTY, _GUIDE, _GREY, _NOT_FINITE = (0.95, 0.72, 0.25), (0.36, 0.75, 0.72), (0.5, 0.52, 0.56), (1.0, 0.0, 0.8)
_TINTS = {"color": _BEAUTY, UNUSED: _GREY}  # any other role is a guide
_SHOWN_AS = {"color": "light", "diffuse": "light", "specular": "light", "depth": "depth", "normal": "vector"}


Pixels = NDArray[Any]


@dataclass(frozen=True)
class Tile:
    """One layer on the sheet."""

    pixels: NDArray[np.float32] | None  # height x width x channels, as read; None where they cannot be read
    role: str  # the buffer that it is, several with commas, or UNUSED
    name: str
    notes: str = ""

    @property
    def kind(self) -> str:
        """How it is shown: by its role, or, where it has none, by its values."""
        role = self.role.split(", ")[0]
        if role.endswith("variance"):
            return "variance"
        if role != UNUSED or self.pixels is None:
            return _SHOWN_AS.get(role, "reflectance")
        if (self.pixels < -0.05).any():
            return "vector"
        return "depth" if self.pixels.shape[-1] == 1 else "light"


def check(path: Path) -> None:
    """Raise OutputError now, not after reading, where a sheet could not be written to `path`."""
    if path.suffix.lower() not in (".png", ".jpg", ".jpeg"):
        raise OutputError(f"{path}: a sheet is a PNG or JPEG; name it {path.with_suffix('.png').name}")
    check_writable(path)


def write(path: Path, title: str, subtitle: str, tiles: Sequence[Tile]) -> None:
    """Write the sheet. Raises OutputError where that cannot be done."""
    sheet = _draw(title, subtitle, tiles)
    with replacing(path) as unfinished:
        if not sheet.write(str(unfinished)):
            raise OutputError(f"{path}: cannot be written: {why(sheet)}")


def thumbnail(tile: Tile, width: int = _WIDTH) -> Pixels:
    """Display values, height x `width` x 3, of a layer; pixels that are not finite are pink."""
    if tile.pixels is None:
        return np.full((width * 9 // 16, width, 3), _BLANK)
    rows, columns = tile.pixels.shape[:2]
    height = min(max(1, round(width * rows / columns)), 2 * width)
    step = max(1, min(columns // (2 * width), rows // (2 * height)))
    sparse = np.asarray(tile.pixels[::step, ::step], np.float64)
    finite = np.asarray(np.isfinite(sparse).all(-1))[..., None]
    seen = _SHOWN[tile.kind](np.where(finite, sparse, 0))
    seen = np.where(finite, np.clip(np.broadcast_to(seen, (*seen.shape[:2], 3)), 0, 1), _NOT_FINITE)
    small = oiio.ImageBufAlgo.resize(_buffer(seen), "box", 0.0, oiio.ROI(0, width, 0, height))
    return np.asarray(small.get_pixels(), np.float64)


def _light(pixels: Pixels) -> Pixels:
    """Exposed so that nine in ten lit pixels are below white, then bent as for a display."""
    bright = pixels.max(-1)
    lit = bright[bright > 0]
    return _reflectance(pixels * (0.75 / max(np.percentile(lit, 90), 1e-30) if lit.size else 1.0))


def _reflectance(pixels: Pixels) -> Pixels:
    return np.asarray(np.clip(pixels, 0, 1) ** (1 / 2.2))


def _vector(pixels: Pixels) -> Pixels:
    """0.5 n + 0.5, black where there is none; lengths above 1 are scaled."""
    scale = max(1.0, float(np.percentile(np.abs(pixels), 99)))
    shown = pixels if encoded(pixels) else 0.5 * pixels / scale + 0.5
    return np.where((pixels != 0).any(-1, keepdims=True), shown, 0)


def _depth(pixels: Pixels) -> Pixels:
    """Near is bright, far is dark, nothing is black."""
    hit = (pixels > 0) & (pixels < FARTHEST)
    if not hit.any():
        return np.zeros_like(pixels)
    near, far = np.percentile(pixels[hit], (1, 99))
    return np.where(hit, 1 - 0.85 * np.clip((pixels - near) / max(far - near, 1e-30), 0, 1), 0)


_SHOWN = {
    "light": _light,
    "reflectance": _reflectance,
    "vector": _vector,
    "depth": _depth,
    "variance": lambda pixels: _light(np.sqrt(np.maximum(pixels, 0))),
}


def _draw(title: str, subtitle: str, tiles: Sequence[Tile]) -> Any:
    """The whole sheet as one image."""
    columns = max(2, min(_COLUMNS, len(tiles)))
    pictures = [thumbnail(tile) for tile in tiles]
    rows = [range(first, min(first + columns, len(tiles))) for first in range(0, len(tiles), columns)]
    heights = [max(pictures[at].shape[0] for at in row) + _LABEL for row in rows]
    width = 2 * _MARGIN + columns * (_WIDTH + _GAP) - _GAP
    top = _MARGIN + 3 * _LINE
    sheet = oiio.ImageBuf(oiio.ImageSpec(width, top + sum(heights) + _GAP * len(rows) + _GAP // 2, 3, "uint8"))
    oiio.ImageBufAlgo.fill(sheet, _PAPER)
    _text(sheet, (_MARGIN, _MARGIN + 22), title, 24, _INK, _BOLD, width - 2 * _MARGIN)
    _text(sheet, (_MARGIN, _MARGIN + 48), subtitle, 14, _FAINT, _PLAIN, width - 2 * _MARGIN)
    for row, height in zip(rows, heights, strict=True):
        for column, at in enumerate(row):
            _card(sheet, _MARGIN + column * (_WIDTH + _GAP), top, height, pictures[at], tiles[at])
        top += height + _GAP
    return sheet


def _card(sheet: Any, left: int, top: int, height: int, picture: Pixels, tile: Tile) -> None:
    tint = _TINTS.get(tile.role.split(", ")[0], _GUIDE)
    bottom = top + height - _LABEL
    _fill(sheet, left, top, height, _CARD)
    oiio.ImageBufAlgo.paste(sheet, left, top + (height - _LABEL - picture.shape[0]) // 2, 0, 0, _buffer(picture))
    _fill(sheet, left, bottom, 3, tint)
    if tile.pixels is None:
        _text(sheet, (left + 10, (top + bottom) // 2), "cannot be read", 14, _GREY, _PLAIN, _WIDTH - 20)
    for line, (text, size, ink, font) in enumerate(
        ((tile.role, 17, tint, _BOLD), (tile.name, 16, _INK, _PLAIN), (tile.notes, 13, _FAINT, _PLAIN))
    ):
        _text(sheet, (left + 10, bottom + 24 + line * _LINE), text, size, ink, font, _WIDTH - 20)


def _text(sheet: Any, at: tuple[int, int], text: str, size: int, ink: Sequence[float], font: str, width: int) -> None:
    """A line of text from its lower left corner, its middle left out where it is too long."""
    shown, kept = text, len(text)
    while kept > 8 and _extent(shown, size, font) > width:
        kept -= 1
        shown = f"{text[: kept // 2]}...{text[len(text) - kept + kept // 2 :]}"
    if shown and not oiio.ImageBufAlgo.render_text(sheet, *at, shown, size, font, ink):
        raise OutputError("the sheet needs an OpenImageIO that writes text (FreeType); install that of PyPI")


@cache
def _extent(text: str, size: int, font: str) -> int:
    return int(oiio.ImageBufAlgo.text_size(text, size, font).width)


def _fill(sheet: Any, left: int, top: int, height: int, ink: Sequence[float]) -> None:
    oiio.ImageBufAlgo.fill(sheet, ink, roi=oiio.ROI(left, left + _WIDTH, top, top + height))


def _buffer(picture: Pixels) -> Any:
    return oiio.ImageBuf(np.ascontiguousarray(picture, np.float32))
