"""References: how many samples one is worth, its own error, and the weights and scales that follow from it.

Nothing is clamped: a reference is unbiased, fireflies included, and its two halves show them as error. What a budget
cannot settle is refused (`WORTHLESS`), which biases the choice of views and never a pixel's value.
"""

from __future__ import annotations

import time
from collections.abc import Callable
from typing import Any

import numpy as np
from numpy.typing import NDArray
from pathfold import auto_exposure

from ..scenes.faults import RejectedError
from .store import Line
from .values import known

BUDGET = 0.5  # core-seconds; more views with such references taught more than fewer clean ones (docs/results)
ROUND = 32  # samples per pixel and half between two looks at clock and error
GOOD, POOR = 2e-4, 1e-2  # RelL2 at which rendering stops early, or may take HARD times the budget
HARD = 2
WORTHLESS = 0.25  # a reference noisier than this after all that teaches nothing

Arrays = dict[str, NDArray[Any]]


def render_truth(scene: Any, budget: float, max_depth: int, seeds: list[int]) -> tuple[Arrays, dict[str, float]]:
    """The reference of a scene's first sensor: tensors as the store names them, and its facts for the index.

    Two independent halves are rendered in rounds until their difference says that the mean is good, or `budget`
    seconds are spent (of one core; of the clock on a GPU). Raises RejectedError where the result would be worthless.
    """
    from pathfold.mitsuba import trace_mean

    halves: list[dict[str, Any]] = [{}, {}]
    rounds, clock = 0, _clock()
    start = clock()
    while True:
        for half, seed in zip(halves, seeds, strict=True):
            mean = trace_mean(scene, spp=ROUND, seed=(seed + rounds) % 2**32, max_depth=max_depth)
            for name in ("color", "diffuse", "diffuse.albedo", "depth"):
                half[name] = half.get(name, 0) + (mean[name].astype(np.float64) - half.get(name, 0)) / (rounds + 1)
        rounds += 1
        if rounds == 1:
            start = clock()  # the first round compiles, which is not what the budget is for
            continue
        a, b = (half["color"] for half in halves)
        scale = exposure(np.moveaxis((a + b) / 2, -1, 0))
        rell2 = half_error(scale * a, scale * b)  # exposed: the metric's 0.01 would hide all noise of a dark scene
        if rell2 < GOOD or clock() - start > budget * (HARD if rell2 > POOR else 1):
            break
    spp = 2 * ROUND * rounds
    if not rell2 < WORTHLESS:
        raise RejectedError(f"its reference has RelL2 {rell2:.2g} after {spp} spp")
    tensors = _tensors(*halves)
    facts = {"reference_spp": spp, "reference_rell2": rell2, "exposure": exposure(tensors["reference.color"])}
    return tensors, facts | {"depth_scale": depth_scale((halves[0]["depth"] + halves[1]["depth"]) / 2)}


def _clock() -> Any:
    """Seconds that count against a budget: the core's own on a CPU, which other work does not lengthen."""
    import mitsuba as mi

    return time.monotonic if str(mi.variant()).startswith("cuda") else time.process_time


def _tensors(a: dict[str, Any], b: dict[str, Any]) -> Arrays:
    def channels_first(image: Any) -> NDArray[np.float32]:
        return np.moveaxis(image, -1, 0).astype(np.float32)

    tensors = {f"reference.{n}": channels_first((a[n] + b[n]) / 2) for n in ("color", "diffuse", "diffuse.albedo")}
    tensors |= {f"reference.half_{n}.color": channels_first(half["color"]) for n, half in (("a", a), ("b", b))}
    tensors["importance"] = importance(*(tensors[f"reference.half_{n}.color"] for n in "ab"))
    return tensors


def window_halves(line: Line, tensor: Callable[[str], Any], number: int) -> tuple[NDArray[np.float32], ...]:
    """The reference of window `number` of a view, [3, h, w], twice, of independent samples.

    `line` is the view's, `tensor` gives its tensors by name; what is cut is read. Unknown values are 0.
    """
    top, left = line["crops"][number]
    rows, columns = slice(top, top + line["crop"]), slice(left, left + line["crop"])
    halves = (tensor(f"reference.half_{name}.color")[:, rows, columns] for name in "ab")
    return tuple(known(half) for half in halves)


def half_error(a: NDArray[Any], b: NDArray[Any]) -> float:
    """RelL2 against the truth of the mean of two independent, equally noisy halves."""
    return float(np.mean((a - b) ** 2 / 4 / (((a + b) / 2) ** 2 + 1e-2)))


def depth_scale(depth: NDArray[Any]) -> float:
    """1 / geometric mean of the depths above 0, as the SDK computes it; 1 where nothing was met."""
    seen = depth[np.isfinite(depth) & (depth > 0)]
    return float(np.exp(-np.log(seen).mean())) if seen.size else 1.0


def importance(a: NDArray[np.float32], b: NDArray[np.float32]) -> NDArray[np.float32]:
    """Weight [H, W] with mean 1 for drawing crops, from two halves [3, H, W]: their noise, and the picture's detail."""
    mean = ((a + b) / 2).mean(0)
    level = mean + 0.1 * float(mean.mean()) + 1e-6
    noise = np.minimum(np.abs(a - b).mean(0) / level, 10)
    detail = sum(np.abs(g) for g in np.gradient(np.log(level)))
    weight = 0.3 + sum(np.minimum(part / max(float(part.mean()), 1e-6), 4) for part in (noise, detail))
    reach = min(9, *weight.shape)
    for axis in (0, 1):
        weight = np.apply_along_axis(
            lambda row: np.convolve(np.pad(row, reach // 2, "edge"), np.ones(reach) / reach, "valid"), axis, weight
        )[tuple(slice(n) for n in a.shape[1:])]
    return (weight / weight.mean()).astype(np.float32)


def exposure(color: NDArray[Any]) -> float:
    """Scale that brings the log-average luminance of [3, H, W] to 0.18, by the SDK's own rule; 1 if black."""
    return auto_exposure(np.moveaxis(color, 0, -1).astype(np.float32))
