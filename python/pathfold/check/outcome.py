"""The outcome of one case or property, and what is looked at in every result."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np

from pathfold.check.measure import SMALLEST, relative_error, tolerance
from pathfold.check.prepare import Array, Branch, Prepared, window_limits
from pathfold.denoiser import Result

CLEANING_RADIUS = 14  # pixels that a pyramid of three levels reaches: two of its coarsest cells, and 6 by upsampling


@dataclass
class Row:
    """`error` is the largest relative one, None where nothing is compared; `reason` says why it fails."""

    name: str
    stresses: str
    error: float | None = None
    allowed: float | None = None
    worst: tuple[int, int] | None = None  # pixel y, x
    finite: bool = True
    bounded: bool = True  # before remodulation, between the least and the largest of the window
    reason: str = ""

    def fail(self, reason: str) -> None:
        self.reason = f"{self.reason}; {reason}" if self.reason else reason

    def compare(self, image: Any, right: Any, largest: float = 0.0, deepest: float = 0.0) -> None:
        """Keep the largest relative error of several images; `largest` and `deepest` as in relative_error."""
        error, worst = relative_error(image, right, largest, deepest)
        if self.error is None or error > self.error:
            self.error, self.worst = error, worst

    def inspect(self, result: Result, frame: Prepared, manifest: dict[str, Any]) -> None:
        """Whether a result is finite, bounded by its window and made without falling back to noisy pixels."""
        images = [image for image in (result.color, result.diffuse, result.specular) if image is not None]
        if not all(bool(np.isfinite(image).all()) for image in images):
            self.finite = False
        if not bounded(result, frame, manifest):
            self.bounded = False
        if repaired := result.report["repaired"]:
            self.fail(f"the network gave {repaired} values no finite kernel")

    def judged(self) -> Row:
        """The row, with the reasons that follow from its figures."""
        if not self.finite:
            self.fail("not finite")
        if not self.bounded:
            self.fail("outside of its window's least and largest value")
        if self.error is not None and self.allowed is not None and not self.error <= self.allowed:
            self.fail(f"error above {self.allowed:g}")
        return self


def bounded(result: Result, frame: Prepared, manifest: dict[str, Any]) -> bool:
    """Whether each branch's result, before remodulation, lies within the least and largest value of its window.

    Where the factor is cleaned, what divides and multiplies lies within a window of its own in turn.
    """
    split = len(frame.branches) > 1
    for branch in frame.branches:
        image = getattr(result, branch.buffer) if split else result.color
        least, most = factor_limits(branch, frame)
        radius = window_radius(manifest)
        divided = branch.radiance / least, branch.radiance / most  # below 0 the smaller factor takes further down
        low, _ = window_limits(np.minimum(*divided), frame.valid, radius)
        _, high = window_limits(np.maximum(*divided), frame.valid, radius)
        slack = tolerance("bounded") * np.maximum(np.abs(low), np.abs(high)) + SMALLEST
        with np.errstate(invalid="ignore"):
            above = np.maximum(image / least, image / most) >= low - slack
            if not (above & (np.minimum(image / least, image / most) <= high + slack)).all():
                return False
    return True


def factor_limits(branch: Branch, frame: Prepared) -> tuple[Array, Array]:
    """Least and largest of what a branch's result may have been multiplied by, H x W x 3."""
    if not branch.clean:
        return branch.factor, branch.factor
    low, high = window_limits(branch.factor, frame.valid, CLEANING_RADIUS)
    return np.where(low > 0, np.minimum(low, branch.factor), branch.factor), np.maximum(high, branch.factor)


def window_radius(manifest: dict[str, Any]) -> int:
    """Pixels that a result's weighted mean reaches: a gather's own radius, else all that a pixel depends on."""
    block = manifest["reconstruction"]
    plain = block["operator"] == "gather" and "levels" not in block
    return int(block["size"] // 2 if plain else manifest["tile"]["overlap"])
