"""Textures and environment maps made in code, as Mitsuba plugins holding linear float bitmaps."""

from __future__ import annotations

import mitsuba as mi
import numpy as np
from numpy.random import Generator
from numpy.typing import NDArray

from .tones import Tones

Array = NDArray[np.float64]
SIZE = 256


def colour(rng: Generator, saturation: float | None = None, low: float = 0.05, high: float = 0.85) -> list[float]:
    """An RGB for lights and skies; mostly muted, sometimes vivid."""
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
    if kind in ("tiles", "dots", "weave"):
        return _regular(rng, kind, x, y, 2 * n)
    if kind == "cells":
        return _cells(rng, x, y, n * n + 6)
    if kind == "plaid":
        bands = rng.uniform(size=(2, 3 * n))
        return 0.5 * (bands[0, (x * 3 * n).astype(int)] + bands[1, (y * 3 * n).astype(int)])
    if kind == "stains":
        return 0.5 + 0.45 * np.tanh(9 * (noise(rng, rng.uniform(1.2, 2)) - rng.uniform(0.4, 0.6)))
    return noise(rng, rng.uniform(0.8, 2))


def _regular(rng: Generator, kind: str, x: Array, y: Array, n: int) -> Array:
    """Tiles with joints, a raster of dots, or threads over and under one another; n to a side."""
    u, v = (x * n) % 1 - 0.5, (y * n) % 1 - 0.5
    column, row = (x * n).astype(int), (y * n).astype(int)
    if kind == "tiles":
        joint = np.maximum(abs(u), abs(v)) < 0.46
        return joint * (0.45 + 0.5 * (rng.uniform(size=(n, n)) ** rng.uniform(0.3, 4))[row, column])
    if kind == "dots":
        return np.clip(0.5 + 12 * (rng.uniform(0.2, 0.42) - np.hypot(u, v)), 0, 1)
    over = (column + row) % 2 == 0
    return np.where(over, np.cos(np.pi * v) * (0.75 + 0.25 * np.cos(2 * np.pi * u)), 0.8 * np.cos(np.pi * u))


def _cells(rng: Generator, x: Array, y: Array, count: int) -> Array:
    """Cracked ground, scales or leather: distance to the edge between the two nearest of some points."""
    from scipy.spatial import KDTree

    near, _ = KDTree(rng.uniform(size=(count, 2)), boxsize=1).query(np.stack([x, y], -1), 2)
    return np.clip((near[..., 1] - near[..., 0]) * np.sqrt(count) * 1.2, 0, 1)


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


KINDS = (
    *("checker", "stripes", "bricks", "planks", "wood", "marble", "shapes", "noise"),
    *("tiles", "dots", "weave", "cells", "plaid", "stains"),
)
RELIEF = ("bricks", "planks", "tiles", "dots", "weave", "cells", "noise", "stains")


def bitmap(values: Array, repeat: float = 1, raw: bool = True) -> mi.Texture:
    """A texture over linear values, H x W or H x W x 3, repeated over the unit square."""
    pixels = values if values.ndim == 3 else values[..., None]
    scale = mi.ScalarTransform4f().scale([repeat, repeat, 1])
    data = mi.Bitmap(np.ascontiguousarray(pixels, np.float32))
    return mi.load_dict({"type": "bitmap", "bitmap": data, "raw": raw, "to_uv": scale})


def coloured(rng: Generator, tones: Tones, kind: str | None = None, repeat: float = 1) -> mi.Texture:
    """A pattern painted with two to four colours, from quiet to loud."""
    value = pattern(rng, kind or str(rng.choice(KINDS)))
    stops = np.sort(rng.uniform(size=int(rng.integers(2, 5))))
    base, loud = np.array(tones.colour(rng)), rng.uniform(0.2, 1)
    paint = np.array([(1 - loud) * base + loud * np.array(tones.colour(rng)) for _ in stops])
    pixels = np.stack([np.interp(value, stops, paint[:, i]) for i in range(3)], -1)
    return bitmap(pixels, repeat, raw=False)


def scalar(rng: Generator, low: float, high: float, repeat: float = 1) -> mi.Texture:
    """A pattern between two values: roughness, blend weights, bumps."""
    return bitmap(low + (high - low) * pattern(rng, str(rng.choice(KINDS))), repeat)


def slopes(rng: Generator, repeat: float = 1) -> mi.Texture:
    """A normal map: the directions of a relief, as RGB."""
    height = pattern(rng, str(rng.choice(RELIEF)))
    dy, dx = (np.roll(height, -1, axis) - np.roll(height, 1, axis) for axis in (0, 1))
    steep = rng.uniform(0.1, 0.5) / max(float(np.hypot(dx, dy).std()), 1e-3)
    normal = np.stack([-steep * dx, -steep * dy, np.ones_like(dx)], -1)
    normal[..., :2] = np.clip(normal[..., :2], -1.5, 1.5)
    return bitmap(0.5 + 0.5 * normal / np.linalg.norm(normal, axis=-1, keepdims=True), repeat)


def leaf(rng: Generator) -> mi.Texture:
    """Opacity of a leaf on its card: pointed, round, lobed, or a fan of blades."""
    y, x = np.meshgrid(*[np.linspace(-1, 1, 64)] * 2, indexing="ij")
    turn, far, kind = np.arctan2(x, y + 0.9), np.hypot(x, y + 0.9), rng.integers(4)
    if kind == 0:
        inside = np.abs(x) < rng.uniform(0.25, 0.7) * (1 - y**2)
    elif kind == 1:
        inside = np.hypot(x / 0.8, y) < 1
    elif kind == 2:
        inside = np.hypot(x, y) < 0.7 + 0.28 * np.cos(rng.integers(3, 7) * np.arctan2(x, y))
    else:
        inside = (np.cos(rng.integers(7, 15) * turn) > 0.2) & (far < 1.8)
    return bitmap(inside.astype(float))


def holes(rng: Generator, repeat: float = 1) -> mi.Texture:
    """Opacity of a perforated sheet, a grille, lace or torn cloth."""
    value = pattern(rng, str(rng.choice(["dots", "cells", "checker", "stripes", "stains", "tiles"])))
    return bitmap((value > rng.uniform(0.3, 0.5)).astype(float), repeat)
