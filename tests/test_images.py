"""Picture files: what is read, and that all but the changed channels comes back as it was."""

import stat
from pathlib import Path

import numpy as np
import OpenImageIO as oiio  # noqa: N813
import pytest
from exr_files import SIZE, noise, part, write
from pathfold.images import HALF_MAX, ImageError, ImageFile, NewPart, OutputError, replacing, save_as, write_parts


@pytest.fixture
def mixed(tmp_path: Path) -> Path:
    """One part of half, float and integer channels, with odd bit patterns, and a second part."""
    values = noise(6)
    values[0, 0, 4] = np.uint32(0x00000007).view(np.float32)  # an id hash: a denormal as a float
    values[0, 1, 4] = np.inf
    values[..., 5] = np.arange(values[..., 5].size).reshape(values.shape[:2]) / 4294967295.0
    first = part(
        "",
        ["R", "G", "B", "A", "crypto.R", "id"],
        ["half", "half", "half", "half", "float", "uint"],
        values,
        artist="nobody",
        frame=7,
    )
    return write(tmp_path / "mixed.exr", [first])


def test_only_the_changed_channels_change(mixed: Path, tmp_path: Path) -> None:
    file = ImageFile(mixed)
    new = np.full((SIZE[1], SIZE[0]), 0.5, np.float32)
    save_as(file, tmp_path / "out.exr", {(0, 0): new}, metadata={"pathfold:model": "tiny"})

    again = ImageFile(tmp_path / "out.exr")
    assert again.parts[0].channelnames == file.parts[0].channelnames
    assert list(map(str, again.parts[0].channelformats)) == list(map(str, file.parts[0].channelformats))
    before, after = file.read(0, range(6)), again.read(0, range(6))
    assert (after[..., 0] == 0.5).all()
    assert before[..., 1:].tobytes() == after[..., 1:].tobytes()
    header = again.metadata()
    assert (header["artist"], header["frame"], header["compression"]) == ("nobody", 7, "zips")
    assert header["pathfold:model"] == "tiny"


def test_integers_that_would_be_bent_are_an_error(tmp_path: Path) -> None:
    values = noise(4)
    values[..., 3] = 0.9  # ids up to 3.9e9
    path = write(tmp_path / "a.exr", [part("", ["R", "G", "B", "id"], ["half"] * 3 + ["uint"], values)])
    with pytest.raises(OutputError, match="channel 'id' holds integers above 8388608"):
        save_as(ImageFile(path), tmp_path / "out.exr", {(0, 0): values[..., 0]})
    assert list(tmp_path.iterdir()) == [path]


def test_half_channels_stay_finite(mixed: Path, tmp_path: Path) -> None:
    save_as(ImageFile(mixed), tmp_path / "out.exr", {(0, 0): np.full((SIZE[1], SIZE[0]), 1e9, np.float32)})
    assert (ImageFile(tmp_path / "out.exr").read(0, [0]) == HALF_MAX).all()


def test_untouched_parts_are_copied_and_parts_can_be_left_out(tmp_path: Path) -> None:
    parts = [
        part("beauty", ["R", "G", "B"], ["half"] * 3, noise(3, 1)),
        part("id", ["id.u"], ["uint"], np.full((SIZE[1], SIZE[0], 1), 0.75)),
        part("strip", ["s.R", "s.G", "s.B"], ["float"] * 3, noise(3, 2, (SIZE[0], 5))),
    ]
    parts[2][0].full_height = SIZE[1]
    file = ImageFile(write(tmp_path / "in.exr", parts))
    save_as(file, tmp_path / "out.exr", {(0, 1): np.zeros((SIZE[1], SIZE[0]), np.float32)}, leave_out=[2])
    again = ImageFile(tmp_path / "out.exr")
    assert [again.part_name(number) for number in range(len(again.parts))] == ["beauty", "id"]
    raw = [opened.input.read_image(1, 0, 0, 1, oiio.UINT) for opened in (file, again)]
    assert (raw[0] == raw[1]).all() and raw[0].max() > 2**31


def test_deep_parts_are_named() -> None:
    file = ImageFile.__new__(ImageFile)
    file.path, file.parts = (
        Path("in.exr"),
        [oiio.ImageSpec(*SIZE, 3, oiio.HALF), oiio.ImageSpec(*SIZE, 2, oiio.HALF)],
    )
    file.parts[1].deep = True
    file.parts[1].attribute("oiio:subimagename", "fog")
    with pytest.raises(OutputError, match="part 'fog' is deep"):
        save_as(file, "out.exr", {})


def test_tiles_and_windows_are_kept(tmp_path: Path) -> None:
    spec, values = part("", ["R", "G", "B"], ["half"] * 3, noise(3, size=(40, 24)))
    spec.tile_width = spec.tile_height = 16
    spec.x, spec.y, spec.full_width, spec.full_height = 3, 5, 64, 48
    write(tmp_path / "in.exr", [(spec, values)])
    save_as(ImageFile(tmp_path / "in.exr"), tmp_path / "out.exr", {(0, 2): values[..., 0]})
    after = ImageFile(tmp_path / "out.exr").parts[0]
    assert (after.tile_width, after.x, after.y, after.full_width) == (16, 3, 5, 64)


def test_new_parts_come_back(tmp_path: Path) -> None:
    size, deep = (7, 150), 1500  # more rows than a band, more channels than OpenImageIO opens by default
    values = np.random.default_rng(3).normal(0, 1e5, (size[1], size[0], deep)).astype(np.float32)
    part = NewPart("many", [f"c{i:04d}" for i in range(deep)], ["float"] * deep, size, lambda a, b: values[a:b])
    write_parts(tmp_path / "new.exr", [part], {"pathfold:version": "0", "pathfold:spp": 8})
    file = ImageFile(tmp_path / "new.exr")
    assert np.concatenate([rows for _, rows in file.bands(0)]).tobytes() == values.tobytes()
    assert file.metadata()["pathfold:spp"] == 8
    assert file.read(0, [9, 4]).tolist() == values[..., [9, 4]].tolist()


def test_layers_of_parts(tmp_path: Path) -> None:
    parts = [
        part("rgba", ["R", "G", "B", "A", "albedo.red"], ["half"] * 5, noise(5)),
        part("normal", ["X", "Y", "Z"], ["half"] * 3, noise(3)),
        part("VL.Depth", ["VL.Depth.V"], ["float"], noise(1)),
    ]
    file = ImageFile(write(tmp_path / "parts.exr", parts))
    assert [layer.names for layer in file.layers] == [
        ("rgba", ""),
        ("albedo", "rgba.albedo"),
        ("normal",),
        ("VL.Depth",),
    ]


@pytest.mark.parametrize("content", [b"", b"hello" * 100, b"\x76\x2f\x31\x01" + bytes(60)])
def test_what_is_no_picture_is_named(tmp_path: Path, content: bytes) -> None:
    path = tmp_path / "bad.exr"
    path.write_bytes(content)
    with pytest.raises(ImageError, match=r"bad.exr: not a picture"):
        ImageFile(path)


def test_missing_files_and_folders_are_named(tmp_path: Path) -> None:
    with pytest.raises(ImageError, match=r"none.exr: no such file"):
        ImageFile(tmp_path / "none.exr")
    with pytest.raises(ImageError, match="is not a file"):
        ImageFile(tmp_path)


def test_truncated_pixels_are_named(mixed: Path) -> None:
    mixed.write_bytes(mixed.read_bytes()[:-200])
    with pytest.raises(ImageError, match=r"mixed.exr: "):
        ImageFile(mixed).read(0, range(6))


def test_a_failure_leaves_nothing(tmp_path: Path) -> None:
    target = tmp_path / "out.exr"
    target.write_text("old")
    with pytest.raises(RuntimeError, match="midway"), replacing(target) as unfinished:
        unfinished.write_text("half of it")
        raise RuntimeError("midway")
    assert target.read_text() == "old" and list(tmp_path.iterdir()) == [target]


def test_outputs_that_cannot_be(tmp_path: Path) -> None:
    with pytest.raises(OutputError, match="No such file or directory"), replacing(tmp_path / "no" / "x.exr"):
        pass
    with pytest.raises(OutputError, match="is a folder"), replacing(tmp_path):
        pass
    with pytest.raises(OutputError, match=r"x.nonsense"):
        write_parts(tmp_path / "x.nonsense", [], {})
    assert list(tmp_path.iterdir()) == []


def test_written_files_get_ordinary_permissions(tmp_path: Path) -> None:
    plain = tmp_path / "plain"
    plain.touch()
    with replacing(tmp_path / "out.txt") as unfinished:
        unfinished.write_text("x")
    assert stat.S_IMODE((tmp_path / "out.txt").stat().st_mode) == stat.S_IMODE(plain.stat().st_mode)
