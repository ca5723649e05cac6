"""Where an albedo does not explain the light, in NumPy and float64: sdk/src/demodulation.h does the same."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]
CELL, REACH = 4, 2  # pixels, cells
RADIUS = (REACH + 1) * CELL + CELL  # pixels around that change what is made of an albedo, at most
DOUBT = 2.0  # standard errors that a slope is given
EXPLAINS = 0.5  # the slope from which on an albedo explains the light
FLOOR = 1e-4  # of relative variances: less is flat


def flatten(albedo: Array, radiance: Array, valid: NDArray[np.bool_], epsilon: float) -> Array:
    """The albedo H x W x 3, brought to its mean around a pixel where dividing by it makes the light no flatter."""
    undivided, level = doubts(albedo + epsilon, radiance, valid)
    share = spread(undivided, albedo.shape[:2])
    return np.where(share > 0, albedo + share * (spread(level, albedo.shape[:2]) - epsilon - albedo), albedo)


def doubts(factor: Array, radiance: Array, valid: NDArray[np.bool_]) -> tuple[Array, Array]:
    """By cells: how much is not to be divided, in [0, 1], and the mean factor."""
    known = valid[..., None].astype(np.float64)
    divided = known * radiance / factor
    cells = {
        "n": of_cells(known),
        "a": of_cells(known * factor),
        "aa": of_cells(known * factor**2),
        "l": of_cells(known * radiance),
        "ll": of_cells(known * radiance**2),
        "al": of_cells(known * factor * radiance),
        "d": of_cells(divided),
        "dd": of_cells(divided**2),
    }
    sums = {name: around(values) for name, values in cells.items()}
    n = np.maximum(sums["n"], 1.0)
    mean = {name: values / n for name, values in sums.items()}
    a, light = np.where(mean["a"] > 0, mean["a"], 1.0), mean["l"]
    scale = np.maximum(light, 0.05 * light.mean(-1, keepdims=True))
    lit = scale > 0
    scale = np.where(lit, scale, 1.0)
    # sum over channels of (a/ma - 1)^2, and of (a/ma - 1)(l/s - ml/s), by windows
    spread_a = (mean["aa"] / a**2 - np.where(mean["a"] > 0, 1.0, 0.0)).clip(0).sum(-1, keepdims=True)
    # excess of each cell over what a slope of 1 would say, about the window's means
    total, squares, count = np.zeros_like(spread_a), np.zeros_like(spread_a), np.zeros_like(spread_a)
    for dy in range(-REACH, REACH + 1):
        for dx in range(-REACH, REACH + 1):
            c = {name: shifted(values, dy, dx) for name, values in cells.items()}
            follows = (c["al"] - a * c["l"] - light * c["a"] + c["n"] * a * light) / (a * scale)
            varies = (c["aa"] - 2 * a * c["a"] + c["n"] * a**2) / a**2
            excess = np.where(lit, follows - varies, 0.0).sum(-1, keepdims=True)
            total, squares = total + excess, squares + excess**2
            count = count + (c["n"] > 0)
    excess = total / n
    deviation = np.sqrt(np.maximum(squares - total**2 / np.maximum(count, 1), 0)) / n
    slope = 1 + (excess + DOUBT * deviation) / (spread_a + FLOOR)
    unexplained = np.clip((EXPLAINS - slope) / EXPLAINS, 0, 1)
    worse = (relative(mean["d"], mean["dd"]) + FLOOR) / (relative(mean["l"], mean["ll"]) + FLOOR)
    return unexplained * np.clip(np.log2(worse), 0, 1), mean["a"]


def relative(mean: Array, square: Array) -> Array:
    """Variance over the squared mean, of all channels."""
    variance = np.maximum(square - mean**2, 0).sum(-1, keepdims=True)
    level = (mean**2).sum(-1, keepdims=True)
    return np.where(level > 0, variance / np.where(level > 0, level, 1.0), 0.0)


def of_cells(values: Array) -> Array:
    """Sums over cells of 4 x 4 pixels."""
    height, width, channels = values.shape
    down, across = -(-height // CELL), -(-width // CELL)
    whole = np.pad(values, ((0, down * CELL - height), (0, across * CELL - width), (0, 0)))
    return whole.reshape(down, CELL, across, CELL, channels).sum((1, 3))


def shifted(cells: Array, dy: int, dx: int) -> Array:
    """The cell so many rows and columns further, 0 beyond the frame."""
    height, width, _ = cells.shape
    whole = np.pad(cells, ((REACH, REACH), (REACH, REACH), (0, 0)))
    return whole[REACH + dy : REACH + dy + height, REACH + dx : REACH + dx + width]


def around(cells: Array) -> Array:
    """Sums over 5 x 5 cells."""
    offsets = range(-REACH, REACH + 1)
    return np.sum([shifted(cells, dy, dx) for dy in offsets for dx in offsets], 0)


def spread(cells: Array, size: tuple[int, int]) -> Array:
    """Cells' values at pixels, linear between the cells' centres."""
    for axis in (0, 1):
        at = np.clip((np.arange(size[axis]) + 0.5) / CELL - 0.5, 0, cells.shape[axis] - 1)
        low = np.floor(at).astype(int)
        high = np.minimum(low + 1, cells.shape[axis] - 1)
        part = (at - low).reshape([-1 if k == axis else 1 for k in range(3)])
        cells = (1 - part) * cells.take(low, axis) + part * cells.take(high, axis)
    return cells
