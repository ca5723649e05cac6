"""Display values as PNG and JPEG files."""

from collections.abc import Sequence
from io import BytesIO
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from pathfold.images import replacing

ERROR_GAIN = 4  # FLIP errors of denoised pictures are small; the map is white from 1/4 on


def error_map(errors: NDArray[Any]) -> NDArray[Any]:
    """FLIP errors (height x width, in [0, 1]) as display values, ERROR_GAIN times as large."""
    from matplotlib import colormaps

    mapped: NDArray[Any] = colormaps["magma"](ERROR_GAIN * errors)[..., :3]
    return mapped


def png(pixels: NDArray[Any]) -> bytes:
    """Display values (height x width x 3 in [0, 1]) as a PNG file in memory."""
    return _encoded(pixels, "png")


def _encoded(pixels: NDArray[Any], kind: str, **options: Any) -> bytes:
    from matplotlib.image import imsave

    buffer = BytesIO()
    imsave(buffer, (np.clip(pixels, 0, 1) * 255 + 0.5).astype(np.uint8), format=kind, **options)
    return buffer.getvalue()


def save_sheet(path: Path, pictures: Sequence[Path], columns: int = 3) -> None:
    """Write a JPEG of pictures of one size side by side, in rows of three, in their order."""
    from matplotlib.image import imread

    tiles = [imread(picture)[..., :3] for picture in pictures]
    tiles += [np.zeros_like(tiles[0])] * (-len(tiles) % columns)
    rows = [np.concatenate(tiles[i : i + columns], 1) for i in range(0, len(tiles), columns)]
    with replacing(path) as unfinished:
        unfinished.write_bytes(jpeg(np.concatenate(rows, 0), 90))


def jpeg(pixels: NDArray[Any], quality: int) -> bytes:
    """Display values (height x width x 3 in [0, 1]) as a JPEG file in memory."""
    return _encoded(pixels, "jpeg", pil_kwargs={"quality": quality})


def write_png(path: Path, pixels: NDArray[Any]) -> None:
    """Display values, height x width x 3, or height x width of grey, as an 8-bit file."""
    grey = pixels if pixels.ndim == 3 else np.repeat(pixels[..., None], 3, -1)
    with replacing(path) as unfinished:
        unfinished.write_bytes(png(grey))
