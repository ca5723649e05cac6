"""Training end to end on a tiny data set: exact resume, warm start, averages, what is refused."""

import json
import logging
import sys
from pathlib import Path

import pytest
import torch
from pathfold.models import ALL_SAMPLES
from pathfold_training import cli
from pathfold_training.dataset.store import append_line, read_index, write
from pathfold_training.fit.checkpoint import start_record
from pathfold_training.fit.crops import Crops
from pathfold_training.fit.preset import Data
from pathfold_training.fit.task import Denoising
from pathfold_training.fit.train import fit
from pathfold_training.fit.views import Stored, ValidationViews
from pathfold_training.fit.warm_start import checkpoint_weights
from pathfold_training.networks.pathfold.sizes import PathfoldSizes
from pathfold_training.release.average import average
from pathfold_training.release.export import export
from training_data import TINY, view_tensors, write_data_set


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
        ("export {0}/typed -o {0}/run", 1, "typed/record.json is altered: nothing can be made of seed, which is '0'"),
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
    """Presets, runs and model folders that are none, or damaged; of `whole` and `typed` the record alone."""
    for name in ("folder.yaml", "empty", "text", "foreign", "cut", "hollow", "whole", "typed"):
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
    record = {"config": {}, "seed": "0", "started_from": None, "commit": "", "hardware": "", "data": {}}
    records = {"whole": {"config": {}, "seed": 0, "hardware": "", "data": {}}, "typed": record}
    for name, content in records.items():
        torch.save(state, folder / name / "last.ckpt")
        (folder / name / "record.json").write_text(json.dumps(content))


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


def test_last_checkpoint_is_of_the_last_step(data_set: Path, tmp_path: Path) -> None:
    last = fit(TINY.with_steps(3), data_set, tmp_path / "run", validate_every=1000, save_every=2, threads=1)
    assert torch.load(last, map_location="cpu", weights_only=True)["global_step"] == 3
