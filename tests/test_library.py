"""Library scenes: what is found, how it varies, where cameras are."""

from pathlib import Path

import numpy as np
import pytest

mi = pytest.importorskip("mitsuba")
mi.set_variant("llvm_ad_rgb")

import drjit as dr  # noqa: E402
from pathfold.mitsuba import trace_mean  # noqa: E402
from pathfold_training.scenes import (  # noqa: E402
    cameras,
    library,
    variation,
)
from pathfold_training.scenes.cameras import Camera  # noqa: E402
from pathfold_training.scenes.faults import RejectedError  # noqa: E402

LIBRARY = Path(__file__).parent / "assets" / "library"


def test_the_library_lists_scenes_with_their_licence() -> None:
    (entry,) = library.scan(LIBRARY)
    assert (entry.name, entry.licence) == ("tiny", "CC0 1.0")
    assert "Tiny room" in entry.origin
    with pytest.raises(FileNotFoundError, match="is no folder"):
        library.scan(LIBRARY / "tiny" / "nothing")


def test_a_folder_without_scenes_is_named(tmp_path: Path) -> None:
    with pytest.raises(FileNotFoundError, match="no Mitsuba scene"):
        library.scan(tmp_path)


def test_a_broken_scene_is_named(tmp_path: Path) -> None:
    (tmp_path / "broken.xml").write_text("<scene version='3.0.0'><shape type='nosuchshape'/></scene>")
    with pytest.raises(RejectedError, match=r"broken\.xml does not load"):
        library.load(library.scan(tmp_path)[0])


def test_library_scenes_vary_in_light_colour_and_roughness() -> None:
    def values(seed: int | None) -> dict[str, np.ndarray]:
        scene = library.load(library.scan(LIBRARY)[0])
        if seed is not None:
            variation.vary(scene, np.random.default_rng(seed))
        kept = mi.traverse(scene)
        names = ("paint.brdf_0.reflectance.value", "gloss.brdf_0.alpha", "gloss.brdf_0.diffuse_reflectance.value")
        light = next(k for k in kept.keys() if k.endswith("radiance.value"))  # noqa: SIM118
        return {name: np.array(kept[name]).ravel() for name in names} | {"light": np.array(kept[light]).ravel()}

    before, varied, again, other = values(None), values(1), values(1), values(2)
    for name, value in before.items():
        assert not np.allclose(varied[name], value), name
        assert not np.allclose(varied[name], other[name]), name
        np.testing.assert_array_equal(varied[name], again[name])
    for name in ("paint.brdf_0.reflectance.value", "gloss.brdf_0.diffuse_reflectance.value"):
        assert 0 <= varied[name].min() <= varied[name].max() <= 1
    assert 0.1 / 2 <= varied["gloss.brdf_0.alpha"][0] <= 0.1 * 2
    assert (np.abs(np.log2(varied["light"] / before["light"])) < 2 + 1).all()


@pytest.mark.parametrize(
    ("text", "may"),
    [
        ("CC0 1.0", True),
        ("'Room' by X, CC BY 4.0", True),
        ("CC BY-ND 4.0", False),
        ("CC BY 4.0, see https://creativecommons.org/licenses/by-nc-nd/4.0/", False),
        ("Attribution-NoDerivatives 4.0", False),
        ("all rights reserved", False),
    ],
)
def test_only_licences_that_allow_it_are_varied(tmp_path: Path, text: str, may: bool) -> None:
    (tmp_path / "scene.xml").touch()
    (tmp_path / "LICENSE.txt").write_text(text)
    assert library.scan(tmp_path)[0].may_vary is may


def test_varied_bitmaps_stay_bitmaps() -> None:
    pixels = np.random.default_rng(0).integers(0, 256, (4, 5, 3)).astype(np.uint8)
    texture = {"type": "bitmap", "bitmap": mi.Bitmap(pixels), "format": "uint8"}
    scene = mi.load_dict({"type": "scene", "s": {"type": "sphere", "b": {"type": "diffuse", "reflectance": texture}}})
    variation.vary(scene, np.random.default_rng(0))
    kept = mi.traverse(scene)
    data = np.array(next(kept[k] for k in kept.keys() if k.endswith(".data")))  # noqa: SIM118
    assert data.shape == pixels.shape
    assert data.max() > 100  # not mistaken for values in [0, 1]
    assert not np.array_equal(data, pixels)


def test_another_camera_needs_no_other_kernels() -> None:
    scene = library.load(library.scan(LIBRARY)[0])
    with dr.scoped_set_flag(dr.JitFlag.KernelHistory):
        used = []
        for x in (0.3, -0.2):
            camera = Camera(np.array([x, -1.0, 0.5]), np.array([x, 0.0, 0.3]), np.array([0, 0, 1.0]), 40 + x, 0.01)
            cameras.aim(scene, camera, (16, 16))
            dr.kernel_history_clear()
            trace_mean(scene, spp=2, seed=1, max_depth=3)
            used.append([entry["hash"] for entry in dr.kernel_history() if entry["type"] == dr.KernelType.JIT])
    assert used[0] == used[1] and used[0]


def test_library_cameras_stay_in_free_space_and_differ() -> None:
    (entry,) = library.scan(LIBRARY)
    scene = library.load(entry)
    bright = np.kron(np.exp(np.random.default_rng(0).normal(size=(4, 4))), np.ones((8, 8)))[..., None] * np.ones(3)
    found = []
    for number in range(3):
        library.choose(scene, number, lambda _: bright, np.random.default_rng(5), (32, 32))
        found.append(cameras.pose(scene)[:2])
        assert list(scene.sensors()[0].film().crop_size()) == [32, 32]
        assert np.isfinite(cameras.survey(scene).distance).all()  # the room is closed: nothing leaks out
        scene = library.load(entry)
    for origin, _ in found:
        assert (np.abs(origin) < [2, 4, 3.01]).all()
    gaps = [
        np.linalg.norm(a - c) + np.linalg.norm(b - d) for (a, b), (c, d) in ((found[0], found[1]), (found[1], found[2]))
    ]
    assert min(gaps) > 0.2


def test_no_acceptable_camera_is_an_error_with_reasons() -> None:
    scene = library.load(library.scan(LIBRARY)[0])
    into_floor = Camera(np.array([0, 0, 0.7]), np.array([0.01, 0, 0]), np.array([0, 1, 0]), 5.0)
    with pytest.raises(RejectedError, match=r"\d+ x"):
        cameras.find(
            scene, lambda _: into_floor, lambda _: np.ones((8, 8, 3)), np.random.default_rng(0), (8, 8), tries=3
        )
