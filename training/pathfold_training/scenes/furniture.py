"""Assemblies: things a room, a table or a garden is full of. All stand on z = 0 of the frame they are given."""

from __future__ import annotations

import mitsuba as mi
import numpy as np
from numpy.random import Generator

from . import growth, materials, meshes, solids, textures
from .meshes import Array, frame
from .stage import Stage, warm

ITEMS = {  # what lies about, and how often
    "vase": 2,
    "bowl": 2,
    "glass": 2,
    "knot": 1,
    "spring": 1,
    "block": 2,
    "ball": 2,
    "quadric": 2,
    "blob": 2,
    "carved": 3,
    "turned": 3,
    "hull": 2,
    "wire": 1,
    "text": 1,
    "fur": 0.5,
    "tuft": 1,
    "shade": 0.7,
    "crumple": 0.7,
}
STANDING = ("vase", "bowl", "glass", "spring", "turned", "text")  # made on z = 0, 1 high
ROUND = ("quadric", "blob", "ball", "carved", "hull", "wire", "knot")  # made about the origin, radius 1


def item(stage: Stage, placement: Array, size: float, bsdf: mi.BSDF | None = None, kind: str | None = None) -> None:
    """One object about `size` tall, of one of ITEMS."""
    rng = stage.rng
    weights = np.array(list(ITEMS.values())) / sum(ITEMS.values())
    kind = kind or str(rng.choice(list(ITEMS), p=weights))
    placement = placement @ frame(yaw=rng.uniform(0, 6.3))
    if kind in ("fur", "tuft"):
        make = growth.fur if kind == "fur" else growth.tuft
        grown = placement @ frame(z=0.5 * size * (kind == "fur"), scale=size * (0.5 if kind == "fur" else 1))
        stage.put(growth.strands(*make(rng), stage.material("hair"), grown))
        if kind == "fur":
            stage.mesh(meshes.superquadric(1, 1, 24), stage.material("matte"), grown @ frame(scale=0.69))
        return
    bsdf = bsdf or stage.any_material()
    if kind in STANDING:
        surface = solids.text(rng) if kind == "text" else solids.turned(rng) if kind == "turned" else None
        surface = surface or (meshes.spring(rng) if kind == "spring" else meshes.lathe(rng, kind))
        stage.mesh(surface, bsdf, placement @ frame(scale=size))
    elif kind in ROUND:
        stretch = (
            size * rng.uniform(0.35, 0.5) * (rng.uniform(0.6, 1, 3) if kind in ("quadric", "blob") else np.ones(3))
        )
        stage.mesh(_round(rng, kind), bsdf, placement @ frame(z=0.95 * stretch[2]) @ frame(scale=stretch))
    elif kind == "shade":
        sheet = stage.material("perforated" if rng.uniform() < 0.6 else "translucent")
        bend = meshes.grid(lambda u, v: (0.4 * np.cos(4.5 * u), 0.4 * np.sin(4.5 * u), v), 40, 2)
        stage.mesh(bend, sheet, placement @ frame(scale=size))
    elif kind == "crumple":
        stage.mesh(growth.crumple(rng), bsdf, placement @ frame(scale=0.6 * size))
    else:
        stage.box(size * rng.uniform(0.3, 1, 3), bsdf, placement)


def _round(rng: Generator, kind: str) -> meshes.Surface:
    if kind in ("carved", "hull"):
        return getattr(solids, kind)(rng)
    if kind == "wire":
        return growth.wire(rng)
    if kind == "knot":
        knot = meshes.knot(rng)
        return knot._replace(vertices=knot.vertices[:, [0, 2, 1]] * [1, -1, 1])  # upright
    if kind == "blob":
        return meshes.blob(rng, rng.uniform(0.1, 0.6))
    return meshes.superquadric(*((1, 1) if kind == "ball" else rng.uniform(0.1, 2, 2)))


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
    if rng.uniform() < 0.1:
        top = stage.material("glass")
    elif rng.uniform() < 0.2:
        cloth = growth.drape(rng, (x / 2, y / 2), rng.uniform(0.15, 0.9) * z)
        stage.mesh(cloth, stage.material(), placement @ frame(z=z))
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
                "reflectance": textures.coloured(
                    rng, stage.tones, str(rng.choice(["shapes", "noise", "marble", "cells", "plaid", "stains"]))
                ),
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


def bed(stage: Stage, placement: Array) -> None:
    """Head against the wall behind (+y), under a crumpled cover."""
    rng = stage.rng
    wood, linen = stage.material(), stage.material()
    wide = rng.uniform(0.9, 1.7)
    stage.box((wide, 2, 0.25), wood, placement, (0, -0.75, 0.05))
    stage.box((wide, 0.06, rng.uniform(0.7, 1.2)), wood, placement, (0, 0.24, 0))
    soft = meshes.superquadric(0.2, 0.2, 32)
    stage.mesh(soft, linen, placement @ frame(0, -0.75, 0.4) @ frame(scale=np.array([wide / 2, 0.98, 0.13])))
    cover = growth.crumple(rng)
    spread = np.array([0.55 * wide, 0.7, 0.25])
    stage.mesh(cover, stage.material(), placement @ frame(0, -1.05, 0.5) @ frame(scale=spread))
    for x in np.linspace(-0.25, 0.25, 1 if wide < 1.2 else 2) * wide:
        pillow = frame(x, -0.02, 0.57, rng.normal() * 0.1) @ frame(scale=np.array([0.3, 0.2, 0.09]))
        stage.mesh(meshes.superquadric(0.5, 0.4, 24), linen, placement @ pillow)


def crates(stage: Stage, placement: Array, count: int) -> None:
    """Boxes piled up."""
    rng = stage.rng
    skins = [stage.material() for _ in range(2)]
    for x in (-0.45, 0, 0.45)[: count // 2 + 1]:
        z = 0.0
        for _ in range(int(rng.integers(1, 2 + count // 2))):
            size = rng.uniform(0.25, 0.45, 3)
            stage.box(size, skins[rng.integers(2)], placement @ frame(x, rng.normal() * 0.05, z, rng.normal() * 0.2))
            z += size[2]


def pedestal(stage: Stage, placement: Array, height: float) -> None:
    """A plinth with one large thing on it."""
    kinds = ["carved", "turned", "knot", "hull", "quadric", "blob", "wire", "fur", "vase", "text"]
    wide = stage.rng.uniform(0.3, 0.5)
    stage.box((wide, wide, height), stage.material("matte"), placement)
    item(stage, placement @ frame(z=height), stage.rng.uniform(0.4, 0.9), kind=str(stage.rng.choice(kinds)))


def rug(stage: Stage, placement: Array, size: tuple[float, float]) -> None:
    """A flat patterned cloth, or one with a pile of curves."""
    rng = stage.rng
    cover = materials.opaque(rng, stage.tones, 0.9, float(rng.integers(1, 5)), "diffuse")
    stage.box((*size, 0.012), cover, placement)
    if rng.uniform() < 0.25:
        points, radius = growth.lawn(rng, 1, 4000, 0.05 / max(size))
        pile = placement @ frame(z=0.01) @ np.diag([*size, max(size), 1])
        stage.put(growth.strands(points, radius, stage.material("hair"), pile))


def mirror(stage: Stage, placement: Array) -> None:
    """On the wall behind (+y)."""
    w, h = stage.rng.uniform(0.4, 1.2, 2)
    stage.box((w + 0.1, 0.03, h + 0.1), stage.material(), placement, (0, 0, -0.05))
    stage.box((w, 0.01, h), mi.load_dict({"type": "conductor", "material": "Ag"}), placement, (0, -0.02, 0))


def stairs(stage: Stage, placement: Array, width: float, steps: int) -> None:
    """Steps that rise along +y."""
    stone = stage.material()
    for i in range(steps):
        stage.box((width, 0.3, 0.17 * (i + 1)), stone, placement, (0, 0.3 * i, 0))


def tree(stage: Stage, placement: Array, height: float) -> None:
    wood, crown = growth.tree(stage.rng)
    stage.mesh(wood, stage.material(), placement @ frame(scale=height))
    stage.mesh(crown, stage.material("foliage"), placement @ frame(scale=height))


def arcade(stage: Stage, placement: Array, bays: int, height: float, bsdf: mi.BSDF) -> None:
    """A row of columns along x under a beam, with round arches between where there is room."""
    rng = stage.rng
    column = meshes.lathe(rng, "column", 24) if rng.uniform() < 0.6 else solids.turned(rng, 72)
    gap = height * rng.uniform(0.4, 0.7)
    thick = 0.3 * gap
    ring = meshes.tube(
        lambda u: np.stack([0.5 * gap * np.cos(np.pi * u), 0 * u, 0.4 * gap * np.sin(np.pi * u)], -1),
        0.13 * gap,
        32,
        12,
    )
    for i in range(bays + 1):
        at = placement @ frame((i - bays / 2) * gap)
        stage.mesh(column, bsdf, at @ frame(scale=np.array([thick, thick, 0.7 * height])))
        if i < bays:
            stage.mesh(ring, bsdf, at @ frame(0.5 * gap, 0, 0.7 * height))
    stage.box((bays * gap + thick, 0.9 * thick, 0.1 * height), bsdf, placement, (0, 0, 0.7 * height + 0.5 * gap))
