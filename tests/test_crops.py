"""Crops and windows as batches: which samples, what is read of them, fireflies, augmentation."""

import json
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import torch
from pathfold.metrics import rell2
from pathfold.models import ALL_SAMPLES
from pathfold_training.fit.augment import add_fireflies, augment
from pathfold_training.fit.crops import Crops
from pathfold_training.fit.frames import PATH_NAMES, frame_inputs, reduce_samples
from pathfold_training.fit.task import Denoising
from pathfold_training.fit.views import SAMPLE_NAMES, Stored, ValidationViews, Window
from training_data import SIDE, TINY, view_tensors, write_data_set


@pytest.fixture(scope="module")
def data_set(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return write_data_set(tmp_path_factory.mktemp("data") / "set")


def test_batches_depend_on_seed_and_step_alone(data_set: Path) -> None:
    stored = Stored(data_set)
    first = [batch for batch, _ in zip(Crops(stored, TINY.data, seed=5, paths=ALL_SAMPLES), range(3), strict=False)]
    again = next(iter(Crops(stored, TINY.data, seed=5, paths=ALL_SAMPLES, skip=2)))
    assert again.counts == first[2].counts
    for name, value in again.inputs.items():
        torch.testing.assert_close(value, first[2].inputs[name], rtol=0, atol=0)
    other = next(iter(Crops(stored, TINY.data, seed=6, paths=ALL_SAMPLES)))
    assert not torch.equal(other.truth["color"], first[0].truth["color"])


def test_fireflies_are_improbable_paths_of_a_few_samples(data_set: Path) -> None:
    view = Stored(data_set).train[0]
    many = 0
    for seed in range(40):
        plain, _ = view.crop(4, 4, 24, np.arange(4), 2)
        given, _ = view.crop(4, 4, 24, np.arange(4), 2)
        add_fireflies(given, view.exposure, np.random.default_rng(seed))
        ratio = given["samples.radiance"] / plain["samples.radiance"]
        bright = (ratio > 1.001).any(1)
        assert 1 <= int(bright.sum()) <= 8
        exposed = given["samples.radiance"].amax(1)[bright] * view.exposure
        assert float(exposed.min()) > 9.9 and float(exposed.max()) < 1.01e5
        torch.testing.assert_close(ratio.amax(1), ratio.amin(1), rtol=1e-4, atol=0)  # the colour stays
        told = plain["samples.density"] - given["samples.density"]
        torch.testing.assert_close(told, ratio[:2].log().mean(1, keepdim=True), rtol=1e-3, atol=1e-4)
        many += int(bright[:2].sum())
        assert torch.equal(given["samples.descriptor"], plain["samples.descriptor"])
    assert many > 20
    crops = Crops(Stored(data_set), TINY.data.model_copy(update={"fireflies": 1.0}), seed=5, paths=ALL_SAMPLES)
    brightest = [batch.inputs["color"].amax((1, 2, 3)) for batch, _ in zip(crops, range(4), strict=False)]
    assert float(torch.cat(brightest).min()) > 4


def test_the_albedo_is_told_by_samples_that_were_not_given(data_set: Path) -> None:
    view = Stored(data_set).train[0]
    stored = view.tensor("samples.albedo")[view.number].astype(np.float32)[:, :, 2:10, 4:12]
    for given in ([0], [5, 1], [view.samples - 1, 0, 3]):
        others = np.delete(stored, given, 0).mean(0)
        own = torch.from_numpy(stored[given])
        np.testing.assert_allclose(view.albedo(2, 4, own).numpy(), others, rtol=1e-5, atol=1e-6)
    assert view.albedo(2, 4, torch.from_numpy(stored[: view.samples // 2 + 1])).isnan().all()


def test_a_view_is_scored_without_the_noise_of_its_reference() -> None:
    tensors = view_tensors(0)
    noise = 0.05 * np.random.default_rng(1).standard_normal((2, 3, SIDE, SIDE)).astype(np.float32)
    clean = tensors["reference.color"] + 1.0  # where it is dark, noise makes its weight uncertain
    halves = {"reference.half_a.color": clean + noise[0], "reference.half_b.color": clean + noise[1]}
    line = {"scene": "smooth", "spp": 8, "described": 8, "crop": SIDE, "crops": [[0, 0]]}
    view = Window(line | {"exposure": 1.0, "depth_scale": 1.0}, (tensors | halves).__getitem__, 0, lambda: clean)
    batch = ValidationViews([view], ALL_SAMPLES, 4)[0]
    task = Denoising(TINY)
    task.denoise = lambda _: torch.from_numpy(clean + 0.04)[None]  # a picture whose error is known
    noisy = np.moveaxis(batch.inputs["color"][0].numpy(), 0, -1)
    expected = 0.04**2 * (1 / (clean**2 + 0.01)).mean() / rell2(noisy, np.moveaxis(clean, 0, -1))
    assert float(task.ratio_log(batch).exp()) == pytest.approx(expected, rel=0.2)
    with_noise = batch.truth | dict.fromkeys(("half_a", "half_b"), torch.from_numpy(sum(halves.values()) / 2)[None])
    assert float(task.ratio_log(replace(batch, truth=with_noise)).exp()) > 1.5 * expected


def test_paths_of_the_first_samples_alone_are_read(data_set: Path) -> None:
    view = Stored(data_set).train[0]
    whole, _ = view.crop(0, 0, 16, np.array([4, 1, 6]), ALL_SAMPLES)
    part, _ = view.crop(0, 0, 16, np.array([4, 1, 6]), 2)
    for name, value in part.items():
        fewer = name in ("samples.descriptor", "samples.density")
        assert torch.equal(value, whole[name][:2] if fewer else whole[name])
    inputs = frame_inputs(part, 1.0, 1.0)
    assert inputs["samples.valid"].shape[0] == 2
    assert torch.equal(inputs["variance"], frame_inputs(whole, 1.0, 1.0)["variance"])


def test_samples_are_any_subset_and_begin_with_those_whose_paths_are_stored(tmp_path: Path) -> None:
    tensors = view_tensors(0)
    stored = {name: v[:, :3] if name in PATH_NAMES else v for name, v in tensors.items()}
    line = json.loads((write_data_set(tmp_path / "data", 1) / "index.jsonl").read_text())
    view = Window(line | {"described": 3}, stored.__getitem__, 0, lambda: stored["reference.color"])
    rng = np.random.default_rng(1)
    drawn = [view.subset(count, 2, rng) for count in (1, 2, 5, 8) for _ in range(50)]
    for numbers in drawn:
        assert len(set(numbers)) == len(numbers) and (numbers[:2] < 3).all()
    assert len({frozenset(numbers) for numbers in drawn[100:150]}) > 15
    assert {int(n) for numbers in drawn[100:150] for n in numbers} == set(range(8))
    samples, _ = view.crop(3, 5, 16, np.array([2, 0, 7, 1]), ALL_SAMPLES)
    for name in SAMPLE_NAMES:
        np.testing.assert_array_equal(samples[name].numpy(), tensors[name][0, [2, 0, 7, 1], :, 3:19, 5:21])
    described = tensors["samples.descriptor"][0, [2, 0], :, 3:19, 5:21]
    np.testing.assert_array_equal(samples["samples.descriptor"].numpy(), described)
    assert samples["samples.density"].shape[0] == 2


def test_variance_is_of_the_pixel_mean() -> None:
    rng = np.random.default_rng(0)
    blocks = torch.from_numpy(rng.exponential(2.0, (4000, 8, 3, 1, 1))).float()
    guides = {f"samples.{n}": torch.zeros(8, 3, 1, 1) for n in ("diffuse.albedo", "albedo", "normal", "depth")}
    frames = []
    for block in blocks:
        frames.append(reduce_samples(guides | {"samples.radiance": block, "samples.diffuse": block * 0.25}))
    means = torch.stack([f["color"] for f in frames])
    estimate = torch.stack([f["variance"] for f in frames]).mean()
    assert float(estimate) == pytest.approx(float(means.var()), rel=0.05)


def test_augmentation_turns_everything_alike() -> None:
    inputs = {
        "samples.descriptor": torch.rand(2, 36, 6, 6),
        "normal": torch.rand(3, 6, 6),
        "exposure": torch.tensor(2.0),
    }
    inputs["color"] = inputs["samples.descriptor"][:, :3].mean(0)  # a triple that must stay aligned
    reference = {"color": inputs["color"]}
    first, length = inputs["color"], inputs["normal"].square().sum()
    for seed in range(8):
        augment(inputs, reference, np.random.default_rng(seed), normal_turn=0.5)
        torch.testing.assert_close(inputs["color"], reference["color"])
        torch.testing.assert_close(inputs["samples.descriptor"][:, :3].mean(0), inputs["color"])
    assert not torch.equal(inputs["color"], first)
    torch.testing.assert_close(inputs["normal"].square().sum(), length)
    assert float(inputs["exposure"]) == 2.0


def test_means_turned_are_the_means_of_samples_turned() -> None:
    shapes = {"radiance": 3, "diffuse": 3, "diffuse.albedo": 3, "albedo": 3, "normal": 3, "depth": 1, "density": 1}
    samples = {f"samples.{n}": torch.rand(4, c, 6, 6) for n, c in shapes.items()}
    samples["samples.descriptor"] = torch.rand(4, 36, 6, 6)

    def turned(x: torch.Tensor, name: str) -> torch.Tensor:
        """What augment does by the numbers drawn below: flipped both ways, transposed, colours in the order 2, 0, 1."""
        x = x.flip((-1, -2)).transpose(-1, -2)
        if name == "samples.normal":
            return torch.stack([-x[:, 1], -x[:, 0], x[:, 2]], 1)
        if name == "samples.descriptor":
            return torch.cat([x[:, :24].unflatten(1, (8, 3))[:, :, [2, 0, 1]].flatten(1, 2), x[:, 24:]], 1)
        return x[:, [2, 0, 1]] if x.shape[1] == 3 else x

    class Drawn:
        def __init__(self) -> None:
            self.values = [np.zeros(3), np.array([2, 0, 1]), 1.0]

        def __getattr__(self, name: str) -> object:
            return lambda *_: self.values.pop(0)

    inputs, reference = frame_inputs(samples, 2.0, 1.0), {"color": samples["samples.radiance"].mean(0)}
    augment(inputs, reference, Drawn(), normal_turn=0.0)  # type: ignore[arg-type]
    wanted = frame_inputs({name: turned(x, name) for name, x in samples.items()}, 2.0, 1.0)
    assert inputs.keys() == wanted.keys()
    for name, value in wanted.items():
        torch.testing.assert_close(inputs[name], value, msg=lambda text, name=name: f"{name}: {text}")
    torch.testing.assert_close(reference["color"], wanted["color"])


def test_one_sample_has_no_variance() -> None:
    shapes = {"radiance": 3, "diffuse": 3, "diffuse.albedo": 3, "albedo": 3, "normal": 3, "depth": 1}
    inputs = frame_inputs({f"samples.{n}": torch.rand(1, c, 4, 4) for n, c in shapes.items()}, 1.0, 1.0)
    assert float(inputs["variance.present"]) == 0.0
    assert inputs["variance"].abs().max() == 0.0
