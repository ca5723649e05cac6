"""Other light, colours and roughness for a library scene: what its further views have besides another camera."""

from __future__ import annotations

from typing import Any

import drjit as dr
import mitsuba as mi
import numpy as np
from numpy.random import Generator
from numpy.typing import NDArray

LIGHT = ("radiance.value", "intensity.value", "irradiance.value", "sky_scale", "sun_scale")
COLOR = ("reflectance.value", "base_color.value", "reflectance.data", "base_color.data")
ROUGHNESS = ("alpha", "alpha.value", "alpha_u.value", "alpha_v.value", "roughness.value")
LEAST_ROUGHNESS = 0.01  # below it lobes are narrower than any light


def vary(scene: mi.Scene, rng: Generator) -> None:
    """Changes the scene in place: lights by up to two stops and a tint, colours and textures by order of channels and
    a power, roughness by up to a factor of 2. Equal seeds change equal scenes equally. What is black stays black.
    """
    parameters = mi.traverse(scene)
    for key in parameters.keys():  # noqa: SIM118 (iterating itself would read values that cannot be read)
        node = parameters.properties[key][2]
        if key.endswith(LIGHT) or (key.endswith(".scale") and isinstance(node, mi.Emitter)):
            change = _lit(rng)
        elif key.endswith(COLOR):
            change = _colored(rng)
        elif key.split(".", 1)[-1].endswith(ROUGHNESS):
            change = _roughened(rng)
        else:
            continue
        old = parameters[key]
        eight_bits = dr.is_tensor_v(old) and dr.type_v(old) == dr.VarType.UInt8
        values = change(np.array(old, np.float32) / (255 if eight_bits else 1))
        parameters[key] = _like(old, values * 255 + 0.5 if eight_bits else values)
    parameters.update()


def _like(old: Any, values: NDArray[Any]) -> Any:
    """The values in the type that the scene keeps them in."""
    if isinstance(old, float):
        return float(values)
    if dr.is_tensor_v(old):
        return type(old)(values.astype(np.uint8) if dr.type_v(old) == dr.VarType.UInt8 else values)
    return type(old)(*values.ravel().tolist()) if dr.size_v(type(old)) > 1 else type(old)(values.ravel())


def _lit(rng: Generator) -> Any:
    gain, tint = 2.0 ** rng.uniform(-2, 2), rng.lognormal(0, 0.15, 3)
    return lambda value: value * (gain * tint.reshape(value.shape) / tint.mean() if value.size == 3 else gain)


def _colored(rng: Generator) -> Any:
    order, power = rng.permutation(3), 2.0 ** rng.uniform(-0.5, 0.5)

    def change(value: NDArray[np.float32]) -> NDArray[np.float32]:
        if value.ndim == 3 and value.shape[-1] >= 3:
            value = value[..., [*order, *range(3, value.shape[-1])]]
        elif value.size == 3:
            value = value.ravel()[order].reshape(value.shape)
        return np.clip(value, 0, 1) ** power

    return change


def _roughened(rng: Generator) -> Any:
    factor = 2.0 ** rng.uniform(-1, 1)
    return lambda value: np.clip(value * factor, min(LEAST_ROUGHNESS, float(value.min())), max(1.0, float(value.max())))
