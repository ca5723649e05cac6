"""References without most of their noise, to learn from: `pathfold-train dataset clean`.

They inherit a denoiser's habits: never score by them. Data sets keep them: count store.CLEANING up when they come out
otherwise.
"""

from __future__ import annotations

import io
from collections.abc import Callable
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray
from pathfold.bench import peers
from pathfold.metrics import EPSILON

from ..files import make_folder, write_whole
from .store import Line, Store, cleaned_path, read_cleaned
from .truth import window_halves
from .values import known

REACH = 15  # pixels of the square over which errors are compared

Image = NDArray[np.float32]


def clean(folder: Path, tell: Callable[[int, int], None] = lambda done, total: None) -> int:
    """Make the cleaned references of a data set's training windows that lack one; returns how many those were.

    `tell` is called with the number of windows that are done and of all. Raises FileNotFoundError for a folder without
    views, OSError where nothing can be written, ModuleNotFoundError without pyoidn.
    """
    store = Store(folder)
    make_folder(folder / "cleaned")
    windows = [(line, number) for line in store.split("train") for number in range(len(line["crops"]))]
    made = 0
    for done, (line, number) in enumerate(windows, 1):
        if read_cleaned(folder, line, number) is None:
            content = io.BytesIO()
            np.save(content, cleaned_window(line, partial(store.tensor, line["id"]), number))
            write_whole(cleaned_path(folder, line, number), content.getvalue())
            made += 1
        tell(done, len(windows))
    return made


def cleaned_window(line: Line, tensor: Callable[[str], Any], number: int) -> Image:
    """The reference of window `number` of a view, [3, h, w]; takes a third of a second for 128 x 128 pixels.

    `line` is the view's, `tensor` gives its tensors by name.
    """
    a, b = window_halves(line, tensor, number)
    albedo, normal = (
        known(tensor(f"samples.{name}")[number].astype(np.float32)).mean(0) for name in ("albedo", "normal")
    )
    return cleaned(a, b, albedo, normal, line["exposure"])


def cleaned(a: Image, b: Image, albedo: Image, normal: Image, exposure: float) -> Image:
    """The mean of two independent, equally noisy halves, denoised by OIDN where that brings it nearer the truth.

    a, b: linear radiance [3, H, W]; albedo, normal [3, H, W], noisy or clean; all finite. `exposure` brings radiance to
    the units of RelL2's epsilon. Each denoised half is compared with the other, raw one: the expected square of their
    difference is the denoised one's error plus the raw one's variance. Where OIDN blurs what the halves agree on,
    their mean stays. Raises ModuleNotFoundError without pyoidn.
    """
    mean: Image = (a + b) * np.float32(0.5)
    guides = peers.prefiltered(rows(albedo), rows(normal))
    result, smooth_a, smooth_b = (peers.oidn_clean(rows(x), *guides).transpose(2, 0, 1) for x in (mean, a, b))
    scale = np.square(result) + EPSILON / exposure**2
    variance = np.square(a - b) / 2
    crossed = (np.square(smooth_a - b) + np.square(smooth_b - a)) / 2
    bias = np.maximum(box((crossed - variance) / scale), 0.0)
    noise = box(variance / 2 / scale)
    share = bias / np.maximum(bias + noise, 1e-12)
    return (result + share * (mean - result)).astype(np.float32)


def rows(image: Image) -> Image:
    """[3, H, W] -> H x W x 3."""
    return np.ascontiguousarray(image.transpose(1, 2, 0), np.float32)


def box(x: Image) -> Image:
    """Means over the channels of [3, H, W] and squares of REACH pixels, mirrored at the borders -> [H, W]."""
    total = np.pad(x.mean(0, dtype=np.float64), REACH // 2, "reflect")
    for axis in (0, 1):
        total = np.lib.stride_tricks.sliding_window_view(total, REACH, axis).mean(-1)
    return total
