"""What makes a view not worth having: it sees nothing, it is black, blown out or flat, or it is there already."""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

Vector = NDArray[np.float64]
THUMB = 16  # pictures are compared as THUMB x THUMB block means
SAME = 0.95  # correlation from which two count as one: unlike views stay below 0.86, one moved by 2 % is near 0.98


class RejectedError(Exception):
    """No acceptable view was found; the text says why."""


class Survey(NamedTuple):
    """What camera rays hit: points [N, 3], distances [N] (infinite on a miss), ids of shapes [N]."""

    points: Vector
    distance: Vector
    shape: NDArray[np.uint32]


def geometry_fault(seen: Survey) -> str | None:
    """Why the view is not worth rendering, from the distances and shapes alone."""
    hit = np.isfinite(seen.distance)
    if hit.mean() < 0.4:
        return "sees nothing"
    middle = np.median(seen.distance[hit])
    if (seen.distance[hit] < 0.15 * middle).mean() > 0.2:
        return "something before the lens"
    share = np.sort(np.bincount(np.unique(seen.shape, return_inverse=True)[1]))[::-1] / len(hit)
    if share[0] > 0.9 or (share > 0.004).sum() < 3:
        return "one surface only"
    count = np.unique(seen.shape[hit], return_counts=True)[1]
    if share[0] > 0.65 and (count.sum() - count.max()) < 0.1 * len(hit):
        return "little to see"
    spread = np.percentile(seen.distance[hit], [5, 95])
    if spread[1] < 1.15 * spread[0]:
        return "looks into a wall"
    return None


def picture_fault(color: NDArray[np.float32], may_be_flat: bool = False) -> str | None:
    """Why a rendered view [H, W, 3] is refused: black, blown out or flat; noise is averaged away in blocks of 8."""
    luminance = np.nan_to_num(color.astype(np.float64) @ [0.2126, 0.7152, 0.0722])
    height, width = (n // 8 * 8 for n in luminance.shape)
    blocks = luminance[:height, :width].reshape(height // 8, 8, width // 8, 8).mean((1, 3))
    if blocks.mean() < 1e-5:
        return "black"
    exposed = 0.18 * blocks / np.exp(np.log(np.maximum(blocks, 1e-3 * blocks.mean())).mean())
    tone = (exposed / (1 + exposed)) ** (1 / 2.2)
    if (tone > 0.93).mean() > 0.4:
        return "blown out"
    if (blocks < 0.03 * blocks.mean()).mean() > 0.4:
        return "black"
    if tone.std() < 0.04 and not may_be_flat:
        return "flat"
    return None


class Gallery:
    """The pictures of a data set: whether another one would add anything."""

    def __init__(self) -> None:
        self._names: list[str] = []
        self._thumbs: list[NDArray[np.float32]] = []

    def add(self, name: str, color: NDArray[Any]) -> None:
        """Takes up a view's reference [3, H, W], linear."""
        self._names.append(name)
        self._thumbs.append(thumb(color))

    def fault(self, color: NDArray[Any], may_be_flat: bool = False) -> str | None:
        """Why this view is refused: a fault of its own, or the name of the view that it repeats."""
        reason = picture_fault(np.moveaxis(color, 0, -1), may_be_flat)
        if reason is None and self._thumbs:
            likeness = np.stack(self._thumbs) @ thumb(color)
            nearest = int(likeness.argmax())
            if likeness[nearest] > SAME:
                reason = f"repeats {self._names[nearest]} (correlation {likeness[nearest]:.3f})"
        return reason


def thumb(color: NDArray[Any]) -> NDArray[np.float32]:
    """A unit vector of THUMB^2 numbers: log luminance of [3, H, W] in blocks, less its mean."""
    luminance = np.tensordot([0.2126, 0.7152, 0.0722], np.nan_to_num(color.astype(np.float64)), 1)
    for axis in (0, 1):
        edges = np.linspace(0, luminance.shape[axis], THUMB + 1)[:-1].astype(int)
        size = np.diff(np.append(edges, luminance.shape[axis])).clip(1)
        luminance = np.add.reduceat(luminance, edges, axis) / np.expand_dims(size, 1 - axis)
    tone = np.log(np.maximum(luminance, 1e-3 * luminance.mean() + 1e-30))
    tone = tone - tone.mean()
    return (tone / max(float(np.linalg.norm(tone)), 1e-9)).astype(np.float32).ravel()
