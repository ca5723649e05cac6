"""Error of a picture against a reference: arrays are height x width x 3, linear radiance, finite.

Smaller is better for all but SSIM. SSIM and FLIP look at the display picture (`display`), exposed as the reference
wants it or, where frames belong together, by a `scale` that they share; they need scikit-image and flip-evaluator,
which come with the `bench` extra.
"""

from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

EPSILON = 1e-2
PAPER_EPSILON, PAPER_BORDER = 1e-4, 28  # RelL2 as published for path manifolds: this epsilon, so many pixels cut off
_LUMINANCE = np.array([0.2126, 0.7152, 0.0722])
_GREY = 0.18

Image = NDArray[np.floating[Any]]


def rell2(image: ArrayLike, reference: ArrayLike, epsilon: float = EPSILON) -> float:
    """Relative squared error, mean((x - r)^2 / (r^2 + epsilon)): no trimming, no crop."""
    x, r = _pair(image, reference)
    return float(np.mean((x - r) ** 2 / (r**2 + epsilon)))


def rell2_halves(image: ArrayLike, a: ArrayLike, b: ArrayLike, epsilon: float = EPSILON) -> float:
    """Relative squared error against two independent halves of a reference.

    mean((x - a)(x - b) / (r^2 + epsilon)), r = (a + b) / 2: the reference's own noise drops out of the
    numerator. It may come out slightly negative where the picture is as good as the reference.
    """
    x, a = _pair(image, a)
    _, b = _pair(image, b)
    return float(np.mean((x - a) * (x - b) / (((a + b) / 2) ** 2 + epsilon)))


def reference_rell2(a: ArrayLike, b: ArrayLike, epsilon: float = EPSILON) -> float:
    """The error of a reference (a + b) / 2 itself, estimated from its two independent halves."""
    a, b = _pair(a, b)
    return float(np.mean(((a - b) / 2) ** 2 / (((a + b) / 2) ** 2 + epsilon)))


def cropped(image: ArrayLike, border: int = PAPER_BORDER) -> Image | None:
    """The picture without its border; None where nothing would be left."""
    x = np.asarray(image)
    return x[border:-border, border:-border] if min(x.shape[:2]) > 2 * border else None


def smape(image: ArrayLike, reference: ArrayLike, epsilon: float = EPSILON) -> float:
    """Symmetric absolute error, mean(|x - r| / (|x| + |r| + epsilon)), in [0, 1]."""
    x, r = _pair(image, reference)
    return float(np.mean(np.abs(x - r) / (np.abs(x) + np.abs(r) + epsilon)))


def ssim(image: ArrayLike, reference: ArrayLike, scale: float | None = None) -> float:
    """Structural similarity of the display pictures: scikit-image's 7 x 7 window, data range 1. 1 is equal.

    Raises ValueError for a picture smaller than the window.
    """
    try:
        from skimage.metrics import structural_similarity
    except ModuleNotFoundError as error:
        raise _missing("SSIM", "scikit-image") from error
    x, r = _pair(image, reference)
    if min(x.shape[:2]) < 7:
        raise ValueError(f"SSIM needs at least 7x7 pixels, given {x.shape[1]}x{x.shape[0]}")
    scale = exposure(r) if scale is None else scale
    return float(structural_similarity(display(x, scale), display(r, scale), data_range=1, channel_axis=2))


def flip(image: ArrayLike, reference: ArrayLike, scale: float | None = None) -> float:
    """Mean LDR-FLIP error of the display pictures at FLIP's default viewing distance."""
    return float(flip_map(image, reference, scale).mean(dtype=np.float64))


def flip_map(image: ArrayLike, reference: ArrayLike, scale: float | None = None) -> NDArray[np.float32]:
    """The FLIP error of every pixel, height x width, in [0, 1]."""
    try:
        import flip_evaluator
    except ModuleNotFoundError as error:
        raise _missing("FLIP", "flip-evaluator") from error
    x, r = _pair(image, reference)
    scale = exposure(r) if scale is None else scale
    errors = flip_evaluator.evaluate(display(r, scale), display(x, scale), "LDR", applyMagma=False)[0]
    return np.asarray(errors, np.float32).reshape(r.shape[:2])


def compare(image: ArrayLike, reference: ArrayLike, scale: float | None = None) -> dict[str, float]:
    """All four: {"rell2", "smape", "ssim", "flip"}."""
    relative = {"rell2": rell2(image, reference), "smape": smape(image, reference)}
    return relative | {"ssim": ssim(image, reference, scale), "flip": flip(image, reference, scale)}


class Flicker:
    """Unsteadiness of a sequence: the mean absolute second difference over time of its error in display values.

    A steady error, however large, is 0; `scale` is the exposure that all frames share. Fed frame by frame, it holds
    the errors of two.
    """

    def __init__(self, scale: float) -> None:
        self._scale = scale
        self._errors: list[Image] = []
        self._sum, self._count = 0.0, 0

    def add(self, image: ArrayLike, reference: ArrayLike) -> None:
        """The next frame and its reference."""
        x, r = _pair(image, reference)
        self._errors.append(display(x, self._scale) - display(r, self._scale))
        if len(self._errors) == 3:
            first, middle, last = self._errors
            self._sum += float(np.mean(np.abs(first - 2 * middle + last)))
            self._count += 1
            del self._errors[0]

    @property
    def value(self) -> float | None:
        """None where fewer than three frames came."""
        return self._sum / self._count if self._count else None


def exposure(reference: ArrayLike) -> float:
    """The factor that brings a reference's log-average luminance to middle grey: 0.18 / exp(mean(ln
    luminance)).

    The mean is over pixels that are not black; 1 where all are.
    """
    luminance = np.asarray(reference, np.float64) @ _LUMINANCE
    lit = luminance[luminance > 0]
    return float(_GREY / np.exp(np.mean(np.log(lit)))) if lit.size else 1.0


def display(image: ArrayLike, scale: float) -> NDArray[np.float32]:
    """Linear radiance as it is shown: (s x / (1 + s x))^(1 / 2.2), in [0, 1]."""
    exposed = scale * np.maximum(np.asarray(image, np.float64), 0)
    return ((exposed / (1 + exposed)) ** (1 / 2.2)).astype(np.float32)


def _pair(image: ArrayLike, reference: ArrayLike) -> tuple[Image, Image]:
    x, r = np.asarray(image, np.float64), np.asarray(reference, np.float64)
    if x.shape != r.shape or x.ndim != 3 or x.shape[2] != 3:
        raise ValueError(f"two height x width x 3 pictures are wanted, given {x.shape} and {r.shape}")
    return x, r


def _missing(metric: str, package: str) -> ModuleNotFoundError:
    return ModuleNotFoundError(f"{metric} needs {package}, which is not installed: pip install 'pathfold[bench]'")
