"""The data set's store: whole files only, recovery after an interruption, checksums, full disks, the commands."""

import json
import resource
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest
from pathfold_training.cli import app
from pathfold_training.dataset import contents, store
from safetensors.numpy import save_file
from training_data import view_tensors, write_data_set
from typer.testing import CliRunner


@pytest.fixture
def folder(tmp_path: Path) -> Path:
    """Three views: view-0 and view-1 to train on, view-2 held out."""
    return write_data_set(tmp_path / "set")


def path(folder: Path, kind: str, number: int) -> Path:
    return store.file_path(folder, kind, f"view-{number}")


def ids(lines: list[store.Line]) -> list[str]:
    return [line["id"] for line in lines]


def alter(file: Path) -> None:
    content = bytearray(file.read_bytes())
    content[-1] ^= 1
    file.write_bytes(content)


def test_what_is_read_is_what_was_written(folder: Path) -> None:
    data = store.Store(folder)
    assert ids(data.split("val")) == ["view-2"]
    expected = view_tensors(1)
    for name, values in expected.items():
        assert np.array_equal(data.tensor("view-1", name)[:], values), name
        assert data.tensor("view-1", name)[:].dtype == values.dtype
    part = data.tensor("view-1", "samples.radiance")[0, 1:3, :, 2:7, 3:7]
    assert np.array_equal(part, expected["samples.radiance"][0, 1:3, :, 2:7, 3:7])


def test_a_file_being_written_is_not_seen(folder: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    def killed(*_: object) -> None:
        raise KeyboardInterrupt

    line = store.read_index(folder)[0] | {"id": "view-9"}
    monkeypatch.setattr(Path, "replace", killed)
    with pytest.raises(KeyboardInterrupt):
        store.write(folder, line, view_tensors(9))
    monkeypatch.undo()
    assert not path(folder, store.REFERENCES, 9).exists()
    assert list(folder.glob("references/*.partial"))
    assert ids(store.recover(folder)) == ["view-0", "view-1", "view-2"]
    assert not list(folder.glob("references/*.partial"))


def test_recovery_drops_cut_and_altered_files_and_takes_up_whole_ones(folder: Path) -> None:
    cut = path(folder, store.REFERENCES, 0)
    cut.write_bytes(cut.read_bytes()[:-100])
    alter(path(folder, store.SAMPLES, 1))
    index = folder / "index.jsonl"
    rows = index.read_text().splitlines()
    index.write_text("\n".join([rows[0], rows[1], rows[2][:40]]))  # the last line was being written
    lines = store.recover(folder)
    assert ids(lines) == ["view-0", "view-1", "view-2"]  # the first is rendered again
    assert [set(line["files"]) for line in lines] == [{"samples"}, {"references"}, {"references", "samples"}]
    assert ids(store.read_index(folder)) == ids(lines)
    assert not cut.exists()
    assert not path(folder, store.SAMPLES, 1).exists()
    assert store.recover(folder) == lines


@pytest.mark.parametrize(
    "line",
    [
        b"5",
        b'{"format": 3}',
        b'{"format": 3, "id": "view-1"}',
        b'{"format": 3, "id": "view-1", "files": {}}',
        b"\x93\xff\x00binary",
    ],
)
def test_a_damaged_line_is_left_out_and_mended(folder: Path, line: bytes) -> None:
    index = folder / "index.jsonl"
    rows = index.read_bytes().splitlines()
    whole = store.read_index(folder)
    index.write_bytes(b"\n".join([rows[0], line, rows[2]]) + b"\n")
    assert ids(store.Store(folder).lines) == ["view-0", "view-2"]
    assert contents.info(folder)["views"] == 2
    assert sorted(store.recover(folder), key=lambda line: line["id"]) == whole


def test_a_file_that_says_nothing_of_its_view_is_removed(folder: Path) -> None:
    foreign = path(folder, store.REFERENCES, 9)
    save_file({"reference.color": np.zeros(3, np.float32)}, foreign, {"view": "5"})
    assert ids(store.recover(folder)) == ["view-0", "view-1", "view-2"]
    assert not foreign.exists()


def test_samples_that_the_index_does_not_know_replace_what_it_says(folder: Path) -> None:
    lines = store.read_index(folder)
    tensors = {k: v[:, :2] for k, v in view_tensors(0).items() if k.startswith("samples.")}
    store.write(folder, lines[0] | {"spp": 2}, tensors)  # killed before the line was written
    assert list(store.damaged(folder, lines)) == [path(folder, store.SAMPLES, 0)]
    assert [line["id"] for line in store.Store(folder).lines] == ["view-1", "view-2"]
    assert [line["spp"] for line in store.recover(folder)] == [2, 8, 8]
    assert [line["id"] for line in store.Store(folder).lines] == ["view-0", "view-1", "view-2"]


def test_an_index_is_made_again_with_the_facts_of_the_newest_files(folder: Path) -> None:
    lines = store.read_index(folder)
    better = {k: v for k, v in view_tensors(0).items() if not k.startswith("samples.")}
    store.write(folder, lines[0] | {"budget": 8.0, "reference_spp": 4096}, better)
    fewer = {k: v[:, :2] for k, v in view_tensors(1).items() if k.startswith("samples.")}
    store.write(folder, lines[1] | {"spp": 2}, fewer)
    (folder / "index.jsonl").unlink()
    assert store.begun(folder)
    again = store.recover(folder)
    assert [line["reference_spp"] for line in again] == [4096, 1024, 1024]
    assert [line["spp"] for line in again] == [8, 2, 8]
    assert ids(store.Store(folder).lines) == ["view-0", "view-1", "view-2"]


def test_damage_is_found_before_it_is_read(folder: Path) -> None:
    alter(path(folder, store.SAMPLES, 1))
    data = store.Store(folder)
    data.tensor("view-0", "samples.radiance")
    data.tensor("view-1", "reference.color")
    with pytest.raises(store.DamagedFileError, match=r"samples/view-1\.safetensors is damaged .*pathfold-train render"):
        data.tensor("view-1", "samples.radiance")
    path(folder, store.SAMPLES, 2).unlink()
    with pytest.raises(store.DamagedFileError, match="view-2"):
        data.tensor("view-2", "samples.radiance")


def test_views_without_samples_are_left_out_with_a_warning(folder: Path, caplog: pytest.LogCaptureFixture) -> None:
    path(folder, store.SAMPLES, 0).unlink()
    assert ids(store.Store(folder).lines) == ["view-1", "view-2"]
    assert "1 views left out" in caplog.text
    for number in (1, 2):
        path(folder, store.SAMPLES, number).unlink()
    with pytest.raises(FileNotFoundError, match=r"no view in .* has all its files"):
        store.Store(folder)


def test_an_empty_folder_says_how_to_fill_it(tmp_path: Path) -> None:
    with pytest.raises(FileNotFoundError, match="pathfold-train render"):
        store.Store(tmp_path)


def test_another_format_is_an_error(tmp_path: Path) -> None:
    (tmp_path / "index.jsonl").write_text('{"format": 1, "id": "a", "spp": 16}\n')
    with pytest.raises(ValueError, match=r"format 1, this version reads format 3: render it anew"):
        store.Store(tmp_path)


def test_a_write_beyond_the_file_size_limit_leaves_nothing(folder: Path) -> None:
    program = f"""
import sys; sys.path.insert(0, {str(Path(__file__).parent)!r})
from pathlib import Path
from pathfold_training.dataset import store
from training_data import view_tensors
folder = Path({str(folder)!r})
store.write(folder, store.read_index(folder)[0] | {{"id": "view-9"}}, view_tensors(9))
"""
    limit = path(folder, store.REFERENCES, 0).stat().st_size * 2  # references fit, samples do not
    run = subprocess.run(
        [sys.executable, "-c", program],
        preexec_fn=lambda: resource.setrlimit(resource.RLIMIT_FSIZE, (limit, limit)),
        capture_output=True,
        text=True,
    )
    assert "samples/view-9.safetensors: File too large" in run.stderr
    assert not list(folder.glob("*/*.partial"))
    assert not path(folder, store.SAMPLES, 9).exists()
    assert ids(store.Store(folder).lines) == ["view-0", "view-1", "view-2"]
    assert ids(store.recover(folder)) == ["view-0", "view-1", "view-2", "view-9"]  # its reference is whole


def test_info_says_what_there_is(folder: Path) -> None:
    path(folder, store.SAMPLES, 0).unlink()
    facts = json.loads(CliRunner().invoke(app, ["dataset", "info", str(folder), "--json"]).stdout)
    assert facts["views"] == 3
    assert facts["without_samples"] == 1
    assert facts["bytes"]["samples"] == sum(path(folder, store.SAMPLES, n).stat().st_size for n in (1, 2))
    assert facts["spp"] == [8]
    assert facts["splits"] == {"train": 2, "val": 1}
    assert facts["licences"] == {"CC0-1.0": 3}
    assert facts["reference_rell2"]["max"] == 0
    assert facts["faults"]["view-1"] == "repeats view-0 (correlation 1.000)"  # the tests' views are of one picture


def test_info_checks_every_byte_when_asked(folder: Path) -> None:
    assert CliRunner().invoke(app, ["dataset", "info", str(folder), "--check"]).exit_code == 0
    alter(path(folder, store.REFERENCES, 1))
    assert CliRunner().invoke(app, ["dataset", "info", str(folder)]).exit_code == 0
    result = CliRunner().invoke(app, ["dataset", "info", str(folder), "--check"])
    assert result.exit_code == 1
    assert contents.info(folder, check=True)["damaged"] == [str(path(folder, store.REFERENCES, 1))]
    cut, gone = (path(folder, kind, 0) for kind in (store.SAMPLES, store.REFERENCES))
    cut.write_bytes(cut.read_bytes()[:-1])
    gone.unlink()
    assert set(contents.info(folder, check=True)["damaged"]) == {
        *map(str, (cut, gone, path(folder, store.REFERENCES, 1)))
    }


def test_sheet_shows_every_reference(folder: Path, tmp_path: Path) -> None:
    oiio = pytest.importorskip("OpenImageIO")
    picture = tmp_path / "sheet.png"
    result = CliRunner().invoke(app, ["dataset", "sheet", str(folder), "-o", str(picture), "--columns", "2"])
    assert result.exit_code == 0
    pixels = oiio.ImageBuf(str(picture)).get_pixels(oiio.UINT8)
    assert pixels.shape == (80, 80, 3)
    exposed = 0.5 * np.moveaxis(view_tensors(2)["reference.color"], 0, -1)
    assert np.abs(pixels[40:, :40] - 255 * (exposed / (1 + exposed)) ** (1 / 2.2)).max() < 1
    assert not pixels[40:, 40:].any()
    with pytest.raises(OSError, match=r"cannot write .*; give a \.jpg or \.png"):
        contents.sheet(folder, tmp_path / "nowhere" / "sheet.png")


@pytest.mark.parametrize(
    ("arguments", "said"),
    [
        (["render", "--out", "{}/file", "--procedural", "1"], "file is a file; give a folder"),
        (["render", "--out", "{}/new", "--procedural", "1", "--budget", "inf"], "--budget inf: give core-seconds"),
        (["dataset", "sheet", "{}", "-o", "sheet.exr"], "sheet.exr: a contact sheet is written as .jpg or .png"),
        (["fit", "kpcn-vanilla", "--data", "{}", "--out", "{}/file"], "file is a file; give a folder"),
    ],
)
def test_a_wrong_argument_is_named(arguments: list[str], said: str, tmp_path: Path) -> None:
    (tmp_path / "file").touch()
    result = CliRunner().invoke(app, [argument.format(tmp_path) for argument in arguments])
    assert isinstance(result.exception, ValueError)
    assert said in str(result.exception)
