"""Files of several pictures and layers through a denoiser: whose layer is filtered with whose kernels."""

from pathlib import Path

import numpy as np
import pytest
from exr_files import SIZE, noise, part, write
from pathfold import Denoiser, channels
from pathfold.files import denoise_file, read
from pathfold.images import ImageError, ImageFile

RGB = "RGB"


def filtered(color: np.ndarray, layer: np.ndarray) -> np.ndarray:
    return Denoiser("single-3").run(color, layers={"layer": {"color": layer}}, exposure=1.0).layers["layer"]


def one_part(path: Path, layers: dict[str, str], seed: int = 0) -> Path:
    names = [f"{layer}.{c}" if layer else c for layer, letters in layers.items() for c in letters]
    return write(path, [part("", names, ["float"] * len(names), noise(len(names), seed))])


def pixels(file: ImageFile, name: str) -> np.ndarray:
    layer = file.layer(name)
    assert layer
    return file.read(layer.part, layer.pick(3) or [])


@pytest.mark.parametrize("told_by", ["alpha", "normal"])
def test_an_albedo_that_is_0_on_misses_is_completed(tiny: Path, tmp_path: Path, told_by: str) -> None:
    width, height = SIZE
    names = [*RGB, "A", *(f"albedo.{c}" for c in RGB), *(f"nn.{c}" for c in "XYZ"), "dd.T"]
    values, covered = noise(len(names)), np.zeros((height, width, 1), np.float32)
    covered[:, :5], covered[:, 5] = 1, 0.25
    values[..., 3:4] = covered if told_by == "alpha" else 1
    values[..., 4:7], values[..., 7:10], values[..., 10:] = 0.4 * covered, covered * np.float32([0.6, 0, -0.8]), covered
    header = {"generatedBy": "Mitsuba version 3.9.1"}
    file = ImageFile(write(tmp_path / "in.exr", [part("", names, ["float"] * len(names), values, **header)]))
    (frame,) = channels.match(file)
    buffers, converted = read(file, frame, ["color"], ["albedo"])
    assert buffers["albedo"] == pytest.approx((values[..., 4:7] + 1 - covered), abs=1e-6)
    assert set(buffers) == {"color", "alpha", "albedo"} and len(converted) == 1
    count = (covered < 1).sum()
    assert converted[0].startswith(f"albedo is 0 on misses: made 1 in {count} pixels, by coverage ({told_by}")
    assert np.array_equal(file.read(0, [4, 5, 6]), values[..., 4:7])  # the file's own stay


def test_each_eye_keeps_its_own_layers(tiny: Path, tmp_path: Path) -> None:
    parts, made = [], {}
    for seed, eye in enumerate(("left", "right")):
        for number, name in enumerate(("Combined", "Combined_key")):
            made[eye, name] = noise(3, 10 * seed + number)
            names = [f"VL.{name}.{letter}" for letter in RGB]
            parts.append(part(f"VL.{name}-{eye}", names, ["float"] * 3, made[eye, name], view=eye))
    source = write(tmp_path / "in.exr", parts)
    done = denoise_file(source, tmp_path / "out.exr", Denoiser("single-3"), layers=["VL.Combined_*"], exposures=[1.0])
    assert [one.layers for one in done] == [("VL.Combined_key",)] * 2
    clean = ImageFile(tmp_path / "out.exr")
    for number, eye in enumerate(("left", "right")):
        expected = filtered(made[eye, "Combined"], made[eye, "Combined_key"])
        assert clean.read(2 * number + 1, range(3)) == pytest.approx(expected, rel=1e-5), eye


def test_each_view_layer_keeps_its_own_layers(tiny: Path, tmp_path: Path) -> None:
    views = ("Far.Away", "Far", "Near")  # in the order of the file, which sorts by name
    layers = {f"{view}.{name}": RGB for view in views for name in ("Combined", "Combined_key")}
    source = one_part(tmp_path / "in.exr", {**layers, "matte": RGB})
    done = denoise_file(source, tmp_path / "out.exr", Denoiser("single-3"), layers=["*_key"], exposures=[1.0])
    assert [one.layers for one in done] == [(f"{view}.Combined_key",) for view in views]
    before, after = ImageFile(source), ImageFile(tmp_path / "out.exr")
    for view in views:
        picture, key = pixels(before, f"{view}.Combined"), pixels(before, f"{view}.Combined_key")
        assert pixels(after, f"{view}.Combined_key") == pytest.approx(filtered(picture, key), rel=1e-5)
    with pytest.raises(ImageError, match="--layer matte: nothing to filter: matte belongs to none of the file's pict"):
        denoise_file(source, tmp_path / "out.exr", Denoiser("single-3"), layers=["matte"])


def test_layers_of_one_name_in_two_parts(tiny: Path, tmp_path: Path) -> None:
    main = part("main", list(RGB), ["float"] * 3, noise(3))
    keys = [part(name, [f"key.{c}" for c in RGB], ["float"] * 3, noise(3, 5 + i)) for i, name in enumerate("ab")]
    source = write(tmp_path / "in.exr", [main, *keys])
    (done,) = denoise_file(source, tmp_path / "out.exr", Denoiser("single-3"), layers=["key"], exposures=[1.0])
    assert done.layers == ("key", "key")
    clean = ImageFile(tmp_path / "out.exr")
    for number, (_, pixels) in enumerate(keys):
        assert clean.read(number + 1, range(3)) == pytest.approx(filtered(noise(3), pixels), rel=1e-5)


def test_a_layer_of_one_channel_is_filtered(tiny: Path, tmp_path: Path) -> None:
    source = one_part(tmp_path / "in.exr", {"": RGB, "shadow": "Y"})
    (done,) = denoise_file(source, tmp_path / "out.exr", Denoiser("single-3"), layers=["shadow"], exposures=[1.0])
    assert done.layers == ("shadow",)
    before, after = ImageFile(source).read(0, range(4)), ImageFile(tmp_path / "out.exr").read(0, range(4))
    assert after[..., 3:] == pytest.approx(filtered(before[..., :3], before[..., 3:]), rel=1e-5)


def test_a_layer_that_cannot_be_filtered_is_said(tiny: Path, tmp_path: Path) -> None:
    size = (SIZE[0] // 2, SIZE[1])
    main = part("main", [*RGB, "motion.U", "motion.V"], ["float"] * 5, noise(5))
    half = part("half", ["half.R", "half.G", "half.B"], ["float"] * 3, noise(3, size=size))
    half[0].full_width, half[0].x = SIZE[0], SIZE[0]
    source, target = write(tmp_path / "in.exr", [main, half]), tmp_path / "out.exr"
    for pattern, reason in {
        "half": "half is 6x9 at 12,0, beside the picture, 12x9 at 0,0",
        "motion": "motion has U, V; R, G, B or one channel can be filtered",
        "main": "main is the picture itself",
    }.items():
        with pytest.raises(ImageError, match=f"--layer {pattern}: nothing to filter: .*{reason}"):
            denoise_file(source, target, Denoiser("single-3"), layers=[pattern])
    assert not target.exists()
