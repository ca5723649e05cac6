"""What is written is what was handed over: compressions, levels, links, permissions, other formats; odd texts."""

import os
import stat
from collections.abc import Callable
from pathlib import Path

import numpy as np
import OpenImageIO as oiio  # noqa: N813
import pytest
from exr_files import RGB, part, write
from pathfold.denoiser import Denoiser
from pathfold.files import denoise_file
from pathfold.images import ImageError, ImageFile, OutputError, save_as, why

LOSSLESS = ["none", "rle", "zip", "zips", "piz"]
LOSSY = ["b44", "b44a", "dwaa:45", "dwaa:1", "dwab:200", "dwab:7"]
KEY = [f"key.{c}" for c in RGB]


def picture(seed: int = 0, size: int = 40) -> np.ndarray:
    return np.random.default_rng(seed).gamma(2.0, 0.5, (size, size, 3)).astype(np.float32)


def bright() -> np.ndarray:
    """Shapes near the largest half beside dark ones: what a cosine transform overshoots."""
    rng = np.random.default_rng(3)
    pixels = picture(1)
    for y, x in rng.integers(0, 34, (6, 2)):
        pixels[y : y + 9, x : x + 9] = rng.uniform(5e4, 65504)
    return pixels


def source(path: Path, compression: str, kind: str) -> Path:
    values = np.dstack([picture(), picture(1)])
    return write(path, [part("", RGB + KEY, [kind] * 6, values, compression=compression)])


def changed(pixels: np.ndarray, at: int = 0) -> dict:
    return {(at, number): pixels[..., number] for number in range(3)}


def read(path: Path, number: int = 0) -> np.ndarray:
    file = ImageFile(path)
    return file.read(number, range(file.parts[number].nchannels))


def stored(path: Path, number: int = 0) -> tuple[str, float]:
    spec = ImageFile(path).parts[number]
    return spec.get_string_attribute("compression"), spec.get_float_attribute("openexr:dwaCompressionLevel", 0.0)


@pytest.mark.parametrize("kind", ["half", "float"])
@pytest.mark.parametrize("compression", [*LOSSLESS, "pxr24", *LOSSY])
def test_compression_and_its_level_stay_and_loss_is_told(tmp_path: Path, compression: str, kind: str) -> None:
    before = source(tmp_path / "in.exr", compression, kind)
    lines = save_as(ImageFile(before), tmp_path / "out.exr", changed(picture(2)))
    assert stored(tmp_path / "out.exr") == stored(before)
    loses = (
        compression[:3] == "dwa"
        or (compression[:3] == "b44" and kind == "half")
        or (compression, kind) == ("pxr24", "float")
    )
    assert len(lines) == loses
    if loses:
        assert lines[0].startswith("stored with loss, as it was")
    else:
        assert np.array_equal(read(tmp_path / "out.exr")[..., 3:], read(before)[..., 3:])


@pytest.mark.parametrize("scale", [1.0, 1e4, -1.0])
@pytest.mark.parametrize("kind", ["half", "float"])
@pytest.mark.parametrize("compression", ["dwaa:45", "dwab:200", "dwaa:1", "b44", "pxr24", "zip"])
def test_what_is_finite_is_finite_when_read_back(tmp_path: Path, compression: str, kind: str, scale: float) -> None:
    before = source(tmp_path / "in.exr", compression, kind)
    lines = save_as(ImageFile(before), tmp_path / "out.exr", changed(bright() * scale))
    after = read(tmp_path / "out.exr")
    assert np.isfinite(after).all()
    if compression != "zip" and stored(tmp_path / "out.exr")[0] == "zip":
        assert "would become infinite" in lines[0]
        expected = bright() * scale if kind == "float" else np.clip(bright() * scale, -65504, 65504)
        np.testing.assert_allclose(after[..., :3], expected, rtol=1e-3)
    else:
        assert stored(tmp_path / "out.exr") == stored(before) or scale != 1.0


@pytest.mark.parametrize("compression", [*LOSSY, "piz", "pxr24"])
def test_parts_without_a_change_are_kept_to_the_bit(tmp_path: Path, compression: str) -> None:
    parts = [
        part("beauty", RGB, ["half"] * 3, picture(), compression=compression),
        part("key", RGB, ["half"] * 3, picture(1), compression=compression),
        part("id", ["id"], ["uint"], np.full((40, 40, 1), 0.123), compression="zip"),
    ]
    before = write(tmp_path / "in.exr", parts)
    lines = save_as(ImageFile(before), tmp_path / "out.exr", changed(picture(2)))
    for number in (1, 2):
        assert np.array_equal(read(tmp_path / "out.exr", number), read(before, number))
    told = [line for line in lines if line.startswith("part 1: stored without loss")]
    assert len(told) == (compression in LOSSY)
    assert stored(tmp_path / "out.exr", 1)[0] == ("zip" if told else compression)


@pytest.mark.parametrize("name", ["in.exr", "in.tif"])
def test_of_mip_maps_only_what_is_written_is_promised(tmp_path: Path, name: str) -> None:
    settings = oiio.ImageSpec()
    pixels = oiio.ImageBuf(picture(size=64))
    assert oiio.ImageBufAlgo.make_texture(oiio.MakeTxTexture, pixels, str(tmp_path / name), settings)
    after = tmp_path / f"out{Path(name).suffix}"
    lines = save_as(ImageFile(tmp_path / name), after, changed(picture(2, 64)))
    assert lines == ["mip maps are left out, they would show the picture as it was: 1 of 7 levels stays"]
    opened = oiio.ImageInput.open(str(after))
    assert opened.spec().get_int_attribute("oiio:miplevels", 1) == 1
    assert opened.spec().tile_width == 64
    assert opened.spec().get_string_attribute("oiio:AverageColor") == ""
    assert not opened.seek_subimage(0, 1)
    np.testing.assert_allclose(read(after), picture(2, 64), rtol=1e-3)


@pytest.mark.parametrize(("name", "tolerance"), [("out.pfm", 0), ("out.tif", 0), ("out.hdr", 0.05)])
def test_other_formats_hold_the_same_picture(tmp_path: Path, name: str, tolerance: float) -> None:
    before = write(tmp_path / "in.exr", [part("", RGB, ["float"] * 3, picture())])
    lines = save_as(ImageFile(before), tmp_path / name, changed(picture(2)))
    assert bool(lines) == (name == "out.hdr")
    assert np.abs(read(tmp_path / name) - picture(2)).max() <= tolerance
    again = tmp_path / f"again{Path(name).suffix}"
    save_as(ImageFile(tmp_path / name), again, changed(picture(3)))
    assert np.abs(read(again) - picture(3)).max() <= tolerance


def test_a_pfm_begins_with_its_lowest_row(tmp_path: Path) -> None:
    rows = picture(size=4)
    (tmp_path / "a.pfm").write_bytes(b"PF\n4 4\n-1.0\n" + rows[::-1].astype("<f4").tobytes())
    assert np.array_equal(read(tmp_path / "a.pfm"), rows)


def test_what_a_format_cannot_hold_is_said(tmp_path: Path) -> None:
    several = source(tmp_path / "in.exr", "zip", "half")
    assert "no names of channels are kept" in save_as(ImageFile(several), tmp_path / "o.tif", changed(picture(2)))[0]
    with pytest.raises(OutputError, match=r"o\.pfm: cannot be written: .*channel"):
        save_as(ImageFile(several), tmp_path / "o.pfm", changed(picture(2)))
    parts = [part(name, RGB, ["half"] * 3, picture()) for name in ("a", "b")]
    with pytest.raises(OutputError, match="this format holds one picture"):
        save_as(ImageFile(write(tmp_path / "two.exr", parts)), tmp_path / "o.hdr", changed(picture(2)))


@pytest.mark.parametrize("exists", [True, False])
def test_a_link_is_written_through(tiny: Path, tmp_path: Path, exists: bool) -> None:
    noisy = write(tmp_path / "in.exr", [part("", RGB, ["half"] * 3, picture())])
    (tmp_path / "shots").mkdir()
    target = tmp_path / "shots" / "real.exr"
    if exists:
        target.write_bytes(b"old")
        target.chmod(0o640)
    link, chain = tmp_path / "link.exr", tmp_path / "chain.exr"
    link.symlink_to(Path("shots") / "real.exr")
    chain.symlink_to(link)
    denoise_file(noisy, chain, Denoiser("single-3"))
    assert chain.is_symlink()
    assert link.is_symlink()
    assert read(target).shape == (40, 40, 3)
    if exists:
        assert stat.S_IMODE(target.stat().st_mode) == 0o640
    assert sorted(path.name for path in (tmp_path / "shots").iterdir()) == ["real.exr"]


def test_a_file_that_is_written_over_keeps_its_permissions(tmp_path: Path) -> None:
    before = source(tmp_path / "in.exr", "zip", "half")
    before.chmod(0o604)
    save_as(ImageFile(before), before, changed(picture(2)))
    assert stat.S_IMODE(before.stat().st_mode) == 0o604


def test_what_is_no_file_is_not_replaced(tmp_path: Path) -> None:
    os.mkfifo(tmp_path / "pipe.exr")
    with pytest.raises(OutputError, match=r"pipe\.exr: is no file that can be replaced"):
        save_as(ImageFile(source(tmp_path / "in.exr", "zip", "half")), tmp_path / "pipe.exr", changed(picture(2)))
    assert stat.S_ISFIFO((tmp_path / "pipe.exr").stat().st_mode)


class _Quotes:
    def __init__(self, text: bytes) -> None:
        self.text = text

    def geterror(self) -> str:
        return self.text.decode()


@pytest.mark.parametrize(
    ("said", "told"),
    [(b"", ""), (b"no such\nthing", "no such"), (b"channel \xff\xfe is odd", "channel \ufffd\ufffd is odd")],
)
def test_errors_of_openimageio_are_read_in_any_encoding(said: bytes, told: str) -> None:
    assert why(_Quotes(said)) == told


def _spoil(path: Path, old: bytes, new: bytes) -> Path:
    content = path.read_bytes()
    assert old in content
    path.write_bytes(content.replace(old, new))
    return path


@pytest.mark.parametrize("spoil", [(b"key.R", b"key.\xff"), (b"zzzzcompressed", b"\xff\xfe\xfd\xfccompressed")])
def test_a_header_that_is_not_utf8_is_an_error_or_is_copied(
    tiny: Path, tmp_path: Path, spoil: tuple[bytes, bytes]
) -> None:
    values = np.dstack([picture(), picture(1)])
    before = write(tmp_path / "in.exr", [part("", RGB + KEY, ["half"] * 6, values, owner="zzzzcompressed")])
    _spoil(before, *spoil)
    try:
        denoise_file(before, tmp_path / "out.exr", Denoiser("single-3"))
    except ImageError as error:
        assert "not UTF-8" in str(error)
    else:
        assert spoil[1] in (tmp_path / "out.exr").read_bytes()


@pytest.mark.parametrize("use", [lambda path: ImageFile(path), lambda path: save_as(ImageFile(path), path, {})])
def test_a_name_that_is_not_utf8_is_said(tmp_path: Path, use: Callable[[Path], object]) -> None:
    odd = Path(os.fsdecode(os.fsencode(tmp_path) + b"/odd\xff.exr"))
    odd.write_bytes(source(tmp_path / "in.exr", "zip", "half").read_bytes())
    with pytest.raises(ImageError, match="its name is not UTF-8"):
        use(odd)
