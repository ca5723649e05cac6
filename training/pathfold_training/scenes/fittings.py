"""What is fixed to a room's walls or stands in rows: joinery, doors, kitchens, desks; frames are as in furniture.

The frame of a wall has its inner face on y = 0 and the room at negative y.
"""

from __future__ import annotations

import mitsuba as mi
import numpy as np

from . import furniture, meshes
from .meshes import Array, frame
from .stage import Stage


def mouldings(stage: Stage, place: Array, length: float, height: float, paint: mi.BSDF) -> None:
    """Skirting and cornice along a wall without openings, and often panelling: edges between faces of one paint."""
    rng = stage.rng
    stage.box((length, 0.02, rng.uniform(0.06, 0.2)), paint, place, (0, -0.01, 0))
    for step in range(int(rng.integers(0, 4))):
        deep = 0.03 * (step + 1)
        stage.box((length, deep, 0.03), paint, place, (0, -deep / 2, height - 0.03 * (3 - step)))
    if rng.uniform() < 0.5:
        return
    low, high = 0.25, float(rng.choice([1.0, height - 0.3]))
    if high < height / 2:
        stage.box((length, 0.035, 0.05), paint, place, (0, -0.017, high + 0.08))
    count = max(1, round(length / rng.uniform(0.5, 1.4)))
    wide = length / count
    for i in range(count):
        _border(stage, place @ frame((i + 0.5) * wide - length / 2, 0, low), (wide - 0.16, high - low), 0.03, paint)


def _border(stage: Stage, place: Array, size: tuple[float, float], width: float, bsdf: mi.BSDF) -> None:
    """A rectangle of four thin laths on a wall, standing on z = 0."""
    x, z = size
    for up in (0, z - width):
        stage.box((x, 0.015, width), bsdf, place, (0, -0.0075, up))
    for side in (-1, 1):
        stage.box((width, 0.015, z), bsdf, place, (side * (x - width) / 2, -0.0075, 0))


def door(stage: Stage, place: Array, bsdf: mi.BSDF) -> None:
    """A closed door in its frame, with panels and a knob."""
    rng = stage.rng
    wide = rng.uniform(0.75, 1.0)
    for side in (-1, 1):
        stage.box((0.09, 0.04, 2.1), bsdf, place, (side * (wide / 2 + 0.045), -0.02, 0))
    stage.box((wide + 0.18, 0.04, 0.09), bsdf, place, (0, -0.02, 2.05))
    leaf = bsdf if rng.uniform() < 0.6 else stage.material()
    stage.box((wide, 0.02, 2.05), leaf, place, (0, -0.01, 0))
    rows, columns = int(rng.integers(1, 4)), int(rng.integers(1, 3))
    cell = np.array([(wide - 0.1) / columns, 1.9 / rows])
    for row in range(rows):
        for column in range(columns):
            at = place @ frame((column + 0.5) * cell[0] - (wide - 0.1) / 2, -0.02, 0.08 + row * cell[1])
            _border(stage, at, (0.85 * cell[0], 0.88 * cell[1]), 0.025, leaf)
    knob = place @ frame(0.42 * wide, -0.06, 1) @ frame(scale=0.03)
    stage.mesh(meshes.superquadric(1, 1, 16), stage.material("metal"), knob)


def radiator(stage: Stage, place: Array, bsdf: mi.BSDF) -> None:
    """Ribs and two pipes."""
    rng = stage.rng
    count, high = int(rng.integers(6, 20)), rng.uniform(0.4, 0.8)
    for i in range(count):
        stage.box((0.035, 0.09, high), bsdf, place, (0.06 * (i - count / 2), -0.1, 0.12))
    for z in (0.16, high + 0.04):
        stage.box((0.06 * count, 0.03, 0.03), bsdf, place, (0, -0.1, z))


def beams(stage: Stage, size: Array) -> None:
    """Beams under the ceiling, along x."""
    rng = stage.rng
    wood = stage.material()
    x, y, z = size
    count, high = int(rng.integers(3, 9)), rng.uniform(0.08, 0.22)
    for i in range(count):
        stage.box((x, 0.6 * high, high), wood, frame(), (0, ((i + 0.5) / count - 0.5) * y, z - high))


def mullions(stage: Stage, place: Array, size: tuple[float, float], bars: mi.BSDF) -> None:
    """The frame and bars of a window of many panes, with its sill; `place` is the opening's lower edge."""
    rng = stage.rng
    x, z = size
    thin = rng.uniform(0.015, 0.05)
    columns, rows = (int(n) for n in rng.integers(1, 6, 2))
    for i in range(columns + 1):
        stage.box((thin, 0.04, z), bars, place, ((i / columns - 0.5) * (x - thin), 0, 0))
    for i in range(rows + 1):
        stage.box((x, 0.04, thin), bars, place, (0, 0, i / rows * (z - thin)))
    stage.box((x + 0.2, 0.24, 0.03), bars, place, (0, -0.12, -0.03))


def kitchen(stage: Stage, place: Array, length: float) -> None:
    """Cupboards under a worktop with things on it, and over it more cupboards or boards."""
    rng = stage.rng
    fronts, top, handle = stage.material(), stage.material(), stage.material("metal")
    count = max(2, int(length / rng.uniform(0.4, 0.7)))
    wide = length / count
    _fronts(stage, place, (count, wide), (0.1, 0.85, 0.6), fronts, handle)
    stage.box((length, 0.63, 0.04), top, place, (0, -0.31, 0.86))
    if rng.uniform() < 0.5:  # tiles behind
        stage.box((length, 0.01, 0.5), stage.material(), place, (0, -0.005, 0.9))
    furniture.scatter(stage, place @ frame(0, -0.3, 0.9), (0.9 * length, 0.35), int(rng.integers(3, 9)), (0.08, 0.35))
    if rng.uniform() < 0.6:
        _fronts(stage, place, (count, wide), (1.45, 2.1, 0.33), fronts, handle)
    else:
        for z in (1.45, 1.8):
            stage.box((length, 0.25, 0.025), top, place, (0, -0.125, z))
            row(stage, place @ frame(0, -0.125, z + 0.025), 0.9 * length, (0.06, 0.25))
    if rng.uniform() < 0.4:  # a cooker's hood
        stage.box((0.6, 0.45, 0.12), handle, place, (rng.uniform(-0.3, 0.3) * length, -0.23, 1.5))


def _fronts(
    stage: Stage,
    place: Array,
    across: tuple[int, float],
    box: tuple[float, float, float],
    bsdf: mi.BSDF,
    handle: mi.BSDF,
) -> None:
    """A row of cupboards: `across` is their number and width, `box` lower and upper edge and depth."""
    (count, wide), (low, high, deep) = across, box
    bordered, bar = stage.rng.uniform(size=2) < 0.5
    stage.box((count * wide, deep, high - low), bsdf, place, (0, -deep / 2, low))
    for i in range(count):
        x = (i + 0.5 - count / 2) * wide
        front = place @ frame(x, -deep - 0.01, low + 0.01)
        stage.box((wide - 0.012, 0.02, high - low - 0.02), bsdf, front)
        if bordered:
            _border(stage, front @ frame(0, -0.01, 0.03), (wide - 0.08, high - low - 0.08), 0.05, bsdf)
        size = (0.12, 0.015, 0.012) if bar else (0.012, 0.015, 0.12)
        stage.box(size, handle, front, (0 if bar else 0.38 * wide, -0.035, 0.75 * (high - low) if low < 1 else 0.06))


def row(stage: Stage, place: Array, length: float, size: tuple[float, float]) -> None:
    """Small things side by side: jars, cups, figures, piles of plates or books."""
    rng = stage.rng
    kinds = rng.choice(["vase", "bowl", "glass", "turned", "block", "ball", "pile"], 3)
    x = -length / 2
    while x < length / 2:
        tall = rng.uniform(*size)
        if (kind := str(kinds[rng.integers(3)])) == "pile":
            cover = stage.material()
            for i in range(int(rng.integers(3, 10))):
                stage.box((0.9 * tall, 0.7 * tall, 0.018), cover, place @ frame(x, 0, 0.02 * i, rng.normal() * 0.1))
        else:
            furniture.item(stage, place @ frame(x), tall, kind=kind)
        x += tall * rng.uniform(0.8, 1.6)


def shelves(stage: Stage, place: Array, width: float) -> None:
    """Single boards on a wall, each with its row of small things."""
    rng = stage.rng
    board = stage.material()
    for z in np.cumsum(rng.uniform(0.3, 0.5, int(rng.integers(1, 4)))) + 0.6:
        stage.box((width, 0.22, 0.025), board, place, (0, -0.11, z))
        row(stage, place @ frame(0, -0.11, z + 0.025), 0.85 * width, (0.06, 0.22))


def desks(stage: Stage, size: Array) -> None:
    """Rows of equal desks with chairs and papers: a class or an office."""
    rng = stage.rng
    top, leg, seat = stage.material(), stage.material("metal"), stage.material()
    x, y, _ = size
    for px in np.arange(-0.36 * x, 0.36 * x, rng.uniform(0.9, 1.5)):
        for py in np.arange(-0.36 * y, 0.36 * y, rng.uniform(1.0, 1.6)):
            at = frame(px, py, 0, rng.normal() * 0.05)
            stage.box((0.7, 0.5, 0.03), top, at, (0, 0, 0.7))
            for sx, sy in ((1, 1), (1, -1), (-1, 1), (-1, -1)):
                stage.box((0.03, 0.03, 0.7), leg, at, (0.3 * sx, 0.2 * sy, 0))
            chair = at @ frame(rng.normal() * 0.05, -0.45, 0, rng.normal() * 0.2)
            stage.box((0.38, 0.38, 0.03), seat, chair, (0, 0, 0.42))
            stage.box((0.38, 0.03, 0.25), seat, chair, (0, -0.19, 0.6))
            for sx, sy in ((1, 1), (1, -1), (-1, 1), (-1, -1)):
                stage.box((0.025, 0.025, 0.85 if sy < 0 else 0.42), leg, chair, (0.17 * sx, 0.17 * sy, 0))
            for _ in range(int(rng.integers(0, 3))):
                spot = at @ meshes.at(rng.uniform(-0.15, 0.15, 2), 0.73, rng.uniform(0, 6.3))
                stage.box((0.21, 0.29, rng.uniform(0.002, 0.04)), stage.material("matte"), spot)


def railing(stage: Stage, place: Array, length: float) -> None:
    """Balusters under a hand rail along x."""
    rng = stage.rng
    wood, bars = stage.material(), stage.material()
    turned = meshes.lathe(rng, "leg", 16) if rng.uniform() < 0.5 else None
    for x in np.arange(-length / 2, length / 2, rng.uniform(0.1, 0.2)):
        if turned is not None:
            stage.mesh(turned, bars, place @ frame(x) @ frame(scale=np.array([0.6, 0.6, 0.9])))
        else:
            stage.box((0.025, 0.025, 0.9), bars, place, (x, 0, 0))
    stage.box((length, 0.07, 0.05), wood, place, (0, 0, 0.9))
