"""Training end to end on a tiny data set: exact resume, warm start, the batch stream."""

import json
import logging
import sys
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import torch
from pathfold.metrics import rell2
from pathfold.models import ALL_SAMPLES
from pathfold_training import cli
from pathfold_training.dataset.store import append_line, read_index, write
from pathfold_training.fit.augment import add_fireflies, augment
from pathfold_training.fit.checkpoint import start_record
from pathfold_training.fit.crops import Crops
from pathfold_training.fit.frames import PATH_NAMES, frame_inputs, reduce_samples
from pathfold_training.fit.preset import Config, Data, Optimiser
from pathfold_training.fit.task import Denoising
from pathfold_training.fit.train import fit
from pathfold_training.fit.views import SAMPLE_NAMES, Stored, ValidationViews, Window
from pathfold_training.fit.warm_start import checkpoint_weights
from pathfold_training.networks.kpcn.sizes import KpcnSizes
from pathfold_training.networks.losses import Loss
from pathfold_training.networks.pathfold.sizes import PathfoldSizes
from pathfold_training.release.average import average
from pathfold_training.release.export import export
from training_data import SIDE, view_tensors, write_data_set

TINY = Config(
    name="tiny",
    description="a network for tests",
    network=KpcnSizes(width=8, layers=3, kernel_size=5, embedding=3, embedding_width=4),
    loss=Loss(manifold=0.0125, manifold_pairs=256),
    data=Data(crop=24, batch=2, spp_max=4),
    optimiser=Optimiser(steps=4, precision="fp32", warmup=1),
)


def weights(checkpoint: Path) -> dict[str, torch.Tensor]:
    return torch.load(checkpoint, map_location="cpu", weights_only=True)["state_dict"]


@pytest.fixture(scope="module")
def data_set(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return write_data_set(tmp_path_factory.mktemp("data") / "set")


def test_both_networks_learn(data_set: Path, tmp_path: Path) -> None:
    before = weights(fit(TINY.with_steps(1), data_set, tmp_path / "one", validate_every=1000, threads=1))
    after = weights(fit(TINY.with_steps(3), data_set, tmp_path / "three", validate_every=1000, threads=1))
    moved = [name for name in before if not torch.equal(before[name], after[name])]
    assert any("trunk" in name for name in moved)
    assert any("paths" in name for name in moved)  # F learns from the same loss


def test_resumed_run_equals_the_whole_one(data_set: Path, tmp_path: Path) -> None:
    whole = weights(fit(TINY, data_set, tmp_path / "whole", seed=3, validate_every=1000, threads=1))

    class InterruptError(Exception):
        pass

    original = Crops.draw
    calls = 0

    def stops(self: Crops, *arguments: object) -> object:
        nonlocal calls
        calls += 1
        if calls > 2 * TINY.data.batch + 1:
            raise InterruptError
        return original(self, *arguments)  # type: ignore[arg-type]

    Crops.draw = stops  # type: ignore[method-assign,assignment]
    try:
        with pytest.raises(InterruptError):
            fit(TINY, data_set, tmp_path / "parts", seed=3, validate_every=1000, threads=1, save_every=2)
    finally:
        Crops.draw = original  # type: ignore[method-assign]
    resumed = weights(fit(TINY, data_set, tmp_path / "parts", seed=3, validate_every=1000, threads=1))
    for name, value in whole.items():
        torch.testing.assert_close(resumed[name], value, rtol=0, atol=0, msg=name)


def test_start_from_copies_the_shared_weights(data_set: Path, tmp_path: Path) -> None:
    vanilla = TINY.model_copy(update={"name": "base", "network": TINY.network.model_copy(update={"embedding": 0})})
    base = fit(vanilla.with_steps(1), data_set, tmp_path / "base", validate_every=1000, threads=1)
    frozen = TINY.model_copy(update={"optimiser": TINY.optimiser.model_copy(update={"learning_rate": 0.0, "steps": 1})})
    begun = weights(fit(frozen, data_set, tmp_path / "begun", validate_every=1000, threads=1, start_from=base))
    shared = weights(base)
    first = "model.branches.diffuse.trunk.0.weight"
    extra = begun[first].shape[1] - shared[first].shape[1]
    assert extra == 1 + TINY.network.embedding + 1
    torch.testing.assert_close(begun[first][:, :-extra], shared[first])
    assert begun[first][:, -extra:].std() > 0.5 * shared[first].std()  # not zero: R is to read F from the start
    record = start_record(base)
    assert record is not None
    assert record["preset"] == "base"
    assert record["steps"] == 1
    again = start_record(tmp_path / "begun" / "last.ckpt")
    assert again is not None
    assert again["steps"] == 2  # all that went before counts
    assert again["cpu_seconds"] >= record["cpu_seconds"]  # both in tenths


def test_a_model_folder_starts_a_run_where_it_stood(data_set: Path, tmp_path: Path) -> None:
    run = tmp_path / "run"
    checkpoint = fit(TINY.with_steps(2), data_set, run, validate_every=1000, threads=1)
    folder = export(checkpoint, tmp_path / "model", json.loads((run / "record.json").read_text()))
    frozen = TINY.model_copy(update={"optimiser": TINY.optimiser.model_copy(update={"learning_rate": 0.0, "steps": 1})})
    begun = fit(frozen, data_set, tmp_path / "begun", validate_every=1000, threads=1, start_from=folder)
    for name, value in checkpoint_weights(checkpoint).items():
        torch.testing.assert_close(checkpoint_weights(begun)[name], value, rtol=1e-5, atol=1e-6, msg=name)
    start = start_record(folder)
    assert start is not None
    assert (start["preset"], start["steps"]) == ("tiny", 2)


def test_averaged_runs_have_the_mean_of_their_weights(
    data_set: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    runs = [tmp_path / "one", tmp_path / "two"]
    one = fit(TINY.with_steps(1), data_set, runs[0], seed=1, validate_every=1000, threads=1)
    two = fit(TINY.with_steps(2), data_set, runs[1], seed=2, validate_every=1000, threads=1, start_from=one)
    out = tmp_path / "mean"
    monkeypatch.setattr(sys, "argv", ["pathfold-train", "average", str(runs[1]), str(runs[0]), "-o", str(out)])
    with pytest.raises(SystemExit) as stop:
        cli.main()
    assert not stop.value.code
    first, second, mean = (weights(checkpoint) for checkpoint in (one, two, out / "last.ckpt"))
    assert any(not torch.equal(first[name], second[name]) for name in first)
    for name, value in mean.items():
        torch.testing.assert_close(value, (first[name] + second[name]) / 2, msg=name)
    folder = export(out / "last.ckpt", tmp_path / "model", json.loads((out / "record.json").read_text()))
    training = json.loads((folder / "manifest.json").read_text())["training"]
    assert (training["seed"], training["steps"]) == (2, 2)
    assert [(other["seed"], other["steps"]) for other in training["averaged_with"]] == [(1, 1)]
    assert "; averaged with the run of seed 1 and commit " in (folder / "README.md").read_text()


def test_runs_that_cannot_be_averaged_are_named(data_set: Path, tmp_path: Path) -> None:
    other = TINY.model_copy(update={"network": TINY.network.model_copy(update={"width": 6})})
    for name, config in (("one", TINY), ("two", other)):
        fit(config.with_steps(1), data_set, tmp_path / name, validate_every=1000, threads=1)
    one, two = tmp_path / "one", tmp_path / "two"
    with pytest.raises(ValueError, match=r"two has another network than .*one"):
        average([one, two], tmp_path / "mean")
    with pytest.raises(ValueError, match="two runs or more"):
        average([one], tmp_path / "mean")
    with pytest.raises(ValueError, match="two holds a run already"):
        average([one, one], two)
    with pytest.raises(ValueError, match=r"cannot read .*nothing/last\.ckpt"):
        average([one, tmp_path / "nothing"], tmp_path / "mean")
    with pytest.raises(ValueError, match="one is given twice"):
        average([one, two, two / ".." / "one"], tmp_path / "mean")
    assert not (tmp_path / "mean").exists()


def test_other_preset_and_missing_data_are_named(data_set: Path, tmp_path: Path) -> None:
    fit(TINY.with_steps(1), data_set, tmp_path / "run", validate_every=1000, threads=1)
    with pytest.raises(ValueError, match=r"of a run of 1 steps.*--start-from"):
        fit(TINY.with_steps(2), data_set, tmp_path / "run")
    with pytest.raises(ValueError, match="another preset"):
        fit(TINY.with_steps(1).model_copy(update={"data": Data(crop=16)}), data_set, tmp_path / "run")
    with pytest.raises(FileNotFoundError, match="pathfold-train render"):
        fit(TINY, tmp_path / "nothing", tmp_path / "other")


def test_a_finished_run_keeps_its_record(data_set: Path, tmp_path: Path) -> None:
    last = fit(TINY.with_steps(1), data_set, tmp_path, seed=3, validate_every=1000, threads=1)
    record = (tmp_path / "record.json").read_text()
    again = fit(TINY.with_steps(1), data_set, tmp_path, seed=3, validate_every=1000, threads=1, start_from=last)
    assert again == last
    assert (tmp_path / "record.json").read_text() == record
    with pytest.raises(ValueError, match="was begun with --seed 3"):
        fit(TINY.with_steps(1), data_set, tmp_path, seed=4)


def test_views_of_few_samples_and_of_several_sizes_are_trained_on(tmp_path: Path) -> None:
    folder = write_data_set(tmp_path / "set", 4)
    for line in read_index(folder):
        side = 40 if line["id"] == "view-0" else 16
        tensors = {
            name: value[..., :side, :side] if not name.startswith("samples.") else value[:, :4, :, :side, :side]
            for name, value in view_tensors(line["seed"]).items()
        }
        line |= {"spp": 4, "described": 4, "width": side, "height": side, "crop": side}
        append_line(folder, write(folder, line, tensors))
    fit(TINY.with_steps(2), folder, tmp_path / "run", validate_every=1, threads=1)
    (batch,) = list(ValidationViews(Stored(folder).held_out(), ALL_SAMPLES))
    assert batch.counts == [4]


@pytest.mark.parametrize(
    ("arguments", "code", "words"),
    [
        ("fit pathfold-fast --out {0}/run --data {0}/nothing", 1, "pathfold-train render"),
        ("fit pathfold-fast --out {0}/run --data {0}/few", 1, "one scene in ten is 'val'"),
        ("fit pathfold-fast --out {0}/run --data {0}/few --threads -1", 2, "--threads"),
        ("fit", 2, "preset"),
        ("fit {0}/folder.yaml --out {0}/run --data {0}/few", 1, "folder.yaml: Is a directory; there are: kpcn-"),
        ("fit {0}/binary.yaml --out {0}/run --data {0}/few", 1, "binary.yaml is no YAML"),
        ("fit {0}/wrong.yaml --out {0}/run --data {0}/few", 1, "wrong.yaml: data.batch: Input should be"),
        ("card {0}/nothing --results {0}", 1, "has no manifest.json"),
        ("card {0}/text --results {0}", 1, "text/manifest.json is no JSON"),
        ("card {0}/foreign --results {0}", 1, "foreign/manifest.json lacks training; make it by pathfold-train export"),
        ("average {0}/text {0}/foreign -o {0}/run", 1, "text/last.ckpt is no checkpoint of 'pathfold-train fit'"),
        ("average {0}/foreign {0}/text -o {0}/run", 1, "foreign/last.ckpt is no checkpoint of 'pathfold-train fit'"),
        ("average {0}/text {0}/foreign -o {0}/text/last.ckpt", 1, "last.ckpt is a file; give a folder"),
        ("average {0}/whole {0}/text/../whole -o {0}/run", 1, "whole is given twice"),
        ("export {0}/whole -o {0}/run", 1, "whole/record.json lacks started_from, commit; give another"),
        ("export {0}/whole -o {0}/text/last.ckpt", 1, "last.ckpt is a file; give a folder"),
        ("render --out {0}/text/last.ckpt/set --procedural 1", 1, "cannot write into {0}/text/last.ckpt/set"),
    ],
)
def test_what_a_command_cannot_do_is_one_line_and_leaves_nothing(
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
    arguments: str,
    code: int,
    words: str,
) -> None:
    few = write_data_set(tmp_path / "few")
    lines = [json.loads(line) for line in (few / "index.jsonl").read_text().splitlines()]
    (few / "index.jsonl").write_text("".join(json.dumps(line | {"split": "train"}) + "\n" for line in lines))
    damaged_files(tmp_path)
    monkeypatch.setattr(sys, "argv", ["pathfold-train", *arguments.format(tmp_path).split()])
    with pytest.raises(SystemExit) as left:
        cli.main()
    error = capsys.readouterr().err
    assert left.value.code == code
    assert error.startswith("pathfold-train: ") and error.count("\n") == 1 and words.format(tmp_path) in error
    assert not (tmp_path / "run").exists()


def damaged_files(folder: Path) -> None:
    """Presets, runs and model folders that are none, or damaged; of `whole` the record alone."""
    for name in ("folder.yaml", "empty", "text", "foreign", "cut", "hollow", "whole"):
        (folder / name).mkdir()
    (folder / "binary.yaml").write_bytes(b"\xff\xfe\x00name")
    (folder / "wrong.yaml").write_text("name: a\ndescription: b\ndata: {batch: 0}\n")
    for name in ("last.ckpt", "manifest.json"):
        (folder / "text" / name).write_text("a text\n")
    torch.save({"weights": torch.zeros(2)}, folder / "foreign" / "last.ckpt")
    (folder / "foreign" / "manifest.json").write_text('{"name": "a", "graphs": {}, "reconstruction": {}}')
    manifest = {"name": "a", "graphs": {"network": {"file": "network.onnx"}}, "training": {"started_from": None}}
    for name, graph in (("cut", b"\x08\x08\x3a\xff\x01\x0a"), ("hollow", b"")):
        (folder / name / "manifest.json").write_text(json.dumps(manifest | {"reconstruction": {"operator": "gather"}}))
        (folder / name / "network.onnx").write_bytes(graph)
    pyramid = PathfoldSizes(widths=(8, 8, 8, 8), convolutions=(1, 1, 1, 1), embedding=2)
    task = Denoising(TINY.model_copy(update={"network": pyramid}))
    state = {"state_dict": task.state_dict(), "hyper_parameters": {"config": task.config.model_dump()}}
    state |= {"global_step": 1, "callbacks": {"TrainingSeconds": {"seconds": 1.0, "cpu_seconds": 1.0}}}
    torch.save(state, folder / "whole" / "last.ckpt")
    (folder / "whole" / "record.json").write_text('{"config": {}, "seed": 0, "hardware": "", "data": {}}')


@pytest.mark.parametrize(
    ("start", "words"),
    [
        ("nosuch", r"cannot read .*nosuch: No such file or directory; give a checkpoint"),
        ("empty", r"cannot read .*empty/manifest\.json: No such file or directory; give a checkpoint"),
        ("text/last.ckpt", r"text/last\.ckpt is no checkpoint of 'pathfold-train fit', or is damaged"),
        ("foreign", r"foreign/manifest\.json lacks training; give a checkpoint"),
        ("cut", r"cut/network\.onnx is no ONNX graph, or is damaged"),
        ("hollow", r"hollow/network\.onnx holds no weights"),
        ("whole/last.ckpt", r"does not fit preset 'tiny'; give a network of its family"),
    ],
)
def test_a_start_that_is_none_is_named_before_anything_is_written(
    data_set: Path, tmp_path: Path, start: str, words: str
) -> None:
    damaged_files(tmp_path)
    with pytest.raises(ValueError, match=words):
        fit(TINY, data_set, tmp_path / "run", start_from=tmp_path / start)
    assert not (tmp_path / "run").exists()


def test_an_export_that_cannot_be_made_leaves_nothing(tmp_path: Path) -> None:
    damaged_files(tmp_path)
    with pytest.raises(ValueError, match="leave --standalone away"):
        export(tmp_path / "whole" / "last.ckpt", tmp_path / "model", {}, standalone=True)
    assert not (tmp_path / "model").exists()


def test_advertisements_are_not_logged() -> None:
    logger = logging.getLogger("lightning.pytorch.utilities.rank_zero")
    said = [logging.LogRecord("", logging.INFO, "", 0, text, (), None) for text in ("try litlogger", "GPU available")]
    assert [bool(logger.filter(record)) for record in said] == [False, True]


@pytest.mark.parametrize("command", [[], ["dataset"], ["fit"]])
def test_help_has_a_short_name(
    command: list[str], monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setattr(sys, "argv", ["pathfold-train", *command, "-h"])
    with pytest.raises(SystemExit) as left:
        cli.main()
    assert not left.value.code
    assert "--help" in capsys.readouterr().out


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


def test_last_checkpoint_is_of_the_last_step(data_set: Path, tmp_path: Path) -> None:
    last = fit(TINY.with_steps(3), data_set, tmp_path / "run", validate_every=1000, save_every=2, threads=1)
    assert torch.load(last, map_location="cpu", weights_only=True)["global_step"] == 3
