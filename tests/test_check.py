"""`pathfold check`: its frames, its measure, its verdicts; and its properties on random frames."""

import hashlib
import json
import math
import shutil
import sys
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import onnx
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st
from pathfold import _core, models
from pathfold.check import cases, check_model, references
from pathfold.check.cases import CASES, Buffers, Draw
from pathfold.check.measure import relative_error, tolerance
from pathfold.check.outcome import Row, factor_limits
from pathfold.check.prepare import Branch, Prepared, auto_exposure, prepare, window_limits
from pathfold.check.properties import PROPERTIES, gather
from pathfold.check.spoilt import SPOILT
from pathfold.cli import app, console
from pathfold.denoiser import Denoiser

SHIPPED = models.available(models.shipped_directories())
FRAME = "5b7b5151fa5469d1c4547562327586f05722a53b9da48cf3f5c5dc34a03a9370"
RANDOM = settings(max_examples=40, deadline=None, suppress_health_check=[HealthCheck.function_scoped_fixture])


def test_frames_are_the_same_bits_everywhere() -> None:
    """What an exported reference belongs to: a change here makes every model's references stale."""
    assert references.frame_hash(cases.frame()) == FRAME
    assert all(references.frame_hash(case.make()) == references.frame_hash(case.make()) for case in CASES)
    names = [entry.name for entry in (*CASES, *PROPERTIES, *SPOILT)]
    assert len(set(names)) == len(names)


def test_every_tolerance_has_a_reason() -> None:
    path = Path(cases.__file__).parent / "tolerances.toml"
    assert path.read_text().count("\nvalue = ") == path.read_text().count("\nreason = ")
    with pytest.raises(KeyError):
        tolerance("chain.fp8")


def test_relative_error_names_the_worst_pixel() -> None:
    right = np.array([[[1e-3], [1.0], [1e8]]])
    image = right * np.array([[[1.001], [1.0], [1.0001]]])
    error, worst = relative_error(image, right)
    assert error == pytest.approx(1e-3, rel=1e-6) and worst == (0, 0)  # the dark pixel is not hidden by the bright
    assert relative_error(right, right) == (0.0, None)
    assert relative_error(np.full((1, 1, 1), math.nan), np.ones((1, 1, 1))) == (math.inf, (0, 0))
    tiny = np.full((1, 1, 1), 1e-40)
    assert relative_error(tiny, 2 * tiny)[0] < 1e-2  # denormals have few digits


def test_a_cleaned_factor_is_bounded_by_what_its_pyramid_reaches() -> None:
    factor = np.ones((1, 40, 3))
    factor[0, 5] = 3.0
    branch = Branch("network", "color", factor, factor, {}, clean=True)
    low, high = factor_limits(branch, Prepared([branch], np.ones((1, 40), bool), 1.0, 1.0))
    assert (low == 1.0).all()
    assert (high[0, :20] == 3.0).all()  # 14 pixels away at most
    assert (high[0, 20:] == 1.0).all()


def test_window_limits_leave_masked_pixels_out() -> None:
    values, valid = np.arange(20.0).reshape(4, 5, 1), np.ones((4, 5), bool)
    valid[0, 0] = valid[3, 4] = False
    low, high = window_limits(values, valid, 1)
    assert (low[0, 0, 0], high[0, 0, 0]) == (1, 6)
    assert (low[3, 3, 0], high[3, 3, 0]) == (12, 18)
    assert not window_limits(values, np.zeros((4, 5), bool), 1)[1].any()


def test_a_row_gives_every_reason() -> None:
    row = Row("case", "", error=1.0, allowed=0.1, finite=False, bounded=False)
    assert row.judged().reason.count(";") == 2
    assert not Row("case", "", error=0.1, allowed=0.1).judged().reason
    assert Row("case", "", error=math.nan, allowed=0.1).judged().reason


@pytest.mark.parametrize(("name", "precision"), [(n, p) for n in SHIPPED for p in models.precisions(n)])
def test_shipped_models_are_stable(name: str, precision: str) -> None:
    report = check_model(SHIPPED[name], precision=precision)
    assert report.passed, [(row.name, row.reason) for row in report.rows if row.reason]
    assert len(report.rows) > 30


@pytest.fixture
def run(tiny: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]) -> Any:
    def call(*arguments: object) -> tuple[int, str, str]:
        monkeypatch.setattr(sys, "argv", ["pathfold", "check", *map(str, arguments)])
        code = console.run(app)
        return code, *capsys.readouterr()

    return call


def test_the_table_says_what_was_not_checked(run: Any) -> None:
    code, out, _ = run("--model", "single-3", "--model", "single-21")
    assert code == 0
    assert "single-3, fp32: all" in out and "single-21, fp32: all" in out and "error, fp32" in out
    assert "no usable references.npz" in out and "left out" in out and "no accumulator" in out


def test_a_model_is_checked_in_every_precision(run: Any, tiny: Path) -> None:
    code, out, _ = run("--model", "quantised-3")
    assert code == 0 and "quantised-3, fp32: all" in out and "quantised-3, int8: all" in out
    assert "error, int8" in out and "to those in fp32" in out
    plain = check_model(tiny / "quantised-3", precision="int8").rows[0]
    assert plain.name == "plain" and 1e-3 < (plain.error or 0) < plain.allowed == tolerance("chain.int8")


def test_an_int8_graph_of_other_weights_is_found(tiny: Path, tmp_path: Path) -> None:
    folder = shutil.copytree(tiny / "quantised-3", tmp_path / "model")
    graph = onnx.load(folder / "color.int8.onnx")
    (scales,) = (tensor for tensor in graph.graph.initializer if tensor.name == "weights:scales")
    scales.CopyFrom(onnx.numpy_helper.from_array(-4 * onnx.numpy_helper.to_array(scales), scales.name))
    onnx.save(graph, folder / "color.int8.onnx")
    manifest = json.loads((folder / "manifest.json").read_text())
    digest = hashlib.sha256((folder / "color.int8.onnx").read_bytes()).hexdigest()
    manifest["variants"]["int8"]["graphs"]["color"]["sha256"] = digest
    (folder / "manifest.json").write_text(json.dumps(manifest))
    assert check_model(folder).passed
    rows = check_model(folder, precision="int8").rows
    assert "error above" in rows[0].reason


def test_tolerances_of_a_precision() -> None:
    assert tolerance("tiles", "int8") > tolerance("tiles")
    assert tolerance("constant", "int8") == tolerance("constant")


def test_a_network_that_sees_the_scale_is_found(run: Any) -> None:
    code, out, _ = run("--model", "samples-5")  # its logits depend on the exposure itself
    assert code == 1 and "samples-5, fp32: 1 of" in out
    (line,) = (line for line in out.splitlines() if "scale equivariance" in line)
    assert "error above" in line


def test_a_network_that_fails_is_found(run: Any) -> None:
    code, out, _ = run("--model", "broken-3", "--json")
    record = json.loads(out)
    assert code == 1 and not record["passed"] and not record["models"][0]["passed"]
    plain = next(row for row in record["models"][0]["rows"] if row["name"] == "plain")
    assert "no finite kernel" in plain["reason"]


@pytest.mark.parametrize(("arguments", "code"), [(["--model", "nobody"], 4), (["--provider", "abacus"], 4), (["x"], 2)])
def test_wrong_use_is_one_line(run: Any, arguments: list[str], code: int) -> None:
    found, out, error = run(*arguments)
    assert found == code and not out and error.count("\n") == 1


def test_spoilt_references_are_named(tiny: Path, tmp_path: Path) -> None:
    folder = shutil.copytree(tiny / "single-3", tmp_path / "model")
    for text in (b"", b"no archive", b"PK\x03\x04"):
        (folder / references.FILE).write_bytes(text)
        report = check_model(folder)
        assert not report.passed and "export the model again" in report.rows[0].reason
    np.savez(folder / references.FILE, about=np.frombuffer(b'{"format": 1, "graphs": {}}', np.uint8))
    assert "frames" in check_model(folder).rows[0].reason


MAGNITUDES = st.integers(-149, 127).map(lambda exponent: math.ldexp(1, exponent))
EXTREMES = st.one_of(MAGNITUDES, st.sampled_from([0.0, -1.0, math.nan, math.inf, -math.inf, 3.4e38]))


@dataclass(frozen=True)
class Recipe:
    """A frame of any size with extreme values in places; one line where a test fails."""

    height: int
    width: int
    samples: int
    seed: int
    split: bool
    changes: dict[str, tuple[float, float, int]]  # by buffer: share of values, the value there, seed

    def frame(self) -> Buffers:
        buffers = cases.frame(self.height, self.width, self.samples, self.seed)
        for name, (share, value, seed) in self.changes.items():
            buffers[name][Draw(seed).uniform(*buffers[name].shape) < share] = value
        return buffers if self.split else cases.unsplit(buffers)


SIDE, SEED = st.integers(1, 20), st.integers(0, 99)
CHANGE = st.tuples(st.sampled_from([0.01, 0.3, 1.0]), EXTREMES, SEED)
CHANGES = st.dictionaries(st.sampled_from(sorted(cases.frame(1, 1))), CHANGE)
RECIPES = st.builds(Recipe, SIDE, SIDE, st.integers(1, 4), SEED, st.booleans(), CHANGES)


@RANDOM
@given(recipe=RECIPES, model=st.sampled_from(["single-3", "split-5", "samples-5"]))
def test_any_frame_is_finite_and_within_its_window(tiny: Path, recipe: Recipe, model: str) -> None:
    denoiser, row, frame = Denoiser(model, threads=1), Row("", ""), recipe.frame()
    result = denoiser.run_buffers(frame)
    row.inspect(result, prepare(frame, denoiser.model.manifest), denoiser.model.manifest)
    assert not row.judged().reason


@RANDOM
@given(recipe=RECIPES, model=st.sampled_from(["split-5", "samples-5"]))
def test_any_frame_is_the_same_in_tiles_and_in_any_order_of_samples(tiny: Path, recipe: Recipe, model: str) -> None:
    frame = recipe.frame()
    whole = Denoiser(model, threads=1).run_buffers(frame).color
    assert relative_error(Denoiser(model, threads=1, tile=8).run_buffers(frame).color, whole)[0] <= tolerance("tiles")
    turned = {name: values[::-1] if name.startswith("samples.") else values for name, values in frame.items()}
    image = Denoiser(model, threads=1).run_buffers(turned).color
    assert relative_error(image, whole)[0] <= tolerance("sample_order")


@RANDOM
@given(exponent=st.floats(-30, 25), seed=SEED)
def test_any_scale_of_the_light_scales_the_picture(tiny: Path, exponent: float, seed: int) -> None:
    denoiser, color, scale = Denoiser("single-3", threads=1), cases.frame(seed=seed)["color"], 10**exponent
    before, after = (denoiser.run(given).color for given in (color, color * np.float32(scale)))
    assert relative_error(after, before * np.float64(np.float32(scale)))[0] <= tolerance("scale")


@RANDOM
@given(recipe=RECIPES, y=st.integers(0, 19), x=st.integers(0, 19))
def test_a_bad_pixel_stays_where_it_is(tiny: Path, recipe: Recipe, y: int, x: int) -> None:
    frame, y, x = recipe.frame(), y % recipe.height, x % recipe.width
    frame["depth"][y, x] = 0
    if "diffuse.albedo" in frame:  # where it does not explain the light, a pixel changes what it is further away
        light = np.clip(np.nan_to_num(frame["diffuse.albedo"]), 0, 1)
        frame = cases.with_color(frame | {"diffuse": light})
    denoiser = Denoiser("samples-5", threads=1)
    before = denoiser.run_buffers(frame, exposure=0.5)
    for values in frame.values():
        values[..., y, x, :] = math.nan
    after = denoiser.run_buffers(frame, exposure=0.5)
    assert np.isfinite(after.color).all()
    if before.report["inputs"]["used"] != after.report["inputs"]["used"]:
        return  # a guide was the same everywhere, and was not used, but for that pixel
    reach = denoiser.model.manifest["tile"]["overlap"]
    rows, columns = np.ogrid[: recipe.height, : recipe.width]
    far = ((abs(rows - y) > reach) | (abs(columns - x) > reach))[..., None]
    # a branch that is left out as constant is not when a pixel is bad: then it is its constant again, as filtered
    allowed = 0 if before.report["branches"] == after.report["branches"] else tolerance("constant")
    assert relative_error(np.where(far, after.color, 0), np.where(far, before.color, 0))[0] <= allowed


@RANDOM
@given(recipe=RECIPES)
def test_exposure_equals_float64(recipe: Recipe) -> None:
    color = recipe.frame()["color"]
    valid = np.isfinite(color).all(-1)
    clean = np.where(valid[..., None], np.maximum(color.astype(np.float64), 0), 0)
    right = auto_exposure(clean, valid, 0.18)
    assert _core.auto_exposure(color) == pytest.approx(right, rel=tolerance("statistics"))


@RANDOM
@given(
    size=st.sampled_from([1, 3, 7]),
    shape=st.tuples(st.integers(1, 12), st.integers(1, 70)),
    spread=st.sampled_from([0.1, 10.0, 1e4]),
    masked=st.sampled_from([0.0, 0.2, 1.0]),
    seed=st.integers(0, 99),
)
def test_gather_equals_float64(size: int, shape: tuple[int, int], spread: float, masked: float, seed: int) -> None:
    draw = Draw(seed)
    image = draw.magnitudes(-40, 90, *shape, 3).astype(np.float32)
    image[draw.uniform(*shape) < masked] = math.nan
    logits = draw.between(-spread, spread, size * size, *shape).astype(np.float32)
    largest = float(np.nan_to_num(image).max())
    assert relative_error(_core.gather(image, logits), gather(image, logits, size), largest)[0] <= tolerance("gather")
