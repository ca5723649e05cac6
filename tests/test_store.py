"""The data set's store: whole views only, crops, recovery after an interruption, checksums."""

import json
from pathlib import Path

import numpy as np
import pytest
from pathfold_training import dataset, store


def line(name: str, **extra: object) -> store.Line:
    facts = {"id": name, "scene": name, "kind": "procedural", "content": "room", "licence": "CC0-1.0", "origin": "code"}
    return facts | {"split": "train", "spp": 4, "reference_spp": 64, "reference_rell2": 1e-3} | extra


def tensors(seed: int = 0) -> store.Arrays:
    rng = np.random.default_rng(seed)
    return {
        "samples.radiance": rng.uniform(0, 2, (4, 3, 12, 10)).astype(np.float32),
        "samples.normal": rng.normal(size=(4, 3, 12, 10)).astype(np.float16),
        "reference.color": rng.uniform(0, 2, (3, 12, 10)).astype(np.float32),
        "importance": np.ones((12, 10), np.float32),
    }


def save(folder: Path, name: str, seed: int = 0, **extra: object) -> None:
    store.append_line(folder, store.write_view(folder, line(name, **extra), tensors(seed), {"exposure": "0.5"}))


def test_crops_are_parts_of_what_was_written(tmp_path: Path) -> None:
    save(tmp_path, "a")
    save(tmp_path, "b", 1, split="val")
    data = store.Store(tmp_path)
    assert [entry["id"] for entry in data.split("val")] == ["b"]
    assert data.exposure("a") == 0.5
    crop = data.crop("b", 2, 3, 5, 4, samples=slice(1, 3))
    expected = tensors(1)
    assert np.array_equal(crop["samples.radiance"], expected["samples.radiance"][1:3, :, 2:7, 3:7])
    assert crop["samples.normal"].dtype == np.float16
    assert np.array_equal(crop["reference.color"], expected["reference.color"][:, 2:7, 3:7])
    assert crop["importance"].shape == (5, 4)
    assert np.array_equal(data.view("b")["samples.normal"], expected["samples.normal"])


def test_a_view_being_written_is_not_seen(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    save(tmp_path, "a")

    def killed(*_: object) -> None:
        raise KeyboardInterrupt

    monkeypatch.setattr(Path, "replace", killed)
    with pytest.raises(KeyboardInterrupt):
        save(tmp_path, "b")
    monkeypatch.undo()
    assert not store.view_path(tmp_path, "b").exists()
    assert [entry["id"] for entry in store.recover(tmp_path)] == ["a"]
    assert not list(tmp_path.glob("views/*.partial"))


def test_recovery_drops_cut_files_and_adopts_whole_ones(tmp_path: Path) -> None:
    for name in ("a", "b", "c"):
        save(tmp_path, name)
    cut = store.view_path(tmp_path, "b")
    cut.write_bytes(cut.read_bytes()[:-100])
    index = tmp_path / "index.jsonl"
    rows = index.read_text().splitlines()
    index.write_text("\n".join([rows[0], rows[1], rows[2][:40]]))  # the last line was being written
    assert [entry["id"] for entry in store.read_index(tmp_path)] == ["a"]
    assert [entry["id"] for entry in store.recover(tmp_path)] == ["a", "c"]
    assert [json.loads(row)["id"] for row in index.read_text().splitlines()] == ["a", "c"]
    assert not cut.exists()


def test_altered_views_are_found(tmp_path: Path) -> None:
    for name in ("a", "b"):
        save(tmp_path, name)
    path = store.view_path(tmp_path, "b")
    content = bytearray(path.read_bytes())
    content[-1] ^= 1
    path.write_bytes(content)
    assert list(store.Store(tmp_path).damaged()) == ["b"]


def test_a_file_that_vanishes_is_named(tmp_path: Path) -> None:
    save(tmp_path, "a")
    data = store.Store(tmp_path)
    store.view_path(tmp_path, "a").unlink()
    with pytest.raises(store.DamagedViewError, match="view a in"):
        data.view("a")


def test_an_empty_folder_says_how_to_fill_it(tmp_path: Path) -> None:
    with pytest.raises(FileNotFoundError, match="pathfold-train render"):
        store.Store(tmp_path)


def test_info_and_sheet(tmp_path: Path) -> None:
    for i in range(3):
        save(tmp_path, f"v{i}", i, split="val" if i == 2 else "train")
    facts = dataset.info(tmp_path)
    assert facts["views"] == 3
    assert facts["splits"] == {"train": 2, "val": 1}
    assert facts["licences"] == {"CC0-1.0": 3}
    assert dataset.sheet(tmp_path, tmp_path / "sheet.png", columns=2) == 3
    assert (tmp_path / "sheet.png").stat().st_size > 100
