"""One way to get a picture, with what it cost and how far it is from the reference."""

from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

METRICS = ("rell2", "smape", "ssim", "flip")
TITLES = {"rell2": "RelL2", "smape": "SMAPE", "ssim": "SSIM", "flip": "FLIP"}


@dataclass
class Method:
    """A labelled picture (height x width x 3, linear), its errors, and its times in milliseconds."""

    name: str
    image: NDArray[np.float32]
    errors: dict[str, float] = field(default_factory=dict)
    render_ms: float | None = None
    denoise_ms: float | None = None
    note: str = ""

    @property
    def total_ms(self) -> float | None:
        return None if self.render_ms is None else self.render_ms + (self.denoise_ms or 0)


def best(methods: list[Method], metric: str) -> Method | None:
    """The method with the smallest error (the greatest SSIM)."""
    measured = [method for method in methods if metric in method.errors]
    sign = -1 if metric == "ssim" else 1
    return min(measured, key=lambda method: sign * method.errors[metric], default=None)
