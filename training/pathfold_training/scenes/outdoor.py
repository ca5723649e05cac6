"""Outdoors: gardens, streets and wide land, by day and by night."""

from __future__ import annotations

import mitsuba as mi
import numpy as np
from numpy.random import Generator

from . import furniture, growth, lights, materials, meshes, solids
from .cameras import Camera, Propose, orbit
from .meshes import Array, frame
from .meshes import at as floor_at
from .stage import Stage, emission, warm


def garden(stage: Stage, blur: float) -> Propose:
    """Plants, walls, columns and things on the ground."""
    rng, tones = stage.rng, stage.tones
    ground = materials.opaque(rng, tones, 0.8, float(rng.integers(6, 20)), "diffuse" if rng.uniform() < 0.6 else None)
    if rng.uniform() < 0.4:
        stage.mesh(meshes.terrain(rng), ground, frame(scale=np.array([12, 12, 1])))
    else:
        stage.box((40, 40, 0.1), ground, frame(), (0, 0, -0.1))
    stone = materials.opaque(rng, tones, 0.8, 2)
    for _ in range(int(rng.integers(0, 4))):
        at = floor_at(rng.uniform(-4, 4, 2), -0.1, rng.uniform(0, 6.3))
        if rng.uniform() < 0.6:
            stage.box((rng.uniform(1, 4), 0.25, rng.uniform(0.5, 3)), stone, at)
        else:
            furniture.arcade(stage, at, int(rng.integers(1, 5)), rng.uniform(1.5, 3), stone)
    for _ in range(int(rng.integers(1, 6))):
        furniture.plant(stage, floor_at(rng.uniform(-3, 3, 2), 0), rng.uniform(0.6, 2.5))
    for _ in range(int(rng.integers(0, 3))):
        furniture.tree(stage, floor_at(rng.uniform(-5, 5, 2), 0), rng.uniform(2, 5))
    if rng.uniform() < 0.4:
        blades, radius = growth.lawn(rng, 5, 9000, rng.uniform(0.08, 0.25))
        stage.put(growth.strands(blades, radius, stage.material("hair"), frame()))
    furniture.scatter(stage, frame(), (4, 4), int(rng.integers(2, 10)), (0.3, 1.1))
    if rng.uniform() < 0.4:
        furniture.table(stage, floor_at(rng.uniform(-1, 1, 2)), (1.2, 0.8, 0.7))
    if rng.uniform() < 0.75:
        lights.sky(stage)
    else:
        lights.environment(stage, "night")
        lights.bulbs(stage, [-3, -3, 0.2], [3, 3, 2.5], int(rng.integers(6, 24)), 12)

    def propose(rng: Generator) -> Camera:
        return orbit(rng, rng.uniform([-0.8, -0.8, 0.2], [0.8, 0.8, 0.9]), (1.5, 5), (3, 45), blur, (30, 75))

    return propose


def _house(stage: Stage, place: Array, size: Array, wall: mi.BSDF, night: bool) -> None:
    """A block whose front, at y = 0 of the frame and facing -y, has rows of windows and a door or a shop."""
    rng = stage.rng
    x, y, z = size
    stage.box((x, y, z), wall, place, (0, y / 2, 0))
    trim, dark = stage.material("matte"), stage.material("pane" if rng.uniform() < 0.2 else "metal")
    columns, rows = max(1, int(x / rng.uniform(1.1, 2))), max(1, int(z / rng.uniform(2.2, 3.2)))
    wide, high = 0.55 * x / columns, rng.uniform(0.45, 0.65) * z / rows
    lit = emission(rng.uniform(2, 10), warm(rng))
    for row in range(rows):
        for column in range(columns):
            across, up = (column + 0.5) * x / columns - x / 2, (row + 0.3) * z / rows
            stage.box((wide + 0.16, 0.1, high + 0.16), trim, place, (across, -0.02, up - 0.08))
            glow = {"emitter": lit} if night and rng.uniform() < 0.3 else {}
            stage.box((wide, 0.06, high), dark, place, (across, -0.06, up), **glow)
    stage.box((x + 0.2, 0.3, 0.2), trim, place, (0, 0, z))
    if rng.uniform() < 0.5:
        cloth, at = stage.material("translucent"), place @ frame(rng.uniform(-0.2, 0.2) * x, -0.5, 2.3)
        tilt = np.eye(4)
        tilt[1:3, 1:3] = [[0.9, -0.4], [0.4, 0.9]]
        stage.box((0.6 * x, 1.1, 0.02), cloth, at @ tilt)
    if rng.uniform() < 0.4:
        sign = place @ frame(rng.uniform(-0.3, 0.3) * x, -0.15, rng.uniform(2.6, 3.2), scale=0.8)
        if night:
            lights.neon(stage, sign, rng.uniform(5, 25))
        else:
            stage.mesh(solids.text(rng), stage.material(), sign)


def street(stage: Stage, blur: float) -> Propose:
    """Houses on one or two sides of a road along x."""
    rng, tones = stage.rng, stage.tones
    night = bool(rng.uniform() < 0.4)
    road = materials.opaque(rng, tones._replace(value=(0.2, 0.6), accents=0), 0.8, float(rng.integers(10, 30)))
    stage.box((60, 40, 0.1), road, frame(), (0, 0, -0.1))
    half = rng.uniform(1.5, 5)
    for side in (1, -1)[: 1 + int(rng.uniform() < 0.6)]:
        turn = frame(yaw=0 if side > 0 else np.pi)
        stage.box((40, 1.2, 0.12), stage.material("matte"), turn, (0, half - 0.6, 0))
        x = -12.0
        while x < 10:
            size = np.array([rng.uniform(3, 7), rng.uniform(3, 6), rng.uniform(2.8, 11)])
            wall = materials.opaque(rng, tones, 0.4, 3, "diffuse" if rng.uniform() < 0.5 else None)
            _house(stage, turn @ frame(x + size[0] / 2, half + rng.uniform(0, 0.6)), size, wall, night)
            x += size[0] + rng.choice([0, rng.uniform(0.5, 3)])
    for x in np.arange(-9, 10, rng.uniform(3, 6)):
        at = floor_at(np.array([x, rng.choice([-1, 1]) * (half - 0.5)]))
        pick = rng.uniform()
        if pick < 0.35:
            furniture.tree(stage, at, rng.uniform(2.5, 5))
        elif pick < 0.6:
            stage.box((0.08, 0.08, 3), stage.material("metal"), at)
            if night:
                stage.bulb((at @ [0, 0, 3.1, 1])[:3], 0.15, rng.uniform(80, 300), warm(rng))
        elif pick < 0.8:
            furniture.crates(stage, at, int(rng.integers(1, 5)))
    furniture.scatter(stage, frame(), (9, 1.2 * half), int(rng.integers(1, 6)), (0.4, 1.4))
    if night:
        lights.environment(stage, "night")
    else:
        lights.sky(stage)

    def propose(rng: Generator) -> Camera:
        origin = np.array(
            [rng.uniform(-6, 6), rng.uniform(-0.8, 0.8) * half, rng.choice([rng.uniform(0.4, 2), rng.uniform(2, 6)])]
        )
        target = np.array([rng.uniform(-6, 6), rng.uniform(0.2, 1.2) * half, rng.uniform(0.3, 3.5)])
        return Camera(origin, target, np.array([0.0, 0, 1]), rng.uniform(35, 85), blur)

    return propose


def land(stage: Stage, blur: float) -> Propose:
    """Rolling ground, water, rocks, trees and something built, seen from afar."""
    rng, tones = stage.rng, stage.tones
    earth = materials.opaque(
        rng, tones, 0.85, float(rng.integers(4, 30)), str(rng.choice(["diffuse", "bump", "fabric"]))
    )
    rise = rng.uniform(0.5, 4)
    ground = meshes.terrain(rng)
    stage.mesh(ground, earth, frame(scale=np.array([22, 22, rise])))

    def level(xy: Array) -> float:
        """Height of the ground at a point."""
        near = np.abs(ground.vertices[:, :2] * 22 - xy).sum(1).argmin()
        return float(ground.vertices[near, 2] * rise)

    sights: list[Array] = []

    def spot(reach: float, yaw: float = 0) -> Array:
        xy = rng.uniform(-reach, reach, 2)
        sights.append(xy)
        return frame(xy[0], xy[1], level(xy) - 0.05, yaw)

    if rng.uniform() < 0.45:
        ripple = meshes.terrain(rng)
        water = (
            {"type": "dielectric", "int_ior": 1.33}
            if rng.uniform() < 0.5
            else {"type": "roughdielectric", "alpha": 0.08}
        )
        low = float(np.quantile(ground.vertices[:, 2], rng.uniform(0.2, 0.5))) * rise
        stage.mesh(ripple, mi.load_dict(water), frame(z=low, scale=np.array([22, 22, 0.25])))
    for _ in range(int(rng.integers(3, 14))):
        size = rng.uniform(0.2, 1) ** 2 * 2 + 0.15
        stage.mesh(solids.hull(rng), stage.material(), spot(8, rng.uniform(0, 6.3)) @ frame(z=0.3 * size, scale=size))
    for _ in range(int(rng.integers(0, 8))):
        furniture.tree(stage, spot(9), rng.uniform(2, 6))
    for _ in range(int(rng.integers(0, 4))):
        pick = rng.uniform()
        if pick < 0.3:
            furniture.arcade(
                stage, spot(6, rng.uniform(0, 6.3)), int(rng.integers(2, 6)), rng.uniform(2, 4), stage.material()
            )
        elif pick < 0.6:
            furniture.item(stage, spot(6), rng.uniform(1.5, 5))
        else:
            _house(stage, spot(7, rng.uniform(0, 6.3)), rng.uniform([2, 2, 2], [5, 4, 5]), stage.material(), False)
    for _ in range(int(rng.integers(0, 6))):
        tuft, radius = growth.tuft(rng, 120)
        stage.put(growth.strands(tuft, radius, stage.material("hair"), spot(4) @ frame(scale=rng.uniform(0.4, 1.3))))
    lights.sun(stage) if rng.uniform() < 0.7 else lights.environment(stage)

    def propose(rng: Generator) -> Camera:
        turn, far = rng.uniform(0, 6.3), rng.uniform(2.5, 10)
        target = sights[rng.integers(len(sights))]
        origin = target + far * np.array([np.cos(turn), np.sin(turn)])
        eye = level(origin) + rng.choice([rng.uniform(0.5, 2), rng.uniform(2, 7)])
        goal = level(target) + rng.uniform(0, 2)
        return Camera(np.append(origin, eye), np.append(target, goal), np.array([0.0, 0, 1]), rng.uniform(25, 75), blur)

    return propose
