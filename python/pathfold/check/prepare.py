"""What the SDK does to a frame before and after the network, written again in NumPy, in float64: the checks' measure.

The rules are those of docs/architecture.md ("The way of a frame"); sdk/src/prepare.cpp and pack.cpp do the same.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from pathfold._core import DEAD_LOG
from pathfold.check.cases import LAYOUT, LOGS, Buffers

Array = NDArray[np.float64]
LUMINANCE = np.array([0.212671, 0.715160, 0.072169])
BIN = 16  # pixels
DARK_BIN, BRIGHT_BIN = 1e-8, 16.0  # of the bright level
OUTLYING = 64  # one in so many pixels of a bin, or bins, may be an outlier
RANGES = {"normal": (-1.0, 1.0), "albedo": (0.0, 1e4), "diffuse.albedo": (0.0, 1e4)}  # else >= 0


@dataclass(frozen=True)
class Branch:
    """A branch at work: what it filters, by the graph of which name."""

    graph: str
    buffer: str  # "diffuse", "specular" or "color"
    radiance: Array  # H x W x 3, 0 where masked, capped
    factor: Array  # H x W x 3, what radiance is divided by while it is filtered
    inputs: dict[str, Array]  # the graph's: H x W x C, S x H x W x C, scalars [1]
    clean: bool = False  # whether the factor is cleaned before it divides and multiplies


@dataclass(frozen=True)
class Prepared:
    branches: list[Branch]
    valid: NDArray[np.bool_]  # H x W, False where radiance is masked
    exposure: float
    depth_scale: float


def prepare(buffers: Buffers, manifest: dict[str, Any]) -> Prepared:
    """Sanitise a frame, take its statistics and make the inputs of each graph that the frame needs."""
    with np.errstate(invalid="ignore"):  # a signalling NaN complains
        given = {n: v for n, v in buffers.items() if not n.startswith("samples.") or reads(manifest, n)}
        double = {name: values.astype(np.float64) for name, values in given.items()}
    branches = active_branches(double, manifest)
    split = len(branches) == len(manifest["reconstruction"]["branches"]) and branches[0]["radiance"] != "color"
    names = [branch["radiance"] for branch in branches]
    if names == ["color"] and "color" not in double:
        double["color"] = double["diffuse"] + double["specular"]
    valid = np.logical_and.reduce([np.isfinite(double[name]).all(-1) for name in names])
    radiance = [np.where(valid[..., None], np.maximum(double[name], 0), 0) for name in names]
    exposure = auto_exposure(sum(radiance[1:], radiance[0]), valid, manifest["exposure"]["key"])
    cap = min(1e30 / exposure, 1e32)
    depth_scale = find_depth_scale(double.get("depth", np.zeros(0))) if reads(manifest, "depth") else 1.0
    shared = guides(double, split) | samples(double, valid.shape)
    spp = shared["samples.valid"].shape[0] if "samples.descriptor" in double else 0
    embedded = manifest["samples_per_pixel"].get("embedded")
    shared |= {name: shared[name][:embedded] for name in shared if name.startswith("samples.")}
    shared |= {"exposure": np.array([exposure]), "depth_scale": np.array([depth_scale])}
    shared["split.present"] = np.array([float(split)])
    shared["paths.present"] = np.array([float("samples.descriptor" in double)])
    made = []
    for branch, name, values in zip(branches, names, radiance, strict=True):
        factor = np.ones_like(values)
        by = branch.get("demodulate", {}).get("by")
        if by in double:
            factor = guide(double[by], by) + branch["demodulate"]["epsilon"]
        values = np.minimum(values, cap)
        variance = double.get("variance" if name == "color" else f"{name}.variance")
        own = {
            "radiance": values,
            "variance": guide(np.zeros_like(values) if variance is None else variance, "variance"),
        }
        own["variance.present"] = np.array([float(variance is not None and spp != 1)])
        clean = by in double and branch["demodulate"].get("clean", False)
        made.append(Branch(branch["graph"], name, values, factor, shared | own, clean))
    return Prepared(made, valid, exposure, depth_scale)


def reads(manifest: dict[str, Any], buffer: str) -> bool:
    return buffer in (*manifest["requires"], *manifest["uses"])


def active_branches(buffers: Buffers, manifest: dict[str, Any]) -> list[dict[str, Any]]:
    """All branches of a frame that has radiance for each, else the one that filters what is not split."""
    branches: list[dict[str, Any]] = manifest["reconstruction"]["branches"]
    needed = {branch["radiance"] for branch in branches}
    needed |= {branch["demodulate"]["by"] for branch in branches if "demodulate" in branch}
    if "color" not in needed and needed <= buffers.keys():
        return branches
    return [{**branch, "radiance": "color"} for branch in branches if branch.get("unsplit")]


def auto_exposure(color: Array, valid: NDArray[np.bool_], key: float) -> float:
    """key / log-average luminance of bins of 16 x 16 pixels, by the rule in sdk/src/prepare.h."""
    luminance, bins = color @ LUMINANCE, []
    height, width = valid.shape
    down, across = -(-height // BIN), -(-width // BIN)
    for j in range(down):
        for i in range(across):
            area = np.s_[j * height // down : (j + 1) * height // down, i * width // across : (i + 1) * width // across]
            bins.append(np.sort(luminance[area][valid[area]]))
    means = np.array([pixels.mean() if pixels.size else 0.0 for pixels in bins])
    kept = [pixels[: pixels.size - -(-pixels.size // OUTLYING)] for pixels in bins]
    levels = sorted(pixels.mean() for pixels in kept if pixels.any())
    bright = levels[-1 - len(levels) // OUTLYING] if levels else means.max()
    counted = np.minimum(means[means > DARK_BIN * bright], BRIGHT_BIN * bright)
    return float(np.clip(key / np.exp2(np.log2(counted).mean()), 1e-37, 1e37)) if counted.size else 1.0


def find_depth_scale(depth: Array) -> float:
    """1 / geometric mean of the depths that are no miss."""
    hits = depth[np.isfinite(depth) & (depth > 0)]
    return float(np.clip(np.exp(-np.log(hits).mean()), 1e-37, 1e37)) if hits.size else 1.0


def guide(values: Array, name: str) -> Array:
    """What is not finite becomes 0, the rest is brought into the guide's range."""
    return np.clip(np.where(np.isfinite(values), values, 0), *RANGES.get(name, (0.0, math.inf)))


def guides(buffers: dict[str, Array], split: bool) -> dict[str, Array]:
    """Guides as the graphs read them, 0 where the frame has none."""
    height, width = next(values for name, values in buffers.items() if not name.startswith("samples.")).shape[:2]
    made: dict[str, Array] = {}
    for name, channels in (("albedo", 3), ("normal", 3), ("depth", 1)):
        values = buffers.get(name, np.zeros((height, width, channels)))
        made |= {name: guide(values, name), f"{name}.present": np.array([float(name in buffers)])}
    albedo = buffers["diffuse.albedo"] if split else np.zeros((height, width, 3))
    made["diffuse.albedo"] = guide(albedo, "diffuse.albedo")
    return made


def samples(buffers: dict[str, Array], size: tuple[int, ...]) -> dict[str, Array]:
    """The block of samples, what is not finite marked as not valid; without one, a single sample that says nothing."""
    given = "samples.descriptor" in buffers
    descriptor = buffers.get("samples.descriptor", np.zeros((1, *size, LAYOUT.channels))).copy()
    density = buffers.get("samples.density", np.zeros((*descriptor.shape[:3], 1)))
    valid = buffers.get("samples.valid", np.full((*descriptor.shape[:3], 1), float(given)))
    finite = np.isfinite(np.concatenate([descriptor, density, valid], -1)).all(-1, keepdims=True)
    valid = finite & (np.where(finite, valid, 0) > 0.5)
    dead = np.zeros(LAYOUT.channels)
    dead[LOGS] = DEAD_LOG
    return {
        "samples.descriptor": np.where(valid, descriptor, dead),
        "samples.density": np.where(valid, density, 0),
        "samples.valid": valid.astype(np.float64),
    }


def window_limits(values: Array, valid: NDArray[np.bool_], radius: int) -> tuple[Array, Array]:
    """Least and largest valid value in the (2 radius + 1)^2 window of each pixel, H x W x C; 0 where none is valid."""
    pad = [(radius, radius), (radius, radius), (0, 0)]
    sides = []
    for sign in (1.0, -1.0):  # the largest, then the least
        masked = np.pad(np.where(valid[..., None], sign * values, -math.inf), pad, constant_values=-math.inf)
        for axis in (0, 1):
            masked = np.lib.stride_tricks.sliding_window_view(masked, 2 * radius + 1, axis).max(-1)
        sides.append(np.where(np.isfinite(masked), sign * masked, 0))
    return sides[1], sides[0]
