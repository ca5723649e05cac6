"""Small worlds: still lifes, close-ups of one thing, and arrangements of many."""

from __future__ import annotations

import numpy as np
from numpy.random import Generator

from . import furniture, growth, lights, materials, meshes, solids
from .cameras import Camera, Propose, orbit
from .meshes import Array, frame
from .meshes import at as floor_at
from .stage import Stage, emission, warm


def _backdrop(stage: Stage) -> None:
    """What stands under and behind the objects: a curved sweep, a slab, a cloth, or a corner of two walls."""
    rng, tones = stage.rng, stage.tones
    cover = materials.opaque(rng, tones, 0.5, float(rng.integers(1, 8)))
    pick = rng.uniform()
    if pick < 0.35:
        path = np.array([[-3.0, 0], [0.4, 0], [0.9, 0.1], [1.15, 0.35], [1.25, 0.9], [1.25, 3]])

        def sweep(u: Array, v: Array) -> tuple[Array, Array, Array]:
            at = u * (len(path) - 1)
            y, z = (np.interp(at, np.arange(len(path)), path[:, i]) for i in (0, 1))
            return 5 * (v - 0.5), y, z

        stage.mesh(meshes.grid(sweep, 40, 8), cover, frame(yaw=rng.uniform(0, 6.3)))
        return
    stage.box((6, 6, 0.1), cover, frame(), (0, 0, -0.1))
    if pick < 0.6:
        wall, turn = materials.opaque(rng, tones, 0.5, 2), frame(yaw=rng.uniform(0, 6.3))
        stage.box((6, 0.1, 3), wall, turn, (0, 1.3, 0))
        stage.box((0.1, 6, 3), wall, turn, (1.3, 0, 0))
    elif pick < 0.72:
        stage.mesh(growth.crumple(rng), stage.material(), frame(yaw=rng.uniform(0, 6.3), scale=np.array([1, 1, 0.25])))


def _light(stage: Stage) -> None:
    """Sky, studio lights, a spot, or a lamp among the things."""
    rng = stage.rng
    pick = rng.uniform()
    if pick < 0.42:
        lights.sky(stage)
    elif pick < 0.82:
        lights.key_lights(stage, 1.3)
    elif pick < 0.9:
        turn = rng.uniform(0, 6.3)
        origin = [1.5 * np.cos(turn), 1.5 * np.sin(turn), rng.uniform(0.5, 2)]
        lights.spot(stage, origin, rng.uniform(-0.2, 0.2, 3), rng.uniform(5, 20), rng.uniform(12, 40))
        lights.even(stage, 0.02, 0.2)
    else:
        at = floor_at(rng.uniform(-0.4, 0.4, 2))
        lights.lantern(stage, at, rng.uniform(2, 10), rng.uniform(0.15, 0.3))
        lights.even(stage, 0.01, 0.1)


def still_life(stage: Stage, blur: float) -> Propose:
    """A few things on a table."""
    rng = stage.rng
    _backdrop(stage)
    wide = rng.uniform(0.7, 1.5)
    furniture.scatter(stage, frame(), (wide, wide), int(rng.integers(3, 14)), (0.1, rng.uniform(0.25, 0.7)))
    _light(stage)
    return lambda rng: orbit(rng, rng.uniform([-0.3, -0.3, 0.05], [0.3, 0.3, 0.25]), (0.7, 1.25), (8, 65), blur)


def close_up(stage: Stage, blur: float) -> Propose:
    """One or two things that fill the picture, often with a shallow depth of field."""
    rng, tones = stage.rng, stage.tones
    _backdrop(stage)
    relief = materials.opaque(rng, tones, 0.6, float(rng.integers(1, 5)), str(rng.choice(["bump", "normal", "fabric"])))
    kinds = [k for k in furniture.ITEMS if k not in ("block", "shade")]
    for i, kind in enumerate(rng.permutation(kinds)[: rng.integers(1, 4)]):
        at = frame(0.42 * i, 0.2 * i * rng.normal())
        furniture.item(stage, at, rng.uniform(0.3, 0.45), relief if rng.uniform() < 0.4 else None, str(kind))
    _light(stage)

    def propose(rng: Generator) -> Camera:
        target = np.array([rng.uniform(-0.1, 0.2), rng.normal() * 0.06, rng.uniform(0.1, 0.3)])
        return orbit(rng, target, (0.4, 0.6), (2, 55), blur, (22, 50))

    return propose


def arrangement(stage: Stage, blur: float) -> Propose:
    """Many things in an order: a grid, rings, a spiral, towers, a heap, a cloud in the air, a relief on the ground."""
    rng = stage.rng
    order = str(rng.choice(["grid", "rings", "spiral", "towers", "heap", "cloud", "relief"]))
    if order != "cloud" or rng.uniform() < 0.4:
        ground = materials.opaque(rng, stage.tones, 0.4, float(rng.integers(2, 9)))
        stage.box((9, 9, 0.1), ground, frame(), (0, 0, -0.1 if order != "cloud" else -1.2))
    shapes = [_shape(rng) for _ in range(int(rng.integers(1, 4)))]
    skins = [stage.any_material() for _ in range(int(rng.integers(1, 5)))]
    glow = rng.uniform(2, 12) if rng.uniform() < 0.25 else 0
    for number, (at, size) in enumerate(_places(rng, order)):
        surface = shapes[number % len(shapes)]
        turn = frame(yaw=rng.uniform(0, 6.3) if order in ("heap", "cloud") else 0.0)
        low = surface.vertices[:, 2].min() * (order != "cloud")
        placement = frame(*at) @ turn @ frame(z=-low * size, scale=size)
        lit = glow > 0 and number % 7 == 3
        light = emission(glow, warm(rng)) if lit else None
        stage.mesh(surface, skins[rng.integers(len(skins))] if not lit else stage.material("matte"), placement, light)
    _light(stage)
    centre = np.array([0, 0, 0.0 if order == "cloud" else 0.15])
    return lambda rng: orbit(
        rng, centre + rng.uniform(-0.35, 0.35, 3) * [1, 1, 0.3], (0.8, 2.2), (4, 80), blur, (25, 75)
    )


def _shape(rng: Generator) -> meshes.Surface:
    kind = str(rng.choice(["carved", "hull", "turned", "quadric", "blob", "knot", "text", "box"]))
    if kind in ("carved", "hull", "turned"):
        surface = getattr(solids, kind)(rng)
    elif kind == "text":
        surface = solids.text(rng, 1)
    elif kind == "quadric":
        surface = meshes.superquadric(rng.uniform(0.15, 2), rng.uniform(0.15, 2), 32)
    elif kind == "box":
        surface = meshes.superquadric(0.1, 0.1, 24)
    else:
        surface = meshes.knot(rng) if kind == "knot" else meshes.blob(rng, 0.3, 48)
    span = np.ptp(surface.vertices, 0).max()
    return surface._replace(vertices=surface.vertices / span * 2)


def _places(rng: Generator, order: str) -> list[tuple[Array, float]]:
    """Points and radii of about 20 to 60 things within about 1 of the origin."""
    if order in ("grid", "relief"):
        n = int(rng.integers(4, 8))
        side = np.linspace(-1, 1, n)
        wave = rng.uniform(0.3, 1, (n, n)) if order == "relief" else np.full((n, n), rng.uniform(0.4, 0.9))
        return [(np.array([x, y, 0]), wave[i, j] / n) for i, x in enumerate(side) for j, y in enumerate(side)]
    if order in ("rings", "spiral"):
        count = int(rng.integers(18, 50))
        t = (np.arange(count) + 0.5) / count
        turns = rng.integers(2, 5)
        far = 0.15 + 0.85 * (np.ceil(t * turns) / turns if order == "rings" else t)
        rise = (t if order == "spiral" else 0 * t) * rng.choice([0, rng.uniform(0.3, 1)])
        a = 2 * np.pi * turns * t
        return [(np.array([f * np.cos(b), f * np.sin(b), z]), 0.1) for f, b, z in zip(far, a, rise, strict=True)]
    if order == "towers":
        spots = rng.uniform(-0.9, 0.9, (int(rng.integers(4, 11)), 2))
        return [
            (np.array([*spot, 0.22 * level]), 0.11 * rng.uniform(0.7, 1))
            for spot in spots
            for level in range(rng.integers(1, 6))
        ]
    spread = np.array([0.45, 0.45, 0.12 if order == "heap" else 0.45])
    count = int(rng.integers(15, 45))
    return [
        (np.abs(p) * [np.sign(p[0]), np.sign(p[1]), 1 if order == "heap" else np.sign(p[2])], r)
        for p, r in zip(rng.normal(size=(count, 3)) * spread, rng.uniform(0.06, 0.2, count), strict=True)
    ]
