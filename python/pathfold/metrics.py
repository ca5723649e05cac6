"""Error of a picture against a reference: arrays are height x width x 3, linear radiance, finite.

Smaller is better for all but SSIM. SSIM and FLIP look at the display picture (`display`); they need
scikit-image and flip-evaluator, which come with the `bench` extra.
"""

from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

EPSILON = 1e-2
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


def smape(image: ArrayLike, reference: ArrayLike, epsilon: float = EPSILON) -> float:
    """Symmetric absolute error, mean(|x - r| / (|x| + |r| + epsilon)), in [0, 1]."""
    x, r = _pair(image, reference)
    return float(np.mean(np.abs(x - r) / (np.abs(x) + np.abs(r) + epsilon)))


def ssim(image: ArrayLike, reference: ArrayLike) -> float:
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
    scale = exposure(r)
    return float(structural_similarity(display(x, scale), display(r, scale), data_range=1, channel_axis=2))


def flip(image: ArrayLike, reference: ArrayLike) -> float:
    """Mean LDR-FLIP error of the display pictures at FLIP's default viewing distance."""
    return float(_flip(image, reference)[1])


def flip_map(image: ArrayLike, reference: ArrayLike) -> NDArray[np.float32]:
    """The FLIP error of every pixel, height x width, in [0, 1]."""
    return np.asarray(_flip(image, reference)[0], np.float32).reshape(np.shape(reference)[:2])


def compare(image: ArrayLike, reference: ArrayLike) -> dict[str, float]:
    """All four: {"rell2", "smape", "ssim", "flip"}."""
    measures = {"rell2": rell2, "smape": smape, "ssim": ssim, "flip": flip}
    return {name: measure(image, reference) for name, measure in measures.items()}


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


def _flip(image: ArrayLike, reference: ArrayLike) -> tuple[Any, float, Any]:
    try:
        import flip_evaluator
    except ModuleNotFoundError as error:
        raise _missing("FLIP", "flip-evaluator") from error
    x, r = _pair(image, reference)
    scale = exposure(r)
    result: tuple[Any, float, Any] = flip_evaluator.evaluate(
        display(r, scale), display(x, scale), "LDR", applyMagma=False
    )
    return result


def _pair(image: ArrayLike, reference: ArrayLike) -> tuple[Image, Image]:
    x, r = np.asarray(image, np.float64), np.asarray(reference, np.float64)
    if x.shape != r.shape or x.ndim != 3 or x.shape[2] != 3:
        raise ValueError(f"two height x width x 3 pictures are wanted, given {x.shape} and {r.shape}")
    return x, r


def _missing(metric: str, package: str) -> ModuleNotFoundError:
    return ModuleNotFoundError(f"{metric} needs {package}, which is not installed: pip install 'pathfold[bench]'")
