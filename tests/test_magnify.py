"""Magnified crops: their mean is the interpolated picture, and no sample is used twice while there are enough."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
import torch
from pathfold_training.dataset.clean import clean
from pathfold_training.fit.crops import Crops
from pathfold_training.fit.frames import PATH_NAMES
from pathfold_training.fit.magnify import Magnifier, stored_side, turns
from pathfold_training.fit.preset import Data
from pathfold_training.fit.views import Stored, Window
from training_data import SIDE, view_tensors, write_data_set


def larger(factor: float, count: int, samples: int, paths: int = 2, size: int = 24, seed: int = 0) -> Magnifier:
    rng = np.random.default_rng(seed)
    return Magnifier(size, stored_side(size, factor), factor, count, paths, samples, min(samples, 16), rng)


@pytest.mark.parametrize("factor", [1.0, 1.7, 4.0])
def test_mean_of_samples_is_the_interpolated_image(factor: float) -> None:
    magnifier = larger(factor, 4000, 100000, paths=0)
    side = magnifier.side
    image = torch.rand(3, side, side, generator=torch.Generator().manual_seed(1))
    magnifier.slots[:] = 0  # each stored pixel has one sample, its value
    mean = magnifier.samples(image[None], 4000).mean(0)
    expected = magnifier.image(image)
    assert float((mean - expected).abs().max()) < 5 * 0.5 / 4000**0.5
    assert float((mean - expected).mean().abs()) < 1e-3
    rows = torch.arange(side, dtype=torch.float32)[:, None].expand(side, side)
    climb = magnifier.image(rows[None])[0].diff(dim=0)
    torch.testing.assert_close(climb, torch.full_like(climb, 1 / factor), rtol=1e-3, atol=1e-4)


def test_no_sample_is_used_twice_while_there_are_enough() -> None:
    magnifier = larger(2.0, 6, 64, paths=1)
    used = magnifier.slots * magnifier.side**2 + magnifier.pixels
    assert magnifier.slots.max() < 64
    assert len(np.unique(used)) == used.size
    scarce = larger(4.0, 4, 8, paths=2)
    assert scarce.slots.max() == 7
    assert larger(4.0, 4, 64, paths=2).slots[:2].max() < 16


def test_samples_are_those_of_their_pixel_and_turn() -> None:
    magnifier = larger(3.0, 3, 64)
    side = magnifier.side
    stored = torch.arange(64 * 2 * side * side, dtype=torch.float32).reshape(64, 2, side, side)
    taken = magnifier.samples(stored, 2)
    assert taken.shape == (2, 2, 24, 24)
    for k, y, x in ((0, 0, 0), (1, 5, 23), (0, 23, 11)):
        row, column = divmod(int(magnifier.pixels[k, y, x]), side)
        assert taken[k, :, y, x].tolist() == stored[magnifier.slots[k, y, x], :, row, column].tolist()


def test_turns_count_what_came_before() -> None:
    assert turns(np.array([3, 1, 3, 3, 0, 1])).tolist() == [0, 0, 1, 2, 0, 1]


@pytest.mark.parametrize("paths", [0, 2])
def test_batches_of_magnified_crops_look_like_others(tmp_path: Path, paths: int) -> None:
    folder = write_data_set(tmp_path / "data")
    clean(folder)
    stored = Stored(folder)
    settings = Data(crop=24, batch=2, spp_max=8, cleaned=True)
    plain = next(iter(Crops(stored, settings, 3, paths, albedo=True)))
    magnified = Crops(stored, settings.model_copy(update={"magnified": 1.0}), 3, paths, albedo=True)
    batch, again = (next(iter(magnified)) for _ in range(2))
    assert batch.inputs.keys() == plain.inputs.keys() and batch.truth.keys() == plain.truth.keys()
    for name, value in batch.inputs.items():
        assert value.shape[1:] == plain.inputs[name].shape[1:], name
        assert torch.equal(value, again.inputs[name]), name
    for name, value in batch.truth.items():
        assert value.shape == plain.truth[name].shape, name
        assert name == "albedo" or value.isfinite().all()
    assert len(batch.counts) == 2 and all(1 <= count <= (paths or settings.spp_max) for count in batch.counts)


def view_of_many_samples(noisy: bool) -> Window:
    """64 samples of each pixel, 16 of them described; without noise each is the reference."""
    tensors = {n: np.concatenate([v] * 8, 1) if n.startswith("samples.") else v for n, v in view_tensors(0).items()}
    if not noisy:
        tensors["samples.radiance"] = np.broadcast_to(tensors["reference.color"], (1, 64, 3, SIDE, SIDE))
    described = {name: tensors[name][:, :16] for name in PATH_NAMES}
    line = {"scene": "smooth", "spp": 64, "described": 16, "crop": SIDE, "crops": [[0, 0]]}
    line |= {"exposure": 1.0, "depth_scale": 1.0}
    return Window(line, (tensors | described).__getitem__, 0, lambda: tensors["reference.color"])


def test_a_magnified_crop_shows_what_its_reference_does_and_its_own_paths() -> None:
    settings = Data(crop=24, batch=1, spp_max=8, drop=0.0, drop_all=0.0, drop_split=0.0, magnified=1.0, cleaned=False)
    still, noisy = (view_of_many_samples(noise) for noise in (False, True))
    known = 0
    for step in range(12):
        rng = np.random.default_rng(step)
        samples, reference = Crops(lambda _: [still], settings, 0, 2, albedo=True).enlarged(still, 24, rng)
        difference = samples["samples.radiance"].mean(0) - reference["color"]
        assert float(difference.abs().max()) < 2 / SIDE  # the slope of a stored pixel
        assert float(difference.mean((1, 2)).abs().max()) < 0.1 / SIDE
        target = reference["albedo"]
        if known_here := bool(target.isfinite().all()):
            torch.testing.assert_close(target, reference["color"], rtol=0.01, atol=0.01)
        known += known_here
        samples, _ = Crops(lambda _: [noisy], settings, 0, 2).enlarged(noisy, 24, rng)
        paths = samples["samples.descriptor"].float()
        assert 1 <= len(paths) <= 2
        logs = samples["samples.radiance"][: len(paths)].log()
        torch.testing.assert_close(paths[:, :3], logs, rtol=0.01, atol=0.01)
    assert known >= 3
