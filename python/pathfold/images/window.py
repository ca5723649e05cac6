"""Where pictures lie: windows in pixel coordinates, and pixels laid from one into another."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

Image = NDArray[np.float32]


@dataclass(frozen=True)
class Window:
    """A rectangle of pixels, its corner at x, y; x to the right, y down."""

    x: int
    y: int
    width: int
    height: int

    @property
    def size(self) -> tuple[int, int]:
        """Width, height."""
        return self.width, self.height

    def __str__(self) -> str:
        return f"{self.width}x{self.height} at {self.x},{self.y}"

    def common(self, other: "Window") -> "Window | None":
        """The pixels of both; None where they have none in common."""
        x, y = max(self.x, other.x), max(self.y, other.y)
        right = min(self.x + self.width, other.x + other.width)
        bottom = min(self.y + self.height, other.y + other.height)
        return Window(x, y, right - x, bottom - y) if right > x and bottom > y else None

    def slices(self, part: "Window") -> tuple[slice, slice]:
        """Rows and columns of a part in an array over this window."""
        row, column = part.y - self.y, part.x - self.x
        return slice(row, row + part.height), slice(column, column + part.width)


def lay(pixels: Image, window: Window, into: Window, outside: float | Image) -> Image:
    """Pixels over `window` (height x width x channels) as they lie in another window, `outside` where they do not.

    `outside`: a number, or an array over `into`, which is left as it is.
    """
    if window == into and isinstance(outside, float):
        return pixels
    if isinstance(outside, float):
        laid = np.full((into.height, into.width, *pixels.shape[2:]), outside, np.float32)
    else:
        laid = outside.copy()
    if both := window.common(into):
        laid[into.slices(both)] = pixels[window.slices(both)]
    return laid
