"""The stiff and extreme frames that a model is checked on: the one place where they are defined.

`pathfold-train export` runs each through the float64 reference, `pathfold check` through the SDK. A frame is made
anew wherever it is needed, the same bits on every machine: uniform numbers are Philox's raw words, and of arithmetic
only what IEEE 754 rounds exactly (and powers of two) is used.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from pathfold._core import DEAD_LOG, KINDS, MAX_VERTICES, Layout

Buffers = dict[str, NDArray[Any]]  # under the names of the manifest; H x W x C, samples S x H x W x C
HEIGHT, WIDTH, SAMPLES = 22, 18, 3  # no multiples of a network's alignment
RADIANCE = ("color", "diffuse", "specular")
VARIANCES = ("variance", "diffuse.variance", "specular.variance")
LAYOUT = Layout()
LIGHT = slice(LAYOUT.radiance, LAYOUT.attenuation)  # logarithms of a path's radiance and photon energy
LOGS = slice(0, LAYOUT.kind)
DRAWN = [f"{lobe}-{side}" for side in ("reflection", "transmission") for lobe in ("diffuse", "glossy", "delta")]
DRAWN_KINDS = [KINDS[name] for name in ("none", *DRAWN, "generic")]


@dataclass(frozen=True)
class Case:
    """A frame with a reference."""

    name: str
    stresses: str
    make: Callable[[], Buffers]
    needs: str = "color"  # a buffer that a model must read for the case to say anything


CASES: list[Case] = []


def case(name: str, stresses: str, needs: str = "color") -> Callable[[Callable[[], Buffers]], Callable[[], Buffers]]:
    """Adds a function that makes a frame to CASES."""

    def add(make: Callable[[], Buffers]) -> Callable[[], Buffers]:
        CASES.append(Case(name, stresses, make, needs))
        return make

    return add


class Draw:
    """A stream of random numbers."""

    def __init__(self, seed: int) -> None:
        self._words = np.random.Philox(key=seed)

    def uniform(self, *shape: int) -> NDArray[np.float64]:
        """In [0, 1), multiples of 2^-24."""
        return np.asarray((self.words(*shape) >> np.uint64(40)) * 2.0**-24, np.float64)

    def words(self, *shape: int) -> NDArray[np.uint64]:
        return self._words.random_raw(math.prod(shape)).reshape(shape)

    def between(self, low: float, high: float, *shape: int) -> NDArray[np.float64]:
        return low + (high - low) * self.uniform(*shape)

    def magnitudes(self, low: int, high: int, *shape: int) -> NDArray[np.float64]:
        """From 2^low to 2^high, all exponents alike."""
        return np.ldexp(1 + self.uniform(*shape), np.floor(self.between(low, high, *shape)).astype(int))


def frame(height: int = HEIGHT, width: int = WIDTH, samples: int = SAMPLES, seed: int = 1) -> Buffers:
    """Every buffer there is: radiance with a heavy tail over guides that vary from pixel to pixel."""
    draw, shape = Draw(seed), (height, width, 3)
    x = np.arange(width).reshape(1, width, 1) / width
    diffuse = (0.1 + x) * draw.uniform(*shape) / (1.02 - draw.uniform(*shape))
    specular = 0.2 * draw.uniform(*shape) * draw.uniform(*shape) / (1.005 - draw.uniform(*shape))
    buffers: Buffers = {"diffuse": diffuse, "specular": specular}
    buffers |= {"diffuse.albedo": draw.uniform(*shape), "albedo": draw.uniform(*shape)}
    buffers |= {"normal": draw.between(-1, 1, *shape), "depth": draw.between(0.5, 50, height, width, 1)}
    buffers |= {name: draw.uniform(*shape) / (1.02 - draw.uniform(*shape)) / 8 for name in VARIANCES}
    logs = draw.between(-20, 8, samples, height, width, LAYOUT.kind)
    logs[draw.uniform(*logs.shape) < 0.3] = DEAD_LOG
    vertices = (samples, height, width, MAX_VERTICES)
    kinds = np.array(DRAWN_KINDS)[(draw.words(*vertices) % len(DRAWN_KINDS)).astype(int)]
    buffers["samples.descriptor"] = np.concatenate([logs, kinds, draw.uniform(*vertices)], -1)
    buffers["samples.density"] = draw.between(-40, 40, samples, height, width, 1)
    return with_color({name: values.astype(np.float32) for name, values in buffers.items()})


def with_color(buffers: Buffers) -> Buffers:
    """`color` as the sum of the split, the largest float where that is beyond float32."""
    with np.errstate(over="ignore", invalid="ignore"):
        total = buffers["diffuse"].astype(np.float32) + buffers["specular"].astype(np.float32)
    return buffers | {"color": np.where(np.isfinite(total), total, np.finfo(np.float32).max)}


def scaled(buffers: Buffers, scale: float) -> Buffers:
    """The same frame under light `scale` times as bright."""
    buffers = {name: values.copy() for name, values in buffers.items()}
    for name in RADIANCE:
        buffers[name] *= np.float32(scale)
    for name in VARIANCES:
        buffers[name] *= np.float32(scale) ** 2
    light = buffers["samples.descriptor"][..., LIGHT]
    light[light != DEAD_LOG] += np.float32(math.log(scale))
    return buffers


def without(buffers: Buffers, *names: str) -> Buffers:
    return {name: values for name, values in buffers.items() if name not in names}


def unsplit(buffers: Buffers) -> Buffers:
    return without(buffers, "diffuse", "specular", "diffuse.albedo", "diffuse.variance", "specular.variance")


@case("plain", "every buffer given, nothing extreme")
def plain() -> Buffers:
    return frame()


@case("color alone", "no guides, no variance, no split")
def color_alone() -> Buffers:
    return {name: values for name, values in frame().items() if name == "color" or name.startswith("samples.")}


@case("unsplit", "guides and variance, no split")
def whole_radiance() -> Buffers:
    return unsplit(frame())


@case("half floats", "all buffers as 16-bit floats")
def half_floats() -> Buffers:
    return {name: values.astype(np.float16) for name, values in frame().items()}


@case("scale 1e-6", "radiance a millionth of usual")
def dim() -> Buffers:
    return scaled(frame(), 1e-6)


@case("scale 1e6", "radiance a million times usual")
def bright() -> Buffers:
    return scaled(frame(), 1e6)


@case("1e-30 to 1e30", "radiance across 60 decades in one frame")
def all_magnitudes() -> Buffers:
    draw, buffers = Draw(2), frame()
    for name in ("diffuse", "specular"):
        buffers[name] = draw.magnitudes(-100, 99, HEIGHT, WIDTH, 3).astype(np.float32)
    return with_color(buffers)


@case("capped radiance", "finite radiance up to the largest float")
def capped() -> Buffers:
    draw, buffers = Draw(3), frame()
    for name in ("diffuse", "specular"):
        buffers[name][draw.uniform(HEIGHT, WIDTH) < 0.1] = np.finfo(np.float32).max
    return with_color(buffers)


@case("denormals", "radiance below the smallest normal float")
def denormals() -> Buffers:
    buffers = frame()
    for name in ("diffuse", "specular"):
        buffers[name] = np.ldexp(buffers[name], -133)
    for name in VARIANCES:
        buffers[name][:] = 0
    return with_color(buffers)


@case("fireflies", "single pixels 1e3 to 1e8 above their surroundings")
def fireflies() -> Buffers:
    buffers = frame()
    for number, height in enumerate((1e3, 1e5, 1e8)):
        at = 3 + 7 * number, 4 + 5 * number
        for name in ("diffuse", "specular"):
            buffers[name][at] = height
        for name in VARIANCES:
            buffers[name][at] = height**2
        buffers["samples.descriptor"][0, at[0], at[1], LIGHT] = math.log(height)
    return with_color(buffers)


def damaged(value: float, seed: int) -> Buffers:
    """`value` in a few places of every buffer, each time in other ones."""
    draw, buffers = Draw(seed), with_color(frame())
    for values in buffers.values():
        values[draw.uniform(*values.shape) < (0.02 if values.shape[-1] < 10 else 0.005)] = value
    return buffers


@case("NaN", "NaN in every buffer")
def not_numbers() -> Buffers:
    return damaged(math.nan, 4)


@case("infinity", "infinity in every buffer")
def infinities() -> Buffers:
    return damaged(math.inf, 5)


@case("-infinity", "negative infinity in every buffer")
def negative_infinities() -> Buffers:
    return damaged(-math.inf, 6)


@case("negative", "negative values in every buffer")
def negatives() -> Buffers:
    return damaged(-3.0, 7)


@case("one valid pixel", "NaN radiance everywhere else")
def one_valid_pixel() -> Buffers:
    buffers = frame()
    for name in RADIANCE:
        kept = buffers[name][9, 8].copy()
        buffers[name][:] = math.nan
        buffers[name][9, 8] = kept
    return buffers


@case("no valid pixel", "NaN radiance everywhere")
def no_valid_pixel() -> Buffers:
    buffers = frame()
    for name in RADIANCE:
        buffers[name][:] = math.nan
    return buffers


@case("black", "radiance 0 everywhere")
def black() -> Buffers:
    buffers = frame()
    for name in (*RADIANCE, *VARIANCES):
        buffers[name][:] = 0
    buffers["samples.descriptor"][..., LIGHT] = DEAD_LOG
    return buffers


@case("black but one", "one pixel that is not 0")
def black_but_one() -> Buffers:
    buffers = black()
    buffers["diffuse"][5, 6] = 3
    return with_color(buffers)


@case("constant", "the same radiance everywhere, guides vary")
def constant() -> Buffers:
    buffers = frame()
    for name in ("diffuse", "specular"):
        buffers[name][:] = 0.7
    return with_color(buffers)


@case("1 x 1", "a single pixel")
def single_pixel() -> Buffers:
    return frame(1, 1)


@case("1 x 37", "a single row")
def single_row() -> Buffers:
    return frame(1, 37)


@case("37 x 1", "a single column")
def single_column() -> Buffers:
    return frame(37, 1)


@case("2 x 3", "smaller than any kernel")
def tiny() -> Buffers:
    return frame(2, 3)


@case("normals 0", "zero normals, as on a miss", "normal")
def no_normals() -> Buffers:
    return frame() | {"normal": np.zeros((HEIGHT, WIDTH, 3), np.float32)}


@case("long normals", "normals of length 1e-30 to 1e30", "normal")
def long_normals() -> Buffers:
    buffers, draw = frame(), Draw(8)
    return buffers | {"normal": buffers["normal"] * draw.magnitudes(-100, 99, HEIGHT, WIDTH, 1).astype(np.float32)}


@case("depth 0", "a miss in every pixel", "depth")
def no_depth() -> Buffers:
    return frame() | {"depth": np.zeros((HEIGHT, WIDTH, 1), np.float32)}


@case("depth 1e-30 to 1e30", "depth across 60 decades, misses and infinities among them", "depth")
def all_depths() -> Buffers:
    draw = Draw(9)
    depth = draw.magnitudes(-100, 99, HEIGHT, WIDTH, 1)
    depth[draw.uniform(HEIGHT, WIDTH) < 0.1] = 0
    depth[draw.uniform(HEIGHT, WIDTH) < 0.1] = math.inf
    return frame() | {"depth": depth.astype(np.float32)}


@case("denormal depth", "depths below the smallest normal float and misses", "depth")
def denormal_depth() -> Buffers:
    buffers, draw = frame(), Draw(10)
    buffers["depth"] = np.ldexp(buffers["depth"], -140)
    buffers["depth"][draw.uniform(HEIGHT, WIDTH) < 0.2] = 0
    return buffers


@case("albedo 0", "black albedo everywhere")
def black_albedo() -> Buffers:
    black = np.zeros((HEIGHT, WIDTH, 3), np.float32)
    return frame() | {"albedo": black, "diffuse.albedo": black.copy()}


@case("albedo above 1", "albedos from 1e-4 to 1e4")
def bright_albedo() -> Buffers:
    draw = Draw(11)
    return frame() | {
        name: draw.magnitudes(-13, 13, HEIGHT, WIDTH, 3).astype(np.float32) for name in ("albedo", "diffuse.albedo")
    }


@case("variance 0", "samples that all agree", "variance")
def no_variance() -> Buffers:
    return frame() | {name: np.zeros((HEIGHT, WIDTH, 3), np.float32) for name in VARIANCES}


@case("variance unknown", "guides without variance", "variance")
def unknown_variance() -> Buffers:
    return without(frame(), *VARIANCES)


@case("variance 1e-38 to 1e38", "variance across the range of a float", "variance")
def all_variances() -> Buffers:
    draw = Draw(12)
    return frame() | {name: draw.magnitudes(-126, 127, HEIGHT, WIDTH, 3).astype(np.float32) for name in VARIANCES}


@case("densities", "sampling densities across 60 decades", "samples.density")
def densities() -> Buffers:
    buffers = frame()
    buffers["samples.density"] = Draw(13).between(-70, 70, SAMPLES, HEIGHT, WIDTH, 1).astype(np.float32)
    return buffers


@case("huge logarithms", "log densities and descriptors to 1e30, tags and roughness far out", "samples.descriptor")
def huge_logarithms() -> Buffers:
    buffers, draw = frame(), Draw(14)
    for name in ("samples.descriptor", "samples.density"):
        sign = 1 - 2 * (draw.words(*buffers[name].shape) % 2).astype(np.float64)
        buffers[name] = (sign * draw.magnitudes(0, 99, *buffers[name].shape)).astype(np.float32)
    return buffers


@case("dead paths", "paths that carry nothing", "samples.descriptor")
def dead_paths() -> Buffers:
    buffers = frame()
    buffers["samples.descriptor"][..., LOGS] = DEAD_LOG
    return buffers


@case("1 spp", "one sample per pixel, whose variance is unknown", "samples.descriptor")
def one_sample() -> Buffers:
    return frame(samples=1)


@case("64 spp", "more samples than most models were trained on", "samples.descriptor")
def many_samples() -> Buffers:
    return frame(9, 10, 64)


@case("mixed spp", "0 to 6 valid samples, from pixel to pixel", "samples.valid")
def mixed_samples() -> Buffers:
    buffers = frame(samples=6)
    count = np.floor(Draw(15).between(0, 7, 1, HEIGHT, WIDTH, 1))
    buffers["samples.valid"] = (np.arange(6).reshape(6, 1, 1, 1) < count).astype(np.float32)
    return buffers


@case("no valid sample", "every sample marked invalid", "samples.valid")
def no_valid_sample() -> Buffers:
    return frame() | {"samples.valid": np.zeros((SAMPLES, HEIGHT, WIDTH, 1), np.float32)}
