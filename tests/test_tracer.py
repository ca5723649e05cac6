"""The tracer against Mitsuba's own path integrator, and the identities that its descriptors promise."""

import gc
from collections.abc import Callable, Iterator
from typing import Any

import mitsuba as mi
import numpy as np
import pytest

if mi.variant() != "llvm_ad_rgb":
    mi.set_variant("llvm_ad_rgb")

import tracer_scenes as scenes
from pathfold.channels import samples
from pathfold.mitsuba import Frozen, Samples, trace, trace_mean

LUMINANCE = np.array([0.212671, 0.715160, 0.072169])
BLOCKS = 4
SCENES = [scenes.room, scenes.glassware, scenes.shelf, scenes.terrace]
SIGMA = 4.0  # standard errors: one in 16,000 normal values lies further out, 16 blocks a comparison


@pytest.fixture(scope="module", params=SCENES, ids=lambda build: build.__name__)
def scene(request: pytest.FixtureRequest) -> Iterator[Any]:
    """One scene alive at a time: Dr.Jit compiles the materials of all of them into every kernel."""
    yield request.param()
    gc.collect()


def only(*builders: Callable[[], Any]) -> pytest.MarkDecorator:
    return pytest.mark.parametrize("scene", builders, indirect=True, ids=lambda build: build.__name__)


def blocks(image: np.ndarray) -> np.ndarray:
    """Sum an H x W image over a grid of blocks."""
    h, w = image.shape
    return image.reshape(BLOCKS, h // BLOCKS, BLOCKS, w // BLOCKS).sum((1, 3))


def path_moments(scene: Any, spp: int, max_depth: int) -> tuple[np.ndarray, np.ndarray]:
    """Block means of luminance by Mitsuba's path integrator, and their variances from its second moments."""
    path = {"type": "path", "max_depth": max_depth}
    image = np.array(mi.render(scene, integrator=mi.load_dict({"type": "moment", "p": path}), spp=spp, seed=77))
    mean, square = image[..., 4].astype(np.float64), image[..., 7].astype(np.float64)
    pixels = mean.size / BLOCKS**2
    return blocks(mean) / pixels, blocks((square - mean**2) / (spp - 1)) / pixels**2


def moments(values: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Block means and variances of S x H x W x 3 samples, in luminance."""
    brightness = values.astype(np.float64) @ LUMINANCE
    pixels = brightness[0].size / BLOCKS**2
    variance = brightness.var(0, ddof=1) / len(brightness)
    return blocks(brightness.mean(0)) / pixels, blocks(variance) / pixels**2


def deviation(a: tuple[np.ndarray, np.ndarray], b: tuple[np.ndarray, np.ndarray]) -> float:
    """Largest difference of two sets of means in standard errors."""
    return float(np.abs((a[0] - b[0]) / np.sqrt(a[1] + b[1] + 1e-16)).max())


def recorded(samples: Samples) -> np.ndarray:
    """Return undivided radiance over sampling density, S x H x W x 3."""
    assert samples.descriptor is not None
    logs = samples.descriptor[..., :3].astype(np.float64)
    return np.where(logs > -99, np.exp(logs - samples.density), 0)


def test_radiance_is_that_of_the_path_integrator(scene: Any) -> None:
    ours = moments(trace(scene, spp=256, seed=1, max_depth=6).radiance)
    assert deviation(ours, path_moments(scene, 256, 6)) < SIGMA


def test_split_adds_up(scene: Any) -> None:
    samples = trace(scene, spp=16, seed=4, max_depth=6)
    assert (samples.diffuse >= 0).all()
    assert (samples.specular >= -1e-5 * samples.radiance).all()
    assert 0 < samples.diffuse.sum() < samples.radiance.sum()
    buffers = samples.reduce()
    np.testing.assert_allclose(buffers["diffuse"] + buffers["specular"], buffers["color"], rtol=1e-5, atol=1e-6)


@only(scenes.room, scenes.glassware)
def test_undivided_radiance_is_the_product_of_the_walk(scene: Any) -> None:
    samples = trace(scene, spp=16, seed=2, max_depth=7, emitter_sampling=False)
    logs = samples.descriptor[..., :24].astype(np.float64)
    tags = samples.descriptor[..., 24:30]
    assert not samples.overlong.any()
    vertices = logs[..., 6:].reshape(*tags.shape, 3)
    product = logs[..., 3:6] + np.where(tags[..., None] > 0, vertices, 0).sum(-2)
    lit = (logs[..., :24] > -99)[..., 3:6] & (logs[..., :3] > -99)
    rounding = np.abs(logs).max() * 8 * 2.0**-11
    assert lit.any()
    np.testing.assert_allclose(product[lit], logs[..., :3][lit], atol=rounding)
    # The walk of a path that finds no light stays, with neither radiance nor photon energy.
    dark = samples.radiance.sum(-1) == 0
    assert (logs[dark][:, :6] == -100).all()
    assert dark.any() == (tags[dark] > 0).any()


@only(scenes.glassware, scenes.terrace)
def test_descriptor_over_density_is_the_image_without_emitter_sampling(scene: Any) -> None:
    samples = trace(scene, spp=256, seed=3, max_depth=6, emitter_sampling=False)
    path = recorded(samples)
    lit = samples.radiance > 1e-6
    scale = np.abs(samples.descriptor[..., :6].astype(np.float64)).max(-1, keepdims=True)
    error = np.abs(np.log(path[lit] / samples.radiance[lit]))
    assert (error < 2.0**-10 * np.broadcast_to(scale, lit.shape)[lit] + 1e-3).all()
    assert deviation(moments(path), path_moments(scene, 256, 6)) < SIGMA


def test_light_sample_ends_the_recorded_path() -> None:
    scene = scenes.load(
        floor=scenes.floor({"type": "diffuse", "reflectance": scenes.rgb(0.5, 0.25, 0.0)}),
        lamp={"type": "point", "position": [0.5, 1, 0], "intensity": scenes.rgb(3, 4, 5)},
        sensor=scenes.camera([0, 3, -0.01], [0, -1, 0], size=8),
    )
    samples = trace(scene, spp=4, seed=0, max_depth=6)
    np.testing.assert_allclose(recorded(samples), samples.radiance, rtol=5e-3, atol=1e-6)
    descriptor = samples.descriptor.astype(np.float64)
    assert (descriptor[..., [2, 8]] == -100).all()  # blue is dead: albedo 0
    assert (descriptor[..., 9:24] == -100).all()  # the recorded path ends at its first vertex
    np.testing.assert_array_equal(np.unique(descriptor[..., 24:30].reshape(-1, 6), axis=0), [[5, 0, 0, 0, 0, 0]])
    np.testing.assert_array_equal(np.unique(descriptor[..., 30:36].reshape(-1, 6), axis=0), [[1, 0, 0, 0, 0, 0]])
    np.testing.assert_allclose(samples.density, 0, atol=1e-6)  # the only light is sampled with certainty


@only(scenes.room)
def test_roulette_keeps_the_mean_and_joins_the_density(scene: Any) -> None:
    played = trace(scene, spp=256, seed=6, max_depth=6, rr_depth=2, emitter_sampling=False)
    assert deviation(moments(played.radiance), moments(recorded(played))) < 0.1
    assert deviation(moments(trace(scene, spp=256, seed=6, rr_depth=2).radiance), path_moments(scene, 256, 6)) < SIGMA


@only(scenes.room)
def test_max_depth_one_shows_emitters_only(scene: Any) -> None:
    samples = trace(scene, spp=8, max_depth=1)
    lamp = samples.radiance.sum(-1) > 0
    np.testing.assert_allclose(samples.radiance[lamp], np.broadcast_to([9, 8, 6], (lamp.sum(), 3)))
    assert samples.diffuse.max() == 0
    np.testing.assert_array_equal(np.unique(samples.descriptor[..., 24:]), [0])


@only(scenes.room)
def test_longer_paths_than_recorded_are_flagged(scene: Any) -> None:
    short, long = (trace(scene, spp=8, seed=1, vertices=k) for k in (2, 6))
    assert short.descriptor.shape[-1] == 16
    recorded = (long.descriptor[..., 24:30] > 0).sum(-1, keepdims=True)
    assert (recorded > 2).mean() > 0.05
    np.testing.assert_array_equal(short.overlong > 0, recorded > 2)
    assert not long.overlong.any()
    np.testing.assert_array_equal(short.radiance, long.radiance)


@only(scenes.shelf)
def test_a_seed_gives_identical_arrays(scene: Any) -> None:
    first, again, other = (trace(scene, spp=4, seed=seed) for seed in (9, 9, 10))
    for name, values in vars(first).items():
        np.testing.assert_array_equal(values, getattr(again, name), err_msg=name)
    plain = trace(scene, spp=4, seed=9, recorded=0)
    assert plain.descriptor is None
    np.testing.assert_array_equal(plain.radiance, first.radiance)
    assert (first.radiance != other.radiance).mean() > 0.5


@only(scenes.room)
def test_paths_are_recorded_of_the_first_samples_alone(scene: Any) -> None:
    whole = trace(scene, spp=5, seed=9)
    for recorded in (0, 2, 5):
        part = trace(scene, spp=5, seed=9, recorded=recorded)
        for name, values in vars(part).items():
            expected = getattr(whole, name)
            if name in ("descriptor", "density", "overlong"):
                assert (values is None) == (recorded == 0)
                expected = expected[:recorded]
            if values is not None:
                np.testing.assert_array_equal(values, expected, err_msg=f"{name}, {recorded}")


def test_a_launch_made_ready_once_changes_nothing(scene: Any) -> None:
    launch = Frozen()
    film = mi.traverse(scene.sensors()[0])
    width, height = film["film.size"]
    for offset, rows in (
        (0, height),
        (0, height // 4),
        (height // 2, height // 4),
    ):  # bands of rows, as Renderer takes them
        film["film.crop_offset"], film["film.crop_size"] = [0, offset], [width, rows]
        film.update()
        for spp, seed, recorded, depth in ((1, 1, 1, 6), (4, 2, 2, 6), (5, 3, 2, 6), (3, 3, 0, 4)):
            options = {"spp": spp, "seed": seed, "recorded": recorded, "max_depth": depth}
            plain, ready = trace(scene, **options), trace(scene, **options, launch=launch)
            for name, values in vars(plain).items():
                np.testing.assert_array_equal(getattr(ready, name), values, err_msg=f"{name}, {offset}, {options}")
        replayed = launch._ready.n_recordings
        trace(scene, **options, launch=launch)
        assert launch._ready.n_recordings == replayed
    film["film.crop_offset"], film["film.crop_size"] = [0, 0], [width, height]
    film.update()
    assert launch.refused == any(emitter.class_name() == "EnvironmentMapEmitter" for emitter in scene.emitters())


@only(scenes.room)
def test_trace_mean_averages_the_same_samples(scene: Any) -> None:
    means = [trace_mean(scene, spp=64, seed=seed) for seed in (1, 1, 2)]
    reference = trace(scene, spp=256, seed=5)
    np.testing.assert_array_equal(means[0]["color"], means[1]["color"])
    assert (means[0]["color"] != means[2]["color"]).any()
    expected, variance = moments(reference.radiance)
    got = blocks(means[0]["color"].astype(np.float64) @ LUMINANCE) / (reference.radiance[0, ..., 0].size / BLOCKS**2)
    assert (np.abs(got - expected) < SIGMA * np.sqrt(5 * variance)).all()
    buffers = reference.reduce()
    for name in ("diffuse.albedo", "albedo", "normal", "depth", "alpha"):
        assert means[0][name].shape == buffers[name].shape
        np.testing.assert_allclose(means[0][name].mean(), buffers[name].mean(), rtol=0.02, atol=0.01)
    assert means[0]["dropped"] == 0


@only(scenes.room)
def test_chunks_of_trace_mean_are_averaged_by_their_size(scene: Any, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("pathfold.mitsuba.tracer.CHUNK_LANES", 24 * 32 * 32)
    means = trace_mean(scene, spp=64, seed=1)
    whole = trace(scene, spp=64, seed=1).radiance.mean()
    np.testing.assert_allclose(means["color"].mean(), whole, rtol=0.05)
    assert means["alpha"].max() <= 1


@only(scenes.room)
def test_reduce_drops_and_counts_what_is_not_finite(scene: Any) -> None:
    samples = trace(scene, spp=6, seed=1)
    clean = samples.reduce()
    expected = samples.radiance.astype(np.float64).var(0, ddof=1) / 6
    np.testing.assert_allclose(clean["variance"], expected, rtol=1e-3, atol=1e-7)
    samples.radiance[2, 3, 4, 1] = np.nan
    samples.diffuse[1, 3, 4, 0] = np.inf
    buffers = samples.reduce()
    assert buffers["dropped"] == 2
    left = samples.radiance[[0, 3, 4, 5], 3, 4]
    np.testing.assert_allclose(buffers["color"][3, 4], left.mean(0), rtol=1e-5)
    np.testing.assert_allclose(buffers["variance"][3, 4], left.var(0, ddof=1) / 4, rtol=1e-3, atol=1e-8)
    single = trace(scene, spp=1).reduce()
    assert single["variance"].max() == 0


@only(scenes.room)
@pytest.mark.parametrize(
    ("arguments", "words"),
    [
        ({"spp": 0}, "spp is 0"),
        ({"seed": -1}, "seed is -1"),
        ({"sensor": 2}, "sensor 2 does not exist; the scene has 1"),
        ({"vertices": 0}, "vertices is 0"),
        ({"max_depth": 0}, "max_depth is 0"),
        ({"max_depth": -1}, "together with rr_depth"),
        ({"spp": 10**6}, "lower spp"),
        ({"leave_out": ["color"]}, "leave_out names color; it may name albedo, alpha"),
    ],
)
def test_arguments_out_of_range_are_named(scene: Any, arguments: dict[str, int], words: str) -> None:
    with pytest.raises(ValueError, match=words):
        trace(scene, **arguments)


@only(scenes.room)
def test_unlimited_depth_needs_roulette_only(scene: Any) -> None:
    assert np.isfinite(trace(scene, spp=2, max_depth=-1, rr_depth=3).radiance).all()


@only(scenes.room)
def test_other_objects_and_variants_are_named(scene: Any) -> None:
    with pytest.raises(TypeError, match="scene is a str"):
        trace("scene.xml")
    try:
        mi.set_variant("scalar_rgb")
        with pytest.raises(RuntimeError, match=r"scalar_rgb.*llvm_ad_rgb"):
            trace(scene)
    finally:
        mi.set_variant("llvm_ad_rgb")


def test_first_hit_is_the_mirror_and_the_guides_are_what_it_shows() -> None:
    """A mirror at distance 2 before the camera shows a wall at distance 3 behind it."""
    red = {"type": "twosided", "b": {"type": "diffuse", "reflectance": scenes.rgb(0.6, 0.2, 0.1)}}
    scene = scenes.load(
        mirror={
            "type": "rectangle",
            "to_world": mi.ScalarTransform4f().translate([0, 0, 2]).rotate([1, 0, 0], 180),
            "bsdf": {"type": "conductor", "material": "none"},
        },
        wall={"type": "rectangle", "to_world": scenes.at(0, 0, -3, scale=9), "bsdf": red},
        sky={"type": "constant"},
        sensor=scenes.camera([0, 0, 0], [0, 0, 1], size=9, fov=80),
    )
    samples = trace(scene, spp=4, seed=1)
    mirrored, missed = (slice(None), 4, 4), (slice(None), 0, 0)
    np.testing.assert_allclose(samples.first_depth[mirrored], 2, rtol=0.01)
    np.testing.assert_allclose(samples.depth[mirrored], 7, rtol=0.01)
    np.testing.assert_array_equal(samples.first_albedo[mirrored], 1)
    np.testing.assert_allclose(samples.albedo[mirrored][:, 1], 0.2, rtol=1e-3)
    np.testing.assert_allclose(samples.first_normal[mirrored], [[0, 0, -1]] * 4, atol=1e-3)
    assert (samples.first_albedo[missed] == 1).all() and not samples.first_depth[missed].any()
    assert not samples.first_normal[missed].any() and not samples.visible[missed].any()
    diffuse = samples.alpha[..., 0].astype(bool) & (samples.first_depth[..., 0] == samples.depth[..., 0])
    np.testing.assert_array_equal(samples.first_normal[diffuse], samples.normal[diffuse])


def test_visible_says_whether_light_reaches_the_first_surface() -> None:
    scene = scenes.load(
        floor=scenes.floor({"type": "diffuse"}),
        roof={
            "type": "rectangle",
            "to_world": mi.ScalarTransform4f().translate([3, 1, 0]).rotate([1, 0, 0], 90).scale(3),
        },
        lamp={"type": "directional", "direction": [0, -1, 0], "irradiance": scenes.rgb(1, 1, 1)},
        sensor=scenes.camera([0, 0.5, -6], [0, -1, 0], size=16),
    )
    samples = trace(scene, spp=8, seed=1, max_depth=3)
    on_floor = samples.first_normal[..., 1] > 0.5
    lit = samples.radiance.sum(-1) > 0
    assert on_floor.any() and (lit & on_floor).any() and (~lit & on_floor).any()
    np.testing.assert_array_equal(samples.visible[on_floor][..., 0] > 0, lit[on_floor])
    unsampled = trace(scene, spp=8, seed=1, max_depth=3, emitter_sampling=False)
    assert not unsampled.visible.any()  # nothing runs into a directional light


@only(scenes.glassware)
def test_what_is_left_out_changes_nothing_else(scene: Any) -> None:
    whole = trace(scene, spp=2, seed=3)
    lean = trace(scene, spp=2, seed=3, leave_out={"diffuse", "position", "density"})
    assert lean.diffuse is None and lean.position is None and lean.density is None
    assert (lean.radiance == whole.radiance).all() and (lean.descriptor == whole.descriptor).all()
    means, kept = whole.reduce(), lean.reduce()
    assert means.keys() - kept.keys() == {"diffuse", "specular", "diffuse.variance", "specular.variance"}
    assert all(np.array_equal(kept[name], means[name]) for name in kept)
    assert whole.reduce({"depth"}).keys() == {"color", "depth", "dropped"}


@only(scenes.glassware)
@pytest.mark.parametrize("max_depth", [1, 3])
def test_no_path_has_more_vertices_than_its_depth_allows(scene: Any, max_depth: int) -> None:
    """So `render` need not write more of them, and what is left out is dead in all samples."""
    whole = trace(scene, spp=2, max_depth=max_depth).descriptor
    most = max(1, max_depth - 1)
    part = trace(scene, spp=2, max_depth=max_depth, vertices=most).descriptor
    names, kept = samples.descriptor(6), samples.descriptor(most)
    assert whole is not None and part is not None
    assert part.shape[-1] == len(kept)
    for number, name in enumerate(names):
        if name in kept:
            assert (whole[..., number] == part[..., kept.index(name)]).all(), name
        else:
            assert (whole[..., number] == (-100 if "attenuation" in name else 0)).all(), name
