"""Closed solids: cut and joined from signed distances, letters, turned and twisted profiles, hulls of points."""

from __future__ import annotations

from pathlib import Path

import numpy as np
from numpy.random import Generator

from .meshes import Array, Surface, grid

LETTERS = "ABCDEFGHKLMNPRSTUVXYZ23456789&?"


def contour(values: Array, low: Array, high: Array) -> Surface:
    """The closed surface where values [X, Y, Z] (negative inside) over the box from low to high change their sign."""
    from skimage.measure import marching_cubes

    step = (high - low) / (np.array(values.shape) - 1)
    closed = np.pad(values, 1, constant_values=max(float(values.max()), 1e-3))
    vertices, faces, _, _ = marching_cubes(closed, 0, gradient_direction="descent")
    vertices = low + (vertices - 1) * step
    uv = np.stack([vertices[:, 0] + 0.6 * vertices[:, 2], vertices[:, 1] + 0.8 * vertices[:, 2]], -1)
    return Surface(vertices.astype(float), faces.astype(np.int64), uv.astype(float))


def _box(p: Array, half: Array) -> Array:
    q = np.abs(p) - half
    return np.linalg.norm(np.maximum(q, 0), axis=-1) + np.minimum(q.max(-1), 0)


def _rod(p: Array, radius: float, axis: int) -> Array:
    return np.linalg.norm(np.delete(p, axis, -1), axis=-1) - radius


def _join(a: Array, b: Array, soft: float) -> Array:
    """Union with a fillet of size `soft`."""
    blend = np.clip(0.5 + 0.5 * (b - a) / soft, 0, 1)
    return b + (a - b) * blend - soft * blend * (1 - blend)


def _body(rng: Generator, p: Array) -> Array:
    pick = rng.integers(4)
    if pick == 0:
        return _box(p, rng.uniform(0.45, 0.85, 3)) - 0.04
    if pick == 1:
        return np.linalg.norm(p, axis=-1) - 0.9
    if pick == 2:
        return np.maximum(_rod(p, rng.uniform(0.4, 0.8), 2), np.abs(p[..., 2]) - rng.uniform(0.3, 0.9))
    ring = np.linalg.norm(p[..., :2], axis=-1) - 0.62
    return np.hypot(ring, p[..., 2]) - rng.uniform(0.15, 0.3)


def carved(rng: Generator, detail: int = 44) -> Surface:
    """A body drilled, hollowed, crossed with another or turned into a lattice; within [-1, 1]^3."""
    p = np.stack(np.meshgrid(*[np.linspace(-1, 1, detail)] * 3, indexing="ij"), -1)
    d = _body(rng, p)
    kind = str(rng.choice(["drilled", "shell", "joined", "lattice", "bitten"]))
    if kind == "drilled":
        for axis in range(3):
            if rng.uniform() < 0.7:
                d = np.maximum(d, -_rod(p - rng.uniform(-0.3, 0.3, 3), rng.uniform(0.12, 0.35), axis))
    elif kind == "shell":
        d = np.maximum(np.abs(d + 0.08) - 0.06, p @ _direction(rng) - rng.uniform(0.1, 0.4))
    elif kind == "joined":
        for _ in range(int(rng.integers(1, 4))):
            d = _join(d, np.linalg.norm(p - rng.uniform(-0.6, 0.6, 3), axis=-1) - rng.uniform(0.2, 0.38), 0.15)
    elif kind == "lattice":
        q = p * rng.uniform(4, 8)
        wave = sum(np.sin(q[..., i]) * np.cos(q[..., (i + 1) % 3]) for i in range(3))
        d = np.maximum(d, (np.abs(wave) - rng.uniform(0.3, 0.8)) / 8)
    else:
        for _ in range(int(rng.integers(1, 5))):
            d = np.maximum(d, rng.uniform(0.2, 0.5) - np.linalg.norm(p - 0.9 * _direction(rng), axis=-1))
    if (d < 0).sum() < 0.01 * d.size:
        d = np.linalg.norm(p, axis=-1) - 0.8
    return contour(d, np.full(3, -1.0), np.full(3, 1.0))


def _direction(rng: Generator) -> Array:
    v = rng.normal(size=3)
    return v / np.linalg.norm(v)


def text(rng: Generator, letters: int | None = None) -> Surface:
    """Raised letters, standing on z = 0 in the x-z plane, 1 high, about 0.25 deep."""
    import matplotlib as mpl
    from PIL import Image, ImageDraw, ImageFont
    from scipy.ndimage import gaussian_filter

    word = "".join(rng.choice(list(LETTERS), letters or int(rng.integers(1, 6))))
    face = rng.choice(["DejaVuSans-Bold", "DejaVuSerif-Bold", "DejaVuSansMono-Bold", "STIXGeneralBol"])
    font = ImageFont.truetype(str(Path(mpl.get_data_path()) / "fonts" / "ttf" / f"{face}.ttf"), 48)
    left, top, right, bottom = (int(n) for n in font.getbbox(word))
    image = Image.new("L", (right - left + 4, bottom - top + 4))
    ImageDraw.Draw(image).text((2 - left, 2 - top), word, 255, font)
    plane = 0.5 - gaussian_filter(np.array(image, float)[::-1].T / 255, 0.7)
    wide, tall = plane.shape
    layers = np.repeat(plane[:, None], 5, 1)
    layers[:, [0, -1]] = np.maximum(layers[:, [0, -1]], 0.1)
    half = 0.5 * wide / tall
    return contour(layers, np.array([-half, -0.1, 0.0]), np.array([half, 0.1, 1.0]))


def turned(rng: Generator, detail: int = 120) -> Surface:
    """A star-, gear- or petal-shaped profile swept up z from 0 to 1, twisted and tapered; radius at most about 0.6."""
    lobes, depth, sharp = int(rng.integers(3, 13)), rng.uniform(0.05, 0.35), rng.uniform(0.5, 4)
    twist, taper, belly = rng.choice([0, rng.uniform(-2, 2)]), rng.uniform(-0.7, 0.3), rng.uniform(-0.3, 0.4)
    height = np.concatenate([[0], np.linspace(0, 1, 28), [1]])
    reach = np.concatenate([[0], np.ones(28), [0]])

    def shape(u: Array, v: Array) -> tuple[Array, Array, Array]:
        z, rim = (np.interp(v * (len(height) - 1), np.arange(len(height)), part) for part in (height, reach))
        wave = np.tanh(sharp * np.cos(2 * np.pi * lobes * u)) / np.tanh(sharp)
        r = 0.4 * rim * (1 + depth * wave) * (1 + taper * (z - 0.5) + belly * np.sin(np.pi * z))
        a = 2 * np.pi * u + twist * z
        return r * np.cos(a), r * np.sin(a), z

    return grid(shape, detail, len(height) - 1)


def hull(rng: Generator) -> Surface:
    """Flat-faced rock, crystal or die: the convex hull of random points, radius about 1."""
    from scipy.spatial import ConvexHull

    points = rng.normal(size=(int(rng.integers(6, 60)), 3))
    points *= (rng.uniform(0.75, 1, (len(points), 1)) / np.linalg.norm(points, axis=1, keepdims=True)) * [1, 1, 0.8]
    faces = ConvexHull(points).simplices
    corners = points[faces]
    outward = np.einsum(
        "fk,fk->f", np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0]), corners.mean(1)
    )
    faces = np.where((outward < 0)[:, None], faces[:, ::-1], faces)
    used, index = np.unique(faces, return_inverse=True)
    vertices = points[used]
    return Surface(
        vertices, index.reshape(faces.shape).astype(np.int64), vertices[:, :2] + 0.7 * vertices[:, 2:], False
    )
