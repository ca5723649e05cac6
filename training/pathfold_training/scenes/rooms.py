"""Interiors: rooms with openings, lit from outside or within, and long halls."""

from __future__ import annotations

import mitsuba as mi
import numpy as np
from numpy.random import Generator

from . import fittings, furniture, lights, materials, meshes
from .cameras import Camera, Propose
from .meshes import Array, frame
from .meshes import at as floor_at
from .stage import Stage, warm
from .tones import white

UP = np.array([0.0, 0, 1])
MODES = {  # where the light of a room comes from, and how often
    "window": 0.34,
    "ajar": 0.09,
    "slit": 0.06,
    "skylight": 0.07,
    "panel": 0.09,
    "pendant": 0.08,
    "floor": 0.08,
    "many": 0.06,
    "spots": 0.06,
    "screen": 0.04,
    "lantern": 0.03,
}


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


def _walls(x: float, y: float) -> list[tuple[Array, float]]:
    """The frames of four walls, seen from inside, and their lengths."""
    return [
        (frame(0, y / 2), x),
        (frame(x / 2, 0, 0, -np.pi / 2), y),
        (frame(0, -y / 2, 0, np.pi), x),
        (frame(-x / 2, 0, 0, np.pi / 2), y),
    ]


def _daylight(stage: Stage, at: Array, size: tuple[float, float], strength: float) -> None:
    """A luminous sheet outside an opening, facing in: the sky as a light that is easily found."""
    centre, inside = ((at @ [0, y, size[1] / 2, 1])[:3] for y in (0.3, -1))
    stage.area_light(centre, inside, (1.3 * size[0], 1.3 * size[1]), strength * size[0] * size[1], warm(stage.rng))


def _windows(stage: Stage, place: Array, length: float, height: float, bright: float) -> list[tuple[float, ...]]:
    """Window openings in a wall, dressed with bars, panes, blinds, curtains or a screen; lit if `bright` > 0."""
    rng = stage.rng
    count = int(rng.integers(1, max(2, int(length / 1.6)) + 1))
    cell = length / count
    wide, low = cell * rng.uniform(0.35, 0.8), rng.uniform(0.1, 1.0)
    high = min(height - 0.15, low + rng.uniform(0.7, 1.8))
    dressing, glazed, barred = rng.uniform(), rng.uniform() < 0.2, rng.uniform() < 0.5
    bars = stage.material("matte")
    openings: list[tuple[float, ...]] = []
    for i in range(count):
        middle = (i + 0.5) * cell - length / 2
        openings.append((middle - wide / 2, middle + wide / 2, low, high))
        at = place @ frame(middle, 0.08, low)
        if barred:
            fittings.mullions(stage, at, (wide, high - low), bars)
        else:
            stage.box((0.04, 0.04, high - low), bars, at)
            stage.box((wide, 0.04, 0.04), bars, at, (0, 0, (high - low) / 2))
        if bright > 0:
            _daylight(stage, at, (wide, high - low), bright)
        if glazed:
            stage.box((wide, 0.006, high - low), stage.material("pane"), at, (0, 0.03, 0))
        if dressing < 0.2:
            furniture.blinds(stage, place @ frame(middle, 0.02, low), wide, high - low)
        elif dressing < 0.45:
            cover = stage.material("translucent" if rng.uniform() < 0.4 else "opaque")
            for side in (-1, 1):
                size = np.array([0.45 * wide, 1, high - low + 0.3])
                sheet = place @ frame(middle + side * 0.42 * wide, -0.12, low - 0.15, scale=size)
                stage.mesh(meshes.cloth(rng), cover, sheet)
        elif dressing < 0.52:
            stage.box((wide, 0.003, high - low), stage.material("perforated"), at, (0, -0.03, 0))
    return openings


def _next_room(stage: Stage, place: Array, paint: mi.BSDF, height: float, gap: float) -> list[tuple[float, ...]]:
    """An opening `gap` wide (a door ajar where it is wide enough), and behind it a bright room that lights ours."""
    rng = stage.rng
    x = rng.uniform(-0.6, 0.6)
    if gap > 0.8:
        door = place @ frame(x - gap / 2, 0.02, 0, rng.uniform(0.5, 1.7))
        stage.box((0.98 * gap, 0.04, 2.02), stage.material(), door, (gap / 2, 0, 0))
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
    if gap > 0.8:
        lamp = (back @ [rng.uniform(-0.9, 0.9), 1.6, height - 0.05, 1])[:3]
        stage.area_light(lamp, lamp - UP, rng.uniform(0.3, 1.2, 2), rng.uniform(100, 500), warm(rng))
    else:  # a low sun through a slit draws a stripe
        lamp, way = ((back @ [rng.uniform(-0.3, 0.3), far, high, 1])[:3] for far, high in ((2.3, 1.6), (0, 1)))
        stage.area_light(lamp, way, (0.5, 0.9), rng.uniform(300, 900), warm(rng))
    return [(x - gap / 2, x + gap / 2, 0, 2.05)]


def _lamps(stage: Stage, size: Array, mode: str) -> None:
    """Light from inside the room."""
    rng = stage.rng
    x, y, z = size
    if mode == "panel":
        long = rng.uniform() < 0.4
        for _ in range(int(rng.integers(1, 4))):
            at = floor_at(rng.uniform(-0.35, 0.35, 2) * [x, y], z)
            sides = (0.08, 0.7 * y) if long else tuple(rng.uniform(0.2, 1.2, 2))
            furniture.panel(stage, at, sides, rng.uniform(20, 80))
    elif mode == "pendant":
        for _ in range(int(rng.integers(1, 4))):
            furniture.pendant(stage, floor_at(rng.uniform(-0.3, 0.3, 2) * [x, y], z), rng.uniform(15, 60))
    elif mode == "floor":
        for _ in range(int(rng.integers(1, 3))):
            at = rng.choice([-1, 1], 2) * ([x, y] * rng.uniform(0.3, 0.42, 2))
            lights.shaded_lamp(stage, floor_at(at), rng.uniform(20, 80), rng.uniform(1.1, 1.7))
    elif mode == "many":
        low, high = np.array([-0.45 * x, -0.45 * y, 0.2 * z]), np.array([0.45 * x, 0.45 * y, z - 0.1])
        lights.bulbs(stage, low, high, int(rng.integers(12, 30)), 3)
    elif mode == "screen":
        place, _ = _walls(x, y)[rng.integers(4)]
        lights.screen(stage, place @ frame(0, -0.1, 0.7), (rng.uniform(1, 2.2), rng.uniform(0.7, 1.2)), 8)
    elif mode == "lantern":
        for _ in range(int(rng.integers(1, 4))):
            at = floor_at(rng.uniform(-0.35, 0.35, 2) * [x, y], rng.choice([0, 0.8]))
            lights.lantern(stage, at, rng.uniform(10, 40), rng.uniform(0.2, 0.4))
        furniture.pendant(stage, frame(0, 0, z), 5)
    else:
        for _ in range(int(rng.integers(2, 6))):
            at = rng.uniform(-0.4, 0.4, 2) * size[:2]
            up = rng.uniform() < 0.25
            target = [*(at + rng.uniform(-1, 1, 2)), z if up else 0]
            lights.spot(stage, [*at, 1.2 if up else z - 0.15], target, rng.uniform(8, 40), rng.uniform(15, 45))


def _lid(stage: Stage, size: Array, lid: mi.BSDF, open_: bool) -> None:
    """The ceiling, with a hole for daylight or without."""
    x, y, z = size
    if not open_:
        stage.box((x + 0.4, y + 0.4, 0.1), lid, frame(), (0, 0, z))
        return
    rng = stage.rng
    wide = rng.uniform(0.15, 0.5) * x
    for side in (-1, 1):
        rest = (x + 0.4 - wide) / 2
        stage.box((rest, y + 0.4, 0.1), lid, frame(), (side * (wide + rest) / 2, 0, z))
        stage.box((wide, 0.3 * y, 0.1), lid, frame(), (0, side * 0.4 * y, z))
    at = np.array([rng.uniform(-1, 1), rng.uniform(-1, 1), z + rng.uniform(0.2, 1.5)])
    stage.area_light(at, (0, 0, z), (wide + 0.4, 0.6 * y), rng.uniform(60, 300), warm(rng))


def _furnish(stage: Stage, size: Array) -> None:
    """Furniture along the walls and in the middle: of a home, kitchen, class, gallery or store, or next to none."""
    rng = stage.rng
    x, y, z = size
    styles = {"home": 0.46, "kitchen": 0.16, "class": 0.1, "gallery": 0.1, "store": 0.09, "bare": 0.09}
    style = str(rng.choice(list(styles), p=list(styles.values())))
    for place, length in _walls(x, y):
        if style == "kitchen" and rng.uniform() < 0.5:
            fittings.kitchen(stage, place, length * rng.uniform(0.5, 0.95))
            continue
        for slot in (-0.25, 0.25) if length > 2.6 else (0.0,):
            at, wide = place @ frame(slot * length, -0.28), min(0.42 * length, 2.5)
            if style in ("home", "kitchen"):
                _along_wall(stage, at, wide, z)
            elif style == "store" and rng.uniform() < 0.7:
                furniture.crates(stage, at, int(rng.integers(1, 6)))
            elif style in ("gallery", "class") and rng.uniform() < 0.6:
                furniture.picture(stage, place @ frame(slot * length, -0.02, rng.uniform(1.0, 1.4)))
            if style != "store" and rng.uniform() < 0.07:
                furniture.mirror(stage, place @ frame(slot * length, -0.02, rng.uniform(0.5, 1.2)))
    if rng.uniform() < 0.4:
        furniture.rug(stage, floor_at(rng.normal(size=2) * 0.3, 0, rng.uniform(0, 6.3)), tuple(rng.uniform(1, 2.4, 2)))
    if style == "gallery":
        for _ in range(int(rng.integers(1, 5))):
            spot = floor_at(rng.uniform(-0.3, 0.3, 2) * size[:2], 0, rng.uniform(0, 6.3))
            furniture.pedestal(stage, spot, rng.uniform(0.2, 1.1))
    elif style == "class":
        fittings.desks(stage, size)
    elif style in ("home", "kitchen"):
        _middle(stage, size)
    if rng.uniform() < 0.1:
        fittings.railing(stage, floor_at(rng.uniform(-0.3, 0.3, 2) * size[:2], 0, rng.uniform(0, 6.3)), 0.5 * x)
    count = rng.integers(2, 9) if style in ("bare", "store") else rng.integers(0, 5)
    furniture.scatter(stage, frame(), (0.7 * x, 0.7 * y), int(count), (0.15, 1.1 if style == "bare" else 0.6))


def _joinery(stage: Stage, place: Array, length: float, height: float, paint: mi.BSDF) -> None:
    """What a wall without openings has of wood and iron."""
    rng = stage.rng
    if rng.uniform() < 0.6:
        fittings.mouldings(stage, place, length, height, paint)
    if rng.uniform() < 0.3:
        fittings.door(stage, place @ frame(rng.uniform(-0.35, 0.35) * length), paint)
    if rng.uniform() < 0.15:
        fittings.radiator(stage, place @ frame(rng.uniform(-0.3, 0.3) * length), stage.material("matte"))


def _along_wall(stage: Stage, at: Array, width: float, height: float) -> None:
    rng = stage.rng
    pick = rng.uniform()
    if pick < 0.14:
        furniture.shelf(stage, at, width * 0.8, rng.uniform(1, min(2.2, height - 0.2)))
    elif pick < 0.28:
        furniture.cabinet(stage, at, width * rng.uniform(0.5, 0.9), rng.uniform(0.5, 1.1))
    elif pick < 0.4:
        furniture.sofa(stage, at @ frame(y=-0.3))
    elif pick < 0.48:
        furniture.bed(stage, at)
    elif pick < 0.58:
        furniture.plant(stage, at @ frame(y=-0.2), rng.uniform(0.7, 1.7))
    elif pick < 0.74:
        furniture.picture(stage, at @ frame(0, 0.26, rng.uniform(1.1, 1.4)))
    elif pick < 0.9:
        fittings.shelves(stage, at @ frame(0, 0.28), width * rng.uniform(0.4, 0.9))


def _middle(stage: Stage, size: Array) -> None:
    """Tables with chairs."""
    rng = stage.rng
    for _ in range(int(rng.integers(0, 3))):
        spot = floor_at(rng.uniform(-0.2, 0.2, 2) * size[:2], 0, rng.uniform(0, 6.3))
        wide, deep = rng.uniform(0.8, 1.8), rng.uniform(0.6, 1.0)
        furniture.table(stage, spot, (wide, deep, rng.uniform(0.4, 0.8)), int(rng.integers(3, 9)))
        for side in range(int(rng.integers(0, 5))):
            turn = frame(yaw=side * np.pi / 2 + rng.normal() * 0.15)
            furniture.chair(stage, spot @ turn @ frame(y=(wide if side % 2 else deep) / 2 + 0.3))


def room(stage: Stage, blur: float) -> Propose:
    rng = stage.rng
    if rng.uniform() < 0.4:
        stage.tones = white(float(rng.uniform()))
    tones = stage.tones
    size = np.array([rng.uniform(2.2, 7), rng.uniform(2.6, 7), rng.uniform(2.3, 3.6)])
    x, y, z = size
    paint, other = materials.matte(rng, tones, 0.4), materials.matte(rng, tones)
    if rng.uniform() < 0.5:
        other = materials.opaque(rng, tones, 0.8, float(rng.integers(1, 5)))
    floor = materials.opaque(rng, tones, 0.75, float(rng.integers(2, 6)))
    lid = materials.matte(rng, tones._replace(value=(0.8, 0.97), accents=0), 0.5)
    mode = str(rng.choice(list(MODES), p=list(MODES.values())))
    stage.box((x + 0.4, y + 0.4, 0.1), floor, frame(), (0, 0, -0.1))
    _lid(stage, size, lid, mode == "skylight")
    opened = set(rng.permutation(4)[: 1 if mode in ("ajar", "slit") or rng.uniform() < 0.5 else 2])
    bright = rng.uniform(10, 60) if rng.uniform() < 0.65 else 0
    for i, (place, length) in enumerate(_walls(x, y)):
        openings: list[tuple[float, ...]] = []
        if i in opened and mode == "window":
            openings = _windows(stage, place, length, z, bright)
        elif i in opened and mode in ("ajar", "slit"):
            openings = _next_room(stage, place, paint, z, 0.9 if mode == "ajar" else rng.uniform(0.12, 0.3))
        _wall(stage, place, length, z, other if i == 0 else paint, openings)
        if not openings:
            _joinery(stage, place, length, z, paint if rng.uniform() < 0.8 else stage.material("matte"))
    if rng.uniform() < 0.15:
        fittings.beams(stage, size)
    if mode == "window":
        if bright == 0:
            lights.sky(stage)
            stage.box((60, 60, 0.1), stage.material("matte"), frame(), (0, 0, -0.4))
    elif mode not in ("ajar", "slit", "skylight"):
        _lamps(stage, size, mode)
    if (mode in ("ajar", "slit", "skylight") or bright > 0) and rng.uniform() < 0.35:
        furniture.pendant(stage, frame(0.2 * x, 0.2 * y, z), rng.uniform(2, 10))
    _furnish(stage, size)

    def propose(rng: Generator) -> Camera:
        corner = rng.choice([-1, 1], 2) * rng.uniform(0.1, 0.46, 2) * size[:2]
        height = rng.choice([rng.uniform(0.25, 0.8), rng.uniform(0.9, 1.7), rng.uniform(1.7, z - 0.15)])
        target = np.append(rng.uniform(-0.35, 0.35, 2) * size[:2], rng.uniform(0.2, 1.5))
        return Camera(
            np.append(corner, height), target, UP, rng.choice([rng.uniform(25, 50), rng.uniform(50, 95)]), blur
        )

    return propose


def hall(stage: Stage, blur: float) -> Propose:
    """A corridor, nave or colonnade that runs along y, lit by a rhythm of lamps or windows."""
    rng, tones = stage.rng, stage.tones
    x, y, z = rng.uniform(2, 7), rng.uniform(9, 22), rng.uniform(2.4, 6)
    floor = materials.opaque(rng, tones, 0.8, float(rng.integers(2, 8)))
    wall = materials.opaque(rng, tones, 0.5, float(rng.integers(2, 6)))
    stage.box((x, y, 0.1), floor, frame(), (0, 0, -0.1))
    stage.box((x, y, 0.1), materials.matte(rng, tones, 0.5), frame(), (0, 0, z))
    count = int(rng.integers(3, 7))
    light = str(rng.choice(["panels", "windows", "spots", "neon"], p=[0.35, 0.35, 0.15, 0.15]))
    bright = rng.uniform(15, 60)
    for side in (-1, 1):
        place = frame(side * x / 2, 0, 0, -side * np.pi / 2)
        openings: list[tuple[float, ...]] = []
        if light == "windows" and side == 1:
            cell, low, high = y / count, rng.uniform(0.1, 0.4) * z, 0.85 * z
            for i in range(count):
                middle = (i + 0.5) * cell - y / 2
                openings.append((middle - 0.25 * cell, middle + 0.25 * cell, low, high))
                _daylight(stage, place @ frame(middle, 0.1, low), (0.5 * cell, high - low), bright)
        _wall(stage, place, y, z, wall, openings)
        stage.box((x, 0.1, z), materials.matte(rng, tones), frame(0, side * y / 2))
    for i in range(count):
        at = (i + 0.5) * y / count - y / 2
        if light == "panels":
            furniture.panel(stage, frame(0, at, z), (rng.uniform(0.1, 0.6) * x, 0.4), bright)
        elif light == "spots":
            lights.spot(stage, [0, at, z - 0.1], [rng.choice([-0.45, 0.45]) * x, at, 0], bright, 40)
        elif light == "neon":
            turn = frame(rng.choice([-0.4, 0.4]) * x, at, rng.uniform(0.3, 0.5) * z, np.pi / 2)
            lights.neon(stage, turn @ frame(scale=0.7), 0.6 * bright)
    if rng.uniform() < 0.6 and x > 3:
        pillars = materials.opaque(rng, tones, 0.3, 2)
        for side in (-1, 1):
            row = frame(side * 0.3 * x, 0, 0, np.pi / 2)
            furniture.arcade(stage, row, max(2, int(y / z)), 0.85 * z, pillars)
    if rng.uniform() < 0.35:
        furniture.stairs(stage, frame(0, 0.3 * y), 0.5 * x, int(rng.integers(4, 10)))
    for _ in range(int(rng.integers(2, 8))):
        spot = floor_at(rng.uniform(-0.38, 0.38, 2) * [x, y], 0, rng.uniform(0, 6.3))
        if rng.uniform() < 0.4:
            furniture.plant(stage, spot, rng.uniform(0.8, 1.6))
        else:
            furniture.item(stage, spot, rng.uniform(0.4, 1.6))

    def propose(rng: Generator) -> Camera:
        origin = rng.uniform(-0.4, 0.4, 2) * [x, y * 1.1]
        ahead = np.array([rng.uniform(-0.4, 0.4) * x, origin[1] - np.sign(origin[1]) * rng.uniform(2, 8)])
        height = rng.uniform(0.3, 0.75) * z
        target = np.append(ahead, rng.uniform(0.2, 0.6) * z)
        return Camera(np.append(origin, height), target, UP, rng.uniform(40, 90), blur)

    return propose
