"""The bench: what it measures on small scenes and pictures, what it keeps."""

import json
import math
import shutil
import sys
from pathlib import Path

import numpy as np
import pytest

pytest.importorskip("jinja2")
pytest.importorskip("matplotlib")
pytest.importorskip("flip_evaluator")
pytest.importorskip("skimage")
pytest.importorskip("pyoidn")

from exr_files import part, write
from pathfold import PathfoldError, metrics
from pathfold.bench import candidates, cold, subjects
from pathfold.bench.about import command
from pathfold.bench.reference import Reference
from pathfold.bench.run import Job, _events
from pathfold.bench.timing import in_turns
from pathfold.plan import curves

TINY = Path(__file__).parent / "assets" / "library" / "tiny"


def test_a_frame_is_the_same_however_many_paths_are_recorded() -> None:
    (subject,) = subjects.find(TINY / "scene.xml", subjects.Options(rounds=1))
    size = (12, 8)
    every = subject.shoot(0, 4, 1, {0, 2, 1 << 30}, size, first_seed=True)
    assert sorted(every.render_ms) == [0, 2, 4]
    assert every.buffers["samples.descriptor"].shape[0] == 4
    some = subject.shoot(0, 4, 1, {2}, size, first_seed=False)
    assert sorted(some.render_ms) == [2]
    np.testing.assert_array_equal(some.buffers["color"], every.buffers["color"])
    for name in ("samples.descriptor", "samples.density"):
        np.testing.assert_array_equal(some.buffers[name], every.buffers[name][:2])
    none = subject.shoot(0, 4, 1, set(), size, first_seed=False)
    np.testing.assert_array_equal(none.buffers["variance"], every.buffers["variance"])
    assert "samples.descriptor" not in none.buffers
    for name, count in (("noisy", 0), ("kpcn-vanilla", 0), ("pathfold-balanced", 2), ("kpcn-manifold", 4)):
        candidate = candidates.find(name)
        assert every.rendering_for(candidate) is every.render_ms[count]
        assert bool(some.rendering_for(candidate)) == (count == 2)


def test_how_many_paths_a_model_looks_at_is_part_of_its_identity() -> None:
    manifest = {"graphs": {}, "samples_per_pixel": {"min": 1, "max": 8}}
    limited = {**manifest, "samples_per_pixel": {"min": 1, "max": 8, "embedded": 2}}
    assert candidates.fingerprint(manifest) != candidates.fingerprint(limited)
    assert candidates.fingerprint({**manifest, "samples_per_pixel": None})


def test_calls_take_turns() -> None:
    order: list[str] = []
    took = in_turns({name: lambda name=name: order.append(name) for name in "ab"}, 3)  # type: ignore[misc]
    assert order == list("ababab") and [len(runs) for runs in took.values()] == [3, 3]


def test_a_reference_is_read_as_written_and_its_noise_left_out(tmp_path: Path) -> None:
    rng = np.random.default_rng(0)
    truth = rng.uniform(0.2, 1, (64, 64, 3)).astype(np.float32)
    a, b = (truth + rng.normal(0, 0.03, truth.shape).astype(np.float32) for _ in range(2))
    Reference((a + b) / 2, (a, b), 64, 9).save(tmp_path / "reference.exr")
    read = Reference.read(tmp_path / "reference.exr")
    assert (read.spp, read.max_depth, read.size) == (64, 9, (64, 64))
    np.testing.assert_array_equal(read.halves, (a, b))
    errors = read.errors(truth)
    assert abs(errors["rell2"]) < 0.1 * metrics.rell2(truth, (a + b) / 2)
    assert read.own_error == pytest.approx(metrics.rell2((a + b) / 2, truth), rel=0.1)
    cut = tuple(half[28:-28, 28:-28] for half in (a, b))
    assert errors["rell2_paper"] == pytest.approx(metrics.rell2_halves(truth[28:-28, 28:-28], *cut, epsilon=1e-4))
    with pytest.raises(ValueError, match="1 pixels are not finite"):
        read.errors(np.where(np.arange(64 * 64 * 3).reshape(64, 64, 3) == 0, np.nan, truth))


def test_peak_memory_and_cold_time_of_a_fresh_process(tiny: Path) -> None:
    rng = np.random.default_rng(0)
    names = ("color", "albedo", "normal")
    small, large = ({n: rng.uniform(0, 1, (s, s, 3)).astype(np.float32) for n in names} for s in (32, 640))
    oidn = candidates.find("oidn")
    (ms, mb), (_, more) = (cold.measure(oidn, buffers) for buffers in (small, large))
    assert ms > 1 and more > mb + 20  # 400 times the pixels; weights and code are the same
    with pytest.raises(cold.ColdError, match="color"):
        cold.measure(candidates.find("split-5"), {})


def test_names_that_are_no_method_or_scene(tiny: Path, tmp_path: Path) -> None:
    with pytest.raises(Exception, match=r"nonsense.*besides models there are noisy, oidn, oidn-fast, oidn-prefiltered"):
        candidates.find_all(["nonsense"])
    shutil.copytree(tiny / "split-5", tmp_path / "split-5")
    with pytest.raises(Exception, match="both called split-5"):
        candidates.find_all(["split-5", str(tmp_path / "split-5")])
    with pytest.raises(subjects.SubjectError, match=r"holds no such thing.*scene\.xml"):
        subjects.find(tmp_path, subjects.Options())
    with pytest.raises(subjects.SubjectError, match="is not there"):
        subjects.find(tmp_path / "x", subjects.Options())


def records(folder: Path) -> list[dict]:
    return [json.loads(line) for line in (folder / "results.jsonl").read_text().splitlines()]


def test_a_scene_is_measured_and_what_is_measured_is_kept(run, tmp_path: Path) -> None:
    pytest.importorskip("mitsuba")
    out = tmp_path / "out"
    command = ["bench", TINY, "--seeds", 2, "--reference-spp", 64, "-o", out, "--spp", "1,2"]
    command += ["--methods", "noisy,oidn,samples-5"]
    code, told, err = run(*command)
    assert (code, err) == (0, ""), err
    assert "index.html" in told
    first = records(out)
    assert {(r["spp"], r["seed"], r["method"]) for r in first} == {
        (n, seed, method) for n in (1, 2) for seed in (0, 1) for method in ("noisy", "oidn", "samples-5")
    }
    for record in first:
        assert record["scene"] == "tiny" and (record["width"], record["height"]) == (48, 27)
        assert all(math.isfinite(record[name]) for name in ("rell2", "smape", "ssim", "flip"))
        timed = 3 if record["seed"] == 0 else 1
        assert len(record["denoise_ms"]) == (timed if record["method"] != "noisy" else 0)
        plain = record["method"] != "samples-5"  # without descriptors a frame is rendered for its time only
        assert len(record["render_ms"]) == (0 if plain and record["seed"] else timed)
        measured_cold = record["method"] != "noisy" and record["seed"] == 0
        assert (record["cold_ms"] is not None) == (record["peak_mb"] is not None) == measured_cold
        assert record["reference_spp"] == 64 and 0 < record["reference_rell2"] < 1
        assert record["machine"] and record["versions"]["pathfold"]
    render = {(r["spp"], r["seed"], r["method"]): r["render_ms"] for r in first}
    cold_ms = {(r["spp"], r["method"]): r["cold_ms"] for r in first if r["seed"] == 0}
    assert cold_ms[1, "oidn"] == cold_ms[2, "oidn"]  # its inputs are the same at any spp
    assert cold_ms[1, "samples-5"] != cold_ms[2, "samples-5"]
    assert render[2, 0, "noisy"] == render[2, 0, "oidn"] != render[2, 0, "samples-5"]  # descriptors cost their reader
    rell2 = {(r["spp"], r["seed"]): r["rell2"] for r in first if r["method"] == "noisy"}
    assert rell2[2, 0] < rell2[1, 0] and rell2[1, 0] != rell2[1, 1]
    names = {path.name for path in out.iterdir()}
    data = {"results.jsonl", "about.json", "curves.json", "references"}
    assert names == data | {"table.md", "index.html", "plots", "pictures"}
    assert {path.name for path in (out / "plots").iterdir()} == {"tiny.png", "tiny.svg"}
    planned_from = curves.read(out / "curves.json")
    assert {(s.spp, s.method) for s in planned_from} == {(r["spp"], r["method"]) for r in first}
    page = (out / "index.html").read_text()
    assert "http://www.w3.org/2000/svg" in page  # the only address, a name that nothing is fetched from
    assert page.count("http") == 1 and len(page) < 4_000_000 and "data:image/jpeg;base64," in page

    lines = (out / "results.jsonl").read_text().splitlines()
    lost = [line for line in lines if '"seed": 1' in line and '"spp": 2' in line]
    (out / "results.jsonl").write_text("\n".join(line for line in lines if line not in lost) + '\n{"scene": "ti')
    assert run(*command)[0] == 0
    again = {(r["spp"], r["seed"], r["method"]): r for r in records(out)}
    kept = [r for r in first if (r["spp"], r["seed"]) != (2, 1)]
    assert all(again[r["spp"], r["seed"], r["method"]] == r for r in kept)
    for old in (json.loads(line) for line in lost):  # equal seeds, equal pictures
        new = again[old["spp"], old["seed"], old["method"]]
        assert new["run"] > old["run"] and new["rell2"] == pytest.approx(old["rell2"], rel=1e-3)


def noisy_exr(path: Path, truth: np.ndarray, spp: int, seed: int, **header: float) -> None:
    rng = np.random.default_rng((seed, spp))
    guides = np.full((*truth.shape[:2], 6), 0.5, np.float32)
    color = (truth * rng.gamma(spp, 1 / spp, truth.shape)).astype(np.float32)
    names = [*"RGB", *(f"albedo.{c}" for c in "RGB"), *(f"normal.{c}" for c in "XYZ")]
    from pathfold.images import NewPart, write_parts

    values = np.concatenate([color, guides], -1)
    part = NewPart("", names, ["float"] * 9, (truth.shape[1], truth.shape[0]), lambda first, last: values[first:last])
    write_parts(path, [part], {f"pathfold:{name}": value for name, value in header.items()})


def test_pictures_and_sequences(run, tmp_path: Path) -> None:
    rng = np.random.default_rng(1)
    folder = tmp_path / "shot"
    folder.mkdir()
    for frame in (1, 2, 3):
        truth = rng.uniform(0.2, 1, (32, 40, 3)).astype(np.float32)
        Reference(truth).save(folder / f"reference.{frame:04d}.exr")
        for spp in (2, 8):
            noisy_exr(folder / f"{spp}spp.{frame:04d}.exr", truth, spp, frame, render_seconds=spp / 10)
    out = tmp_path / "out"
    code, _, err = run("bench", folder, "-o", out, "--methods", "noisy,oidn,samples-5")
    assert code == 1 and "samples-5" in err and "samples.descriptor" in err  # it needs what the files do not hold
    found = records(out)
    assert {(r["spp"], r["method"], r["frames"]) for r in found} == {
        (n, m, 3) for n in (2, 8) for m in ("noisy", "oidn")
    }
    assert {r["spp"]: r["render_ms"] for r in found} == {2: [pytest.approx(200)], 8: [pytest.approx(800)]}
    flicker = {(r["spp"], r["method"]): r["flicker"] for r in found}
    assert flicker[2, "noisy"] > 1.5 * flicker[8, "noisy"] > 0  # noise of a quarter of the variance
    assert "flicker" in (out / "table.md").read_text()
    one = tmp_path / "one"
    assert run("bench", folder / "8spp.####.exr", "-o", one, "--methods", "noisy")[0] == 0
    assert {r["spp"] for r in records(one)} == {8} and {r["scene"] for r in records(one)} == {"shot-8spp"}


def test_pictures_are_read_as_denoise_reads_them(tmp_path: Path) -> None:
    names = [*"RGB", "A", *(f"albedo.{c}" for c in "RGB")]
    covered = np.linspace(0, 1, 32, dtype=np.float32)[None, :, None].repeat(24, 0)
    values = np.concatenate([np.ones((24, 32, 3), np.float32), covered, 0.5 * covered.repeat(3, -1)], -1)
    write(tmp_path / "4spp.exr", [part("", names, ["float"] * 7, values, generatedBy="Mitsuba 3")])
    Reference(values[..., :3]).save(tmp_path / "reference.exr")
    shot = subjects.PictureSubject(tmp_path, "shot", subjects.Options()).shoot(0, 4, 0, (), (32, 24), True)
    assert shot.buffers["albedo"] == pytest.approx((0.5 * covered + 1 - covered).repeat(3, -1), abs=1e-6)


def test_what_fails_is_told_and_the_rest_goes_on(run, tmp_path: Path) -> None:
    for name in ("good", "bad"):
        (tmp_path / "all" / name).mkdir(parents=True)
        truth = np.random.default_rng(0).uniform(0.2, 1, (16, 16, 3)).astype(np.float32)
        Reference(truth).save(tmp_path / "all" / name / "reference.exr")
        noisy_exr(tmp_path / "all" / name / "4spp.exr", truth, 4, 0)
    (tmp_path / "all" / "bad" / "4spp.exr").write_text("no picture")
    code, _, err = run("bench", tmp_path / "all", "-o", tmp_path / "out", "--methods", "noisy")
    assert code == 1 and "left out: bad" in err
    assert {r["scene"] for r in records(tmp_path / "out")} == {"good"}
    table = (tmp_path / "out" / "table.md").read_text()
    assert "Left out: bad" in table
    assert not list((tmp_path / "out" / "plots").iterdir())  # nobody told how long the rendering took


@pytest.mark.parametrize(
    ("arguments", "code", "words"),
    [
        (["--spp", "1,x"], 2, "--spp 1,x: write whole numbers"),
        (["--methods", "nonsense"], 4, "besides models there are"),
    ],
)
def test_wrong_arguments(run, tmp_path: Path, arguments: list[str], code: int, words: str) -> None:
    found, _, err = run("bench", TINY, "-o", tmp_path / "out", *arguments)
    assert found == code and words in err and len(err.splitlines()) == 1
    assert not (tmp_path / "out").exists()


def test_a_process_that_dies_costs_its_scene_only(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    subject = subjects.MitsubaSubject(TINY / "scene.xml", "tiny", subjects.Options(spps=(1,), seeds=1))
    job = Job(subject, {(1, 0): ["noisy"]}, ("noisy",), tmp_path, "now")
    monkeypatch.setattr("pathfold.bench.run._work", dies)
    *_, problem, last = list(_events(job))
    assert "exit code 7" in str(problem) and last.work == job.work


def dies(*_: object) -> None:
    sys.exit(7)


def test_evaluate_goes_the_same_way(tmp_path: Path, tiny: Path) -> None:
    pytest.importorskip("mitsuba")
    evaluate = pytest.importorskip("pathfold_training.release.evaluate")
    folder = tmp_path / "scenes" / "tiny"
    shutil.copytree(TINY, folder)
    truth = np.full((27, 48, 3), 0.5, np.float32)
    Reference(truth, (truth, truth), 16, 3).save(folder / "reference.exr")
    vanilla, manifold = (tmp_path / "models" / name for name in ("kpcn-vanilla", "kpcn-manifold"))
    shutil.copytree(tiny / "split-5", vanilla)
    shutil.copytree(tiny / "samples-5", manifold)
    rows = evaluate.evaluate(tmp_path / "scenes", tmp_path / "out", [str(vanilla), str(manifold)], spp=1, seeds=1)
    by = {row.method: row.rell2 for row in rows}
    assert list(by) == ["noisy", "oidn", "oidn-prefiltered", "kpcn-vanilla", "kpcn-manifold"]
    table = (tmp_path / "out" / "table.md").read_text()
    assert f"| **all** | | **{by['kpcn-manifold'] / by['kpcn-vanilla']:.3f}** |" in table
    assert {p.name for p in (tmp_path / "out").iterdir()} == {
        "results.jsonl",
        "about.json",
        "table.md",
        "tiny-1spp.jpg",
    }


def test_results_do_not_tell_where_things_lie(tmp_path: Path) -> None:
    words = ["pathfold", "bench", str(tmp_path / "scenes"), "scenes/a.xml", "../scenes/b", str(Path.cwd() / "c"), "2,4"]
    assert command(words[:3]) == f"pathfold bench {tmp_path.name.upper()}/scenes"
    assert command(words[3:]) == "scenes/a.xml SCENES/b c 2,4"


def test_a_model_is_measured_in_a_precision(tiny: Path) -> None:
    plain, exact, rounded = candidates.find_all(["quantised-3", "quantised-3:fp32", f"{tiny / 'quantised-3'}:int8"])
    assert [method.name for method in (plain, exact, rounded)] == [
        "quantised-3",
        "quantised-3:fp32",
        "quantised-3:int8",
    ]
    assert exact.identity != rounded.identity  # a variant may be written anew without the rest
    color = np.random.default_rng(0).exponential(1.0, (20, 30, 3)).astype(np.float32)
    assert (exact.load()({"color": color}, 1.0, 0) != rounded.load()({"color": color}, 1.0, 0)).any()
    with pytest.raises(PathfoldError, match="single-3:int8: the model has no int8, only fp32"):
        candidates.find("single-3:int8")
    with pytest.raises(PathfoldError, match="int8"):
        candidates.find("int8")


def test_a_frame_has_as_many_samples_as_it_says() -> None:
    """The shipped model that looks at one sample's paths still knows the variance of all."""
    candidate = candidates.find("pathfold-fast")
    assert candidate.path_samples == 1
    draw = np.random.default_rng(1)
    buffers = {name: draw.exponential(1.0, (20, 30, 3)).astype(np.float32) for name in ("color", "variance", "albedo")}
    buffers["samples.descriptor"] = draw.normal(0.0, 1.0, (4, 20, 30, 36)).astype(np.float32)
    first = {**buffers, "samples.descriptor": buffers["samples.descriptor"][:1]}
    run = candidate.load()
    np.testing.assert_array_equal(run(first, 1.0, 4), run(buffers, 1.0, 0))
    assert (run(first, 1.0, 0) != run(buffers, 1.0, 0)).any()  # of one sample nothing has a variance


def test_a_models_fingerprint_is_of_what_its_results_depend_on(tiny_models: Path) -> None:
    manifest = json.loads((tiny_models / "split-5" / "manifest.json").read_text())
    own = candidates.fingerprint(manifest)
    assert candidates.fingerprint(manifest | {"training": {"seed": 7}, "description": "another"}) == own
    assert candidates.fingerprint(manifest | {"graphs": {}}) != own
