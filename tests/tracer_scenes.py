"""Small scenes for the tracer's tests, made in memory: each shows another kind of light transport."""

from typing import Any

import mitsuba as mi
import numpy as np

Node = dict[str, Any]


def camera(origin: list[float], target: list[float], size: int = 32, kind: str = "perspective", **extra: Any) -> Node:
    """Return a sensor with a square film and a box filter; `extra` replaces or adds properties."""
    film = {"type": "hdrfilm", "width": size, "height": size, "rfilter": {"type": extra.pop("rfilter", "box")}}
    pose = mi.ScalarTransform4f().look_at(origin=origin, target=target, up=[0, 1, 0])
    return {"type": kind, "to_world": pose, "film": film, **({"fov": 45} if kind != "orthographic" else {}), **extra}


def rgb(*values: float) -> Node:
    return {"type": "rgb", "value": list(values)}


def texture(low: float, high: float, channels: int = 3) -> Node:
    """Return a raw bitmap of random values between two bounds."""
    pixels = np.random.default_rng(5).uniform(low, high, (16, 16, channels)).astype(np.float32)
    return {"type": "bitmap", "bitmap": mi.Bitmap(pixels), "raw": True, "filter_type": "bilinear"}


def at(*position: float, scale: float = 1.0) -> Any:
    return mi.ScalarTransform4f().translate(list(position)).scale(scale)


def floor(bsdf: Node) -> Node:
    turned = mi.ScalarTransform4f().translate([0, -1, 0]).rotate([1, 0, 0], -90).scale(4)
    return {"type": "rectangle", "to_world": turned, "bsdf": bsdf}


def load(**parts: Node) -> Any:
    return mi.load_dict({"type": "scene", **parts})


def room() -> Any:
    """A closed box: diffuse and glossy interreflection from one area light."""
    lamp = mi.ScalarTransform4f().translate([0, 0.99, 0]).rotate([1, 0, 0], 90).scale(0.4)
    walls = {"type": "twosided", "b": {"type": "diffuse", "reflectance": rgb(0.7, 0.4, 0.2)}}
    plastic = {"type": "roughplastic", "alpha": 0.2, "diffuse_reflectance": rgb(0.1, 0.3, 0.6)}
    return load(
        box={"type": "cube", "flip_normals": True, "bsdf": walls},
        lamp={"type": "rectangle", "to_world": lamp, "emitter": {"type": "area", "radiance": rgb(9, 8, 6)}},
        ball={"type": "sphere", "to_world": at(0.3, -0.6, 0.2, scale=0.4), "bsdf": plastic},
        sensor=camera([0, 0, -0.95], [0, -0.2, 1], fov=80),
    )


def glassware() -> Any:
    """Clear, rough and thin glass, a mirror and a half-open mask under a bright sky, through a thin lens."""
    mask = {"type": "mask", "opacity": texture(0, 1, 1), "b": {"type": "twosided", "b": {"type": "diffuse"}}}
    gold = {"type": "conductor", "material": "Au"}
    items = [{"type": "dielectric"}, {"type": "roughdielectric", "alpha": 0.3}, gold, {"type": "thindielectric"}]
    shapes = {
        f"ball{i}": {"type": "sphere", "to_world": at(1.1 * i - 1.65, -0.5, 0, scale=0.5), "bsdf": bsdf}
        for i, bsdf in enumerate(items)
    }
    return load(
        sky={"type": "envmap", "bitmap": mi.Bitmap(texture(0.2, 2)["bitmap"])},
        floor=floor({"type": "twosided", "b": {"type": "diffuse"}}),
        sheet={"type": "rectangle", "to_world": at(0, 0.5, 1), "bsdf": mask},
        sensor=camera([0, 1, -5], [0, -0.3, 0], kind="thinlens", aperture_radius=0.05, focus_distance=5.0),
        **shapes,
    )


def materials() -> dict[str, Node]:
    """Return BSDFs that mix lobes or wrap others, by name."""
    plastic = {"type": "roughplastic", "alpha": 0.15}
    principled = {
        "type": "principled",
        "base_color": texture(0.1, 0.9),
        "roughness": 0.5,
        "metallic": 0.3,
        "clearcoat": 0.6,
        "clearcoat_gloss": 0.4,
        "sheen": 0.5,
        "flatness": 0.3,
        "spec_trans": 0.2,
    }
    thin = {"type": "principledthin", "base_color": rgb(0.6, 0.3, 0.2), "diff_trans": 0.8, "spec_trans": 0.3}
    brushed = {"type": "roughconductor", "material": "Al", "alpha_u": 0.4, "alpha_v": 0.1}
    return {
        "principled": principled,
        "thin": thin,
        "blend": {"type": "blendbsdf", "weight": texture(0, 1, 1), "a": {"type": "diffuse"}, "b": brushed},
        "bump": {"type": "bumpmap", "t": texture(0, 0.2, 1), "scale": 0.5, "b": principled},
        "normal": {"type": "normalmap", "normalmap": texture(0.3, 0.7), "b": plastic},
        "hair": {"type": "hair", "longitudinal_roughness": 0.4},
        "plastic": {"type": "plastic", "diffuse_reflectance": rgb(0.2, 0.5, 0.3)},
    }


def shelf() -> Any:
    """Spheres of mixed and wrapped materials under sun, spot and point lights and a dim sky."""
    spot_pose = mi.ScalarTransform4f().look_at(origin=[-2, 4, -3], target=[0, -1, 0], up=[0, 0, 1])
    balls = {
        name: {"type": "sphere", "to_world": at(-2.1 + 0.7 * i, -0.6, 0, scale=0.35), "bsdf": bsdf}
        for i, (name, bsdf) in enumerate(materials().items())
    }
    return load(
        sky={"type": "constant", "radiance": 0.3},
        sun={"type": "directional", "direction": [1, -2, 1], "irradiance": rgb(1.0, 0.9, 0.7)},
        spot={"type": "spot", "to_world": spot_pose, "intensity": 20.0},
        lamp={"type": "point", "position": [2, 2, -1], "intensity": rgb(2, 3, 4)},
        floor=floor({"type": "twosided", "b": {"type": "roughplastic", "alpha": 0.3}}),
        sensor=camera([0, 0.6, -6], [0, -0.5, 0], fov=42),
        **balls,
    )


def terrace() -> Any:
    """A sunlit plate and a glossy ball: the sky is an emitter of very uneven brightness."""
    metal = {"type": "roughconductor", "material": "Cu", "alpha": 0.3}
    up = mi.ScalarTransform4f().rotate([1, 0, 0], -90)
    return load(
        sky={"type": "sunsky", "to_world": up, "sun_direction": [0.3, 0.6, -0.7], "sun_aperture": 20.0},
        floor=floor({"type": "twosided", "b": {"type": "diffuse", "reflectance": texture(0.2, 0.8)}}),
        ball={"type": "sphere", "to_world": at(0, -0.2, 0, scale=0.8), "bsdf": metal},
        sensor=camera([0, 1, -5], [0, -0.3, 0]),
    )
