"""What grows or hangs: hair and grass as curves, trees, draped and crumpled cloth, wires."""

from __future__ import annotations

import tempfile
from pathlib import Path

import mitsuba as mi
import numpy as np
from numpy.random import Generator
from numpy.typing import NDArray

from . import meshes
from .meshes import Array, Surface, grid


def strands(points: NDArray[np.float64], radius: Array, bsdf: mi.BSDF, placement: Array) -> mi.Shape:
    """B-spline curves through points [curves, K >= 4, 3] with radii [K], placed by a 4 x 4 matrix."""
    world = points @ placement[:3, :3].T + placement[:3, 3]
    thick = np.broadcast_to(radius * np.cbrt(abs(np.linalg.det(placement[:3, :3]))), world.shape[:2])
    lines = [" ".join(f"{x:.5f}" for x in row) for curve in np.dstack([world, thick]) for row in [*curve, ()]]
    with tempfile.TemporaryDirectory() as folder:  # Mitsuba takes curves from a file only
        path = Path(folder) / "curves.txt"
        path.write_text("\n".join(lines))
        return mi.load_dict({"type": "bsplinecurve", "filename": str(path), "bsdf": bsdf})


def _grow(rng: Generator, roots: Array, way: Array, length: float, bend: float, knots: int = 6) -> Array:
    """Curves from roots [N, 3] along way [N, 3], bent by gravity and chance."""
    t = np.linspace(0, 1, knots)[None, :, None]
    lean = bend * (rng.normal(size=(len(roots), 1, 3)) * 0.5 + [0, 0, -0.5])
    tall = length * rng.uniform(0.6, 1, (len(roots), 1, 1))
    return roots[:, None] + tall * (way[:, None] * t + lean * t**2)


def fur(rng: Generator, count: int = 1500) -> tuple[Array, Array]:
    """Hair on a ball of radius 0.7 about the origin: points [count, 6, 3] and radii [6]."""
    way = rng.normal(size=(count, 3))
    way /= np.linalg.norm(way, axis=1, keepdims=True)
    points = _grow(rng, 0.68 * way, way, rng.uniform(0.25, 0.6), rng.uniform(0.1, 1))
    return points, np.linspace(rng.uniform(0.004, 0.012), 0.001, 6)


def tuft(rng: Generator, count: int = 250) -> tuple[Array, Array]:
    """A tuft of grass or bristles, 1 high, rooted in a disk of radius 0.35 on z = 0."""
    turn, far = rng.uniform(0, 2 * np.pi, count), 0.35 * rng.uniform(0, 1, count) ** 0.5
    roots = np.stack([far * np.cos(turn), far * np.sin(turn), 0 * far], -1)
    way = roots * rng.uniform(0.3, 1.5) + [0, 0, 1]
    return _grow(rng, roots, way, 1, rng.uniform(0.1, 0.7)), np.linspace(rng.uniform(0.008, 0.02), 0.002, 6)


def lawn(rng: Generator, side: float, count: int, height: float) -> tuple[Array, Array]:
    """Blades all over a square of this side."""
    roots = np.append(rng.uniform(-side / 2, side / 2, (count, 2)), np.zeros((count, 1)), 1)
    way = rng.normal(size=(count, 3)) * 0.25 + [0, 0, 1]
    return _grow(rng, roots, way, height, 0.5), np.linspace(0.04, 0.01, 6) * height


def merge(parts: list[Surface]) -> Surface:
    """Several surfaces as one."""
    first = np.cumsum([0, *(len(part.vertices) for part in parts)])
    faces = np.concatenate([part.faces + n for part, n in zip(parts, first, strict=False)])
    return Surface(
        np.concatenate([part.vertices for part in parts]), faces, np.concatenate([part.uv for part in parts]), True
    )


def tree(rng: Generator) -> tuple[Surface, Surface]:
    """Wood and leaf cards of a tree or shrub about 1 high."""
    ends, limbs = [], []
    stack = [(np.zeros(3), np.array([0, 0, 1.0]), rng.uniform(0.3, 0.5), 0.04, int(rng.integers(2, 4)))]
    while stack:
        root, way, length, radius, left = stack.pop()
        bow = 0.2 * rng.normal(size=3)

        def path(u: Array, root: Array = root, way: Array = way, length: float = length, bow: Array = bow) -> Array:
            return root + length * (u[..., None] * way + u[..., None] ** 2 * bow)

        limbs.append(meshes.tube(path, radius, 6, 8))
        tip = path(np.ones(1))[0]
        if left == 0:
            ends.append(tip)
            continue
        for _ in range(int(rng.integers(2, 5))):
            branch = way + 0.8 * rng.normal(size=3)
            stack.append((tip, branch / np.linalg.norm(branch), 0.65 * length, 0.6 * radius, left - 1))
    card = meshes.leaves(rng, int(rng.integers(3, 9)))
    crown = [card._replace(vertices=(card.vertices - [0, 0, 1]) @ _turn(rng) * 0.2 + end) for end in ends[:160]]
    return merge(limbs), merge(crown)._replace(smooth=False)


def _turn(rng: Generator) -> Array:
    matrix, _ = np.linalg.qr(rng.normal(size=(3, 3)))
    return matrix


def drape(rng: Generator, half: tuple[float, float], drop: float) -> Surface:
    """A cloth over a box top of half sizes `half`, z = 0, hanging down by `drop` with folds."""
    folds, phase = rng.integers(6, 14), rng.uniform(0, 6.3)

    def shape(u: Array, v: Array) -> tuple[Array, Array, Array]:
        x, y = (2 * u - 1) * (half[0] + drop), (2 * v - 1) * (half[1] + drop)
        over = np.hypot(np.maximum(np.abs(x) - half[0], 0), np.maximum(np.abs(y) - half[1], 0))
        wave = 0.12 * np.sin(folds * np.arctan2(y, x) + phase) * np.minimum(over / drop, 1) + 0.05
        x, y = (np.sign(c) * (np.minimum(np.abs(c), h) + wave * over) for c, h in ((x, half[0]), (y, half[1])))
        return x, y, 0.008 - np.minimum(over, drop)

    return grid(shape, 96, 96)


def crumple(rng: Generator) -> Surface:
    """A sheet thrown on the floor over [-1, 1] x [-1, 1], with creases."""
    waves, phase = rng.normal(size=(14, 2)) * 4, rng.uniform(0, 6, 14)
    height = rng.uniform(0.1, 0.35)

    def shape(u: Array, v: Array) -> tuple[Array, Array, Array]:
        x, y = 2 * u - 1, 2 * v - 1
        crease = 1 - np.abs(np.sin(np.stack([x, y], -1) @ waves.T + phase))
        z = height * (crease**2 / (1 + np.linalg.norm(waves, axis=1))).sum(-1)
        rim = 1 + 0.05 * np.sin(9 * np.arctan2(y, x) + phase[0])
        return x * rim, y * rim, z + 0.005

    return grid(shape, 110, 110)


def wire(rng: Generator) -> Surface:
    """A closed loop that wanders within a ball of radius about 1: hose, pretzel, sculpture."""
    waves = rng.normal(size=(3, 3, 2)) / np.arange(1, 4)[:, None, None]

    def path(u: Array) -> Array:
        a = 2 * np.pi * u[..., None, None] * np.arange(1, 4)[:, None]
        return 0.5 * (waves[..., 0] * np.cos(a) + waves[..., 1] * np.sin(a)).sum(-2)

    return meshes.tube(path, rng.uniform(0.04, 0.12), 300, 16, int(rng.choice([0, 0, 4, 6])))
