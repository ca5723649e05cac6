"""Crops magnified as if the camera had had more pixels, made of the samples that are stored.

Pictures to denoise have many more pixels than training views, so that what they show is smoother from pixel to pixel.
A pixel between four stored ones takes each of its samples from one of these, drawn with the weight of bilinear
interpolation: its expectation is just the interpolated reference, and its noise its own while stored samples suffice.
Edges become ramps as wide as a stored pixel, so only what is smooth or out of focus looks as in a larger picture.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor

Places = NDArray[np.intp]

MOST = 3.0  # times as large: one described sample of a pixel then takes 9 of the 16 that a stored pixel has
SHARE = 0.6  # of a stored pixel's samples that are used in the mean, since some are drawn from more often


@dataclass
class Axis:
    """Where the pixels of a magnified crop lie between stored ones, along one axis: `first` and `share` of the next."""

    first: Places
    share: NDArray[np.float64]

    @staticmethod
    def draw(size: int, side: int, factor: float, rng: np.random.Generator) -> Axis:
        """`size` pixels, `factor` of them to a stored one, anywhere inside `side` stored ones."""
        where = rng.uniform(0.0, side - 1 - (size - 1) / factor) + np.arange(size) / factor
        first = np.minimum(where.astype(np.intp), side - 2)
        return Axis(first, where - first)

    def weights(self, side: int) -> Tensor:
        """size x side, bilinear."""
        rows, out = np.arange(len(self.first)), np.zeros((len(self.first), side), np.float32)
        out[rows, self.first], out[rows, self.first + 1] = 1.0 - self.share, self.share
        return torch.from_numpy(out)


def stored_side(size: int, factor: float) -> int:
    """The stored pixels along a side that a magnified crop of `size` needs at least."""
    return int(np.ceil((size - 1) / factor)) + 2


def enough(stored: int, factor: float) -> int:
    """The most samples of a pixel, at least 1, that the `stored` ones of each pixel suffice for."""
    return max(1, int(SHARE * stored / factor**2))


class Magnifier:
    """What `count` samples of each of `size` x `size` pixels are, out of a window of `side` x `side` stored pixels.

    A stored pixel, of `samples`, is `factor` pixels wide. `pixels`, count x size x size, is the number of the stored
    pixel that each sample comes from, row by row; `slots`, of the same shape, is which of that pixel's samples it is:
    each in turn, and from the first again where there are too few. The first `paths` samples of a pixel need
    descriptors, which are stored of the first `described`.
    """

    def __init__(
        self,
        size: int,
        side: int,
        factor: float,
        count: int,
        paths: int,
        samples: int,
        described: int,
        rng: np.random.Generator,
    ) -> None:
        self.side = side
        self.y, self.x = (Axis.draw(size, side, factor, rng) for _ in range(2))
        rows = self.y.first[:, None] + (rng.random((count, size, size)) < self.y.share[:, None])
        self.pixels = rows * side + self.x.first + (rng.random((count, size, size)) < self.x.share)
        slots = turns(self.pixels.ravel()).reshape(self.pixels.shape)
        slots[:paths] %= described
        slots[paths:] %= samples
        self.slots = slots

    def samples(self, stored: Tensor, count: int) -> Tensor:
        """The first `count` samples of each pixel, count x C x size x size, of those stored, S x C x side x side."""
        places = torch.from_numpy(self.slots[:count] * self.side**2 + self.pixels[:count])
        return stored.movedim(1, -1).reshape(-1, stored.shape[1])[places].movedim(-1, 1).contiguous()

    def image(self, stored: Tensor) -> Tensor:
        """C x side x side interpolated to C x size x size: what the samples' mean is an estimate of."""
        return self.y.weights(self.side) @ stored @ self.x.weights(self.side).T


def turns(values: Places) -> Places:
    """How often each value has come before it."""
    order = np.argsort(values, kind="stable")
    ordered = values[order]
    starts = np.flatnonzero(np.r_[True, ordered[1:] != ordered[:-1]])
    result = np.empty_like(order)
    result[order] = np.arange(len(order)) - np.repeat(starts, np.diff(np.r_[starts, len(order)]))
    return result
