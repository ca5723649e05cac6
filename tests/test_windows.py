"""Layers lie by pixel coordinates: guides in the file and beside it, further layers, samples, comparisons."""

from pathlib import Path

import numpy as np
import pytest
from exr_files import SIZE, noise, part, with_samples, write
from pathfold import Denoiser, channels
from pathfold.channels import samples
from pathfold.files import denoise_file
from pathfold.images import ImageError, ImageFile, Window, lay

RGB = list("RGB")
WIDTH, HEIGHT = SIZE
MISS = {"albedo": 1.0, "normal": 0.0, "depth": 0.0, "variance": np.nan}
CHANNELS = {"albedo": RGB, "normal": list("XYZ"), "depth": ["Z"], "variance": RGB}


def at(name: str, letters: list[str], values: np.ndarray, x: int = 0, y: int = 0) -> tuple:
    """A part with its pixels at x, y of the frame of SIZE."""
    names = [f"{name}.{letter}" if name else letter for letter in letters]
    made = part(name or "rgba", names, ["float"] * len(names), values, **{"pathfold:version": "0"})
    made[0].x, made[0].y, made[0].full_width, made[0].full_height = x, y, WIDTH, HEIGHT
    return made


def aligned(values: np.ndarray, x: int, y: int, outside: float) -> np.ndarray:
    whole = np.full((HEIGHT, WIDTH, values.shape[-1]), outside, np.float32)
    for row, column in np.ndindex(HEIGHT, WIDTH):
        if 0 <= row - y < values.shape[0] and 0 <= column - x < values.shape[1]:
            whole[row, column] = values[row - y, column - x]
    return whole


@pytest.mark.parametrize("place", [(3, 2, SIZE), (-4, -1, SIZE), (2, 3, (5, 4)), (-2, -3, (20, 20))])
@pytest.mark.parametrize("buffer", MISS)
@pytest.mark.parametrize("beside", [False, True], ids=["in the file", "beside it"])
def test_a_guide_lies_where_its_window_is(
    buffer: str, place: tuple[int, int, tuple[int, int]], beside: bool, tmp_path: Path
) -> None:
    x, y, size = place
    values = noise(len(CHANNELS[buffer]), 1, size)
    guide = at(buffer, CHANNELS[buffer], values, x, y)
    picture = at("", RGB, noise(3))
    file = ImageFile(write(tmp_path / "a.exr", [picture] if beside else [guide, picture]))
    guides = {buffer: write(tmp_path / "b.exr", [guide])} if beside else {}
    (frame,) = channels.match(file, {}, guides)
    expected = aligned(values, x, y, MISS[buffer])
    assert channels.load(file, frame, buffer) == pytest.approx(expected, nan_ok=True)
    covers = x <= 0 and y <= 0 and size[0] + x >= WIDTH and size[1] + y >= HEIGHT
    assert any("a miss outside" in note for note in frame.notes) == (not covers)


@pytest.mark.parametrize("beside", [False, True], ids=["in the file", "beside it"])
def test_a_guide_beside_the_picture_is_not_used(beside: bool, tmp_path: Path) -> None:
    guide, picture = at("albedo", RGB, noise(3), WIDTH, 0), at("", RGB, noise(3))
    file = ImageFile(write(tmp_path / "a.exr", [picture] if beside else [picture, guide]))
    (frame,) = channels.match(file, {}, {"albedo": write(tmp_path / "b.exr", [guide])} if beside else {})
    assert "albedo" not in frame.sources
    note = frame.notes[0]
    assert "albedo is not used, it lies beside the picture" in note and "12x9 at 12,0, the picture 12x9 at 0,0" in note


def test_a_file_of_another_frame_is_refused(tmp_path: Path) -> None:
    file = ImageFile(write(tmp_path / "a.exr", [at("", RGB, noise(3))]))
    half = write(tmp_path / "half.exr", [part("", RGB, ["half"] * 3, noise(3, size=(6, 5)))])
    with pytest.raises(ImageError, match="6x5 at 0,0 in a frame of 6x5 at 0,0, the picture is 12x9 at 0,0 in a frame"):
        channels.match(file, {}, {"albedo": half})


def test_the_result_is_that_of_aligned_buffers(tiny: Path, tmp_path: Path) -> None:
    color, albedo, key = noise(3), noise(3, 1, (6, 5)) / 4, noise(3, 2, (7, 6))
    parts = [at("albedo", RGB, albedo, 4, 3), at("", RGB, color), at("key", RGB, key, -2, 5)]
    source, target = write(tmp_path / "in.exr", parts), tmp_path / "out.exr"
    denoiser = Denoiser("single-3")
    (done,) = denoise_file(source, target, denoiser, layers=["key"], exposures=[1.0])
    line = "key is 7x6 at -2,5, the picture 12x9 at 0,0: beyond it the layer stays as noisy as before"
    assert done.converted == (line,)
    expected = denoiser.run(
        color,
        albedo=aligned(albedo, 4, 3, 1.0),
        layers={"key": {"color": aligned(key, -2, 5, 0.0)}},
        exposure=1.0,
    )
    clean = ImageFile(target)
    assert clean.read(1, range(3)) == pytest.approx(expected.color, rel=1e-5)
    filtered = clean.read(2, range(3))
    assert filtered[:4, 2:] == pytest.approx(expected.layers["key"][5:, :5], rel=1e-5)
    assert (filtered[:, :2] == key[:, :2]).all() and (filtered[4:] == key[4:]).all()  # beyond the picture
    assert (clean.parts[2].x, clean.parts[2].y) == (-2, 5)


def test_samples_lie_where_their_window_is(tmp_path: Path) -> None:
    file = ImageFile(with_samples(tmp_path / "a.exr"))
    plain = samples.load(file)
    moved = samples.load(file, Window(2, -1, 5, 6))
    for name, block in plain.items():
        assert (moved[name][:, 1:] == block[:, :5, 2:7]).all() and (moved[name][:, 0] == 0).all()
    assert (moved["valid"][:, 1:] == 1).all() and (moved["valid"][:, 0] == 0).all()


def test_pictures_are_compared_where_both_have_pixels(run, tmp_path: Path) -> None:
    values = noise(3, 4, (32, 24))

    def saved(name: str, pixels: np.ndarray, x: int, frame: tuple[int, int] = (32, 24)) -> Path:
        made = part("", RGB, ["float"] * 3, pixels)
        made[0].x, (made[0].full_width, made[0].full_height) = x, frame
        return write(tmp_path / name, [made])

    whole, shifted = saved("whole.exr", values, 0), saved("shifted.exr", values, 8)
    code, out, _ = run("compare", shifted, whole)
    assert code == 0 and "24x24 at 8,0" in out and "rell2  0\n" not in out
    code, out, _ = run("compare", saved("crop.exr", values[:, 8:], 8), whole)
    assert code == 0 and "rell2  0\n" in out and "24x24 at 8,0 of 24x24 at 8,0 and 32x24 at 0,0" in out
    for other in (saved("far.exr", values, 40), saved("frame.exr", values[:, 8:], 8, (64, 24))):
        code, _, err = run("compare", other, whole)
        assert code == 3 and "32x24 at 0,0 in a frame of 32x24 at 0,0; only pictures of one frame" in err


def test_pixels_laid_into_another_window() -> None:
    pixels = noise(2, 3, (4, 3))
    window, into = Window(-1, 5, 4, 3), Window(0, 0, 3, 7)
    laid = lay(pixels, window, into, -7.0)
    assert (laid[5:7] == pixels[:2, 1:]).all() and (laid[:5] == -7).all()
    assert lay(pixels, window, window, 0.0) is pixels
    below = noise(2, 4, (3, 7))
    assert (lay(pixels, window, into, below)[:5] == below[:5]).all()
    assert window.common(Window(3, 5, 1, 1)) is None and window.common(Window(2, 7, 9, 9)) == Window(2, 7, 1, 1)
