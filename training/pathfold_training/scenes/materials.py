"""Materials drawn at random over Mitsuba's set; roughness is drawn as a square, so glossy is as common as rough."""

from __future__ import annotations

import mitsuba as mi
import numpy as np
from numpy.random import Generator

from . import textures
from .tones import Tones

METALS = ("Ag", "Al", "Au", "Cu", "Cr", "W")
KINDS = {  # of opaque materials, and how often
    "diffuse": 0.24,
    "plastic": 0.08,
    "roughplastic": 0.22,
    "principled": 0.1,
    "coated": 0.07,
    "fabric": 0.07,
    "blend": 0.04,
    "bump": 0.07,
    "normal": 0.06,
    "metal": 0.05,
}


def roughness(rng: Generator, low: float = 0.02, high: float = 0.6) -> float:
    """Microfacet alpha."""
    return low + (high - low) * float(rng.uniform()) ** 2


def _rgb(value: list[float]) -> dict:
    return {"type": "rgb", "value": value}


def _reflectance(rng: Generator, tones: Tones, textured: float, repeat: float) -> dict | mi.Texture:
    if rng.uniform() < textured:
        return textures.coloured(rng, tones, repeat=repeat)
    return _rgb(tones.colour(rng))


def opaque(rng: Generator, tones: Tones, textured: float = 0.4, repeat: float = 1, kind: str | None = None) -> mi.BSDF:
    """Any two-sided surface that lets no light through."""
    kind = kind or str(rng.choice(list(KINDS), p=list(KINDS.values())))
    if kind == "metal":
        return metal(rng, tones)
    return mi.load_dict({"type": "twosided", "bsdf": _leaf(rng, tones, kind, textured, repeat)})


def _leaf(rng: Generator, tones: Tones, kind: str, textured: float, repeat: float) -> dict:
    def nested(*kinds: str) -> dict:
        return _leaf(rng, tones, str(rng.choice(kinds)), textured, repeat)

    if kind == "roughconductor":
        alpha = textures.scalar(rng, 0.05, 0.5, repeat) if rng.uniform() < 0.3 else roughness(rng)
        return {"type": kind, "material": str(rng.choice(METALS)), "alpha": alpha, "distribution": "ggx"}
    if kind == "blend":
        kinds = rng.permutation(["diffuse", "roughplastic", "roughconductor"])
        children = [_leaf(rng, tones, str(k), textured, repeat) for k in kinds[:2]]
        return {"type": "blendbsdf", "weight": textures.scalar(rng, 0, 1, repeat), "a": children[0], "b": children[1]}
    if kind == "bump":
        relief = textures.bitmap(textures.pattern(rng, str(rng.choice(textures.RELIEF))), repeat)
        below = nested("diffuse", "roughplastic", "roughconductor")
        return {"type": "bumpmap", "map": relief, "scale": rng.uniform(0.01, 0.06), "nested": below}
    if kind == "normal":
        below = nested("diffuse", "roughplastic", "roughconductor", "principled")
        return {"type": "normalmap", "normalmap": textures.slopes(rng, repeat), "nested": below}
    base = _reflectance(rng, tones, textured, repeat)
    if kind in ("diffuse", "plastic"):
        return {"type": kind, "reflectance" if kind == "diffuse" else "diffuse_reflectance": base}
    if kind == "roughplastic":
        return {"type": kind, "diffuse_reflectance": base, "alpha": roughness(rng, 0.04), "distribution": "ggx"}
    return _principled(rng, kind, base, repeat)


def _principled(rng: Generator, kind: str, base: dict | mi.Texture, repeat: float) -> dict:
    """Coated paint, cloth with sheen, or anything between plastic and metal."""
    surface: dict = {"type": "principled", "base_color": base}
    if kind == "coated":
        coat = {"clearcoat": 1.0, "clearcoat_gloss": rng.uniform(0.5, 1), "metallic": float(rng.choice([0, 0.8]))}
        return surface | coat | {"roughness": rng.uniform(0.3, 0.8), "specular": 0.5}
    if kind == "fabric":
        return surface | {"roughness": 0.9, "sheen": rng.uniform(0.3, 1), "sheen_tint": rng.uniform(0, 1)}
    alpha = textures.scalar(rng, 0.1, 0.7, repeat) if rng.uniform() < 0.3 else roughness(rng, 0.1, 1)
    extra = {name: float(rng.uniform()) for name in ("clearcoat", "sheen") if rng.uniform() < 0.25}
    metallic = float(rng.choice([0, 0, 0, 1, rng.uniform()]))
    return surface | {"roughness": alpha, "specular": rng.uniform(0.2, 0.8), "metallic": metallic} | extra


def metal(rng: Generator, tones: Tones) -> mi.BSDF:
    """Mirror to brushed or anodised metal."""
    alpha = roughness(rng, 0, 0.5)
    surface: dict = {"type": "conductor", "material": str(rng.choice(METALS))}
    if alpha > 0.015:
        surface |= {"type": "roughconductor", "alpha": alpha, "distribution": "ggx"}
    if rng.uniform() < 0.2 and alpha > 0.015:
        surface |= {"alpha_u": alpha, "alpha_v": min(1.0, 4 * alpha)}
        del surface["alpha"]
    if rng.uniform() < 0.25:
        surface |= {"material": "Al", "specular_reflectance": _rgb(tones.colour(rng, 0.3))}
    return mi.load_dict({"type": "twosided", "bsdf": surface})


def glass(rng: Generator, tones: Tones) -> mi.BSDF:
    """Solid clear or frosted glass, sometimes tinted."""
    alpha = roughness(rng, 0, 0.4)
    surface: dict = {"type": "dielectric", "int_ior": rng.uniform(1.3, 1.8)}
    if alpha > 0.06:
        surface |= {"type": "roughdielectric", "alpha": alpha, "distribution": "ggx"}
    if rng.uniform() < 0.4:
        tint = 0.4 + 0.6 * np.sqrt(tones.colour(rng, 0.5))
        surface["specular_transmittance"] = _rgb([float(min(t, 0.98)) for t in tint])
    return mi.load_dict(surface)


def pane() -> mi.BSDF:
    """Window glass."""
    return mi.load_dict({"type": "thindielectric", "int_ior": 1.5})


def translucent(rng: Generator, tones: Tones) -> mi.BSDF:
    """Paper, thin cloth, lamp shades: light comes through, scattered."""
    base = _reflectance(rng, tones._replace(value=(0.6, 0.97)), 0.3, 2)
    through = {"diff_trans": rng.uniform(0.5, 1.5), "roughness": rng.uniform(0.4, 1), "eta": 1.3}
    return mi.load_dict({"type": "principledthin", "base_color": base} | through)


def perforated(rng: Generator, tones: Tones) -> mi.BSDF:
    """A sheet full of holes."""
    sheet = {"type": "twosided", "bsdf": _leaf(rng, tones, str(rng.choice(["diffuse", "roughplastic"])), 0.2, 1)}
    return mi.load_dict({"type": "mask", "opacity": textures.holes(rng, float(rng.integers(1, 4))), "nested": sheet})


def foliage(rng: Generator, tones: Tones) -> mi.BSDF:
    """Leaf cut out of a card: green or autumnal, glossy or translucent."""
    hue = rng.choice([rng.uniform(0.2, 0.4), rng.uniform(0, 0.16)], p=[0.75, 0.25])
    base = _rgb(tones._replace(hues=(hue,), stray=0.02, saturation=(0.5, 0.9), value=(0.3, 0.8)).colour(rng))
    if rng.uniform() < 0.4:
        leaf = {"type": "principledthin", "base_color": base, "roughness": 0.5, "diff_trans": 0.8, "eta": 1.4}
    else:
        leaf = {"type": "twosided", "bsdf": {"type": "roughplastic", "alpha": 0.25, "diffuse_reflectance": base}}
    return mi.load_dict({"type": "mask", "opacity": textures.leaf(rng), "nested": leaf})


def hair(rng: Generator, tones: Tones) -> mi.BSDF:
    """For curves: Mitsuba's hair, or a dyed fibre."""
    if rng.uniform() < 0.4:
        pigment = {"eumelanin": rng.uniform(0.1, 2), "pheomelanin": rng.uniform(0, 1)}
        return mi.load_dict({"type": "hair", "longitudinal_roughness": rng.uniform(0.2, 0.6)} | pigment)
    fibre = {"type": "roughplastic", "alpha": 0.3, "diffuse_reflectance": _rgb(tones.colour(rng, 0.2))}
    return mi.load_dict({"type": "twosided", "bsdf": fibre})


def matte(rng: Generator, tones: Tones, low: float = 0, high: float = 1) -> mi.BSDF:
    """Wall paint."""
    colour = _rgb(tones.colour(rng, low, high))
    return mi.load_dict({"type": "twosided", "bsdf": {"type": "diffuse", "reflectance": colour}})
