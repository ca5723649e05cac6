"""Hostile values are taken by their meaning and told, in Python and at the command line."""

from pathlib import Path
from typing import Any

import numpy as np
import pytest
from exr_files import RGB, part, write
from pathfold.check import cases
from pathfold.check.guides import filled, is_encoded, says_nothing
from pathfold.denoiser import Denoiser, Result
from pathfold.images import ImageFile

NOT_FINITE = (np.nan, np.inf, -np.inf)
HEIGHT, WIDTH = 40, 44
Buffers = dict[str, np.ndarray]


def frame(split: bool = True) -> Buffers:
    buffers = {n: v for n, v in cases.frame(HEIGHT, WIDTH).items() if not n.startswith("samples.")}
    return buffers if split else cases.unsplit(buffers)


def run(buffers: Buffers, **settings: Any) -> Result:
    return Denoiser("split-5", threads=1, **settings).run_buffers(buffers, exposure=0.5)


def same_run(buffers: Buffers, other: Buffers) -> Result:
    """The first's result, which must be that of the other to the bit, whole and in tiles."""
    for tile in (0, 16):
        result, right = run(buffers, tile=tile), run(other, tile=tile)
        for name, image in right.images().items():
            assert result.images()[name].tobytes() == image.tobytes(), (name, tile)
    return result


def spoilt(buffers: Buffers, name: str, value: float, share: float = 0.1) -> Buffers:
    values = buffers[name].copy()
    values[np.random.default_rng(3).random(values.shape[:2]) < share] = value
    return buffers | {name: values}


def notes_of(result: Result) -> list[str]:
    """But for that on the light of these frames, which is random."""
    return [note for note in result.report["notes"] if "does not explain the light" not in note]


@pytest.mark.parametrize("name", ["albedo", "diffuse.albedo"])
@pytest.mark.parametrize("kind", [np.float32, np.float16])
def test_a_demodulator_above_1_is_1(tiny: Path, name: str, kind: type) -> None:
    buffers = frame() | {name: (3 * frame()[name]).astype(kind)}
    result = same_run(buffers, buffers | {name: np.clip(buffers[name], 0, 1)})
    assert result.report["sanitised"] == {name: {"above 1 (clamped)": int((buffers[name] > 1.001).any(-1).sum())}}


@pytest.mark.parametrize("value", NOT_FINITE)
@pytest.mark.parametrize("name", ["albedo", "diffuse.albedo"])
def test_an_unknown_demodulator_is_of_its_neighbours(tiny: Path, name: str, value: float) -> None:
    buffers = spoilt(frame(), name, value)
    unknown = ~np.isfinite(buffers[name])
    mended = filled(np.where(unknown, np.nan, buffers[name]).astype(np.float64), "mean").astype(np.float32)
    result = same_run(buffers, buffers | {name: mended})
    faults = {"not finite (rebuilt from neighbours)": int(unknown.any(-1).sum())}
    assert result.report["sanitised"] == {name: faults}


@pytest.mark.parametrize("value", [*NOT_FINITE, 3e38])
@pytest.mark.parametrize("name", ["variance", "diffuse.variance", "specular.variance"])
def test_an_unknown_variance_is_the_largest_around(tiny: Path, name: str, value: float) -> None:
    buffers = spoilt(frame(name != "variance"), name, value)
    unknown = ~np.isfinite(buffers[name]) | (buffers[name] > 1e36)
    mended = filled(np.where(unknown, np.nan, buffers[name]).astype(np.float64), "most").astype(np.float32)
    result = same_run(buffers, buffers | {name: mended})
    assert result.report["sanitised"] == {name: {"not finite (unknown)": int(unknown.any(-1).sum())}}


def test_a_half_that_overflowed_is_no_converged_tile(tiny: Path) -> None:
    buffers = {"color": frame()["color"], "variance": np.full((HEIGHT, WIDTH, 3), 1e-9, np.float32)}
    buffers["variance"][::2, ::2] = 2e-9
    denoiser = Denoiser("split-5", leave_out="converged")
    assert (denoiser.run_buffers(buffers, samples_per_pixel=64).color == buffers["color"]).all()
    with np.errstate(over="ignore"):
        buffers["variance"] = np.where(buffers["variance"] > 1.5e-9, 1e6, buffers["variance"]).astype(np.float16)
    assert (denoiser.run_buffers(buffers, samples_per_pixel=64).color != buffers["color"]).any()


@pytest.mark.parametrize("value", [*NOT_FINITE, 1e10, 3.4e38, -1.0])
def test_a_depth_without_end_is_a_miss(tiny: Path, value: float) -> None:
    buffers = spoilt(frame(), "depth", value)
    missed = (buffers["depth"] == np.float32(value)) | np.isnan(buffers["depth"])
    result = same_run(buffers, buffers | {"depth": np.where(missed, np.float32(0), buffers["depth"])})
    assert sum(result.report["sanitised"]["depth"].values()) == missed.sum()


@pytest.mark.parametrize("value", [0.0, 1.0, np.nan])
@pytest.mark.parametrize("name", ["albedo", "normal", "depth", "diffuse.variance", "diffuse.albedo"])
def test_a_constant_guide_is_none(tiny: Path, name: str, value: float) -> None:
    buffers = frame() | {name: np.full_like(frame()[name], value)}
    for tile in (0, 16):
        result, right = run(buffers, tile=tile), run(cases.without(buffers, name), tile=tile)
        assert result.color.tobytes() == right.color.tobytes()
    shown = 0.0 if np.isnan(value) and name in ("normal", "depth") else value
    reason = "not finite in any pixel" if np.isnan(shown) else f"{shown:g} in every pixel"
    assert notes_of(result) == [f"{name} is {reason}: not used"]
    assert name in result.report["inputs"]["unused"] and name not in result.report["inputs"]["missing"]


@pytest.mark.parametrize("share", [0.0, 0.5, 1.5, 10.0])
def test_parts_that_are_not_color_add_no_light(tiny: Path, share: float) -> None:
    buffers, told = frame(), {"diffuse + specular": {"not color (made to add up)": HEIGHT * WIDTH}}
    wrong = buffers | {name: buffers[name] * np.float32(share) for name in ("diffuse", "specular")}
    diffuse = np.minimum(wrong["diffuse"], buffers["color"])
    result = same_run(wrong, buffers | {"diffuse": diffuse, "specular": buffers["color"] - diffuse})
    assert result.report["sanitised"] == told and "give parts that add up" in notes_of(result)[0]
    np.testing.assert_allclose(result.diffuse + result.specular, result.color, rtol=1e-5)
    assert not run(buffers).report["sanitised"] and not notes_of(run(buffers))


def test_colours_outside_of_the_gamut_come_back(tiny: Path) -> None:
    to_709 = np.array([[1.7051, -0.6218, -0.0833], [-0.1303, 1.1408, -0.0105], [-0.0240, -0.1290, 1.1530]])
    base = np.array([0.05, 0.15, 0.8]) @ to_709.T
    color = (base * np.random.default_rng(1).gamma(4, 0.25, (HEIGHT, WIDTH, 1))).astype(np.float32)
    assert color.min() < 0
    for buffers in ({"color": color}, {"diffuse": color / 2, "specular": color / 2}):
        result = run(buffers | {"albedo": frame()["albedo"]})
        np.testing.assert_allclose(result.color.mean((0, 1)), color.mean((0, 1)), rtol=0.02)
        assert not result.report["sanitised"]
    layer = Denoiser("split-5").run(color, layers={"key": {"color": color}}).layers["key"]
    np.testing.assert_allclose(layer.mean((0, 1)), color.mean((0, 1)), rtol=0.02)


def test_encoded_normals_are_decoded(tiny: Path) -> None:
    normal = frame()["normal"] / np.linalg.norm(frame()["normal"], axis=-1, keepdims=True)
    normal[:9] = 0
    for background in (0.0, 0.5):
        encoded = np.where(np.arange(HEIGHT)[:, None, None] < 9, background, 0.5 * normal + 0.5).astype(np.float32)
        result = run(frame() | {"normal": encoded})
        assert notes_of(result) == ["normal is stored as 0.5 n + 0.5: decoded"]
        np.testing.assert_allclose(result.color, run(frame() | {"normal": normal}).color, rtol=1e-3)
    assert is_encoded(encoded.astype(np.float64)) and not is_encoded(normal.astype(np.float64))
    assert says_nothing(encoded[:9].astype(np.float64), "normal")


def test_the_command_line_tells(run: Any, tmp_path: Path) -> None:
    names = [*RGB, *(f"albedo.{c}" for c in RGB), *(f"variance.{c}" for c in RGB), *(f"normal.{c}" for c in "XYZ")]
    values = np.random.default_rng(0).random((9, 12, 12)).astype(np.float32)
    values[2, 3, 4], values[3, 4, 7], values[..., 9:] = 60.0, 1e6, 0.0  # the variance overflows a half
    header = {"pathfold:version": "0.1.0", "pathfold:spp": 4}
    source = write(tmp_path / "in.exr", [part("", names, ["half"] * 12, values, **header)])
    code, out, _ = run("denoise", source, "-o", tmp_path / "out.exr", "-m", "split-5")
    assert code == 0 and "mended: albedo 1 above 1 (clamped); variance 1 not finite (unknown)" in out
    assert "note: normal is 0 in every pixel: not used" in out
    assert np.isfinite(ImageFile(tmp_path / "out.exr").read(0, range(3))).all()
