"""Lights: skies, environment maps, spots, lamps with shades and behind glass, screens, glowing letters and tubes."""

from __future__ import annotations

from typing import Any

import mitsuba as mi
import numpy as np

from . import growth, meshes, solids, textures
from .meshes import Array, frame
from .stage import Stage, emission, warm

SKIES = ("studio", "overcast", "sunset", "gradient", "night", "sides")


def sky(stage: Stage) -> None:
    """Sun and sky, an environment map, or an even sky."""
    rng = stage.rng
    pick = rng.uniform()
    if pick < 0.45:
        sun(stage)
    elif pick < 0.93:
        environment(stage)
    else:
        even(stage, 0.5, 1)


def sun(stage: Stage) -> None:
    """Sun and sky, from a low sun to noon."""
    rng = stage.rng
    height, turn = np.radians(rng.uniform(6, 75)), rng.uniform(0, 2 * np.pi)
    way = [np.cos(height) * np.cos(turn), np.cos(height) * np.sin(turn), np.sin(height)]
    scale = {
        "sun_scale": rng.uniform(0.1, 1),
        "sky_scale": rng.uniform(0.4, 2),
        "sun_aperture": rng.uniform(0.5, 4),
    }
    stage.put({"type": "sunsky", "sun_direction": list(map(float, way)), "turbidity": rng.uniform(2, 8)} | scale)


def even(stage: Stage, low: float, high: float) -> None:
    """The same light from everywhere."""
    stage.put({"type": "constant", "radiance": {"type": "rgb", "value": textures.colour(stage.rng, 0.2, low, high)}})


def environment(stage: Stage, kind: str | None = None) -> None:
    """An environment map of one of SKIES."""
    rng = stage.rng
    kind = kind or str(rng.choice(SKIES))
    height, width = 64, 128
    v, u = np.meshgrid((np.arange(height) + 0.5) / height, (np.arange(width) + 0.5) / width, indexing="ij")
    sky, horizon, ground = (np.array(textures.colour(rng, rng.uniform(0, 0.7), 0.2, 1)) for _ in range(3))
    if kind == "sunset":
        horizon, sky = np.array([1, 0.45, 0.15]), np.array([0.15, 0.2, 0.45]) * rng.uniform(0.5, 2)
    up = np.clip(1 - 2 * v, 0, 1)[..., None] ** 0.5
    pixels = np.where(v[..., None] < 0.5, horizon + (sky - horizon) * up, 0.4 * ground)
    pixels = pixels * (0.5 + textures.noise(rng, 1.8, size=width)[:height, :, None])
    pixels *= {"studio": 0.1, "night": 0.02, "sides": 0.05}.get(kind, 1)
    if kind == "sides":  # two opposite colours
        for side, hue in ((0.25, horizon), (0.75, sky)):
            pixels += 4 * np.exp(-(((u - side) / 0.08) ** 2) - ((v - 0.4) / 0.15) ** 2)[..., None] * hue
    few, many = {"studio": (1, 5), "sunset": (1, 2), "night": (15, 50), "gradient": (0, 3)}.get(kind, (0, 1))
    for _ in range(int(rng.integers(few, many))):
        low, high, small, large = (0.44, 0.5, 0.02, 0.05) if kind == "sunset" else (0.05, 0.5, 0.02, 0.12)
        cu, cv, size = rng.uniform(), rng.uniform(low, high), rng.uniform(small, large)
        size = 0.012 if kind == "night" else size
        du = np.abs((u - cu + 0.5) % 1 - 0.5)
        box = np.maximum(du / 2, abs(v - cv)) if rng.uniform() < 0.5 else np.hypot(du, abs(v - cv))
        strength = rng.uniform(0.02, 0.15) / size**2
        pixels += (box < size)[..., None] * strength * np.array(warm(rng))
    upright = mi.ScalarTransform4f().rotate([0, 0, 1], rng.uniform(0, 360)).rotate([1, 0, 0], 90)
    stage.put({"type": "envmap", "bitmap": mi.Bitmap(pixels.astype(np.float32)), "to_world": upright})


def spot(stage: Stage, origin: Any, target: Any, power: float, cutoff: float) -> None:
    """A spot whose rim is `cutoff` degrees from its axis."""
    look = mi.ScalarTransform4f().look_at(list(map(float, origin)), list(map(float, target)), [0.1, 0.99, 0.01])
    value = [float(t) * power for t in warm(stage.rng)]
    stage.put({"type": "spot", "intensity": {"type": "rgb", "value": value}, "cutoff_angle": cutoff, "to_world": look})


def bulbs(stage: Stage, low: Any, high: Any, count: int, power: float) -> None:
    """Many small lights in a box, of one colour or of all."""
    rng = stage.rng
    tint = warm(rng) if rng.uniform() < 0.5 else None
    for _ in range(count):
        radius = rng.uniform(0.015, 0.06)
        stage.bulb(rng.uniform(low, high), radius, power * rng.uniform(0.3, 2), tint or rng.uniform(0.15, 1, 3))


def key_lights(stage: Stage, far: float) -> None:
    """One to three area lights around the origin, from needle-sharp to soft, and a faint fill."""
    rng = stage.rng
    for _ in range(int(rng.integers(1, 4))):
        turn, size = rng.uniform(0, 2 * np.pi), far * (rng.uniform(0.05, 1) ** 2 + 0.03)
        high = rng.choice([rng.uniform(0.2, 0.6), rng.uniform(0.7, 1.7)])
        at = far * np.array([np.cos(turn), np.sin(turn), high])
        power = far**2 * rng.uniform(5, 40)
        stage.area_light(at, (0, 0, 0.1 * far), (size, size * rng.uniform(0.5, 2)), power, warm(rng))
    if rng.uniform() < 0.5:
        even(stage, 0.01, 0.2)


def shaded_lamp(stage: Stage, placement: Array, power: float, height: float) -> None:
    """A bulb in an open, often translucent shade on a pole."""
    rng = stage.rng
    stage.box((0.03, 0.03, height), stage.material("metal"), placement)
    stage.box((0.3, 0.3, 0.03), stage.material("metal"), placement)
    wide = rng.uniform(0.05, 0.12)
    shade = meshes.grid(
        lambda u, v: (
            (0.2 - wide * v) * np.cos(6.2832 * u),
            (0.2 - wide * v) * np.sin(6.2832 * u),
            0.28 * v,
        ),
        40,
        2,
    )
    cover = stage.material("translucent" if rng.uniform() < 0.6 else "matte")
    stage.mesh(shade, cover, placement @ frame(z=height))
    stage.bulb((placement @ [0, 0, height + 0.12, 1])[:3], rng.uniform(0.03, 0.06), power, warm(rng))


def lantern(stage: Stage, placement: Array, power: float, size: float) -> None:
    """A light behind glass: a large bulb in a box of panes, as a small one is never met by chance."""
    rng = stage.rng
    edge = stage.material("metal")
    for z in (0, 1):
        stage.box((size, size, 0.05 * size), edge, placement, (0, 0, 1.4 * z * size))
    for x, y in ((1, 1), (1, -1), (-1, 1), (-1, -1)):
        stage.box((0.06 * size,) * 2 + (1.4 * size,), edge, placement, (0.47 * x * size, 0.47 * y * size, 0))
    for turn in range(4):
        side = placement @ frame(yaw=turn * np.pi / 2) @ frame(y=0.46 * size)
        stage.rectangle(
            (side @ [0, 0, 0.7 * size, 1])[:3],
            (side @ [0, 1, 0.7 * size, 1])[:3],
            (0.9 * size, 1.35 * size),
            bsdf=stage.material("pane"),
        )
    stage.bulb((placement @ [0, 0, 0.6 * size, 1])[:3], 0.3 * size, power, warm(rng))


def screen(stage: Stage, placement: Array, size: tuple[float, float], radiance: float) -> None:
    """A television or advertisement facing -y of the frame, its lower edge on z = 0."""
    rng = stage.rng
    w, h = size
    stage.box((w + 0.06, 0.04, h + 0.06), stage.material("matte"), placement, (0, 0.03, -0.03))
    value = textures.pattern(rng, str(rng.choice(["shapes", "noise", "plaid", "stains", "stripes"])))
    paint = np.array([textures.colour(rng, 0.8, 0.1, 1) for _ in range(3)])
    pixels = radiance * np.stack([np.interp(value, [0.1, 0.5, 0.9], paint[:, i]) for i in range(3)], -1)
    at, toward = ((placement @ [0, y, h / 2, 1])[:3] for y in (0, -1))
    stage.rectangle(at, toward, size, emitter={"type": "area", "radiance": textures.bitmap(pixels)})


def neon(stage: Stage, placement: Array, radiance: float) -> None:
    """Glowing letters or a glowing loop, about 1 high."""
    rng = stage.rng
    light = emission(radiance, textures.colour(rng, 0.8, 0.8, 1))
    if rng.uniform() < 0.6:
        stage.mesh(solids.text(rng, int(rng.integers(1, 4))), stage.material("matte"), placement, light)
    else:
        stage.mesh(growth.wire(rng), stage.material("matte"), placement @ frame(z=0.6, scale=0.5), light)
