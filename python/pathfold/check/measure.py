"""How far two images are apart, and how far they may be."""

from __future__ import annotations

import tomllib
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

_TABLE = tomllib.loads((Path(__file__).parent / "tolerances.toml").read_text(encoding="utf-8"))
SMALLEST = float(np.finfo(np.float32).tiny)  # below it float32 has no seven digits
LEAST_SUM = 1e6 * SMALLEST  # nor have products with the pyramid's least weights, exp(-14)


def tolerance(name: str, precision: str = "fp32") -> float:
    """A value of tolerances.toml, "chain.fp32" or "tiles"; of "tiles" in int8 that of "tiles.int8" where there is one.

    Raises KeyError where the table has none.
    """
    entry: Any = _TABLE
    for key in name.split("."):
        entry = entry[key]
    return float(entry.get(precision, entry)["value"])


def relative_error(
    image: NDArray[Any], reference: NDArray[Any], largest: float = 0.0, deepest: float = 0.0
) -> tuple[float, tuple[int, int] | None]:
    """The largest relative error of any value, and its pixel (y, x); None where all are equal.

    Each value is measured against its own reference: a weighted mean of values >= 0 amplifies no rounding. `largest` is
    the brightest that any tap may hold: float32 weights below 1e-38 are 0, so 1e-30 of it is nothing. `deepest` is how
    far below 0 one may lie: what cancels leaves its rounding. Infinite where a value is not finite.
    """
    right = reference.astype(np.float64)
    floor = max(LEAST_SUM, 1e-30 * largest, deepest)
    with np.errstate(invalid="ignore"):
        error = np.abs(image.astype(np.float64) - right) / np.maximum(np.abs(right), floor)
    error = np.where(np.isfinite(error), error, np.inf).max(-1)
    worst = np.unravel_index(int(error.argmax()), error.shape)
    return float(error[worst]), None if error[worst] == 0 else (int(worst[0]), int(worst[1]))


def drift(image: NDArray[Any], reference: NDArray[Any]) -> float:
    """The mean relative difference of two images' values, each to the larger of both: from 0 to 2, dark or bright.

    Infinite where a value is not finite.
    """
    one, other = image.astype(np.float64), reference.astype(np.float64)
    with np.errstate(invalid="ignore"):
        difference = np.abs(one - other) / np.maximum(np.maximum(np.abs(one), np.abs(other)), SMALLEST)
    return float(difference.mean()) if np.isfinite(difference).all() else np.inf
