"""Where camera samples land: pixel positions drawn in proportion to the film's reconstruction filter."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import drjit as dr
import mitsuba as mi
import numpy as np

TABLE = 513


@dataclass(frozen=True)
class Film:
    """Size of a sensor's film, and its filter as a sampling distribution: a sample belongs to one pixel."""

    width: int
    height: int
    radius: float
    table: Any  # None for a box

    @staticmethod
    def of(camera: Any) -> Film:
        """The film of a sensor. Raises ValueError and NotImplementedError, which name what it lacks."""
        film = camera.film()
        width, height = (int(n) for n in film.crop_size())
        if width * height == 0:
            raise ValueError(f"the film is {width}x{height} pixels; give it a size above zero")
        box = film.rfilter().is_box_filter()
        return Film(width, height, float(film.rfilter().radius()), None if box else tabulate(film.rfilter()))

    @property
    def pixels(self) -> int:
        return self.width * self.height

    def sample(self, uniform: Any) -> Any:
        """Map a uniform 2D sample to an offset in pixels from the pixel centre."""
        if self.table is None:
            return (uniform - 0.5) * (2 * self.radius)
        return mi.Point2f(self.table.sample(uniform.x), self.table.sample(uniform.y))

    def place(self, pixel: Any, offset: Any) -> Any:
        """Return the film position in [0, 1]^2 of a pixel index and an offset."""
        width, height = opaque(self.width), opaque(self.height)
        row = pixel // width
        centre = mi.Point2f(mi.Float(pixel - row * width), mi.Float(row)) + 0.5
        return (centre + offset) / mi.Point2f(mi.Float(width), mi.Float(height))


def tabulate(kernel: Any) -> Any:
    """A reconstruction filter as a distribution. Raises NotImplementedError for one that is negative somewhere."""
    radius = float(kernel.radius())
    weights = np.array(kernel.eval(mi.Float(np.linspace(-radius, radius, TABLE, dtype=np.float32))))
    if weights.min() < -1e-4 * weights.max():
        raise NotImplementedError(
            f"film filter {kernel.class_name()} has negative lobes and cannot be sampled; use box, tent or gaussian"
        )
    return mi.ContinuousDistribution(mi.ScalarVector2f(-radius, radius), mi.Float(np.maximum(weights, 0)))


def opaque(number: int) -> Any:
    """Hide a number from the compiler, so that kernels are not compiled again for another one."""
    return dr.opaque(mi.UInt32, number)
