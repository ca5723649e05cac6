"""A Mitsuba scene in the making: shapes, lights and the camera collected in one dictionary."""

from __future__ import annotations

from typing import Any

import mitsuba as mi
import numpy as np
from numpy.random import Generator

from . import materials, tones
from .meshes import Array, Surface, frame, to_shape

PALETTE = {  # materials of a kind in one scene
    "opaque": 6,
    "metal": 2,
    "glass": 2,
    "foliage": 2,
    "matte": 2,
    "translucent": 1,
    "perforated": 1,
    "hair": 1,
    "pane": 1,
}


class Stage:
    """What has been put into the scene so far; lengths in metres, z up."""

    def __init__(self, rng: Generator) -> None:
        self.rng = rng
        self.entries: dict[str, Any] = {"type": "scene", "integrator": {"type": "path", "max_depth": 8}}
        self.tones = tones.draw(rng)
        self.palette: dict[str, list[mi.BSDF]] = {kind: [] for kind in PALETTE}

    def put(self, entry: Any) -> None:
        """Any Mitsuba plugin: an object or a dictionary."""
        self.entries[f"entry{len(self.entries)}"] = entry

    def material(self, kind: str = "opaque") -> mi.BSDF:
        """One of the scene's few materials of this kind: furniture matches, and kernels compile fast."""
        known = self.palette[kind]
        if len(known) < PALETTE[kind]:
            known.append(materials.pane() if kind == "pane" else getattr(materials, kind)(self.rng, self.tones))
            return known[-1]
        return known[self.rng.integers(len(known))]

    def any_material(self) -> mi.BSDF:
        """For things on tables: glass and metal more often than for furniture."""
        kinds = ["glass", "metal", "translucent", "opaque"]
        return self.material(str(self.rng.choice(kinds, p=[0.15, 0.14, 0.04, 0.67])))

    def mesh(self, surface: Surface, bsdf: mi.BSDF, placement: Array, light: dict[str, Any] | None = None) -> None:
        """A surface placed by a 4 x 4 matrix, glowing where `light` is an emitter."""
        self.put(to_shape(surface, bsdf, placement, light))

    def box(self, size: Any, bsdf: mi.BSDF, placement: Array, at: Any = (0, 0, 0), **extra: Any) -> None:
        """A box of `size` whose base centre is `at` in the frame `placement`."""
        sx, sy, sz = size
        local = frame(at[0], at[1], at[2] + sz / 2) @ np.diag([sx / 2, sy / 2, sz / 2, 1])
        self.put({"type": "cube", "to_world": mi.ScalarTransform4f((placement @ local).tolist()), "bsdf": bsdf} | extra)

    def rectangle(self, centre: Any, toward: Any, size: Any, **extra: Any) -> None:
        """A rectangle of `size` that faces the point `toward`."""
        up = [0, 0, 1] if abs(toward[2] - centre[2]) < 0.9 * np.linalg.norm(np.subtract(toward, centre)) else [1, 0, 0]
        transform = mi.ScalarTransform4f().look_at(list(map(float, centre)), list(map(float, toward)), up)
        self.put(
            {"type": "rectangle", "to_world": transform @ mi.ScalarTransform4f().scale([size[0] / 2, size[1] / 2, 1])}
            | extra
        )

    def area_light(self, centre: Any, toward: Any, size: Any, power: float, tint: Any = (1, 1, 1)) -> None:
        """A one-sided light whose power (W, roughly) is spread over its area."""
        self.rectangle(centre, toward, size, emitter=emission(power / (np.pi * size[0] * size[1]), tint))

    def bulb(self, centre: Any, radius: float, power: float, tint: Any = (1, 1, 1)) -> None:
        light = emission(power / (4 * np.pi**2 * radius**2), tint)
        self.put({"type": "sphere", "center": list(map(float, centre)), "radius": float(radius), "emitter": light})

    def camera(self, blur: float = 0) -> None:
        """The sensor, yet to be aimed (cameras.aim): perspective, or a thin lens when `blur` is above 0."""
        sensor = {
            "type": "thinlens" if blur else "perspective",
            "to_world": mi.ScalarTransform4f().look_at([1, 0, 1], [0, 0, 1], [0, 0, 1]),
            "film": {"type": "hdrfilm", "width": 64, "height": 64, "pixel_format": "rgb", "rfilter": {"type": "box"}},
            "near_clip": 0.01,
        }
        self.entries["sensor"] = sensor | ({"aperture_radius": blur, "focus_distance": 1.0} if blur else {})

    def load(self) -> mi.Scene:
        return mi.load_dict(self.entries, optimize=False)  # merged meshes come in another order at every load


def emission(radiance: float, tint: Any = (1, 1, 1)) -> dict[str, Any]:
    """An area emitter of this radiance."""
    value = [float(radiance) * float(t) for t in tint]
    return {"type": "area", "radiance": {"type": "rgb", "value": value}}


def warm(rng: Generator) -> list[float]:
    """The tint of a lamp: from candle to daylight, seldom coloured."""
    if rng.uniform() < 0.15:
        return list(map(float, rng.uniform(0.1, 1, 3)))
    heat = rng.uniform(0, 1)
    return [1, 0.75 + 0.25 * (1 - heat), 1 - 0.6 * heat]
