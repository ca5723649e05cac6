"""Scenes to train on: determinism by seed, meshes, materials and lights, refused views."""

from collections import Counter
from pathlib import Path
from typing import Any

import numpy as np
import pytest

mi = pytest.importorskip("mitsuba")
mi.set_variant("llvm_ad_rgb")

from pathfold.mitsuba import trace_mean  # noqa: E402
from pathfold_training.scenes import (  # noqa: E402
    cameras,
    faults,
    fittings,
    furniture,
    growth,
    lights,
    materials,
    meshes,
    procedural,
    rooms,
    solids,
    textures,
    tones,
)
from pathfold_training.scenes.cameras import Camera  # noqa: E402
from pathfold_training.scenes.faults import Survey  # noqa: E402
from pathfold_training.scenes.stage import Stage, emission  # noqa: E402

LIBRARY = Path(__file__).parent / "assets" / "library"


def fingerprint(built: procedural.Built) -> list[Any]:
    """Vertices and normals of all meshes, and the text of everything else."""
    result: list[Any] = []
    for entry in built.stage.entries.values():
        if isinstance(entry, mi.Shape):
            params = mi.traverse(entry)
            names = ("vertex_positions", "vertex_normals") if isinstance(entry, mi.Mesh) else ("control_points",)
            result += [np.array(params[name]).tobytes() for name in names if name in params]
        elif isinstance(entry, dict):
            result.append([str(value) for value in entry.values()])
    return result


@pytest.mark.parametrize("kind", procedural.KINDS)
def test_a_seed_fixes_the_scene_and_its_cameras(kind: str) -> None:
    first, again, other = (procedural.build(seed, kind) for seed in (7, 7, 8))
    assert fingerprint(first) == fingerprint(again)
    assert fingerprint(first) != fingerprint(other)
    views = [str(built.propose(np.random.default_rng(3))) for built in (first, again)]
    assert views[0] == views[1]
    scenes = [built.stage.load() for built in (first, again)]
    assert scenes[0].bbox().valid()
    assert [shape.id() for shape in scenes[0].shapes()] == [shape.id() for shape in scenes[1].shapes()]


def test_shares_add_up() -> None:
    assert sum(share for _, share in procedural.KINDS.values()) == pytest.approx(1)
    assert sum(rooms.MODES.values()) == pytest.approx(1)
    assert sum(materials.KINDS.values()) == pytest.approx(1)


def drape(rng: np.random.Generator) -> meshes.Surface:
    return growth.drape(rng, (0.5, 0.4), 0.3)


def wood(rng: np.random.Generator) -> meshes.Surface:
    return growth.tree(rng)[0]


CLOSED = [solids.carved, solids.text, solids.turned, solids.hull, growth.wire, meshes.blob, meshes.lathe, meshes.knot]
OPEN = [meshes.spring, meshes.cloth, meshes.terrain, growth.crumple, drape, wood]


@pytest.mark.parametrize("make", CLOSED)
@pytest.mark.parametrize("seed", [1, 2, 3])
def test_solids_are_closed_and_face_outwards(make: Any, seed: int) -> None:
    surface = make(np.random.default_rng(seed))
    _, same = np.unique(np.round(surface.vertices, 5), axis=0, return_inverse=True)
    faces = same.ravel()[surface.faces]
    faces = faces[(faces != np.roll(faces, 1, 1)).all(1)]
    edges = Counter(map(tuple, np.concatenate([faces[:, [i, (i + 1) % 3]] for i in range(3)])))
    assert all(edges[b, a] == count for (a, b), count in edges.items())
    a, b, c = np.moveaxis(surface.vertices[surface.faces], 1, 0)
    assert np.einsum("fk,fk->", a, np.cross(b, c)) > 0


@pytest.mark.parametrize("make", CLOSED + OPEN)
def test_surfaces_are_finite_and_index_their_vertices(make: Any) -> None:
    surface = make(np.random.default_rng(1))
    assert np.isfinite(surface.vertices).all()
    assert surface.faces.min() == 0
    assert surface.faces.max() == len(surface.vertices) - 1
    assert surface.uv.shape == (len(surface.vertices), 2)


@pytest.mark.parametrize("make", [meshes.blob, meshes.knot, meshes.terrain])
def test_normals_are_those_that_mitsuba_computes(make: Any) -> None:
    surface = make(np.random.default_rng(1))
    params = mi.traverse(meshes.to_shape(surface, mi.load_dict({"type": "diffuse"}), meshes.frame(1, 2, 3, 0.4)))
    ours = np.array(params["vertex_normals"])
    params["vertex_positions"] = params["vertex_positions"] + 0.0
    params.update()
    assert np.allclose(np.array(params["vertex_normals"]), ours, atol=1e-3)  # it adds float32, at small faces coarsely


@pytest.mark.parametrize("kind", textures.KINDS)
def test_patterns_stay_in_range(kind: str) -> None:
    values = textures.pattern(np.random.default_rng(2), kind)
    assert values.min() >= -0.1
    assert values.max() <= 1.1
    assert values.std() > 0.01


def lit(*shapes: Any, rng: Any = None, light: Any = None) -> np.ndarray[Any, Any]:
    """Shapes (or functions that put them on a stage) about the origin under a sky, through our own tracer."""
    stage = Stage(rng or np.random.default_rng(0))
    stage.put(light or {"type": "constant"})
    for shape in shapes:
        shape(stage) if callable(shape) else stage.put(shape)
    stage.camera()
    scene = stage.load()
    cameras.aim(scene, Camera(np.array([0, -4.0, 1]), np.zeros(3), np.array([0, 0, 1.0]), 40), (24, 24))
    mean = trace_mean(scene, spp=16, max_depth=5)
    assert mean["dropped"] == 0
    assert np.isfinite(mean["color"]).all()
    return mean["color"]


MATERIALS = [(f"opaque {kind}", kind) for kind in materials.KINDS] + [
    (name, "") for name in ("glass", "translucent", "perforated", "foliage", "hair", "matte")
]


@pytest.mark.parametrize(("name", "kind"), MATERIALS)
def test_materials_go_through_the_tracer_and_make_no_light(name: str, kind: str) -> None:
    def ball(stage: Stage) -> None:
        make = getattr(materials, name.split()[0])
        bsdf = make(stage.rng, stage.tones, kind=kind) if kind else make(stage.rng, stage.tones)
        stage.mesh(meshes.superquadric(1, 1, 24), bsdf, np.eye(4))

    color = lit(ball)
    assert color.min() >= 0
    assert color[8:16, 8:16].mean() < 1.1  # in a furnace of radiance 1


def test_masks_let_light_through_and_curves_are_hit() -> None:
    def card(stage: Stage) -> None:
        stage.box((4, 0.01, 4), stage.material("perforated"), np.eye(4), (0, 0, -2))

    def hair(stage: Stage) -> None:
        points, radius = growth.fur(stage.rng, 400)
        stage.put(growth.strands(points, 4 * radius, stage.material("hair"), np.eye(4)))

    dark = {"type": "constant", "radiance": 1e-3}
    assert 0.05 < (lit(card, light=dark)[..., 0] > 0.9e-3).mean() < 0.99
    furry = lit(hair)
    assert (furry[:2] == 1).all()
    assert (furry[8:16, 8:16] < 0.99).mean() > 0.1


def test_relief_changes_the_shading_normal() -> None:
    def plate(kind: str) -> Any:
        def put(stage: Stage) -> None:
            bsdf = materials.opaque(stage.rng, stage.tones, 0, 2, kind)
            stage.box((3, 0.1, 3), bsdf, np.eye(4), (0, 0, -1.5))

        return put

    for kind in ("bump", "normal"):
        stage = Stage(np.random.default_rng(1))
        plate(kind)(stage)
        stage.put({"type": "constant"})
        stage.camera()
        scene = stage.load()
        cameras.aim(scene, Camera(np.array([0, -4.0, 0]), np.zeros(3), np.array([0, 0, 1.0]), 30), (24, 24))
        assert trace_mean(scene, spp=4)["normal"].std((0, 1)).max() > 0.01


@pytest.mark.parametrize("kind", furniture.ITEMS)
def test_every_item_stands_on_the_ground_at_about_its_size(kind: str) -> None:
    stage = Stage(np.random.default_rng(4))
    furniture.item(stage, np.eye(4), 1, kind=kind)
    stage.camera()
    box = stage.load().bbox()
    assert -0.2 < box.min.z < 0.4
    assert 0.1 < box.max.z < 1.6
    assert max(box.max.x, box.max.y, -box.min.x, -box.min.y) < 3


FITTINGS = {
    "mouldings": lambda stage: fittings.mouldings(stage, np.eye(4), 4, 2.5, stage.material("matte")),
    "door": lambda stage: fittings.door(stage, np.eye(4), stage.material("matte")),
    "radiator": lambda stage: fittings.radiator(stage, np.eye(4), stage.material("matte")),
    "kitchen": lambda stage: fittings.kitchen(stage, np.eye(4), 3.5),
    "shelves": lambda stage: fittings.shelves(stage, np.eye(4), 2),
}


@pytest.mark.parametrize("kind", FITTINGS)
@pytest.mark.parametrize("seed", [1, 2, 3])
def test_fittings_hang_on_their_wall(kind: str, seed: int) -> None:
    stage = Stage(np.random.default_rng(seed))
    FITTINGS[kind](stage)
    stage.camera()
    box = stage.load().bbox()
    assert -1 < box.min.y < -0.005  # into the room
    assert box.max.y < 0.15  # a thing on a board may touch the wall
    assert box.min.z > -1e-3
    assert box.max.z < 2.6
    assert max(box.max.x, -box.min.x) < 2.5


@pytest.mark.parametrize("seed", [1, 2, 3])
def test_rows_stay_in_their_room(seed: int) -> None:
    stage = Stage(np.random.default_rng(seed))
    size = np.array([5.0, 6, 2.5])
    fittings.desks(stage, size)
    fittings.beams(stage, size)
    fittings.railing(stage, np.eye(4), 4)
    stage.camera()
    box = stage.load().bbox()
    assert len(stage.entries) > 100
    assert np.all(np.abs([box.min.x, box.max.x]) < 2.9)
    assert np.all(np.abs([box.min.y, box.max.y]) < 3.4)
    assert box.min.z > -1e-3
    assert box.max.z < 2.5 + 1e-3


@pytest.mark.parametrize("kind", lights.SKIES)
def test_skies_light_the_scene(kind: str) -> None:
    stage = Stage(np.random.default_rng(3))
    lights.environment(stage, kind)
    stage.box((2, 2, 2), stage.material("matte"), np.eye(4))
    stage.camera()
    scene = stage.load()
    cameras.aim(scene, Camera(np.array([0, -6.0, 3]), np.zeros(3), np.array([0, 0, 1.0]), 40), (16, 16))
    color = trace_mean(scene, spp=8)["color"]
    assert np.isfinite(color).all()
    assert color.mean() > 1e-4


def test_letters_glow() -> None:
    def sign(stage: Stage) -> None:
        stage.mesh(solids.text(stage.rng, 2), stage.material("matte"), np.eye(4), emission(50))

    color = lit(sign, light={"type": "constant", "radiance": 0.0})
    assert 49.9 < color.max() < 90  # its own radiance, and what letters throw on each other
    assert color[0].max() == 0


def test_tones_are_reflectances_and_differ() -> None:
    rng = np.random.default_rng(0)
    mean = []
    for _ in range(30):
        scheme = tones.draw(rng)
        colours = np.array([scheme.colour(rng) for _ in range(50)])
        assert colours.min() >= 0.005
        assert colours.max() <= 0.9
        mean.append(colours.mean(0))
    assert np.ptp(mean, 0).min() > 0.2


def seen(distance: Any, shapes: Any) -> Survey:
    count = cameras.RAYS**2
    return Survey(np.zeros((count, 3)), np.resize(distance, count).astype(float), np.resize(shapes, count).astype("u4"))


def test_views_of_nothing_a_wall_or_a_near_object_are_refused() -> None:
    depth = np.linspace(1, 3, 50)
    assert faults.geometry_fault(seen(depth, range(8))) is None
    assert faults.geometry_fault(seen([np.inf, np.inf, 2], range(8))) == "sees nothing"
    assert faults.geometry_fault(seen(depth, [5])) == "one surface only"
    assert faults.geometry_fault(seen(depth, [5] * 80 + [2, 3, 4] * 5)) is None
    assert faults.geometry_fault(seen(depth, [5] * 93 + [2, 2, 3, 3])) == "one surface only"
    empty = np.append(depth, [np.inf] * 15)
    assert faults.geometry_fault(seen(empty, [5] * 45 + [2, 2, 3, 3, 4] + [0] * 15)) == "little to see"
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
