"""Rendering a data set: equal seeds give equal samples, resume, broken scenes, the reference's error."""

import shutil
from dataclasses import replace
from pathlib import Path

import numpy as np
import pathfold
import pytest

pytest.importorskip("mitsuba")

from pathfold_training import render, store

LIBRARY = Path(__file__).parent / "assets" / "library"


@pytest.fixture(scope="module")
def task() -> render.Task:
    return render.plan(0, LIBRARY, 0.0, seed=3, size=16, spp=4, views_per_scene=2, held_out=0.0)[0]


def test_equal_seeds_give_equal_views(task: render.Task, tmp_path: Path) -> None:
    first = render.render_view(task, tmp_path / "first")
    render.render_view(task, tmp_path / "again")
    other = render.render_view(replace(task, seed=4), tmp_path / "other")
    one, two = (store.Store(_indexed(tmp_path / name, first)).view(task.id) for name in ("first", "again"))
    assert all(np.array_equal(one[name], two[name]) for name in one)
    assert one["samples.descriptor"].shape == (4, 36, 16, 16)
    assert one["reference.color"].shape == (3, 16, 16)
    assert np.isclose(one["importance"].mean(), 1, atol=1e-3)
    three = store.Store(_indexed(tmp_path / "other", other)).view(task.id)
    assert not np.array_equal(one["samples.radiance"], three["samples.radiance"])
    halves = np.stack([one["reference.half_a.color"], one["reference.half_b.color"]])
    assert np.allclose(halves.mean(0), one["reference.color"], rtol=1e-5)
    noisy = one["samples.radiance"].mean(0)
    assert abs(noisy.mean() / one["reference.color"].mean() - 1) < 0.3


def _indexed(folder: Path, line: store.Line) -> Path:
    store.append_line(folder, line)
    return folder


def test_the_same_command_continues_and_reports_broken_scenes(tmp_path: Path) -> None:
    scenes = tmp_path / "scenes"
    shutil.copytree(LIBRARY, scenes)
    (scenes / "broken.xml").write_text("<scene version='3.0.0'><nonsense/></scene>")
    arguments = {"library": scenes, "budget": 0.0, "seed": 3, "size": 16, "spp": 2, "views_per_scene": 1, "workers": 2}
    out = tmp_path / "data"
    assert render.render(out, **arguments) == {"done": 1, "kept": 0, "failed": 1}
    before = store.view_path(out, "tiny-3-0").stat().st_mtime_ns
    assert render.render(out, **arguments) == {"done": 0, "kept": 1, "failed": 1}
    assert store.view_path(out, "tiny-3-0").stat().st_mtime_ns == before
    assert "broken-3-0 skipped" in (out / "render.log").read_text()


def test_a_killed_process_costs_its_view_only(tmp_path: Path, task: render.Task) -> None:
    lost = replace(task, id="lost", path="/dev/null/nothing.xml")
    results = {t.id: line for t, line in render._run(tmp_path, [lost], 1)}
    assert results == {"lost": None}


def test_the_plan_is_mixed_fixed_by_the_seed_and_splits_whole_scenes() -> None:
    first, again, other = (render.plan(40, LIBRARY, 1.0, seed, 16, 4, 4, 0.2) for seed in (1, 1, 2))
    assert first == again
    assert [t.id for t in first] != [t.id for t in other]
    assert len({t.split for t in first if t.scene == "tiny"}) == 1
    assert 2 <= sum(t.split == "val" for t in first) <= 18


def test_half_error_estimates_the_error_of_the_mean() -> None:
    rng = np.random.default_rng(0)
    truth = rng.uniform(0.2, 1, (64, 64, 3))
    a, b = (truth + 0.02 * rng.normal(size=truth.shape) for _ in range(2))
    actual = np.mean(((a + b) / 2 - truth) ** 2 / (truth**2 + 1e-2))
    assert render.half_error(a, b) == pytest.approx(actual, rel=0.1)


def test_exposure_is_the_sdk_s_and_stands_outliers() -> None:
    image = np.random.default_rng(0).uniform(0.1, 1, (3, 65, 50)).astype(np.float32)
    calm = render.exposure(image)
    assert calm == pathfold.auto_exposure(np.moveaxis(image, 0, -1))
    image[:, 3, 3] = 1e12
    assert render.exposure(image) == pytest.approx(calm, rel=0.2)


def test_exposure_scales_inversely_and_ignores_black() -> None:
    image = np.random.default_rng(0).uniform(0.1, 1, (3, 64, 48)).astype(np.float32)
    assert render.exposure(image) == pytest.approx(100 * render.exposure(100 * image), rel=1e-5)
    assert render.exposure(np.zeros((3, 8, 8), np.float32)) == 1
    assert render.exposure(np.full((3, 20, 20), 0.18, np.float32)) == pytest.approx(1, rel=1e-4)
