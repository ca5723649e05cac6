"""References that are learned from without their noise."""

from pathlib import Path

import numpy as np
from pathfold_training.dataset.clean import cleaned
from pathfold_training.fit.crops import Crops
from pathfold_training.fit.preset import Data
from pathfold_training.fit.views import Stored
from training_data import write_data_set

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
    stored = Stored(write_data_set(tmp_path / "data"))
    batch = next(iter(Crops(stored, Data(crop=24, batch=2, spp_max=8, cleaned=True), 3, 0)))
    np.testing.assert_allclose(batch.truth["cleaned"], batch.truth["color"], rtol=1e-5)  # halves without noise
    assert "cleaned" not in next(iter(Crops(stored, Data(crop=24, batch=2, spp_max=8), 3, 0))).truth
