"""Values that are not finite never reach weights: as data, as a loss, in a checkpoint and in what is made of one."""

import logging
from pathlib import Path

import numpy as np
import pytest
import torch
from pathfold_training.dataset import store
from pathfold_training.dataset.values import known
from pathfold_training.fit import finite
from pathfold_training.fit.checkpoint import load_checkpoint
from pathfold_training.fit.task import Denoising
from pathfold_training.fit.train import fit
from pathfold_training.fit.views import Stored
from pathfold_training.release.average import average
from pathfold_training.release.export import export
from training_data import TINY, view_tensors, write_data_set

BAD = [np.nan, np.inf, -np.inf, 3e38, -3e38]


@pytest.fixture(scope="module")
def run(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("finite")
    data = write_data_set(folder / "set")
    return fit(TINY.with_steps(1), data, folder / "run", validate_every=1000, threads=1).parent


def poison(folder: Path, value: float) -> Path:
    """Every tensor of every view holds the value somewhere; the index knows of it, as if it had been rendered so."""
    for line in store.read_index(folder):
        tensors = view_tensors(int(line["id"][-1]))
        for tensor in tensors.values():
            tensor[..., 3:9, 5] = np.asarray(value).astype(tensor.dtype)
        store.append_line(folder, store.write(folder, line, tensors))
    for line in store.read_index(folder):
        for number in range(len(line["crops"])):
            path = store.cleaned_path(folder, line, number)
            path.parent.mkdir(exist_ok=True)
            np.save(path, np.where(np.arange(40) == 5, np.float32(value), view_tensors(0)["reference.color"]))
    return folder


@pytest.mark.filterwarnings("ignore:overflow encountered in cast")
@pytest.mark.parametrize("cleaned", [False, True])
@pytest.mark.parametrize("value", BAD)
def test_no_value_of_a_data_set_reaches_the_weights(tmp_path: Path, value: float, cleaned: bool) -> None:
    data = poison(write_data_set(tmp_path / "set"), value)
    preset = TINY.model_copy(update={"data": TINY.data.model_copy(update={"cleaned": cleaned})})
    checkpoint = fit(preset.with_steps(2), data, tmp_path / "run", validate_every=2, threads=1)
    state = torch.load(checkpoint, map_location="cpu", weights_only=True)
    assert finite.not_finite(state["state_dict"]) is None
    assert state["callbacks"]["FiniteSteps"]["skipped"] == 0  # nothing came so far
    for window in Stored(data).held_out():
        assert all(np.isfinite(half).all() and abs(half).max() < 10 for half in window.halves())
        assert torch.isfinite(window.cleaned).all()
        assert np.isfinite(window.cumulative).all()


@pytest.mark.parametrize("kind", [np.float16, np.float32, np.float64])
def test_what_is_known_stays_to_the_bit(kind: type) -> None:
    values = np.array([0.0, -0.0, 1e-7, -3.5, 60000.0], kind)
    assert known(values).tobytes() == values.tobytes()
    assert known(values).dtype == kind
    assert np.array_equal(known(np.array([np.nan, np.inf, -np.inf, 1.0], kind)), [0, 0, 0, 1])


@pytest.mark.parametrize("bad", [torch.nan, torch.inf, -torch.inf])
def test_a_step_that_is_not_finite_is_skipped_and_told(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, caplog: pytest.LogCaptureFixture, bad: float
) -> None:
    data = write_data_set(tmp_path / "set")
    original = Denoising.draw

    def spoil(self: Denoising) -> object:
        spoiled.append(self.global_step == 1)
        return original(self)

    spoiled: list[bool] = []
    monkeypatch.setattr(Denoising, "draw", spoil)
    monkeypatch.setattr(
        "pathfold_training.fit.task.or_nan", lambda loss: finite.or_nan(loss + bad if spoiled[-1] else loss)
    )
    with caplog.at_level(logging.WARNING, logger="pathfold.fit"):
        checkpoint = fit(TINY.with_steps(3), data, tmp_path / "run", validate_every=1000, threads=1)
    _, state = load_checkpoint(checkpoint)
    assert state["global_step"] == 3
    assert state["callbacks"]["FiniteSteps"]["skipped"] == 1
    assert "step 1: loss or gradient is not finite" in caplog.text
    assert "step 2:" not in caplog.text


def test_a_run_stops_where_no_step_is_finite(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    data = write_data_set(tmp_path / "set")
    monkeypatch.setattr("pathfold_training.fit.task.or_nan", lambda loss: finite.or_nan(loss * torch.inf))
    with pytest.raises(RuntimeError, match="in 21 steps in a row; lower the learning_rate"):
        fit(TINY.with_steps(30), data, tmp_path / "run", validate_every=1000, threads=1)


def test_weights_that_overflow_are_not_saved(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    data = write_data_set(tmp_path / "set")
    original = Denoising.draw

    def overflow(self: Denoising) -> object:
        if self.global_step == 1:
            next(self.parameters()).data.mul_(torch.inf)
        return original(self)

    monkeypatch.setattr(Denoising, "draw", overflow)
    with pytest.raises(RuntimeError, match="is not finite; lower the learning_rate"):
        fit(TINY.with_steps(2), data, tmp_path / "run", validate_every=1000, threads=1)
    assert not (tmp_path / "run" / "last.ckpt").exists()


@pytest.mark.parametrize("bad", [torch.nan, torch.inf, -torch.inf])
def test_weights_that_are_not_finite_go_nowhere(run: Path, tmp_path: Path, bad: float) -> None:
    state = torch.load(run / "last.ckpt", map_location="cpu", weights_only=True)
    next(iter(state["state_dict"].values())).view(-1)[0] = bad
    spoiled = tmp_path / "spoiled"
    spoiled.mkdir()
    (spoiled / "record.json").write_bytes((run / "record.json").read_bytes())
    torch.save(state, spoiled / "last.ckpt")
    for attempt in (
        lambda: export(spoiled / "last.ckpt", tmp_path / "model", {}),
        lambda: average([run, spoiled], tmp_path / "mean"),
        lambda: fit(TINY, run.parent / "set", tmp_path / "next", threads=1, start_from=spoiled / "last.ckpt"),
    ):
        with pytest.raises(ValueError, match="is not finite; train again"):
            attempt()
    assert not (tmp_path / "model").exists()
    assert not (tmp_path / "mean").exists()


@pytest.mark.parametrize("cut", [b"", b'{"format": 2, "id"', b"\xff\xfe", b"5"])
def test_a_line_of_the_index_that_is_left_out_is_told(
    tmp_path: Path, caplog: pytest.LogCaptureFixture, cut: bytes
) -> None:
    data = write_data_set(tmp_path / "set")
    index = data / "index.jsonl"
    rows = index.read_bytes().splitlines()
    index.write_bytes(b"\n".join([rows[0], cut or rows[1][:-40], rows[2]]) + b"\n")
    with caplog.at_level(logging.WARNING, logger="pathfold.store"):
        assert [line["id"] for line in store.Store(data).lines] == ["view-0", "view-2"]
    assert f"{index}: line 2 is cut short or altered" in caplog.text


@pytest.mark.parametrize("scale", ["NaN", "Infinity", "-1.0", "0", '"0.5"'])
def test_a_view_of_no_scale_is_left_out(tmp_path: Path, scale: str) -> None:
    data = write_data_set(tmp_path / "set")
    index = data / "index.jsonl"
    index.write_text(index.read_text().replace('"exposure": 0.5', f'"exposure": {scale}', 1))
    assert [line["id"] for line in store.Store(data).lines] == ["view-1", "view-2"]
