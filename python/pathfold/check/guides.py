"""What the SDK makes of guides and variances before it uses them, written again in NumPy: sdk/src/guides.cpp."""

from __future__ import annotations

from typing import Literal, NamedTuple

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]
VARIANCES = ("variance", "diffuse.variance", "specular.variance")


class Meaning(NamedTuple):
    """The range of a buffer's values and what stands for those that are not known."""

    least: float
    most: float
    missing: Literal["zero", "mean", "most"]
    open: bool  # what lies above is not known either, else it is clamped


MEANINGS = {
    "albedo": Meaning(0.0, 1.0, "mean", False),
    "diffuse.albedo": Meaning(0.0, 1.0, "mean", False),
    "normal": Meaning(-1.0, 1.0, "zero", False),
    "depth": Meaning(0.0, 1e9, "zero", True),
} | {name: Meaning(0.0, float(np.float32(1e36)), "most", True) for name in VARIANCES}


def clean(values: Array, name: str) -> Array:
    """A guide or variance, H x W x C, within its range and whole."""
    known = within_range(values, name)
    if np.isnan(known).any():
        known = filled(known, MEANINGS[name].missing)
    return decoded(known) if name == "normal" and is_encoded(known) else known


def says_nothing(values: Array, name: str) -> bool:
    """Whether a guide or variance is the same in every pixel, or not known in any, a variance in most."""
    known = within_range(values, name).reshape(-1, values.shape[-1])
    unknown = np.isnan(known)
    if unknown.all(0).any() or (name in VARIANCES and 2 * unknown.any(1).sum() > len(known)):
        return True
    return bool((np.nanmin(known, 0) == np.nanmax(known, 0)).all())


def within_range(values: Array, name: str) -> Array:
    """What is not known is 0 or, where its neighbours stand for it, NaN."""
    least, most, missing, is_open = MEANINGS[name]
    unknown = ~np.isfinite(values) | (is_open & (values > most))
    return np.where(unknown, 0.0 if missing == "zero" else np.nan, np.clip(values, least, most))


def filled(values: Array, missing: str) -> Array:
    """Each NaN from the least area of 3 x 3 cells of 1, 2, 4, ... pixels around that holds a value; 1 without any."""
    result = values.copy()
    for y, x, channel in np.argwhere(np.isnan(values)):
        side = 1
        while True:
            top, left = ((at // side - 1) * side for at in (y, x))
            area = values[max(top, 0) : top + 3 * side, max(left, 0) : left + 3 * side, channel]
            known = area[~np.isnan(area)]
            if known.size or side > max(values.shape):
                break
            side *= 2
        result[y, x, channel] = 1.0 if not known.size else known.max() if missing == "most" else known.mean()
    return result


def is_encoded(normal: Array) -> bool:
    """Whether normals are stored as 0.5 n + 0.5: so read none is longer than a unit vector, and some are as long."""
    square, code = (normal**2).sum(-1), ((2 * normal - 1) ** 2).sum(-1)
    hit = (square > 0.01) & (code > 0.01)
    hits, plain = int(hit.sum()), (hit & (square > 0.9**2) & (square < 1.1**2)).sum()
    near, longer = (hit & (code > 0.9**2)).sum(), (hit & (code > 1.05**2)).sum()
    few_signed = 1000 * (normal.min(-1) < -0.01).sum() <= hit.size
    return bool(few_signed and hits and 100 * longer <= hits <= 5 * near and 10 * plain < 9 * hits)


def decoded(normal: Array) -> Array:
    return np.where((normal != 0).any(-1, keepdims=True), 2 * normal - 1, 0.0)
