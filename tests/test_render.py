"""Rendering a data set: equal seeds give equal views, resume, samples again, faults, processes and workers killed."""

import json
import os
import shutil
import signal
import subprocess
import sys
import threading
import time
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path

import numpy as np
import pathfold
import pytest

pytest.importorskip("mitsuba")

from pathfold_training.dataset import farm, render, store, trace, truth
from pathfold_training.scenes.faults import RejectedError
from pathfold_training.scenes.procedural import GENERATOR

LIBRARY = Path(__file__).parent / "assets" / "library"
SMALL = {"budget": 0.0, "seed": 3, "size": 16, "spp": 4}


@pytest.fixture(scope="module")
def task() -> trace.Task:
    return render.plan(0, LIBRARY, 2, 0.0, **SMALL)[0]


@pytest.fixture(scope="module")
def rendered(task: trace.Task) -> tuple[store.Line, store.Arrays]:
    return trace.render_view(task)


@pytest.fixture(scope="module")
def finished(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A data set of the library's two views."""
    out = tmp_path_factory.mktemp("finished")
    assert render.render(out, library=LIBRARY, views_per_scene=2, held_out=0, **SMALL)["done"] == 2
    return out


def test_a_library_that_is_no_folder_leaves_nothing_behind(tmp_path: Path) -> None:
    with pytest.raises(FileNotFoundError, match="is no folder"):
        render.render(tmp_path / "data", library=tmp_path / "nowhere")
    assert not (tmp_path / "data").exists()


def test_equal_seeds_give_equal_views(task: trace.Task, rendered: tuple[store.Line, store.Arrays]) -> None:
    line, one = rendered
    _, two = trace.render_view(task)
    assert all(np.array_equal(one[name], two[name]) for name in one)
    assert one["samples.descriptor"].shape == (1, 4, 36, 16, 16)
    assert one["reference.color"].shape == (3, 16, 16)
    assert line["crops"] == [[0, 0]]
    assert np.isclose(one["importance"].mean(), 1, atol=1e-3)
    _, three = trace.render_view(replace(task, seed=4))
    assert not np.array_equal(one["samples.radiance"], three["samples.radiance"])
    halves = np.stack([one["reference.half_a.color"], one["reference.half_b.color"]])
    assert np.allclose(halves.mean(0), one["reference.color"], rtol=1e-5)
    noisy = one["samples.radiance"][0].mean(0)
    assert abs(noisy.mean() / one["reference.color"].mean() - 1) < 0.3


def test_samples_come_again_from_the_description(task: trace.Task, rendered: tuple[store.Line, store.Arrays]) -> None:
    line, first = rendered
    described = json.loads(json.dumps(line))
    for kind in store.KINDS:
        again, tensors = trace.render_view(replace(task, known=described, kinds=(kind,)))
        assert {name.startswith("samples.") for name in tensors} == {kind == store.SAMPLES}
        assert all(np.array_equal(tensors[name], first[name]) for name in tensors)
        assert again["crops"] == line["crops"]


def test_a_larger_budget_gives_new_references_and_leaves_samples(finished: Path, tmp_path: Path) -> None:
    out = tmp_path / "data"
    shutil.copytree(finished, out)
    before = {line["id"]: line for line in store.read_index(out)}
    again = {"library": LIBRARY, "views_per_scene": 2, "held_out": 0, **SMALL}
    assert render.render(out, **again | {"budget": 0.001}) == {"done": 2, "kept": 0, "failed": 0}
    assert render.render(out, **again | {"budget": 0.001}) == {"done": 0, "kept": 2, "failed": 0}
    assert render.render(out)["kept"] == 2
    for line in store.read_index(out):
        old = before[line["id"]]
        assert (old["budget"], line["budget"]) == (0.0, 0.001)
        assert line["files"][store.SAMPLES] == old["files"][store.SAMPLES]
        assert (line["spp"], line["crops"]) == (old["spp"], old["crops"])
        assert store.present(out, line, store.REFERENCES)


def test_references_that_are_lost_or_damaged_are_rendered_again(finished: Path, tmp_path: Path) -> None:
    out = tmp_path / "data"
    shutil.copytree(finished, out)
    before = store.read_index(out)
    gone, cut = (store.file_path(out, store.REFERENCES, line["id"]) for line in before)
    gone.unlink()
    cut.write_bytes(cut.read_bytes()[:-1])
    assert render.render(out) == {"done": 2, "kept": 0, "failed": 0}
    for line in before:
        old, new = (store.Store(folder).tensor(line["id"], "reference.color")[:] for folder in (finished, out))
        assert np.array_equal(old, new)
    assert render.render(out)["kept"] == 2


def test_a_view_whose_generator_is_gone_is_made_anew_when_its_reference_is_lost(finished: Path) -> None:
    line = store.read_index(finished)[0] | {"kind": "procedural", "generator": GENERATOR - 1}
    lost = line | {"files": {store.SAMPLES: line["files"][store.SAMPLES]}}
    assert [render._lost(each) for each in (line, lost, lost | {"generator": GENERATOR})] == [False, True, False]


def test_a_larger_budget_leaves_references_that_are_good(finished: Path) -> None:
    line = store.read_index(finished)[0]
    for error, kinds in ((1e-3, [(store.REFERENCES,)]), (1e-4, [])):
        lines = {line["id"]: line | {"reference_rell2": error}}
        tasks = render._missing(finished, [], lines, None, 8.0, "llvm_ad_rgb")
        assert [task.kinds for task in tasks] == kinds


def test_samples_are_not_rendered_to_a_reference_of_another_generator(task: trace.Task) -> None:
    known = {"kind": "procedural", "generator": 1, "scene_seed": 5, "width": 16, "height": 16, "camera": None}
    with pytest.raises(RejectedError, match="generator 1 made its scene"):
        trace.render_view(replace(task, kind="procedural", path="", known=known))


def test_crops_are_windows_of_the_view(task: trace.Task) -> None:
    line, tensors = trace.render_view(replace(task, size=32, crop=16, crops=3, spp=64))
    assert tensors["samples.radiance"].shape == (3, 64, 3, 16, 16)
    assert tensors["samples.descriptor"].shape == (3, line["described"], 36, 16, 16) and line["described"] < 64
    assert len({tuple(corner) for corner in line["crops"]}) == 3
    clean = tensors["reference.color"]
    for samples, (y, x) in zip(tensors["samples.radiance"], line["crops"], strict=True):
        window = clean[:, y : y + 16, x : x + 16]
        assert np.corrcoef(samples.mean(0).ravel(), window.ravel())[0, 1] > 0.9


def test_a_zoomed_view_is_a_window_of_a_larger_picture(task: trace.Task) -> None:
    task = replace(task, size=32, zoom=4.0, id="tiny-3-1-c")
    line, tensors = trace.render_view(task)
    side, (y, x) = line["window"]["of"], line["window"]["corner"]
    assert 64 < side <= 128 and line["camera"]["fov"] > 25  # the picture's
    for kind in store.KINDS:
        _, again = trace.render_view(replace(task, known=json.loads(json.dumps(line)), kinds=(kind,)))
        assert all(np.array_equal(tensors[name], again[name]) for name in again)
    known = {name: value for name, value in line.items() if name != "window"} | {"width": side, "height": side}
    _, rendered = trace.render_view(replace(task, known=known, kinds=(store.REFERENCES,)))
    whole, own = rendered["reference.color"], tensors["reference.color"]

    def likeness(top: int, left: int) -> float:
        return float(np.corrcoef(own.ravel(), whole[:, top : top + 32, left : left + 32].ravel())[0, 1])

    assert likeness(y, x) > 0.98 > 0.95 > max(likeness(y - 3, x), likeness(y, x - 3))
    noisy = tensors["samples.radiance"][0].mean(0)
    assert abs(noisy.mean() / own.mean() - 1) < 0.3
    assert line["exposure"] == pytest.approx(truth.exposure(whole), rel=0.15)
    assert line["exposure"] != truth.exposure(own)


def test_crops_are_drawn_by_weight_without_repeats() -> None:
    weight = np.ones((300, 256))
    weight[:, 128:] = 9
    drawn = [trace.choose_crops(weight, 128, 2, trace.entropy(seed, "x")) for seed in range(200)]
    assert all(len({tuple(c) for c in corners}) == 2 for corners in drawn)
    assert {y for corners in drawn for y, _ in corners} == {0, 86, 172}
    right = np.mean([x == 128 for corners in drawn for _, x in corners])
    assert 0.8 < right < 0.95
    assert trace.choose_crops(np.ones((16, 16)), 16, 4, trace.entropy(0, "x")) == [[0, 0]]


def test_the_same_command_continues_and_reports_broken_scenes(tmp_path: Path) -> None:
    scenes = tmp_path / "scenes"
    shutil.copytree(LIBRARY, scenes)
    (scenes / "broken.xml").write_text("<scene version='3.0.0'><nonsense/></scene>")
    arguments = {"library": scenes, "views_per_scene": 1, **SMALL}
    out = tmp_path / "data"
    assert render.render(out, **arguments) == {"done": 1, "kept": 0, "failed": 1}
    before = store.file_path(out, store.SAMPLES, "tiny-3-0").stat().st_mtime_ns
    assert render.render(out, **arguments) == {"done": 0, "kept": 1, "failed": 1}
    assert store.file_path(out, store.SAMPLES, "tiny-3-0").stat().st_mtime_ns == before
    log = (out / "render.log").read_text()
    assert "broken-3-0 skipped" in log
    assert "views, " in log
    assert "paths/s" in log


def test_samples_are_rendered_again_at_any_spp(finished: Path, tmp_path: Path) -> None:
    out = tmp_path / "data"
    shutil.copytree(finished, out)
    kept = {line["id"]: line["files"][store.REFERENCES] for line in store.read_index(out)}
    shutil.rmtree(out / store.SAMPLES)
    assert render.render(out)["done"] == 2
    for line in store.read_index(finished):
        one, two = (store.Store(folder).tensor(line["id"], "samples.radiance")[:] for folder in (finished, out))
        assert np.array_equal(one, two)
    assert render.render(out, spp=2) == {"done": 2, "kept": 0, "failed": 0}
    assert render.render(out) == {"done": 0, "kept": 2, "failed": 0}
    for line in store.Store(out).lines:
        assert line["spp"] == 2
        assert line["files"][store.REFERENCES] == kept[line["id"]]
    assert list(store.damaged(out, store.read_index(out))) == []


def test_a_view_that_is_there_already_is_refused(task: trace.Task, finished: Path, tmp_path: Path) -> None:
    lines = {line["id"]: line for line in store.read_index(finished)}
    gallery = render._gallery(finished, lines)
    result = trace.render_view(replace(task, id="copy"))
    assert render._take_in(tmp_path, replace(task, id="copy"), result, gallery) is None
    assert not list(tmp_path.iterdir())


def test_a_killed_process_costs_its_view_a_retry(task: trace.Task) -> None:
    other = replace(task, id="other", number=1)
    killed: list[int] = []

    def kill_first() -> None:
        while not killed:
            for process in farm.multiprocessing.active_children():
                time.sleep(0.3)  # it is importing Mitsuba or at its view
                os.kill(process.pid or 0, signal.SIGKILL)
                killed.append(process.pid or 0)
                return
            time.sleep(0.01)

    thread = threading.Thread(target=kill_first)
    thread.start()
    results = {done.id: result for done, result in farm.local([task, other], 1)}
    thread.join()
    assert killed
    assert set(results) == {task.id, "other"}
    assert all(not isinstance(result, str) for result in results.values())


def die(task: trace.Task) -> farm.Result:
    os.kill(os.getpid(), signal.SIGKILL)
    return "not reached"


def test_a_view_whose_process_always_dies_is_given_up(task: trace.Task) -> None:
    ((_, result),) = farm.local([task], 2, die)
    assert result == "its process died with exit code -9, 2 times"


def words(text: str) -> str:
    """Console output without its line breaks."""
    return " ".join(text.split())


def command(out: Path) -> list[str]:
    options = ["--library", str(LIBRARY), "--cameras", "2", "--budget", "0", "--size", "16", "--spp", "4"]
    return [str(Path(sys.executable).parent / "pathfold-train"), "render", "--out", str(out), "--seed", "3", *options]


def test_the_renderer_is_killed_and_continues(tmp_path: Path, finished: Path) -> None:
    with subprocess.Popen([*command(tmp_path), "--workers", "1"]) as process:
        while process.poll() is None and not store.read_index(tmp_path):
            time.sleep(0.02)
        process.send_signal(signal.SIGKILL)
    assert len(store.Store(tmp_path).lines) == 1
    run = subprocess.run(command(tmp_path), capture_output=True, text=True, check=True)
    assert "1 views made, 1 kept, 0 failed" in words(run.stderr)
    for line in store.read_index(finished):
        one, two = (store.Store(folder).tensor(line["id"], "reference.color")[:] for folder in (finished, tmp_path))
        assert np.array_equal(one, two)


@pytest.mark.long
def test_a_full_disk_stops_with_one_line_and_the_run_continues(tmp_path: Path) -> None:
    """A file system of 256 KiB takes one view and not another."""
    arguments = " ".join(command(tmp_path))
    script = (
        f"mount -t tmpfs -o size=256k none {tmp_path} && {{ {arguments}; code=$?; find {tmp_path} -name '*.partial'; "
    )
    script += f"mount -o remount,size=9m {tmp_path}; {arguments}; exit $code; }}"
    if subprocess.run(["unshare", "-m", "true"], capture_output=True).returncode:
        pytest.skip("no mount namespace: not root")
    run = subprocess.run(["unshare", "-m", "sh", "-c", script], capture_output=True, text=True)
    first, second = words(run.stderr).split("free some space and give the same command again")
    assert run.returncode == 1, run.stderr
    assert "Traceback" not in run.stderr
    assert "No space left on device" in first
    assert run.stdout == ""  # no partial file
    assert "1 views made, 1 kept, 0 failed" in second


@pytest.fixture
def scheduler(tmp_path: Path) -> Iterator[str]:
    """A Dask scheduler with two workers on loopback, each a process of one thread with its nanny."""
    file = tmp_path / "scheduler.json"
    dask = [str(Path(sys.executable).parent / "dask")]
    quiet = {"stdout": subprocess.DEVNULL, "stderr": subprocess.DEVNULL, "cwd": tmp_path}
    joined = [*dask, "worker", "--scheduler-file", str(file), "--nthreads", "1", "--nworkers", "2", "--no-dashboard"]
    start = [*dask, "scheduler", "--host", "127.0.0.1", "--port", "0", "--no-dashboard", "--scheduler-file", str(file)]
    processes = [subprocess.Popen(start, **quiet)]  # type: ignore[call-overload]
    try:
        while not file.exists():
            time.sleep(0.05)
        processes.append(subprocess.Popen([*joined, "--local-directory", str(tmp_path)], **quiet))  # type: ignore[call-overload]
        yield json.loads(file.read_text())["address"]
    finally:
        for process in reversed(processes):
            process.terminate()
            process.wait(20)


@pytest.mark.long
def test_a_cluster_renders_the_same_and_survives_a_killed_worker(
    finished: Path, tmp_path: Path, scheduler: str
) -> None:
    distributed = pytest.importorskip("distributed")
    killed: list[int] = []

    def kill_busy() -> None:
        with distributed.Client(scheduler) as client:
            while not killed:
                pids = client.run(os.getpid)
                for worker in (name for name, keys in client.processing().items() if keys):
                    os.kill(pids[worker], signal.SIGKILL)
                    killed.append(pids[worker])
                    return
                time.sleep(0.02)

    thread = threading.Thread(target=kill_busy)
    thread.start()
    out = tmp_path / "data"
    counts = render.render(out, library=LIBRARY, views_per_scene=2, held_out=0, cluster=scheduler, **SMALL)
    thread.join()
    assert killed
    assert counts == {"done": 2, "kept": 0, "failed": 0}
    for line in store.read_index(finished):
        for name in ("samples.radiance", "reference.color"):
            one, two = (store.Store(folder).tensor(line["id"], name)[:] for folder in (finished, out))
            assert np.array_equal(one, two)


def test_a_cluster_that_is_not_there_is_named(task: trace.Task, monkeypatch: pytest.MonkeyPatch) -> None:
    pytest.importorskip("distributed")
    monkeypatch.setattr(farm, "ANSWER", 1)
    with pytest.raises(OSError, match=r"no Dask scheduler answers at tcp://127\.0\.0\.1:9"):
        list(farm.cluster([task], "tcp://127.0.0.1:9"))


def test_the_plan_is_mixed_fixed_by_the_seed_and_splits_whole_scenes() -> None:
    first, again, other = (render.plan(40, LIBRARY, 4, 0.2, **SMALL | {"seed": seed}) for seed in (1, 1, 2))
    assert first == again
    assert [t.id for t in first] != [t.id for t in other]
    assert len({t.split for t in first if t.scene == "tiny"}) == 1
    assert 2 <= sum(t.split == "val" for t in first) <= 18


def test_views_of_a_generated_scene_share_it_and_its_split() -> None:
    more, one = render.plan(6, None, 4, 0.5, 3, **SMALL), render.plan(6, None, 4, 0.5, **SMALL)
    assert len({t.id for t in more}) == len(more) == 18 and {t.id for t in one} < {t.id for t in more}
    assert len({(t.scene, t.split) for t in more}) == 6
    pair = sorted((t for t in more if t.scene == more[0].scene and t.number < 2), key=lambda t: t.number)
    first, second = (trace.render_view(t)[0] for t in pair)
    assert first["scene_seed"] == second["scene_seed"] and first["camera"] != second["camera"]


def test_the_command_renders_views_of_generated_scenes(tmp_path: Path) -> None:
    options = ["--procedural", "1", "--views", "2", "--budget", "0", "--size", "16", "--spp", "1", "--seed", "9"]
    program = str(Path(sys.executable).parent / "pathfold-train")
    run = subprocess.run(
        [program, "render", "--out", str(tmp_path), *options], capture_output=True, text=True, check=True
    )
    made = {line["id"]: line for line in store.read_index(tmp_path)}
    assert f"{len(made)} views made, 0 kept, {2 - len(made)} failed" in words(run.stderr)
    assert {"procedural-9-0000", "procedural-9-0000-1"} == made.keys()
    assert len({line["scene"] for line in made.values()}) == 1


def test_half_error_estimates_the_error_of_the_mean() -> None:
    rng = np.random.default_rng(0)
    right = rng.uniform(0.2, 1, (64, 64, 3))
    a, b = (right + 0.02 * rng.normal(size=right.shape) for _ in range(2))
    actual = np.mean(((a + b) / 2 - right) ** 2 / (right**2 + 1e-2))
    assert truth.half_error(a, b) == pytest.approx(actual, rel=0.1)


def test_exposure_is_the_sdk_s_and_stands_outliers() -> None:
    image = np.random.default_rng(0).uniform(0.1, 1, (3, 65, 50)).astype(np.float32)
    calm = truth.exposure(image)
    assert calm == pathfold.auto_exposure(np.moveaxis(image, 0, -1))
    image[:, 3, 3] = 1e12
    assert truth.exposure(image) == pytest.approx(calm, rel=0.2)


def test_exposure_scales_inversely_and_ignores_black() -> None:
    image = np.random.default_rng(0).uniform(0.1, 1, (3, 64, 48)).astype(np.float32)
    assert truth.exposure(image) == pytest.approx(100 * truth.exposure(100 * image), rel=1e-5)
    assert truth.exposure(np.zeros((3, 8, 8), np.float32)) == 1
    assert truth.exposure(np.full((3, 20, 20), 0.18, np.float32)) == pytest.approx(1, rel=1e-4)


def test_depth_scale_is_over_what_was_met() -> None:
    assert truth.depth_scale(np.array([0, 2.0, 8.0, np.inf])) == pytest.approx(1 / 4)
    assert truth.depth_scale(np.zeros(4)) == 1
