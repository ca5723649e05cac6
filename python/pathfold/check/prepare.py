"""What the SDK does to a frame before and after the network, written again in NumPy, in float64: the checks' measure.

The rules are those of docs/architecture.md ("The way of a frame"); sdk/src/prepare.cpp, radiance.cpp and pack.cpp
do the same.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from pathfold._core import DEAD_LOG
from pathfold.check.cases import LAYOUT, LOGS, Buffers
from pathfold.check.demodulation import flatten
from pathfold.check.guides import MEANINGS, clean, says_nothing

Array = NDArray[np.float64]
LUMINANCE = np.array([0.212671, 0.715160, 0.072169])
BIN = 16  # pixels
DARK_BIN, BRIGHT_BIN = 1e-8, 16.0  # of the bright level
OUTLYING = 64  # one in so many pixels of a bin, or bins, may be an outlier
BRIGHTEST = 1e30  # radiance that a network is shown, after exposure
OUT_OF_GAMUT = 2.0  # times the largest component: what lies further below 0 is no colour
ROUNDING = 1 / 256  # of the magnitudes of parts that add up


@dataclass(frozen=True)
class Branch:
    """A branch at work: what it filters, by the graph of which name."""

    graph: str
    buffer: str  # "diffuse", "specular" or "color"
    radiance: Array  # H x W x 3, 0 where masked, capped; below 0 where it is outside of the gamut
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
    silent = {name for name in double.keys() & MEANINGS.keys() if says_nothing(double[name], name)}
    double = {name: values for name, values in double.items() if name in manifest["requires"] or name not in silent}
    branches = active_branches(double, manifest)
    split = len(branches) == len(manifest["reconstruction"]["branches"]) and branches[0]["radiance"] != "color"
    names = [branch["radiance"] for branch in branches]
    if split and "color" in double and double["color"].any():
        double |= parts_of(double["color"], double["diffuse"], double["specular"])
    parts = ["diffuse", "specular"] if names == ["color"] and "color" not in double else names
    valid = np.logical_and.reduce([np.isfinite(double[name]).all(-1) for name in parts])
    radiance = [np.where(valid[..., None], within_gamut(double[name]), 0) for name in parts]
    radiance = radiance if parts == names else [radiance[0] + radiance[1]]
    light = np.sum([np.maximum(part, 0) for part in radiance], axis=0)
    exposure = auto_exposure(light, valid, manifest["exposure"]["key"])
    cap = min(BRIGHTEST / min(exposure, 1), 1e32)
    shown = {name for name in double if reads(manifest, name)}
    depth_scale = find_depth_scale(clean(double["depth"], "depth")) if "depth" in shown else 1.0
    factors = [branch.get("demodulate", {}).get("by") for branch in branches]
    for branch, by, values in zip(branches, factors, radiance, strict=True):
        if by in double:
            albedo, epsilon = clean(double[by], by), branch["demodulate"]["epsilon"]
            double[by] = flatten(albedo, np.clip(values, 0, cap), valid, epsilon)
    shared = guides(double, split) | samples(double, valid.shape)
    spp = shared["samples.valid"].shape[0] if "samples.descriptor" in double else 0
    embedded = manifest["samples_per_pixel"].get("embedded")
    shared |= {name: shared[name][:embedded] for name in shared if name.startswith("samples.")}
    shared |= {"exposure": np.array([exposure]), "depth_scale": np.array([depth_scale])}
    shared["split.present"] = np.array([float(split)])
    shared["paths.present"] = np.array([float("samples.descriptor" in double)])
    made = []
    for branch, by, name, values in zip(branches, factors, names, radiance, strict=True):
        factor = np.ones_like(values)
        if by in double:
            factor = clean(double[by], by) + branch["demodulate"]["epsilon"]
        values = np.clip(values, -cap, cap)
        variance = double.get("variance" if name == "color" else f"{name}.variance")
        own = {
            "radiance": np.clip(values, 0, BRIGHTEST / exposure),
            "variance": np.zeros_like(values) if variance is None else clean(variance, "variance"),
        }
        own["variance.present"] = np.array([float(variance is not None and spp != 1)])
        cleaned = by in double and branch["demodulate"].get("clean", False)
        made.append(Branch(branch["graph"], name, values, factor, shared | own, cleaned))
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
    hits = depth[depth > 0]
    return float(np.clip(np.exp(-np.log(hits).mean()), 1e-37, 1e37)) if hits.size else 1.0


def parts_of(color: Array, diffuse: Array, specular: Array) -> dict[str, Array]:
    """Diffuse and specular, brought to add up to a color that is known where they do not."""
    with np.errstate(invalid="ignore", over="ignore"):
        slack = ROUNDING * (np.abs(color) + np.abs(diffuse) + np.abs(specular))
        light = (within_gamut(diffuse) == diffuse) & (within_gamut(specular) == specular)
        fits = light & np.isfinite(diffuse + specular) & (np.abs(diffuse + specular - color) <= slack)
        apart = np.isfinite(color).all(-1) & ~np.all(fits, axis=-1)
        known = np.where(np.isfinite(diffuse).all(-1, keepdims=True), diffuse, 0)
        part = np.clip(known, np.minimum(color, 0), np.maximum(color, 0))
        pixels = np.expand_dims(apart, -1)
        return {"diffuse": np.where(pixels, part, diffuse), "specular": np.where(pixels, color - part, specular)}


def within_gamut(radiance: Array) -> Array:
    """Components far below 0 become 0: they are no light, nor a colour."""
    with np.errstate(invalid="ignore"):
        lowest = -OUT_OF_GAMUT * np.maximum(radiance.max(-1, keepdims=True), 0)
        return np.where(radiance < lowest, 0, radiance)


def guides(buffers: dict[str, Array], split: bool) -> dict[str, Array]:
    """Guides as the graphs read them, 0 where the frame has none."""
    height, width = next(values for name, values in buffers.items() if not name.startswith("samples.")).shape[:2]
    made: dict[str, Array] = {}
    for name, channels in (("albedo", 3), ("normal", 3), ("depth", 1)):
        none = np.zeros((height, width, channels))
        made[name] = clean(buffers[name], name) if name in buffers else none
        made[f"{name}.present"] = np.array([float(name in buffers)])
    none = np.zeros((height, width, 3))
    made["diffuse.albedo"] = clean(buffers["diffuse.albedo"], "diffuse.albedo") if split else none
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
