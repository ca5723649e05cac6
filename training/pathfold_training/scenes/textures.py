"""Textures and environment maps made in code, as Mitsuba plugins holding linear float bitmaps."""

from __future__ import annotations

import mitsuba as mi
import numpy as np
from numpy.random import Generator
from numpy.typing import NDArray

Array = NDArray[np.float64]
SIZE = 256


def colour(rng: Generator, saturation: float | None = None, low: float = 0.05, high: float = 0.85) -> list[float]:
    """A reflectance RGB; mostly muted, sometimes vivid."""
    saturation = rng.uniform(0, 1) ** 2 if saturation is None else saturation
    hue = 0.5 + 0.5 * np.cos(2 * np.pi * (rng.uniform() + np.array([0, 1 / 3, 2 / 3])))
    return list(np.clip(rng.uniform(low, high) * (1 - saturation + saturation * hue), 0.01, 0.9))


def noise(rng: Generator, slope: float = 1.5, stretch: float = 1, size: int = SIZE) -> Array:
    """Periodic noise in [0, 1], size x size: spectrum 1 / f^slope, features drawn out along x by `stretch`."""
    fy, fx = np.meshgrid(np.fft.fftfreq(size), np.fft.fftfreq(size), indexing="ij")
    frequency = np.hypot(fx * stretch, fy) * size
    spectrum = np.fft.fft2(rng.normal(size=(size, size))) / np.maximum(frequency, 1) ** slope
    spectrum[0, 0] = 0
    field = np.fft.ifft2(spectrum).real
    return np.clip(0.5 + field / (5 * field.std()), 0, 1)


def pattern(rng: Generator, kind: str) -> Array:
    """A periodic value map in [0, 1], SIZE x SIZE."""
    y, x = np.meshgrid(*[(np.arange(SIZE) + 0.5) / SIZE] * 2, indexing="ij")
    n = int(rng.integers(2, 9))
    if kind == "checker":
        return ((np.floor(x * 2 * n) + np.floor(y * 2 * n)) % 2) * 0.9 + 0.05
    if kind == "stripes":
        return 0.5 + 0.5 * np.tanh(4 * np.sin(2 * np.pi * n * x))
    if kind in ("bricks", "planks"):
        rows, columns = (n + 2, n // 2 + 1) if kind == "bricks" else (n + 1, 1)
        row = np.floor(y * rows).astype(int)
        across = x * columns + (rng.uniform(size=rows)[row] if kind == "planks" else 0.5 * (row % 2))
        column = np.floor(across).astype(int) % columns
        joint = np.minimum(np.abs((across % 1) - 0.5) < 0.49, np.abs((y * rows) % 1 - 0.5) < 0.46)
        grain = noise(rng, 1.2, 0.06 if kind == "planks" else 1)
        return joint * (0.35 + 0.4 * rng.uniform(size=(rows, columns))[row, column] + 0.35 * (grain - 0.3))
    if kind == "wood":
        rings = x * n + 2.5 * noise(rng, 2.2, 0.15)
        return 0.5 + 0.35 * np.sin(2 * np.pi * rings) + 0.3 * (noise(rng, 1, 0.05) - 0.5)
    if kind == "marble":
        return np.abs(np.sin(2 * np.pi * (x + 2.5 * noise(rng, 2)))) ** 0.5
    if kind == "shapes":
        return _shapes(rng, x, y)
    return noise(rng, rng.uniform(0.8, 2))


def _shapes(rng: Generator, x: Array, y: Array) -> Array:
    """Overlapping disks and bars: pictures, posters, print."""
    value = np.full_like(x, rng.uniform())
    for _ in range(int(rng.integers(8, 40))):
        cx, cy, w, h = rng.uniform(size=4) * [1, 1, 0.25, 0.25]
        inside = (
            np.hypot((x - cx) / w, (y - cy) / h) < 1
            if rng.uniform() < 0.5
            else (abs(x - cx) < w) & (abs(y - cy) < h / 3)
        )
        value = np.where(inside, rng.uniform(), value)
    return value


KINDS = ("checker", "stripes", "bricks", "planks", "wood", "marble", "shapes", "noise")


def bitmap(values: Array, repeat: float = 1, raw: bool = True) -> mi.Texture:
    """A texture over linear values, H x W or H x W x 3, repeated over the unit square."""
    pixels = values if values.ndim == 3 else values[..., None]
    scale = mi.ScalarTransform4f().scale([repeat, repeat, 1])
    data = mi.Bitmap(np.ascontiguousarray(pixels, np.float32))
    return mi.load_dict({"type": "bitmap", "bitmap": data, "raw": raw, "to_uv": scale})


def coloured(rng: Generator, kind: str | None = None, repeat: float = 1) -> mi.Texture:
    """A pattern painted with two to four colours."""
    value = pattern(rng, kind or str(rng.choice(KINDS)))
    stops = np.sort(rng.uniform(size=int(rng.integers(2, 5))))
    base = np.array(colour(rng))
    paint = np.array([0.35 * base + 0.65 * np.array(colour(rng)) for _ in stops])
    pixels = np.stack([np.interp(value, stops, paint[:, i]) for i in range(3)], -1)
    return bitmap(pixels, repeat, raw=False)


def scalar(rng: Generator, low: float, high: float, repeat: float = 1) -> mi.Texture:
    """A pattern between two values: roughness, blend weights, bumps."""
    return bitmap(low + (high - low) * pattern(rng, str(rng.choice(KINDS))), repeat)


def leaf() -> mi.Texture:
    """Opacity of a leaf on its card."""
    y, x = np.meshgrid(*[np.linspace(-1, 1, 64)] * 2, indexing="ij")
    return bitmap(((x / (0.55 * (1 - y**2) + 1e-3)) ** 2 < 1).astype(float))


def environment(rng: Generator) -> mi.Emitter:
    """An environment map: gradient sky, ground, and soft boxes or a bright disk."""
    height, width = 64, 128
    v, u = np.meshgrid((np.arange(height) + 0.5) / height, (np.arange(width) + 0.5) / width, indexing="ij")
    sky, horizon, ground = (np.array(colour(rng, rng.uniform(0, 0.5), 0.1, 1)) for _ in range(3))
    up = np.clip(1 - 2 * v, 0, 1)[..., None] ** 0.5
    pixels = np.where(v[..., None] < 0.5, horizon + (sky - horizon) * up, 0.4 * ground)
    pixels = pixels * (0.5 + noise(rng, 1.8, size=width)[:height, :, None])
    for _ in range(int(rng.integers(1, 5))):
        cu, cv, size = rng.uniform(), rng.uniform(0.05, 0.5), rng.uniform(0.02, 0.1)
        du = np.abs((u - cu + 0.5) % 1 - 0.5)
        box = np.maximum(du / 2, abs(v - cv)) if rng.uniform() < 0.5 else np.hypot(du, abs(v - cv))
        strength = rng.uniform(0.02, 0.15) / size**2
        pixels += (box < size)[..., None] * strength * np.array(colour(rng, 0.2, 0.8, 1))
    upright = mi.ScalarTransform4f().rotate([0, 0, 1], rng.uniform(0, 360)).rotate([1, 0, 0], 90)
    return mi.load_dict({"type": "envmap", "bitmap": mi.Bitmap(pixels.astype(np.float32)), "to_world": upright})
