"""What the tracer asks of a BSDF and Mitsuba does not answer: roughness, reflectance and diffuse part.

`roughness`, `reflectance`, `diffuse_value` and `normal` are meant for `drjit.dispatch`: they receive a concrete
BSDF while the kernel is traced and walk into wrappers (mask, twosided, blendbsdf, maps) that hide what they wrap.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cache
from typing import Any

import drjit as dr
import mitsuba as mi

PERTURBED = ("BumpMap", "NormalMap")
WRAPPERS = ("MaskBSDF", *PERTURBED)
PRINCIPLED = ("Principled", "PrincipledThin")
CONDUCTORS = ("SmoothConductor", "RoughConductor")
TRANSPARENT = ("SmoothDielectric", "ThinDielectric", "RoughDielectric", "Null")
UNSPLIT = ("Measured", "MeasuredPolarized", "Hair", *CONDUCTORS, *TRANSPARENT)
SPLIT = ("SmoothDiffuse", "SmoothPlastic", "RoughPlastic", *PRINCIPLED)
COMPOUND = ("TwoSidedBRDF", "BlendBSDF", *WRAPPERS)

MIN_ALPHA = 1e-3  # floor of Mitsuba's principled BSDFs
UNKNOWN_ALPHA = 0.5


@cache
def _collector(variant: str) -> type:
    """Return the class that lists the objects below another; its base differs between Mitsuba's variants."""

    class Collector(mi.TraversalCallback):
        def __init__(self) -> None:
            super().__init__()
            self.found: dict[str, Any] = {}

        def put(self, name: str, value: Any, flags: int, cpptype: Any = None) -> None:
            if isinstance(value, mi.Object):
                self.found[name] = value

    return Collector


def children(node: Any) -> dict[str, Any]:
    """Return the named objects (textures, nested BSDFs) one level below an object."""
    collector = _collector(mi.variant())()
    node.traverse(collector)
    return collector.found


def leaves(bsdf: Any) -> list[Any]:
    """Return the BSDFs at the bottom of a tree of wrappers."""
    if bsdf.class_name() not in COMPOUND:
        return [bsdf]
    return [leaf for child in children(bsdf).values() if isinstance(child, mi.BSDF) for leaf in leaves(child)]


def descendants(node: Any, seen: dict[int, Any] | None = None) -> list[Any]:
    """Return every object below a scene or BSDF once, those inside of instanced groups too."""
    seen = {} if seen is None else seen
    for child in children(node).values():
        if id(child) not in seen:
            seen[id(child)] = child
            descendants(child, seen)
    return list(seen.values())


@dataclass(frozen=True)
class Lobes:
    """Whether any BSDF of a scene has glossy lobes, has them beside diffuse ones, or has a bump or normal map."""

    glossy: bool
    mixed: bool
    mapped: bool


def survey(scene: Any) -> Lobes:
    """Return the lobes of a scene; raise NotImplementedError that names what cannot be traced or split."""
    objects = descendants(scene)
    for found in objects:
        if isinstance(found, mi.Medium):
            raise NotImplementedError(f"medium '{found.id()}': participating media are not traced; remove it")
        if isinstance(found, mi.BSDF):
            check(found)
    bsdfs = [found for found in objects if isinstance(found, mi.BSDF)]
    return Lobes(
        glossy=any(mi.has_flag(bsdf.flags(), mi.BSDFFlags.Glossy) for bsdf in bsdfs),
        mixed=any(is_mixed(bsdf.flags()) for bsdf in bsdfs),
        mapped=any(bsdf.class_name() in PERTURBED for bsdf in bsdfs),
    )


def check(bsdf: Any) -> None:
    """Raise NotImplementedError for a BSDF whose diffuse part cannot be told from the rest."""
    kind = bsdf.class_name()
    if kind not in (*SPLIT, *UNSPLIT, *COMPOUND) and is_mixed(bsdf.flags()):
        raise NotImplementedError(
            f"BSDF '{bsdf.id()}' ({kind}) mixes diffuse and glossy lobes that pathfold cannot split; "
            f"use one of {', '.join(SPLIT)}, or a blendbsdf of a diffuse and a glossy BSDF"
        )


def is_mixed(flags: Any) -> Any:
    """True where smooth diffuse and glossy lobes come together, so that one value holds both."""
    return mi.has_flag(flags, mi.BSDFFlags.Diffuse) & mi.has_flag(flags, mi.BSDFFlags.Glossy)


def facing(si: Any) -> Any:
    """Return the interaction as twosided shows it to the material it wraps: seen from the front."""
    flipped = mi.SurfaceInteraction3f(si)
    flipped.wi.z = dr.abs(si.wi.z)
    return flipped


def roughness(bsdf: Any, si: Any, active: Any) -> Any:
    """Return the alpha of the glossy lobes: 0 without one, the geometric mean when anisotropic.

    A lobe that pathfold cannot name (hair, measured and unknown BSDFs) gets the negative of its roughness.
    """
    kind = bsdf.class_name()
    if kind in COMPOUND:
        return _combine(bsdf, lambda child, s: roughness(child, s, active), si, active)
    if bsdf.has_attribute("alpha"):
        return mi.Float(bsdf.eval_attribute_1("alpha", si, active))
    if bsdf.has_attribute("alpha_u"):
        product = bsdf.eval_attribute_1("alpha_u", si, active) * bsdf.eval_attribute_1("alpha_v", si, active)
        return dr.sqrt(product)
    if kind in PRINCIPLED:
        return dr.maximum(MIN_ALPHA, dr.square(bsdf.eval_attribute_1("roughness", si, active)))
    if kind == "Hair":
        return -mi.Float(bsdf.eval_attribute_1("longitudinal_roughness", si, active))
    return mi.Float(-UNKNOWN_ALPHA if mi.has_flag(bsdf.flags(), mi.BSDFFlags.Glossy) else 0)


def reflectance(bsdf: Any, si: Any, active: Any) -> tuple[Any, Any]:
    """Return the reflectance of the diffuse lobe, and the guide albedo (specular where nothing is diffuse)."""
    kind = bsdf.class_name()
    if kind in COMPOUND:
        pick = lambda index: lambda child, s: reflectance(child, s, active)[index]  # noqa: E731
        return _combine(bsdf, pick(0), si, active), _combine(bsdf, pick(1), si, active)
    if kind in PRINCIPLED:
        parts = children(bsdf)
        base = parts["base_color"].eval(si, active)
        return base * _diffuse_weight(parts, si, active), base
    if kind in CONDUCTORS:
        return mi.Color3f(0), _conductor_fresnel(children(bsdf), si, active)
    if mi.has_flag(bsdf.flags(), mi.BSDFFlags.Diffuse):
        albedo = bsdf.eval_diffuse_reflectance(si, active)
        return albedo, albedo
    return mi.Color3f(0), mi.Color3f(1)


def diffuse_value(bsdf: Any, si: Any, wo: Any, active: Any) -> Any:
    """Return f|cos| of the diffuse lobes alone, for the local direction `wo`."""
    if not any(leaf.class_name() in PRINCIPLED for leaf in leaves(bsdf)):
        context = mi.BSDFContext()
        context.type_mask = int(mi.BSDFFlags.Diffuse)
        return bsdf.eval(context, si, wo, active)
    if bsdf.class_name() == "TwoSidedBRDF":
        outgoing = mi.Vector3f(wo.x, wo.y, dr.mulsign(wo.z, si.wi.z))
        return _combine(bsdf, lambda child, s: diffuse_value(child, s, outgoing, active), si, active)
    if bsdf.class_name() == "MaskBSDF":
        parts = children(bsdf)
        opacity = dr.clip(parts["opacity"].eval_1(si, active), 0, 1)
        return opacity * diffuse_value(parts["nested_bsdf"], si, wo, active)
    if bsdf.class_name() == "BlendBSDF":
        return _combine(bsdf, lambda child, s: diffuse_value(child, s, wo, active), si, active)
    if bsdf.class_name() in PERTURBED:
        # The ratio is free of the shadowing term, which these BSDFs multiply on but do not show.
        nested, context = children(bsdf)["nested_bsdf"], mi.BSDFContext()
        seen, frame = perturb(bsdf, si, active)
        outgoing = frame.to_local(wo)
        whole = nested.eval(context, seen, outgoing, active)
        part = diffuse_value(nested, seen, outgoing, active)
        return dr.select(whole > 0, bsdf.eval(context, si, wo, active) * part / whole, 0)
    return _principled_diffuse(bsdf, si, wo, active)


def normal(bsdf: Any, si: Any, active: Any) -> Any:
    """Return the shading normal in world space, with bump and normal maps."""
    if not any(node.class_name() in PERTURBED for node in (bsdf, *descendants(bsdf))):
        return mi.Vector3f(si.sh_frame.n)
    if bsdf.class_name() in PERTURBED:
        seen, _ = perturb(bsdf, si, active)
        return normal(children(bsdf)["nested_bsdf"], seen, active)
    return _combine(bsdf, lambda child, s: normal(child, s, active), si, active)


def perturb(bsdf: Any, si: Any, active: Any) -> tuple[Any, Any]:
    """Return the interaction that a bump or normal map shows to its nested BSDF, and its frame in local space."""
    parts, shading = children(bsdf), si.sh_frame
    if bsdf.class_name() == "NormalMap":
        n = mi.Vector3f(parts["normalmap"].eval_3(si, active)) * 2 - 1
    else:
        slope = parts["nested_texture"].eval_1_grad(si, active) * mi.traverse(bsdf)["scale"]
        dp_du = si.dp_du + shading.n * (slope.x - dr.dot(shading.n, si.dp_du))
        dp_dv = si.dp_dv + shading.n * (slope.y - dr.dot(shading.n, si.dp_dv))
        n = dr.normalize(dr.cross(dp_du, dp_dv))
        n = shading.to_local(dr.select(dr.dot(si.n, n) < 0, -n, n))
    n = dr.select(si.wi.z * dr.dot(si.wi, n) <= 0, mi.Vector3f(-n.x, -n.y, n.z), n)
    n = dr.select(dr.squared_norm(n) > 0, dr.normalize(n), mi.Vector3f(0, 0, 1))
    s = dr.normalize(mi.Vector3f(1, 0, 0) - n * n.x)
    local = mi.Frame3f(s, dr.cross(n, s), n)
    seen = mi.SurfaceInteraction3f(si)
    seen.sh_frame = mi.Frame3f(*(shading.to_world(axis) for axis in (local.s, local.t, local.n)))
    seen.wi = local.to_local(si.wi)
    return seen, local


def _combine(bsdf: Any, ask: Any, si: Any, active: Any) -> Any:
    """Ask the children of a compound BSDF and combine the answers as the compound itself does."""
    kind, parts = bsdf.class_name(), children(bsdf)
    if kind == "TwoSidedBRDF":
        front, back = parts["brdf_0"], parts.get("brdf_1", parts["brdf_0"])
        seen = facing(si)
        return ask(front, seen) if front is back else dr.select(si.wi.z > 0, ask(front, seen), ask(back, seen))
    if kind == "BlendBSDF":
        weight = dr.clip(parts["weight"].eval_1(si, active), 0, 1)
        return dr.lerp(ask(parts["bsdf_0"], si), ask(parts["bsdf_1"], si), weight)
    return ask(parts["nested_bsdf"], si)


def _conductor_fresnel(parts: dict[str, Any], si: Any, active: Any) -> Any:
    eta, k = parts["eta"].eval(si, active), parts["k"].eval(si, active)
    pair: Any = mi.Complex2f
    fresnel = mi.Color3f(*(mi.fresnel_conductor(dr.abs(si.wi.z), pair(eta[i], k[i])) for i in range(3)))
    tint = parts.get("specular_reflectance")
    return fresnel if tint is None else fresnel * tint.eval(si, active)


def _diffuse_weight(parts: dict[str, Any], si: Any, active: Any) -> Any:
    metallic = parts["metallic"].eval_1(si, active) if "metallic" in parts else mi.Float(0)
    return (1 - metallic) * (1 - parts["spec_trans"].eval_1(si, active))


def _schlick(cosine: Any) -> Any:
    return dr.power(dr.clip(1 - dr.abs(cosine), 0, 1), 5)


def _principled_diffuse(bsdf: Any, si: Any, wo: Any, active: Any) -> Any:
    """Diffuse, retro-reflection and flatness of Mitsuba's principled BSDFs, which ignore component masks.

    The untinted sheen stays out: it does not scale with the albedo and goes with the specular part.
    """
    parts = children(bsdf)
    one = lambda name: parts[name].eval_1(si, active)  # noqa: E731
    cos_i, cos_o = dr.abs(si.wi.z), dr.abs(wo.z)
    thin = bsdf.class_name() == "PrincipledThin"
    same_side = si.wi.z * wo.z > 0
    half = dr.normalize(si.wi + mi.Vector3f(wo.x, wo.y, dr.mulsign(cos_o, si.wi.z)))
    cos_d = dr.dot(half, mi.Vector3f(wo.x, wo.y, dr.mulsign(cos_o, si.wi.z)))
    retro = 2 * one("roughness") * dr.square(cos_d)
    fo, fi = _schlick(cos_o), _schlick(cos_i)
    lambert = (1 - 0.5 * fi) * (1 - 0.5 * fo) + retro * (fo + fi + fo * fi * (retro - 1))
    fss = dr.lerp(1, retro / 2, fo) * dr.lerp(1, retro / 2, fi)
    subsurface = 1.25 * (fss * (1 / (cos_o + cos_i) - 0.5) + 0.5)
    reflected = dr.lerp(lambert, subsurface, one("flatness"))
    value = _diffuse_weight(parts, si, active) * cos_o * dr.inv_pi * parts["base_color"].eval(si, active)
    if not thin:
        return dr.select(active & same_side & (si.wi.z > 0), value * reflected, 0)
    through = one("diff_trans") / 2
    return dr.select(active, value * dr.select(same_side, (1 - through) * reflected, through), 0)
