"""Assemblies: things a room, a table or a garden is full of. All stand on z = 0 of the frame they are given."""

from __future__ import annotations

import mitsuba as mi
import numpy as np

from . import meshes, textures
from .meshes import Array, frame
from .stage import Stage, warm


def item(stage: Stage, placement: Array, size: float, bsdf: mi.BSDF | None = None) -> None:
    """One object about `size` tall: vase, bowl, glass, knot, pebble, block, ball, spring."""
    rng = stage.rng
    bsdf = bsdf or stage.any_material()
    kind = str(rng.choice(["lathe", "bowl", "glass", "knot", "blob", "block", "quadric", "spring", "ball"]))
    yaw = frame(yaw=rng.uniform(0, 6.3), scale=size)
    if kind in ("lathe", "bowl", "glass"):
        stage.mesh(meshes.lathe(rng, "vase" if kind == "lathe" else kind), bsdf, placement @ yaw)
    elif kind == "spring":
        stage.mesh(meshes.spring(rng), bsdf, placement @ yaw)
    elif kind == "block":
        stage.box(size * rng.uniform(0.3, 1, 3), bsdf, placement @ frame(yaw=rng.uniform(0, 6.3)))
    elif kind == "knot":
        tilt = np.eye(4)
        tilt[1:3, 1:3] = [[0, -1], [1, 0]]
        stage.mesh(
            meshes.knot(rng),
            bsdf,
            placement @ frame(z=0.55 * size) @ frame(yaw=rng.uniform(0, 6.3), scale=0.42 * size) @ tilt,
        )
    else:
        shape = (
            meshes.blob(rng, rng.uniform(0.1, 0.6)) if kind == "blob" else meshes.superquadric(*rng.uniform(0.1, 2, 2))
        )
        shape = meshes.superquadric(1, 1) if kind == "ball" else shape
        stretch = size * rng.uniform(0.3, 0.5) * (1 if kind == "ball" else rng.uniform(0.6, 1, 3))
        height = float(np.broadcast_to(stretch, 3)[2])
        stage.mesh(shape, bsdf, placement @ frame(z=height) @ frame(yaw=rng.uniform(0, 6.3), scale=stretch))


def scatter(stage: Stage, placement: Array, area: tuple[float, float], count: int, size: tuple[float, float]) -> None:
    """Objects spread over an area, kept apart where there is room."""
    rng = stage.rng
    placed: list[tuple[float, float, float]] = []
    for _ in range(count):
        height = rng.uniform(*size)
        for _ in range(12):
            x, y = rng.uniform(-0.5, 0.5, 2) * area
            if all(np.hypot(x - a, y - b) > 0.5 * (height + h) for a, b, h in placed):
                placed.append((x, y, height))
                item(stage, placement @ frame(x, y), height)
                break


def table(stage: Stage, placement: Array, size: tuple[float, float, float], laid: int = 5) -> None:
    rng = stage.rng
    wood, top = (stage.material() for _ in range(2))
    x, y, z = size
    if rng.uniform() < 0.15:
        top = stage.material("glass")
    stage.box((x, y, 0.04), top, placement, (0, 0, z - 0.04))
    leg = meshes.lathe(rng, "leg", 20)
    for sx, sy in ((1, 1), (1, -1), (-1, 1), (-1, -1)):
        at = placement @ frame(sx * (x / 2 - 0.08), sy * (y / 2 - 0.08))
        stage.mesh(leg, wood, at @ frame(scale=np.array([1, 1, z - 0.04])))
    scatter(stage, placement @ frame(z=z), (0.8 * x, 0.8 * y), laid, (0.1, 0.35))


def chair(stage: Stage, placement: Array) -> None:
    rng = stage.rng
    wood, seat = stage.material(), stage.material()
    stage.box((0.45, 0.45, 0.05), seat, placement, (0, 0, 0.42))
    for sx, sy in ((1, 1), (1, -1), (-1, 1), (-1, -1)):
        stage.box((0.04, 0.04, 0.42 if sy < 0 else 0.95), wood, placement, (0.19 * sx, 0.19 * sy, 0))
    for z in np.linspace(0.55, 0.88, int(rng.integers(2, 6))):
        stage.box((0.4, 0.02, 0.04), wood, placement, (0, 0.19, z))


def shelf(stage: Stage, placement: Array, width: float, height: float) -> None:
    """Boards with books and things on them."""
    rng = stage.rng
    wood = stage.material()
    covers = [stage.material() for _ in range(4)]
    for sx in (-1, 1):
        stage.box((0.03, 0.3, height), wood, placement, (sx * width / 2, 0, 0))
    stage.box((width, 0.02, height), wood, placement, (0, 0.15, 0))
    for z in np.linspace(0.05, height - 0.03, int(height / 0.38) + 1):
        stage.box((width, 0.3, 0.03), wood, placement, (0, 0, z))
        if z > height - 0.1:
            break
        x = -width / 2 + 0.05
        while x < width / 2 - 0.08:
            thick, tall = rng.uniform(0.02, 0.06), rng.uniform(0.18, 0.3)
            if rng.uniform() < 0.12:
                item(stage, placement @ frame(x + 0.1, 0, z + 0.03), 0.2)
                x += 0.25
            else:
                stage.box((thick, 0.2, tall), covers[rng.integers(4)], placement, (x + thick / 2, 0, z + 0.03))
                x += thick + 0.004 + (0.1 if rng.uniform() < 0.1 else 0)


def sofa(stage: Stage, placement: Array) -> None:
    rng = stage.rng
    fabric, pillow = stage.material(), stage.material()
    soft = meshes.superquadric(0.25, 0.25, 40)
    seats = int(rng.integers(1, 4))
    wide = 0.7 * seats
    parts = [((wide / 2, 0.42, 0.14), (0.0, 0.0, 0.28)), ((wide / 2, 0.13, 0.3), (0.0, 0.42, 0.6))]
    parts += [((0.1, 0.45, 0.3), (s * (wide / 2 + 0.08), 0.0, 0.36)) for s in (-1, 1)]
    for half, at in parts:
        stage.mesh(soft, fabric, placement @ frame(*at) @ frame(scale=np.array(half)))
    for i in range(seats):
        stage.mesh(
            soft,
            pillow,
            placement
            @ frame(0.7 * (i + 0.5) - wide / 2, 0.2, 0.6, rng.uniform(-0.3, 0.3))
            @ frame(scale=np.array([0.22, 0.1, 0.2])),
        )


def cabinet(stage: Stage, placement: Array, width: float, height: float) -> None:
    body, handle = stage.material(), stage.material("metal")
    stage.box((width, 0.45, height), body, placement)
    columns = max(1, round(width / 0.5))
    for i in range(columns):
        x = (i + 0.5) * width / columns - width / 2
        stage.box((width / columns - 0.03, 0.02, height - 0.1), body, placement, (x, -0.235, 0.05))
        stage.mesh(meshes.superquadric(1, 1, 16), handle, placement @ frame(x + 0.15, -0.27, 0.6 * height, scale=0.02))
    scatter(stage, placement @ frame(z=height), (0.8 * width, 0.3), 3, (0.12, 0.35))


def plant(stage: Stage, placement: Array, height: float) -> None:
    rng = stage.rng
    stage.mesh(meshes.lathe(rng, "bowl"), stage.material(), placement @ frame(scale=0.35 * height))
    stage.box((0.03 * height, 0.03 * height, 0.6 * height), stage.material("matte"), placement, (0, 0, 0.05 * height))
    stage.mesh(
        meshes.leaves(rng, int(rng.integers(60, 220))),
        stage.material("foliage"),
        placement @ frame(z=0.35 * height, scale=0.33 * height),
    )


def floor_lamp(stage: Stage, placement: Array, power: float) -> None:
    """A bulb in an open shade on a pole."""
    rng = stage.rng
    x, y, z = placement[:3, 3]
    height = rng.uniform(1.3, 1.7)
    stage.box((0.03, 0.03, height), stage.material("metal"), placement)
    stage.box((0.3, 0.3, 0.03), stage.material("metal"), placement)
    shade = meshes.grid(
        lambda u, v: ((0.2 - 0.08 * v) * np.cos(6.2832 * u), (0.2 - 0.08 * v) * np.sin(6.2832 * u), 0.28 * v), 40, 2
    )
    cover = mi.load_dict(
        {
            "type": "twosided",
            "bsdf": {"type": "diffuse", "reflectance": {"type": "rgb", "value": textures.colour(rng, 0.2, 0.5, 0.9)}},
        }
    )
    stage.mesh(shade, cover, placement @ frame(z=height))
    stage.bulb((x, y, z + height + 0.12), rng.uniform(0.03, 0.06), power, warm(rng))


def picture(stage: Stage, placement: Array) -> None:
    """A framed picture on the wall behind (+y)."""
    rng = stage.rng
    w, h = rng.uniform(0.3, 1.0, 2)
    stage.box((w + 0.08, 0.04, h + 0.08), stage.material(), placement, (0, 0, -0.04))
    art = mi.load_dict(
        {
            "type": "twosided",
            "bsdf": {
                "type": "diffuse",
                "reflectance": textures.coloured(rng, str(rng.choice(["shapes", "noise", "marble"]))),
            },
        }
    )
    stage.box((w, 0.01, h), art, placement, (0, -0.025, 0))


def blinds(stage: Stage, placement: Array, width: float, height: float) -> None:
    """Tilted slats across an opening: stripes of light."""
    slat, tilt = stage.material("matte"), stage.rng.uniform(0.1, 0.9)
    turn = np.eye(4)
    turn[1:3, 1:3] = [[np.cos(tilt), -np.sin(tilt)], [np.sin(tilt), np.cos(tilt)]]
    for z in np.arange(0.05, height, 0.09):
        stage.box((width, 0.075, 0.004), slat, placement @ frame(z=z) @ turn)


def pendant(stage: Stage, placement: Array, power: float) -> None:
    """A glowing ball under the ceiling (placement is on the ceiling)."""
    rng = stage.rng
    drop, radius = rng.uniform(0.3, 0.9), rng.uniform(0.05, 0.16)
    stage.box((0.01, 0.01, drop), stage.material("metal"), placement, (0, 0, -drop))
    x, y, z = placement[:3, 3]
    stage.bulb((x, y, z - drop - radius), radius, power, warm(rng))


def panel(stage: Stage, placement: Array, size: tuple[float, float], power: float) -> None:
    """A flat light in the ceiling, shining down."""
    x, y, z = placement[:3, 3]
    stage.area_light((x, y, z - 0.02), (x, y, 0), size, power, warm(stage.rng))
