"""Where camera samples land: pixel positions drawn in proportion to the film's reconstruction filter."""

from __future__ import annotations

from typing import Any

import drjit as dr
import mitsuba as mi
import numpy as np

TABLE = 513


class Film:
    """Size of a sensor's film, and its filter as a sampling distribution: a sample belongs to one pixel."""

    def __init__(self, camera: Any) -> None:
        film = camera.film()
        self.width, self.height = (int(n) for n in film.crop_size())
        self.pixels = self.width * self.height
        if self.pixels == 0:
            raise ValueError(f"the film is {self.width}x{self.height} pixels; give it a size above zero")
        self._filter = film.rfilter()
        self._radius = float(self._filter.radius())
        self._table = None if self._filter.is_box_filter() else self._tabulate()

    def _tabulate(self) -> Any:
        offsets = np.linspace(-self._radius, self._radius, TABLE, dtype=np.float32)
        weights = np.array(self._filter.eval(mi.Float(offsets)))
        if weights.min() < -1e-4 * weights.max():
            raise NotImplementedError(
                f"film filter {self._filter.class_name()} has negative lobes and cannot be sampled; "
                "use box, tent or gaussian"
            )
        extent = mi.ScalarVector2f(-self._radius, self._radius)
        return mi.ContinuousDistribution(extent, mi.Float(np.maximum(weights, 0)))

    def sample(self, uniform: Any) -> Any:
        """Map a uniform 2D sample to an offset in pixels from the pixel centre."""
        if self._table is None:
            return (uniform - 0.5) * (2 * self._radius)
        return mi.Point2f(self._table.sample(uniform.x), self._table.sample(uniform.y))

    def place(self, pixel: Any, offset: Any) -> Any:
        """Return the film position in [0, 1]^2 of a pixel index and an offset."""
        width, height = opaque(self.width), opaque(self.height)
        row = pixel // width
        centre = mi.Point2f(mi.Float(pixel - row * width), mi.Float(row)) + 0.5
        return (centre + offset) / mi.Point2f(mi.Float(width), mi.Float(height))


def opaque(number: int) -> Any:
    """Hide a number from the compiler, so that kernels are not compiled again for another one."""
    return dr.opaque(mi.UInt32, number)
