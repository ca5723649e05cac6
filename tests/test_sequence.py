"""What a name on the command line stands for: one file, or the frames of a sequence."""

from pathlib import Path

import pytest
from exr_files import beauty
from pathfold.cli.console import InputError
from pathfold.cli.sequence import expand, similar


def folder(path: Path, *names: str) -> Path:
    for name in names:
        (path / name).touch()
    return path


def pairs(at: Path, source: str, output: str) -> dict[str, str]:
    return {noisy.name: clean.name for noisy, clean in expand(at / source, at / output)}


@pytest.mark.parametrize(
    "name", ["shot#3.exr", "####.exr", "a.####.exr", "50%d.exr", "%04d.exr", "at@@@@.exr", "a[1].exr"]
)
def test_a_file_of_that_very_name_is_that_file(tmp_path: Path, name: str) -> None:
    folder(tmp_path, name, "a.0001.exr", "0001.exr")
    assert pairs(tmp_path, name, "out.exr") == {name: "out.exr"}
    assert similar(tmp_path / name, tmp_path / "out.exr") == []
    if "#" in name:
        assert pairs(tmp_path, name, "out#.exr") == {name: "out#.exr"}


@pytest.mark.parametrize(
    ("pattern", "names"),
    [
        (
            "beauty.####.exr",
            {"beauty.-001.exr": "c.-001.exr", "beauty.0000.exr": "c.0000.exr", "beauty.0001.exr": "c.0001.exr"},
        ),
        ("beauty.####.exr", {"beauty.-0010.exr": "c.-010.exr", "beauty.-0002.exr": "c.-002.exr"}),
        ("beauty.#.exr", {"beauty.-10.exr": "c.-010.exr", "beauty.-2.exr": "c.-002.exr", "beauty.3.exr": "c.0003.exr"}),
        ("####.exr", {"-001.exr": "c.-001.exr", "12345.exr": "c.12345.exr"}),
        ("a-##_v2.exr", {"a--3_v2.exr": "c.-003.exr", "a-07_v2.exr": "c.0007.exr"}),
    ],
)
def test_negative_frames_belong_to_a_sequence_and_come_first(
    tmp_path: Path, pattern: str, names: dict[str, str]
) -> None:
    folder(tmp_path, *names, "other.txt")
    assert pairs(tmp_path, pattern, "c.####.exr") == names
    assert [path.name for path, _ in expand(tmp_path / pattern, tmp_path / "c.####.exr")] == list(names)


def test_similar_names_that_are_left_out_are_told(tmp_path: Path) -> None:
    similars = ["beauty.0001_old.exr", "beauty.12.exr", "beauty.v2.0003.exr"]
    folder(tmp_path, "beauty.0001.exr", *similars, "beauty.clean.0001.exr", "depth.0001.exr", "beauty.0001.png")
    source, output = tmp_path / "beauty.####.exr", tmp_path / "beauty.clean.####.exr"
    assert similar(source, output) == similars
    assert pairs(tmp_path, source.name, output.name) == {"beauty.0001.exr": "beauty.clean.0001.exr"}


@pytest.mark.parametrize(
    ("names", "pattern", "output", "message"),
    [
        (["a.0001.exr"], "a.%04d.exr", "o.exr", r"a\.%04d\.exr: no such file; .* with # for its digits: a\.####\.exr"),
        (["a.0001.exr"], "a.@@@@.exr", "o.exr", r"with # for its digits: a\.####\.exr"),
        (["a.0001.exr"], "a.%d.exr", "o.exr", r"with # for its digits: a\.#\.exr"),
        (["a.0001.exr"], "a.####.exr", "o.exr", "a sequence needs #### in the name of its output"),
        (["a.1.exr"], "a.####.exr", "o.####.exr", r"no file of that name with a frame number; there is a\.1\.exr"),
        (["a.exr"], "a.exr", "o.#.exr", "# stands for a frame number"),
        (["a.-001.exr", "a.-0001.exr"], "a.####.exr", "o.####.exr", "are both frame -1"),
    ],
)
def test_what_is_wrong_with_a_name_is_said_with_the_cure(
    tmp_path: Path, names: list[str], pattern: str, output: str, message: str
) -> None:
    folder(tmp_path, *names)
    with pytest.raises(InputError, match=message):
        expand(tmp_path / pattern, tmp_path / output)


def test_the_command_tells_what_it_left_out(run, tmp_path: Path) -> None:
    for name in ("a.-001.exr", "a.0002.exr", "a.3.exr"):
        beauty(tmp_path / name)
    code, out, _ = run("denoise", tmp_path / "a.####.exr", "-o", tmp_path / "o.####.exr", "-m", "single-3")
    assert code == 0
    assert "not of the sequence a.####.exr: a.3.exr" in out
    assert (tmp_path / "o.-001.exr").is_file()
    assert (tmp_path / "o.0002.exr").is_file()
