"""What the tracer says of materials: tags, roughness, guides, the diffuse part; and what it refuses by name."""

import gc
from collections.abc import Iterator
from typing import Any

import drjit as dr
import mitsuba as mi
import numpy as np
import pytest

if mi.variant() != "llvm_ad_rgb":
    mi.set_variant("llvm_ad_rgb")

import tracer_scenes as scenes
from pathfold.mitsuba import Frozen, Samples, materials, trace
from pathfold.mitsuba.film import Film

MIXED = {
    "type": "principled",
    "base_color": scenes.rgb(0.7, 0.3, 0.1),
    "roughness": 0.6,
    "metallic": 0.4,
    "spec_trans": 0.2,
    "flatness": 0.3,
}
DIFFUSE_ONLY = {**MIXED, "metallic": 0.0, "spec_trans": 0.0, "specular": 0.0}
PLASTIC = {"type": "roughplastic", "alpha": 0.2, "diffuse_reflectance": scenes.rgb(0.2, 0.5, 0.8)}

# name: BSDF, {tag: roughness} of what it can do, reflectance of its diffuse lobe, guide albedo (None: not exact)
CASES: dict[str, tuple[dict[str, Any], dict[int, float], Any, Any]] = {
    "diffuse": (
        {"type": "diffuse", "reflectance": scenes.rgb(0.2, 0.4, 0.6)},
        {5: 1},
        (0.2, 0.4, 0.6),
        (0.2, 0.4, 0.6),
    ),
    "mirror": ({"type": "conductor"}, {17: 0}, 0, 1),
    "metal": ({"type": "roughconductor", "alpha": 0.3}, {9: 0.3}, 0, 1),
    "brushed": ({"type": "roughconductor", "alpha_u": 0.4, "alpha_v": 0.1}, {9: 0.2}, 0, 1),
    "copper": ({"type": "roughconductor", "material": "Cu"}, {9: 0.1}, 0, None),
    "glass": ({"type": "dielectric"}, {17: 0, 18: 0}, 0, 1),
    "pane": ({"type": "thindielectric"}, {0: 0, 17: 0}, 0, 1),
    "frosted": ({"type": "roughdielectric", "alpha": 0.25}, {9: 0.25, 10: 0.25}, 0, 1),
    "lacquer": ({"type": "plastic", "diffuse_reflectance": 0.5}, {5: 1, 17: 0}, None, None),
    "plastic": (PLASTIC, {5: 1, 9: 0.2}, (0.2, 0.5, 0.8), (0.2, 0.5, 0.8)),
    "principled": (MIXED, {5: 1, 9: 0.36, 10: 0.36}, (0.336, 0.144, 0.048), (0.7, 0.3, 0.1)),
    "leaf": ({"type": "principledthin", "diff_trans": 1.0}, {5: 1, 6: 1}, 0.5, 0.5),
    "hair": ({"type": "hair", "longitudinal_roughness": 0.4}, {3: 0.4}, 0, None),
    "blend": (
        {"type": "blendbsdf", "weight": 0.25, "a": {"type": "roughconductor", "alpha": 0.2}, "b": {"type": "diffuse"}},
        {5: 1, 9: 0.15},
        0.125,
        0.875,
    ),
    "hole": ({"type": "mask", "opacity": 0.0, "b": {"type": "diffuse"}}, {0: 0}, 0, 1),
    "card": ({"type": "twosided", "a": {"type": "diffuse"}, "b": PLASTIC}, {5: 1}, 0.5, 0.5),
    "back": (
        {"type": "twosided", "a": {"type": "conductor"}, "b": PLASTIC},
        {5: 1, 9: 0.2},
        (0.2, 0.5, 0.8),
        (0.2, 0.5, 0.8),
    ),
    "veiled": ({"type": "mask", "opacity": 1.0, "b": {"type": "twosided", "b": PLASTIC}}, {5: 1, 9: 0.2}, None, None),
    "bumpy": ({"type": "bumpmap", "t": scenes.texture(0, 0.1, 1), "b": PLASTIC}, {0: 0, 5: 1, 9: 0.2}, None, None),
    "worn": (
        {"type": "normalmap", "normalmap": scenes.rgb(0.5, 0.5, 1.0), "b": {"type": "roughconductor", "alpha": 0.3}},
        {9: 0.3},
        0,
        1,
    ),
    "rusty": (
        {"type": "roughconductor", "alpha": {"type": "checkerboard", "color0": 0.5, "color1": 0.5}},
        {9: 0.5},
        0,
        1,
    ),
    # Two pairs for the split: the second of each shows the diffuse part of the first alone.
    "matte plastic": ({**PLASTIC, "specular_reflectance": 0.0}, {5: 1}, None, None),
    "matte principled": (DIFFUSE_ONLY, {5: 1, 9: 0.36}, None, None),
}


@pytest.fixture(scope="module")
def row() -> Iterator[Samples]:
    """A row of squares, one pixel each, seen straight on under a constant sky: one bounce, no emitter sampling."""
    count = len(CASES)
    squares = {}
    for i, (name, (bsdf, *_)) in enumerate(CASES.items()):
        pose = mi.ScalarTransform4f().translate([(2 * i + 1) / count - 1, 0, 0]).scale(1 / count)
        if name == "back":
            pose = pose.rotate([0, 1, 0], 180)
        squares[f"square{i}"] = {"type": "rectangle", "to_world": pose, "bsdf": bsdf}
    sensor = scenes.camera([0, 0, 3], [0, 0, 0], kind="orthographic")
    sensor["film"] |= {"width": count, "height": 1}
    scene = scenes.load(sky={"type": "constant"}, sensor=sensor, **squares)
    yield trace(scene, spp=8192, seed=2, max_depth=2, emitter_sampling=False)
    del scene
    gc.collect()


@pytest.mark.parametrize("name", CASES)
def test_tags_and_roughness_are_those_of_the_sampled_lobe(row: Samples, name: str) -> None:
    pixel = list(CASES).index(name)
    descriptor = row.descriptor[:, 0, pixel].astype(np.float64)
    tags, roughness = descriptor[:, 24], descriptor[:, 30]
    allowed = CASES[name][1]
    assert set(np.unique(tags)) <= set(allowed) | {0}
    assert {tag for tag in allowed if tag} <= set(np.unique(tags)), "a lobe was never sampled"
    for tag, expected in allowed.items():
        np.testing.assert_allclose(roughness[tags == tag], expected, atol=1e-3)
    assert not descriptor[:, 25:30].any()


@pytest.mark.parametrize("name", [name for name, case in CASES.items() if case[2] is not None])
def test_diffuse_albedo_is_that_of_the_diffuse_lobe(row: Samples, name: str) -> None:
    values = row.diffuse_albedo[:, 0, list(CASES).index(name)].astype(np.float64)
    np.testing.assert_allclose(values, np.broadcast_to(CASES[name][2], values.shape), atol=1e-3)


@pytest.mark.parametrize("name", [name for name, case in CASES.items() if case[3] is not None])
def test_guide_albedo_shows_the_material(row: Samples, name: str) -> None:
    values = row.albedo[:, 0, list(CASES).index(name)].astype(np.float64)
    np.testing.assert_allclose(values, np.broadcast_to(CASES[name][3], values.shape), atol=1e-3)


def test_copper_is_red(row: Samples) -> None:
    r, g, b = row.albedo[0, 0, list(CASES).index("copper")].astype(np.float64)
    assert 1 > r > g > b > 0.2


def test_geometry_guides_of_surfaces_holes_and_mirrors(row: Samples) -> None:
    names = list(CASES)
    for name in ("diffuse", "plastic", "back", "blend", "hair"):
        pixel = names.index(name)
        np.testing.assert_allclose(row.depth[:, 0, pixel], 3, rtol=1e-5)
        np.testing.assert_allclose(row.normal[:, 0, pixel], np.broadcast_to([0, 0, -1], (8192, 3)), atol=1e-3)
        assert row.alpha[:, 0, pixel].all()
    for name in ("hole", "mirror", "glass"):
        pixel = names.index(name)
        assert not row.depth[:, 0, pixel].any()
        assert not row.normal[:, 0, pixel].any()
    assert not row.alpha[:, 0, names.index("hole")].any()
    assert row.alpha[:, 0, names.index("mirror")].all()


@pytest.mark.parametrize(
    ("whole", "matte", "scale"), [("plastic", "matte plastic", 1), ("principled", "matte principled", 0.6 * 0.8)]
)
def test_the_split_is_unbiased(row: Samples, whole: str, matte: str, scale: float) -> None:
    names = list(CASES)
    ours = row.diffuse[:, 0, names.index(whole)].astype(np.float64)
    expected = scale * row.radiance[:, 0, names.index(matte)].astype(np.float64)
    error = np.sqrt((ours.var(0, ddof=1) + expected.var(0, ddof=1)) / len(ours))
    assert (np.abs(ours.mean(0) - expected.mean(0)) < 4 * error).all()
    assert (row.specular[:, 0, names.index(whole)].mean(0) > 4 * error).all()


def random_hits(count: int = 4096) -> tuple[Any, Any]:
    """Return interactions all over a sphere, seen from inside and outside, and random local directions."""
    sphere = mi.load_dict({"type": "scene", "ball": {"type": "sphere"}})
    random = mi.PCG32(count)
    a, b, wo = (
        mi.warp.square_to_uniform_sphere(mi.Point2f(random.next_float32(), random.next_float32())) for _ in range(3)
    )
    inside = random.next_float32() < 0.3
    si = sphere.ray_intersect(mi.Ray3f(dr.select(inside, 0.4, 3) * a, dr.normalize(0.3 * b - a)))
    dr.eval(si, wo)  # while the sphere is there
    return si, wo


@pytest.mark.parametrize(
    ("mixed", "clean", "scale"),
    [
        (MIXED, DIFFUSE_ONLY, 0.6 * 0.8),
        (
            {"type": "principledthin", "roughness": 0.6, "flatness": 0.3, "spec_trans": 0.25, "diff_trans": 0.7},
            {"type": "principledthin", "roughness": 0.6, "flatness": 0.3, "diff_trans": 0.7},
            0.75,
        ),
        ({"type": "twosided", "b": {**MIXED, "spec_trans": 0.0}}, {"type": "twosided", "b": DIFFUSE_ONLY}, 0.6),
        ({"type": "mask", "opacity": 0.7, "b": MIXED}, {"type": "mask", "opacity": 0.7, "b": DIFFUSE_ONLY}, 0.6 * 0.8),
        (
            {"type": "blendbsdf", "weight": 0.3, "a": {"type": "roughconductor"}, "b": MIXED},
            DIFFUSE_ONLY,
            0.3 * 0.6 * 0.8,
        ),
        (
            {"type": "bumpmap", "t": scenes.texture(0, 1, 1), "scale": 0.2, "b": MIXED},
            {"type": "bumpmap", "t": scenes.texture(0, 1, 1), "scale": 0.2, "b": DIFFUSE_ONLY},
            0.6 * 0.8,
        ),
        (
            {"type": "normalmap", "normalmap": scenes.texture(0.3, 0.7), "use_shadowing_function": False, "b": MIXED},
            {
                "type": "normalmap",
                "normalmap": scenes.texture(0.3, 0.7),
                "use_shadowing_function": False,
                "b": DIFFUSE_ONLY,
            },
            0.6 * 0.8,
        ),
    ],
    ids=["principled", "thin", "twosided", "mask", "blend", "bumpmap", "normalmap"],
)
def test_principled_diffuse_part_is_mitsubas(mixed: Any, clean: Any, scale: float) -> None:
    si, wo = random_hits()
    whole, part = mi.load_dict(mixed), mi.load_dict(clean)
    got = np.array(materials.diffuse_value(whole, si, wo, si.is_valid()))
    want = scale * np.array(part.eval(mi.BSDFContext(), si, wo, si.is_valid()))
    assert want.max() > 0.01
    np.testing.assert_allclose(got, want, rtol=1e-3, atol=1e-6)
    assert (got <= np.array(whole.eval(mi.BSDFContext(), si, wo)) * (1 + 1e-4) + 1e-6).all()


def test_guides_lie_behind_mirrors_and_emitters_are_white() -> None:
    turn = mi.ScalarTransform4f().translate([0, 0, 2]).rotate([0, 1, 0], -135)
    wall = mi.ScalarTransform4f().translate([-3, 0, 2]).rotate([0, 1, 0], 90).scale(2)
    scene = scenes.load(
        mirror={"type": "rectangle", "to_world": turn, "bsdf": {"type": "conductor"}},
        wall={"type": "rectangle", "to_world": wall, "emitter": {"type": "area", "radiance": 2.0}},
        sensor=scenes.camera([0, 0, 0], [0, 0, 1], size=1, fov=0.1),
    )
    samples = trace(scene, spp=8, max_depth=6)
    np.testing.assert_allclose(samples.depth, 5, rtol=1e-3)
    np.testing.assert_allclose(samples.radiance, 2, rtol=1e-5)
    assert (samples.albedo == 1).all()
    assert not samples.diffuse.any()
    np.testing.assert_allclose(np.abs(samples.normal[0, 0, 0]), [1, 0, 0], atol=1e-3)
    np.testing.assert_array_equal(np.unique(samples.descriptor[..., 24:26]), [0, 17])


def textured_lamp(rfilter: str) -> Any:
    lamp = {"type": "area", "radiance": scenes.texture(0, 3)}
    sensor = scenes.camera([0, 0, 3], [0, 0, 0], size=16, kind="orthographic", rfilter=rfilter)
    return scenes.load(lamp={"type": "rectangle", "emitter": lamp}, sensor=sensor)


@pytest.mark.parametrize(("rfilter", "deviation"), [("box", 12**-0.5), ("tent", 6**-0.5), ("gaussian", 0.5)])
def test_positions_follow_the_filter(rfilter: str, deviation: float) -> None:
    film = Film.of(textured_lamp(rfilter).sensors()[0])
    random = mi.PCG32(1 << 16)
    offsets = np.array(film.sample(mi.Point2f(random.next_float32(), random.next_float32())))
    np.testing.assert_allclose(offsets.std(1), deviation, rtol=0.01)
    np.testing.assert_allclose(offsets.mean(1), 0, atol=0.01)
    assert 0.499 < np.abs(offsets).max() <= {"box": 0.5, "tent": 1, "gaussian": 2}[rfilter]


def test_filtered_image_is_that_of_mitsubas_film() -> None:
    scene = textured_lamp("gaussian")
    launch = Frozen()
    trace(scene, spp=2, seed=0, max_depth=1, launch=launch)  # makes it ready
    samples = trace(scene, spp=1024, seed=1, max_depth=1, launch=launch)
    path = mi.load_dict({"type": "path", "max_depth": 1})
    halves = [np.array(mi.render(scene, integrator=path, spp=512, seed=seed), np.float64) for seed in (1, 2)]
    # Mitsuba's film at the border knows only samples inside of the image, ours all of them.
    inner = slice(2, -2), slice(2, -2)
    ours = samples.radiance.astype(np.float64)
    error = np.sqrt(ours.var(0, ddof=1)[inner] / 1024 + np.mean((halves[0] - halves[1])[inner] ** 2) / 4)
    assert (np.abs(ours.mean(0) - (halves[0] + halves[1]) / 2)[inner] < 4.5 * error).all()


@pytest.mark.parametrize("rfilter", ["mitchell", "catmullrom", "lanczos"])
def test_filters_with_negative_lobes_are_refused_by_name(rfilter: str) -> None:
    with pytest.raises(NotImplementedError, match=rf"(?i){rfilter}.*use box, tent or gaussian"):
        trace(textured_lamp(rfilter), spp=1)


def test_materials_that_cannot_be_split_are_refused_by_name() -> None:
    # inside of an instanced group too
    ball = {"type": "sphere", "bsdf": {"type": "pplastic", "alpha": 0.1, "id": "odd one"}}
    scene = scenes.load(
        group={"type": "shapegroup", "ball": ball},
        copy={"type": "instance", "group": {"type": "ref", "id": "group"}},
        sensor=scenes.camera([0, 0, 4], [0, 0, 0]),
    )
    with pytest.raises(NotImplementedError, match=r"'odd one' \(PolarizedPlastic\).*RoughPlastic"):
        trace(scene, spp=1)


def test_participating_media_are_refused_by_name() -> None:
    fog = {"type": "homogeneous", "id": "fog"}
    ball = {"type": "sphere", "bsdf": {"type": "null"}, "interior": fog}
    scene = scenes.load(ball=ball, sensor=scenes.camera([0, 0, 4], [0, 0, 0]))
    with pytest.raises(NotImplementedError, match="medium 'fog'"):
        trace(scene, spp=1)


def test_a_scene_without_light_or_surfaces_is_black() -> None:
    samples = trace(scenes.load(sensor=scenes.camera([0, 0, 0], [0, 0, 1], size=4)), spp=2)
    assert samples.radiance.shape == (2, 4, 4, 3)
    assert not samples.radiance.any()
    assert not samples.alpha.any()
    assert (samples.descriptor[..., :24] == -100).all()
