"""A run inside a budget: what is chosen, what is given up, and that a stated memory is kept."""

import json
import re
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest
from exr_files import noise, part, write
from pathfold import Budget, Denoiser, PathfoldError, budget, denoise, memory
from pathfold.bench.results import geometric
from pathfold.cli import app, console

PLENTY = 1e5


def frame(height: int = 40, width: int = 56, seed: int = 0) -> dict[str, np.ndarray]:
    rng = np.random.default_rng(seed)
    return {"color": rng.exponential(1, (height, width, 3)).astype(np.float32)}


@pytest.mark.usefixtures("tiny")
def test_plenty_gives_what_no_budget_gives() -> None:
    choice = Budget(PLENTY, PLENTY, "split-5").choose(frame())
    result = choice.run()
    np.testing.assert_allclose(result.color, Denoiser("split-5").run(**frame()).color, rtol=1e-5, atol=1e-6)
    assert choice.lines[0].startswith("split-5, tiles of 56x40: about ")
    assert len(choice.lines) == 1  # nothing was given up


@pytest.mark.usefixtures("tiny")
def test_denoise_takes_a_budget_and_all_that_it_takes_without() -> None:
    given = frame() | {
        "depth": np.ones((40, 56), np.float32),
        "diffuse_albedo": frame(seed=1)["color"],
        "exposure": 2.0,
    }
    plain = denoise(model="split-5", **given)
    np.testing.assert_allclose(denoise(model="split-5", seconds=PLENTY, **given), plain, rtol=1e-5, atol=1e-6)
    parts = {"diffuse": given["color"], "specular": frame(seed=2)["color"], "diffuse_albedo": given["diffuse_albedo"]}
    whole = denoise(model="split-5", **parts)
    np.testing.assert_allclose(denoise(model="split-5", seconds=PLENTY, **parts), whole, rtol=1e-5, atol=1e-6)
    with pytest.raises(PathfoldError, match="model is a Denoiser"):
        denoise(model=Denoiser("split-5"), memory_mb=PLENTY, **given)
    with pytest.raises(TypeError, match="colour"):
        denoise(colour=given["color"], model="split-5", seconds=PLENTY)


@pytest.mark.usefixtures("tiny")
def test_little_memory_gives_small_tiles_and_the_same_picture() -> None:
    pixels = frame(200, 200)
    whole = Budget(None, PLENTY, "single-21").choose(pixels)
    tight = Budget(None, memory.in_use() + 25, "single-21").choose(pixels)
    assert whole.memory_mb > tight.memory_mb
    result = tight.run()
    assert result.report["tiles"] > whole.run().report["tiles"] == 1
    np.testing.assert_allclose(result.color, whole.run().color, rtol=1e-5, atol=1e-6)


@pytest.mark.usefixtures("tiny")
def test_models_are_tried_in_order_among_those_that_can_read_the_frame(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(budget, "PREFERRED", ("no-such", "samples-5", "split-5", "single-3"))
    chooser = Budget(PLENTY)
    assert chooser.choose(frame()).denoiser.model.name == "split-5"  # there are no samples
    height, width = frame()["color"].shape[:2]
    samples = {"samples.descriptor": np.zeros((2, height, width, 36), np.float16)}
    samples["samples.density"] = np.zeros((2, height, width, 1), np.float32)
    assert chooser.choose(frame() | samples).denoiser.model.name == "samples-5"


def test_the_model_with_the_least_error_in_the_results_is_tried_first() -> None:
    kept = Path(__file__).parent.parent / "docs" / "results" / "validation-8spp" / "results.jsonl"
    errors: dict[str, list[float]] = {}
    for line in kept.read_text().splitlines():
        row = json.loads(line)
        errors.setdefault(row["method"], []).append(row["rell2"])
    known = sorted(set(budget.PREFERRED) & errors.keys(), key=lambda name: geometric(errors[name]))
    assert known == list(budget.PREFERRED)


@pytest.mark.usefixtures("tiny")
def test_only_models_of_the_precision_that_is_asked_for_are_tried(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(budget, "PREFERRED", ("single-3", "quantised-3"))
    assert Budget(PLENTY, precision="fp32").models == ["single-3", "quantised-3"]
    chosen = Budget(PLENTY, precision="int8").choose(frame()).denoiser.model
    assert (chosen.name, chosen.precision) == ("quantised-3", "int8")


def test_paths_are_given_up_before_the_model() -> None:
    pixels = frame() | {"samples.descriptor": np.zeros((2, 40, 56, 36), np.float16)}
    ways = [str(one) for one in Budget(PLENTY, model="pathfold-balanced")._ways(pixels)]
    assert ways == ["pathfold-balanced with paths", "pathfold-balanced without paths"]


@pytest.mark.usefixtures("tiny")
def test_a_choice_stays_for_frames_of_one_kind() -> None:
    chooser = Budget(PLENTY, model="single-3")
    first, second, other = (chooser.choose(frame(*size, seed=1)) for size in ((40, 56), (40, 56), (24, 56)))
    assert first.denoiser is second.denoiser is not other.denoiser


@pytest.mark.usefixtures("tiny")
@pytest.mark.parametrize(
    ("bounds", "words"),
    [
        (
            {"seconds": 1e-6},
            r"nothing stays inside 1e-06 s\. Nearest is single-3: would take .* s, .* s are spent; give [\d.]+ s or",
        ),
        ({"memory_mb": 10}, r"nothing stays inside 10 MB\. Nearest is single-3: needs (\d+) MB; give \1 MB or more"),
        ({"memory_mb": True}, "memory_mb is True; it must be > 0"),
        ({"seconds": 0}, "seconds is 0; it must be > 0"),
        ({"memory_mb": float("nan")}, "memory_mb is nan; it must be > 0"),
    ],
)
def test_what_cannot_be_kept_is_refused_with_what_would_do(bounds: dict[str, float], words: str) -> None:
    with pytest.raises(PathfoldError, match=words):
        Budget(model="single-3", **bounds).choose(frame())


@pytest.mark.usefixtures("tiny")
def test_buffers_may_be_whatever_is_an_array() -> None:
    given = frame()
    choice = Budget(PLENTY, model="single-3").choose({"color": given["color"].astype(np.float64)})
    np.testing.assert_array_equal(choice.run().color, Denoiser("single-3").run(**given).color)
    with pytest.raises(PathfoldError, match="color: given int64 values; pass linear float32"):
        Budget(PLENTY, model="single-3").choose({"color": [[[1, 2, 3]]]})


@pytest.mark.usefixtures("tiny")
def test_buffers_that_no_model_can_do_with_are_named() -> None:
    with pytest.raises(PathfoldError, match="samples-5 require buffers that are not there; there are color"):
        Budget(PLENTY, model="samples-5").choose(frame())


@pytest.mark.parametrize(("edge", "memory_mb"), [(700, 230), (200, 400)])
def test_a_stated_memory_is_kept(tiny: Path, tmp_path: Path, edge: int, memory_mb: int) -> None:
    """In many tiles, of a picture that takes 1 GB in one; and in one tile, which takes most of what the trial told."""
    names = ["R", "G", "B"]
    write(tmp_path / "in.exr", [part("", names, ["float"] * 3, noise(3, size=(edge, edge)))])
    script = f"""
import json, sys
from pathfold import memory
from pathfold.cli import app, console
base = memory.forget_peak()
sys.argv = "pathfold denoise {tmp_path}/in.exr -o {tmp_path}/out.exr -m single-21 --memory {memory_mb}".split()
code = console.run(app)
print(json.dumps([code, base, memory.peak()]))
"""
    done = subprocess.run([sys.executable, "-c", script], capture_output=True, text=True, check=True)
    code, base, peak = json.loads(done.stdout.splitlines()[-1])
    assert (code, done.stderr) == (0, "")
    feared = int(re.search(r"less than (\d+) MB", done.stdout).group(1))  # type: ignore[union-attr]
    assert base < peak < feared <= memory_mb
    assert (f"tiles of {edge}x{edge}:" in done.stdout) == (edge == 200)


def test_the_command_says_what_it_chose(
    tiny: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    write(tmp_path / "in.exr", [part("", ["R", "G", "B"], ["float"] * 3, noise(3))])

    def run(*more: str) -> int:
        arguments = ["pathfold", "denoise", str(tmp_path / "in.exr"), "-o", str(tmp_path / "out.exr"), *more]
        monkeypatch.setattr(sys, "argv", arguments)
        return console.run(app)

    assert run("-m", "single-3", "--seconds", "100") == 0
    assert "single-3, tiles of " in capsys.readouterr().out
    assert run("-m", "single-3", "--seconds", "1e-9") == console.MODEL
    assert "nothing stays inside 1e-09 s" in capsys.readouterr().err
    assert run("-m", "single-3", "--memory", "0") == console.USAGE
    assert "memory_mb is 0" in capsys.readouterr().err
