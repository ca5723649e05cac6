"""Materials drawn at random over Mitsuba's set; roughness is drawn as a square, so glossy is as common as rough."""

from __future__ import annotations

import mitsuba as mi
from numpy.random import Generator

from . import textures
from .textures import colour

METALS = ("Ag", "Al", "Au", "Cu", "Cr", "W")


def roughness(rng: Generator, low: float = 0.02, high: float = 0.6) -> float:
    """Microfacet alpha."""
    return low + (high - low) * float(rng.uniform()) ** 2


def _reflectance(rng: Generator, textured: float, repeat: float) -> dict | mi.Texture:
    if rng.uniform() < textured:
        return textures.coloured(rng, repeat=repeat)
    return {"type": "rgb", "value": colour(rng)}


def opaque(rng: Generator, textured: float = 0.4, repeat: float = 1, kind: str | None = None) -> mi.BSDF:
    """Any two-sided surface that lets no light through."""
    kinds = ["diffuse", "plastic", "roughplastic", "principled", "blend", "bump", "metal"]
    kind = kind or str(rng.choice(kinds, p=[0.3, 0.08, 0.29, 0.15, 0.04, 0.06, 0.08]))
    if kind == "metal":
        return metal(rng)
    return mi.load_dict({"type": "twosided", "bsdf": _leaf(rng, kind, textured, repeat)})


def _leaf(rng: Generator, kind: str, textured: float, repeat: float) -> dict:
    base = _reflectance(rng, textured, repeat)
    if kind in ("diffuse", "plastic"):
        return {"type": kind, "reflectance" if kind == "diffuse" else "diffuse_reflectance": base}
    if kind == "roughplastic":
        return {"type": kind, "diffuse_reflectance": base, "alpha": roughness(rng, 0.04), "distribution": "ggx"}
    if kind == "blend":
        children = [
            _leaf(rng, k, textured, repeat) for k in rng.permutation(["diffuse", "roughplastic", "roughconductor"])
        ]
        return {"type": "blendbsdf", "weight": textures.scalar(rng, 0, 1, repeat), "a": children[0], "b": children[1]}
    if kind == "bump":
        nested = _leaf(rng, str(rng.choice(["diffuse", "roughplastic", "roughconductor"])), textured, repeat)
        return {
            "type": "bumpmap",
            "map": textures.scalar(rng, 0, 1, repeat),
            "scale": rng.uniform(0.01, 0.05),
            "nested": nested,
        }
    if kind == "roughconductor":
        return {"type": kind, "material": str(rng.choice(METALS)), "alpha": roughness(rng), "distribution": "ggx"}
    alpha = textures.scalar(rng, 0.1, 0.7, repeat) if rng.uniform() < 0.3 else roughness(rng, 0.1, 1)
    extra = {name: float(rng.uniform()) for name in ("clearcoat", "sheen") if rng.uniform() < 0.25}
    metallic = float(rng.choice([0, 0, 0, 1, rng.uniform()]))
    return {
        "type": "principled",
        "base_color": base,
        "roughness": alpha,
        "specular": rng.uniform(0.2, 0.8),
        "metallic": metallic,
    } | extra


def metal(rng: Generator) -> mi.BSDF:
    """Mirror to brushed metal."""
    alpha = roughness(rng, 0, 0.5)
    surface: dict = {"type": "conductor", "material": str(rng.choice(METALS))}
    if alpha > 0.015:
        surface |= {"type": "roughconductor", "alpha": alpha, "distribution": "ggx"}
    if rng.uniform() < 0.2 and alpha > 0.015:
        surface |= {"alpha_u": alpha, "alpha_v": min(1.0, 4 * alpha)}
        del surface["alpha"]
    return mi.load_dict({"type": "twosided", "bsdf": surface})


def glass(rng: Generator) -> mi.BSDF:
    """Solid clear or frosted glass, sometimes tinted."""
    alpha = roughness(rng, 0, 0.4)
    surface: dict = {"type": "dielectric", "int_ior": rng.uniform(1.3, 1.8)}
    if alpha > 0.06:
        surface |= {"type": "roughdielectric", "alpha": alpha, "distribution": "ggx"}
    if rng.uniform() < 0.3:
        surface["specular_transmittance"] = {"type": "rgb", "value": colour(rng, None, 0.7, 0.95)}
    return mi.load_dict(surface)


def pane() -> mi.BSDF:
    """Window glass."""
    return mi.load_dict({"type": "thindielectric", "int_ior": 1.5})


def foliage(rng: Generator) -> mi.BSDF:
    """Green leaf cut out of a card."""
    green = [0.05 + 0.15 * rng.uniform(), 0.2 + 0.3 * rng.uniform(), 0.03 + 0.07 * rng.uniform()]
    base = {
        "type": "twosided",
        "bsdf": {"type": "roughplastic", "alpha": 0.25, "diffuse_reflectance": {"type": "rgb", "value": green}},
    }
    return mi.load_dict({"type": "mask", "opacity": textures.leaf(), "nested": base})


def matte(rng: Generator, low: float = 0.4, high: float = 0.85) -> mi.BSDF:
    """Wall paint."""
    return mi.load_dict(
        {
            "type": "twosided",
            "bsdf": {
                "type": "diffuse",
                "reflectance": {"type": "rgb", "value": colour(rng, 0.25 * rng.uniform(), low, high)},
            },
        }
    )
