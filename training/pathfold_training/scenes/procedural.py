"""Scenes made in code from one seed: furnished rooms, still lifes, gardens; and where their cameras may stand."""

from __future__ import annotations

from collections.abc import Callable
from typing import NamedTuple

import mitsuba as mi
import numpy as np
from numpy.random import Generator

from . import furniture, materials, meshes, textures
from .cameras import Camera
from .meshes import Array, frame
from .meshes import at as floor_at
from .stage import Stage, warm

UP = np.array([0.0, 0, 1])


class Built(NamedTuple):
    """A stage to load, its kind, the path depth that suits it, and where cameras may stand."""

    stage: Stage
    kind: str
    max_depth: int
    propose: Callable[[Generator], Camera | None]


def build(seed: int, kind: str | None = None) -> Built:
    """The same seed always gives the same scene; a Mitsuba variant must be set."""
    rng = np.random.default_rng(seed)
    kind = kind or str(rng.choice(["room", "still-life", "garden"], p=[0.58, 0.25, 0.17]))
    stage = Stage(rng)
    blur = float(rng.choice([0, rng.uniform(0.005, 0.03)], p=[0.7, 0.3]))
    stage.camera(blur)
    propose = {"room": _room, "still-life": _still_life, "garden": _garden}[kind](stage, blur)
    return Built(stage, kind, int(rng.choice([6, 6, 7, 8])), propose)


# Light from outside


def _sky(stage: Stage) -> None:
    """Sun and sky, an environment map, or an even sky."""
    rng = stage.rng
    pick = rng.uniform()
    if pick < 0.5:
        height, turn = np.radians(rng.uniform(12, 65)), rng.uniform(0, 2 * np.pi)
        sun = [np.cos(height) * np.cos(turn), np.cos(height) * np.sin(turn), np.sin(height)]
        scale = {
            "sun_scale": rng.uniform(0.1, 1),
            "sky_scale": rng.uniform(0.5, 2),
            "sun_aperture": rng.uniform(0.5, 4),
        }
        stage.put({"type": "sunsky", "sun_direction": list(map(float, sun)), "turbidity": rng.uniform(2, 7)} | scale)
    elif pick < 0.85:
        stage.put(textures.environment(rng))
    else:
        stage.put({"type": "constant", "radiance": {"type": "rgb", "value": textures.colour(rng, 0.15, 0.5, 1)}})


# Rooms


def _wall(
    stage: Stage, place: Array, length: float, height: float, paint: mi.BSDF, openings: list[tuple[float, ...]]
) -> None:
    """A wall along x with its inner face on y = 0 and openings (x0, x1, z0, z1), from left to right."""
    thick = 0.15

    def slab(x0: float, x1: float, z0: float, z1: float) -> None:
        if x1 - x0 > 1e-3 and z1 - z0 > 1e-3:
            stage.box((x1 - x0, thick, z1 - z0), paint, place, ((x0 + x1) / 2, thick / 2, z0))

    left = -length / 2 - thick
    for x0, x1, z0, z1 in openings:
        slab(left, x0, 0, height)
        slab(x0, x1, 0, z0)
        slab(x0, x1, z1, height)
        left = x1
    slab(left, length / 2 + thick, 0, height)


def _windows(stage: Stage, place: Array, length: float, height: float) -> list[tuple[float, ...]]:
    """Window openings in a wall, dressed with bars, panes, blinds or curtains."""
    rng = stage.rng
    count = int(rng.integers(1, max(2, int(length / 1.6)) + 1))
    cell = length / count
    wide, low = cell * rng.uniform(0.35, 0.8), rng.uniform(0.1, 1.0)
    high = min(height - 0.15, low + rng.uniform(0.7, 1.8))
    dressing, glazed = rng.uniform(), rng.uniform() < 0.3
    bars = stage.material("matte")
    pane = materials.pane() if glazed else None
    openings: list[tuple[float, ...]] = []
    for i in range(count):
        middle = (i + 0.5) * cell - length / 2
        openings.append((middle - wide / 2, middle + wide / 2, low, high))
        at = place @ frame(middle, 0.08, low)
        stage.box((0.04, 0.04, high - low), bars, at)
        stage.box((wide, 0.04, 0.04), bars, at, (0, 0, (high - low) / 2))
        if pane is not None:
            stage.box((wide, 0.006, high - low), pane, at, (0, 0.03, 0))
        if dressing < 0.25:
            furniture.blinds(stage, place @ frame(middle, 0.02, low), wide, high - low)
        elif dressing < 0.5:
            cover = stage.material()
            for side in (-1, 1):
                size = np.array([0.45 * wide, 1, high - low + 0.3])
                sheet = place @ frame(middle + side * 0.42 * wide, -0.12, low - 0.15, scale=size)
                stage.mesh(meshes.cloth(rng), cover, sheet)
    return openings


def _next_room(stage: Stage, place: Array, paint: mi.BSDF, height: float) -> list[tuple[float, ...]]:
    """A door ajar, and behind it a bright room that lights ours through the gap."""
    rng = stage.rng
    x = rng.uniform(-0.6, 0.6)
    door = place @ frame(x - 0.45, 0.02, 0, rng.uniform(0.5, 1.7))
    stage.box((0.88, 0.04, 2.02), stage.material(), door, (0.44, 0, 0))
    stage.mesh(meshes.superquadric(1, 1, 16), stage.material("metal"), door @ frame(0.8, -0.05, 1, scale=0.035))
    back = place @ frame(x, 0.15)
    for size, at in (
        ((3, 0.1, height), (0, 2.6, 0)),
        ((0.1, 2.6, height), (-1.5, 1.3, 0)),
        ((0.1, 2.6, height), (1.5, 1.3, 0)),
    ):
        stage.box(size, paint, back, at)
    for z in (-0.1, height):
        stage.box((3, 2.7, 0.1), paint, back, (0, 1.3, z))
    lamp = (back @ [rng.uniform(-0.9, 0.9), 1.6, height - 0.05, 1])[:3]
    stage.area_light(lamp, lamp - UP, rng.uniform(0.3, 1.2, 2), rng.uniform(100, 500), warm(rng))
    return [(x - 0.45, x + 0.45, 0, 2.05)]


def _lamps(stage: Stage, size: Array, mode: str) -> None:
    """Light from inside the room."""
    rng = stage.rng
    x, y, z = size
    if mode == "panel":
        for _ in range(int(rng.integers(1, 4))):
            at = floor_at(rng.uniform(-0.35, 0.35, 2) * [x, y], z)
            furniture.panel(stage, at, tuple(rng.uniform(0.2, 1.2, 2)), rng.uniform(20, 80))
    elif mode == "pendant":
        for _ in range(int(rng.integers(1, 4))):
            furniture.pendant(stage, floor_at(rng.uniform(-0.3, 0.3, 2) * [x, y], z), rng.uniform(15, 60))
    elif mode == "floor":
        for _ in range(int(rng.integers(1, 3))):
            at = rng.choice([-1, 1], 2) * ([x, y] * rng.uniform(0.3, 0.42, 2))
            furniture.floor_lamp(stage, floor_at(at), rng.uniform(20, 80))
    elif mode == "many":
        for _ in range(int(rng.integers(12, 30))):
            at = rng.uniform(-0.45, 0.45, 3) * size + [0, 0, 0.62 * z]
            stage.bulb(
                np.minimum(at, [x, y, z - 0.1]), rng.uniform(0.015, 0.04), rng.uniform(1, 5), rng.uniform(0.15, 1, 3)
            )
    else:
        _spots(stage, size, int(rng.integers(2, 6)))


def _spots(stage: Stage, size: Array, count: int) -> None:
    rng = stage.rng
    for _ in range(count):
        x, y = rng.uniform(-0.4, 0.4, 2) * size[:2]
        target = [x + rng.uniform(-1, 1), y + rng.uniform(-1, 1), size[2] if rng.uniform() < 0.25 else 0]
        origin = [x, y, 1.2 if target[2] > 0 else size[2] - 0.15]
        pose = {"to_world": _look(origin, target), "cutoff_angle": rng.uniform(15, 45)}
        power = [float(t) * rng.uniform(8, 40) for t in warm(rng)]
        stage.put({"type": "spot", "intensity": {"type": "rgb", "value": power}} | pose)


def _look(origin: list[float], target: list[float]) -> mi.ScalarTransform4f:
    return mi.ScalarTransform4f().look_at([float(v) for v in origin], [float(v) for v in target], [0.1, 0.99, 0.01])


def _furnish(stage: Stage, size: Array) -> None:
    """Furniture along the walls and in the middle."""
    rng = stage.rng
    x, y, z = size
    sides = [
        (frame(0, y / 2, 0, 0), x),
        (frame(0, -y / 2, 0, np.pi), x),
        (frame(-x / 2, 0, 0, np.pi / 2), y),
        (frame(x / 2, 0, 0, -np.pi / 2), y),
    ]
    for place, length in sides:
        for slot in (-0.25, 0.25):
            at = place @ frame(slot * length, -0.28)
            width = 0.42 * length
            pick = rng.uniform()
            if pick < 0.17:
                furniture.shelf(stage, at, width * 0.8, rng.uniform(1, min(2.2, z - 0.2)))
            elif pick < 0.34:
                furniture.cabinet(stage, at, width * rng.uniform(0.5, 0.9), rng.uniform(0.5, 1.1))
            elif pick < 0.46:
                furniture.sofa(stage, at @ frame(y=-0.3))
            elif pick < 0.56:
                furniture.plant(stage, at @ frame(y=-0.2), rng.uniform(0.7, 1.7))
            elif pick < 0.8:
                furniture.picture(stage, place @ frame(slot * length, -0.02, rng.uniform(1.1, 1.4)))
    for _ in range(int(rng.integers(1, 3))):
        spot = floor_at(rng.uniform(-0.2, 0.2, 2) * size[:2], 0, rng.uniform(0, 6.3))
        wide, deep = rng.uniform(0.8, 1.8), rng.uniform(0.6, 1.0)
        furniture.table(stage, spot, (wide, deep, rng.uniform(0.4, 0.8)), int(rng.integers(3, 9)))
        for side in range(int(rng.integers(0, 5))):
            turn = frame(yaw=side * np.pi / 2 + rng.normal() * 0.15)
            furniture.chair(stage, spot @ turn @ frame(y=(wide if side % 2 else deep) / 2 + 0.3))
    furniture.scatter(stage, frame(), (0.7 * x, 0.7 * y), int(rng.integers(0, 6)), (0.15, 0.6))


def _room(stage: Stage, blur: float) -> Callable[[Generator], Camera | None]:
    rng = stage.rng
    size = np.array([rng.uniform(3.2, 6.5), rng.uniform(3.2, 6.5), rng.uniform(2.4, 3.3)])
    x, y, z = size
    paint, other = (
        materials.matte(rng),
        (materials.opaque(rng, 0.7, 2) if rng.uniform() < 0.4 else materials.matte(rng)),
    )
    floor, lid = materials.opaque(rng, 0.75, float(rng.integers(2, 6))), materials.matte(rng, 0.6)
    stage.box((x + 0.4, y + 0.4, 0.1), floor, frame(), (0, 0, -0.1))
    stage.box((x + 0.4, y + 0.4, 0.1), lid, frame(), (0, 0, z))
    modes = ["window", "ajar", "panel", "pendant", "floor", "many", "spots"]
    mode = str(rng.choice(modes, p=[0.42, 0.16, 0.1, 0.1, 0.08, 0.07, 0.07]))
    walls = [
        (frame(0, y / 2), x),
        (frame(x / 2, 0, 0, -np.pi / 2), y),
        (frame(0, -y / 2, 0, np.pi), x),
        (frame(-x / 2, 0, 0, np.pi / 2), y),
    ]
    opened = set(rng.permutation(4)[: 1 if mode == "ajar" or rng.uniform() < 0.5 else 2])
    for i, (place, length) in enumerate(walls):
        colour, openings = (other if i == 0 else paint), []
        if i in opened and mode == "window":
            openings = _windows(stage, place, length, z)
        elif i in opened and mode == "ajar":
            openings = _next_room(stage, place, paint, z)
        _wall(stage, place, length, z, colour, openings)
    if mode == "window":
        _sky(stage)
        stage.box((60, 60, 0.1), stage.material("matte"), frame(), (0, 0, -0.4))
    elif mode != "ajar":
        _lamps(stage, size, mode)
    elif rng.uniform() < 0.3:
        furniture.pendant(stage, frame(0.2 * x, 0.2 * y, z), 2)
    _furnish(stage, size)

    def propose(rng: Generator) -> Camera:
        origin = np.append(
            rng.choice([-1, 1], 2) * rng.uniform(0.2, 0.46, 2) * size[:2], rng.uniform(0.9, min(2.1, z - 0.3))
        )
        target = np.append(rng.uniform(-0.25, 0.25, 2) * size[:2], rng.uniform(0.3, 1.3))
        return Camera(origin, target, UP, rng.uniform(40, 80), blur)

    return propose


# Still lifes and gardens


def _backdrop(stage: Stage) -> None:
    """What stands under and behind the objects: a curved sweep, a slab, or a corner of two walls."""
    rng = stage.rng
    cover = materials.opaque(rng, 0.6, float(rng.integers(1, 8)))
    if rng.uniform() < 0.5:
        path = np.array([[-3.0, 0], [0.4, 0], [0.9, 0.1], [1.15, 0.35], [1.25, 0.9], [1.25, 3]])

        def sweep(u: Array, v: Array) -> tuple[Array, Array, Array]:
            at = u * (len(path) - 1)
            y, z = (np.interp(at, np.arange(len(path)), path[:, i]) for i in (0, 1))
            return 5 * (v - 0.5), y, z

        stage.mesh(meshes.grid(sweep, 40, 8), cover, frame(yaw=rng.uniform(0, 6.3)))
        return
    stage.box((6, 6, 0.1), cover, frame(), (0, 0, -0.1))
    if rng.uniform() < 0.5:
        wall, turn = materials.opaque(rng, 0.4, 2), frame(yaw=rng.uniform(0, 6.3))
        stage.box((6, 0.1, 3), wall, turn, (0, 1.3, 0))
        stage.box((0.1, 6, 3), wall, turn, (1.3, 0, 0))


def _still_life(stage: Stage, blur: float) -> Callable[[Generator], Camera | None]:
    rng = stage.rng
    _backdrop(stage)
    furniture.scatter(stage, frame(), (1.3, 1.3), int(rng.integers(4, 13)), (0.12, 0.5))
    if rng.uniform() < 0.5:
        _sky(stage)
    else:
        for _ in range(int(rng.integers(1, 4))):
            turn, size = rng.uniform(0, 2 * np.pi), rng.uniform(0.05, 1) ** 2 + 0.03
            at = np.array([1.1 * np.cos(turn), 1.1 * np.sin(turn), rng.uniform(0.8, 1.8)])
            stage.area_light(at, (0, 0, 0.1), (size, size * rng.uniform(0.5, 2)), rng.uniform(5, 40), warm(rng))
        if rng.uniform() < 0.5:
            stage.put({"type": "constant", "radiance": {"type": "rgb", "value": textures.colour(rng, 0.2, 0.02, 0.2)}})

    def propose(rng: Generator) -> Camera:
        turn, far, height = rng.uniform(0, 2 * np.pi), rng.uniform(0.7, 1.2), rng.uniform(0.15, 0.9)
        target = np.append(rng.uniform(-0.3, 0.3, 2), rng.uniform(0.05, 0.25))
        return Camera(np.array([far * np.cos(turn), far * np.sin(turn), height]), target, UP, rng.uniform(30, 60), blur)

    return propose


def _garden(stage: Stage, blur: float) -> Callable[[Generator], Camera | None]:
    rng = stage.rng
    ground = materials.opaque(rng, 0.8, float(rng.integers(6, 20)), "diffuse" if rng.uniform() < 0.6 else None)
    if rng.uniform() < 0.4:
        stage.mesh(meshes.terrain(rng), ground, frame(scale=np.array([12, 12, 1])))
    else:
        stage.box((40, 40, 0.1), ground, frame(), (0, 0, -0.1))
    stone = materials.opaque(rng, 0.8, 2)
    for _ in range(int(rng.integers(1, 5))):
        at = floor_at(rng.uniform(-4, 4, 2), -0.1, rng.uniform(0, 6.3))
        if rng.uniform() < 0.5:
            stage.box((rng.uniform(1, 4), 0.25, rng.uniform(0.5, 3)), stone, at)
        else:
            for i in range(int(rng.integers(2, 6))):
                stage.mesh(
                    meshes.lathe(rng, "column"), stone, at @ frame(0.9 * i, 0, 0, scale=np.array([0.5, 0.5, 2.2]))
                )
    for _ in range(int(rng.integers(2, 7))):
        furniture.plant(stage, floor_at(rng.uniform(-3, 3, 2), 0), rng.uniform(0.6, 2.5))
    furniture.scatter(stage, frame(), (4, 4), int(rng.integers(3, 10)), (0.3, 1.1))
    if rng.uniform() < 0.5:
        furniture.table(stage, floor_at(rng.uniform(-1, 1, 2)), (1.2, 0.8, 0.7))
    if rng.uniform() < 0.75:
        _sky(stage)
    else:
        stage.put({"type": "constant", "radiance": {"type": "rgb", "value": [0.004, 0.005, 0.01]}})
        for _ in range(int(rng.integers(6, 24))):
            stage.bulb(
                rng.uniform([-3, -3, 0.2], [3, 3, 2.5]),
                rng.uniform(0.02, 0.1),
                rng.uniform(5, 30),
                rng.uniform(0.15, 1, 3),
            )

    def propose(rng: Generator) -> Camera:
        turn, far = rng.uniform(0, 2 * np.pi), rng.uniform(1.5, 4.5)
        target = np.append(rng.uniform(-0.8, 0.8, 2), rng.uniform(0.2, 0.9))
        return Camera(
            np.array([far * np.cos(turn), far * np.sin(turn), rng.uniform(0.4, 2.2)]),
            target,
            UP,
            rng.uniform(35, 65),
            blur,
        )

    return propose
