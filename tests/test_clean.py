"""References that are learned from without their noise."""

import json
from pathlib import Path

import numpy as np
import pytest
from pathfold_training.cli import app
from pathfold_training.dataset import clean, store
from pathfold_training.dataset.clean import cleaned
from pathfold_training.fit.crops import Crops
from pathfold_training.fit.preset import Data, load_preset
from pathfold_training.fit.train import fit
from pathfold_training.fit.views import Stored
from training_data import view_tensors, write_data_set
from typer.testing import CliRunner

SIDE = 64


def guides() -> tuple[np.ndarray, np.ndarray]:
    albedo = np.full((3, SIDE, SIDE), 0.5, np.float32)
    return albedo, np.broadcast_to(np.float32([0, 0, 1])[:, None, None], albedo.shape)


def test_noise_is_taken_out() -> None:
    rng = np.random.default_rng(1)
    truth = np.broadcast_to(np.linspace(0.2, 2.0, SIDE, dtype=np.float32), (3, SIDE, SIDE))
    a, b = (truth * rng.gamma(16, 1 / 16, truth.shape).astype(np.float32) for _ in "ab")
    error, raw = (np.square(x - truth).mean() for x in (cleaned(a, b, *guides(), 1.0), (a + b) / 2))
    assert error < 0.1 * raw


def test_detail_that_both_halves_show_stays() -> None:
    rng = np.random.default_rng(2)
    detail = rng.gamma(1, 1, (3, SIDE, SIDE)).astype(np.float32)  # no denoiser can tell it from noise, the halves can
    np.testing.assert_allclose(cleaned(detail, detail, *guides(), 1.0), detail, rtol=1e-5, atol=1e-6)


def test_crops_carry_the_cleaned_reference_where_the_preset_asks(tmp_path: Path) -> None:
    folder = write_data_set(tmp_path / "data")
    clean.clean(folder)
    stored = Stored(folder)
    batch = next(iter(Crops(stored, Data(crop=24, batch=2, spp_max=8, cleaned=True), 3, 0)))
    np.testing.assert_allclose(batch.truth["cleaned"], batch.truth["color"], rtol=1e-5)  # halves without noise
    assert "cleaned" not in next(iter(Crops(stored, Data(crop=24, batch=2, spp_max=8), 3, 0))).truth


def test_cleaned_references_are_kept_until_the_view_changes(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    folder = write_data_set(tmp_path / "data", 3)
    calls = []
    monkeypatch.setattr(clean, "cleaned", lambda a, *_: calls.append(1) or np.full_like(a, len(calls)))
    assert clean.clean(folder) == 2 and clean.clean(folder) == 0  # those to train on
    assert [float(window.cleaned.mean()) for window in Stored(folder).train] == [1.0, 2.0]
    line = json.loads((folder / "index.jsonl").read_text().splitlines()[0])
    store.append_line(folder, store.write(folder, line, {n: v + 1.0 for n, v in view_tensors(0).items()}))
    result = CliRunner().invoke(app, ["dataset", "clean", str(folder)])
    assert result.exit_code == 0 and "1 references cleaned" in " ".join(result.output.split())
    assert float(Stored(folder).train[0].cleaned.mean()) == 3.0
    store.recover(folder)
    kept = sorted((folder / "cleaned").iterdir())
    assert [float(np.load(path).mean()) for path in kept] == [3.0, 2.0]
    kept[0].write_bytes(b"")
    assert clean.clean(folder) == 1 and len(calls) == 4


def test_a_data_set_without_cleaned_references_is_named_before_anything_is_written(tmp_path: Path) -> None:
    folder = write_data_set(tmp_path / "data")
    with pytest.raises(FileNotFoundError, match=r"lacks the cleaned reference of view-0.*dataset clean .*data` makes"):
        fit(load_preset("pathfold-fast"), folder, tmp_path / "run")
    assert not (tmp_path / "run").exists() and not (folder / "cleaned").exists()
