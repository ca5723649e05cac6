"""Scenes to train on: determinism by seed, refused views, the library loader."""

from pathlib import Path
from typing import Any

import numpy as np
import pytest

mi = pytest.importorskip("mitsuba")
mi.set_variant("llvm_ad_rgb")

from pathfold_training.scenes import cameras, faults, library, meshes, procedural, textures  # noqa: E402
from pathfold_training.scenes.cameras import Camera  # noqa: E402
from pathfold_training.scenes.faults import RejectedError, Survey  # noqa: E402

LIBRARY = Path(__file__).parent / "assets" / "library"


def fingerprint(built: procedural.Built) -> list[Any]:
    """Vertex positions of all meshes, and the text of everything else."""
    result: list[Any] = []
    for entry in built.stage.entries.values():
        if isinstance(entry, mi.Mesh):
            result.append(np.array(mi.traverse(entry)["vertex_positions"]).tobytes())
        elif isinstance(entry, dict):
            result.append([str(value) for value in entry.values()])
    return result


@pytest.mark.parametrize("kind", ["room", "still-life", "garden"])
def test_a_seed_fixes_the_scene_and_its_cameras(kind: str) -> None:
    first, again, other = (procedural.build(seed, kind) for seed in (7, 7, 8))
    assert fingerprint(first) == fingerprint(again)
    assert fingerprint(first) != fingerprint(other)
    views = [str(built.propose(np.random.default_rng(3))) for built in (first, again)]
    assert views[0] == views[1]
    assert first.stage.load().bbox().valid()


@pytest.mark.parametrize("make", [meshes.blob, meshes.lathe, meshes.knot, meshes.spring, meshes.cloth, meshes.terrain])
def test_surfaces_are_finite_and_index_their_vertices(make: Any) -> None:
    surface = make(np.random.default_rng(1))
    assert np.isfinite(surface.vertices).all()
    assert surface.faces.min() == 0
    assert surface.faces.max() == len(surface.vertices) - 1
    assert surface.uv.shape == (len(surface.vertices), 2)


@pytest.mark.parametrize("kind", textures.KINDS)
def test_patterns_stay_in_range(kind: str) -> None:
    values = textures.pattern(np.random.default_rng(2), kind)
    assert values.min() >= -0.1
    assert values.max() <= 1.1
    assert values.std() > 0.01


def seen(distance: Any, shapes: Any) -> Survey:
    count = cameras.RAYS**2
    return Survey(np.zeros((count, 3)), np.resize(distance, count).astype(float), np.resize(shapes, count).astype("u4"))


def test_views_of_nothing_a_wall_or_a_near_object_are_refused() -> None:
    depth = np.linspace(1, 3, 50)
    assert faults.geometry_fault(seen(depth, range(8))) is None
    assert faults.geometry_fault(seen([np.inf, np.inf, 2], range(8))) == "sees nothing"
    assert faults.geometry_fault(seen(depth, [5])) == "one surface only"
    assert faults.geometry_fault(seen([2, 2.05], range(8))) == "looks into a wall"
    assert faults.geometry_fault(seen([0.1, 2, 2.5], range(8))) == "something before the lens"


def test_black_flat_and_blown_pictures_are_refused() -> None:
    rng = np.random.default_rng(0)
    good = np.kron(np.exp(rng.normal(size=(8, 8))), np.ones((8, 8)))[..., None] * np.ones(3)
    assert faults.picture_fault(good) is None
    assert faults.picture_fault(0 * good) == "black"
    assert faults.picture_fault(1 + 0 * good) == "flat"
    mostly_dark = np.where(np.arange(64)[:, None, None] < 16, good, 1e-6)
    assert faults.picture_fault(mostly_dark) == "black"
    glare = np.where(np.arange(64)[:, None, None] < 32, 1e4, good)
    assert faults.picture_fault(glare) == "blown out"


def test_a_gallery_refuses_what_it_has_at_any_exposure_and_nothing_else() -> None:
    rng = np.random.default_rng(0)

    def picture() -> Any:
        return np.exp(np.kron(rng.normal(size=(1, 6, 6)), np.ones((3, 16, 16))))

    one, other = picture(), picture()
    gallery = faults.Gallery()
    assert gallery.fault(one) is None
    gallery.add("one", one)
    assert gallery.fault(other) is None
    gallery.add("other", other)
    assert gallery.fault(5 * one * rng.uniform(0.8, 1.2, one.shape)) is not None
    assert str(gallery.fault(np.roll(other, 1, 2))).startswith("repeats other")
    assert gallery.fault(other[:, ::-1]) is None
    assert gallery.fault(0 * one) == "black"


def test_the_library_lists_scenes_with_their_licence() -> None:
    (entry,) = library.scan(LIBRARY)
    assert (entry.name, entry.licence) == ("tiny", "CC0 1.0")
    assert "Tiny room" in entry.origin
    with pytest.raises(FileNotFoundError, match="no Mitsuba scene"):
        library.scan(LIBRARY / "tiny" / "nothing")


def test_a_broken_scene_is_named(tmp_path: Path) -> None:
    (tmp_path / "broken.xml").write_text("<scene version='3.0.0'><shape type='nosuchshape'/></scene>")
    with pytest.raises(RejectedError, match=r"broken\.xml does not load"):
        library.load(library.scan(tmp_path)[0])


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
