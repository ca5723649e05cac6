"""`info` of a picture, and its sheet of thumbnails."""

import re
from pathlib import Path

import numpy as np
import OpenImageIO as oiio  # noqa: N813
import pytest
from exr_files import RGB, noise, part, with_samples, write
from pathfold import Denoiser, channels, sheet
from pathfold.cli import console

XYZ = "XYZ"


def layered(path: Path, layers: dict[str, str], **header: object) -> Path:
    names = [f"{layer}.{c}" if layer else c for layer, letters in layers.items() for c in letters]
    return write(path, [part("", names, ["half"] * len(names), noise(len(names)), **header)])


def picture(path: Path) -> np.ndarray:
    return np.asarray(oiio.ImageBuf(str(path)).get_pixels())


def rows(out: str) -> list[list[str]]:
    return [re.split(r"\s{2,}", line) for line in out.splitlines()]


def test_the_mapping_is_a_row_per_buffer(run, tmp_path: Path) -> None:
    layers = {
        "VL.Combined": "RGBA",
        "VL.Denoising Normal": XYZ,
        "VL.DiffDir": RGB,
        "VL.DiffInd": RGB,
        "VL.DiffCol": RGB,
    }
    code, out, err = run(
        "info", layered(tmp_path / "a.exr", {**layers, "VL.my normals": XYZ, "VL.key": RGB, "VL.id": "A"})
    )
    assert (code, err) == (0, "")
    told = rows(out)
    assert ["color", "VL.Combined", "0", "R,G,B", "half", "12x9"] in told
    assert ["alpha", "VL.Combined", "0", "A", "half", "12x9"] in told
    assert ["normal", "VL.Denoising Normal", "0", "X,Y,Z", "half", "12x9"] in told
    assert "diffuse = (VL.DiffDir + VL.DiffInd) * VL.DiffCol" in out and "channel names of Blender Cycles" in out
    reasons = {row[0]: row[-1] for row in told}
    assert "--map 'normal=VL.my normals' would use it" in reasons["VL.my normals"]
    assert "--layer VL.key filters it" in reasons["VL.key"] and reasons["VL.id"] == "no buffer; kept as it is"
    assert "not found: albedo, depth, variance" in out


def test_parts_views_and_windows_are_told(run, tmp_path: Path) -> None:
    small = part("N", [*RGB], ["half"] * 3, noise(3, size=(6, 5)))
    small[0].x, small[0].y = 2, 3
    small[0].full_x, small[0].full_y, small[0].full_width, small[0].full_height = 0, 0, 12, 9
    right = part("rgba_main", [*RGB, "A"], ["half"] * 4, noise(4))
    code, out, _ = run("info", write(tmp_path / "a.exr", [small, right]))
    told = rows(out)
    assert code == 0 and ["color", "rgba_main", "1 rgba_main", "R,G,B", "half", "12x9"] in told
    assert ["normal", "N", "0 N", "R,G,B", "half", "6x5 at 2,3"] in told
    assert "normal (N) is 6x5 at 2,3, the picture 12x9 at 0,0: a miss outside" in out


def test_what_would_be_converted_is_told(run, tmp_path: Path) -> None:
    normal = np.zeros((9, 12, 3), np.float32) + 0.5
    normal[:, :6] += np.float32([0, 0.3, 0.4])
    values = np.concatenate([noise(3), np.where(normal == 0.5, 0, 0.4) * np.ones(3), normal], -1)
    values[:, :6, 3:6] = 0.4
    names = [*RGB, *(f"albedo.{c}" for c in RGB), *(f"nn.{c}" for c in XYZ)]
    source = write(tmp_path / "a.exr", [part("", names, ["float"] * 9, values, generatedBy="Mitsuba 3")])
    out = run("info", source)[1]
    assert "albedo is 0 on misses: made 1 in 54 pixels" in out and "normal is stored as 0.5 n + 0.5: decoded" in out


@pytest.mark.parametrize("noisy", [False, True])
@pytest.mark.parametrize("stored", ["plain", "encoded"])
def test_encoded_normals_are_known_by_their_values_as_to_the_sdk(tiny: Path, stored: str, noisy: bool) -> None:
    rng = np.random.default_rng(3)
    each = rng.normal(size=(40, 50, 4 if noisy else 1, 3)) * 0.5 - [0, 0, 1]
    normal = (each / np.linalg.norm(each, axis=-1, keepdims=True)).mean(-2).astype(np.float32)
    normal[:5] = 0
    held = 0.5 * normal + 0.5 if stored == "encoded" else normal
    assert channels.encoded(held) == (stored == "encoded")
    notes = Denoiser("split-5").run(noise(3, size=(50, 40)), normal=held).report["notes"]
    assert any("0.5 n + 0.5" in note for note in notes) == (stored == "encoded")


def test_no_color_is_told_and_drawn(run, tmp_path: Path) -> None:
    source, drawn = layered(tmp_path / "a.exr", {"foo_albedo": RGB, "foo_x": RGB}), tmp_path / "sheet.png"
    code, out, err = run("info", source, "--sheet", drawn)
    assert (code, err) == (0, "")
    assert "no color found; it has foo_albedo, foo_x; name it with --map color=LAYER" in out
    assert picture(drawn).std() > 0.1


def test_a_picture_for_a_display_is_told_to_be_none_to_denoise(run, tmp_path: Path) -> None:
    buffer = oiio.ImageBuf(noise(3) / 4)
    assert buffer.write(str(tmp_path / "a.png"), "uint8")
    code, out, _ = run("info", tmp_path / "a.png")
    assert code == 0 and ["color", "R,G,B", "0", "R,G,B", "uint8", "12x9"] in rows(out)
    assert "a.png: holds uint8 display values; linear floating point is needed (EXR)" in out


def test_a_damaged_file_is_told_and_drawn(run, tmp_path: Path) -> None:
    source, drawn = layered(tmp_path / "a.exr", {"": "RGBA", "albedo": RGB}), tmp_path / "sheet.png"
    held = source.read_bytes()
    source.write_bytes(held[: len(held) * 2 // 3])
    code, out, err = run("info", source, "--sheet", drawn)
    assert code == 0 and "a.exr: damaged: " in out and ["albedo", "albedo", "0", "R,G,B", "half", "12x9"] in rows(out)
    assert drawn.is_file()
    source.write_bytes(held[:40])
    code, out, err = run("info", source, "--sheet", tmp_path / "none.png")
    assert code == console.INPUT and "a.exr: " in err and not (tmp_path / "none.png").exists()


def test_every_layer_has_a_place_on_the_sheet(run, tmp_path: Path) -> None:
    sizes = []
    for count in (1, 4, 9):
        source = layered(tmp_path / f"{count}.exr", {"": "RGBA", **{f"layer{i}": RGB for i in range(count)}})
        assert run("info", source, "--sheet", tmp_path / f"{count}.png")[0] == 0
        sizes.append(picture(tmp_path / f"{count}.png").shape)
    assert sizes[0][1] < sizes[1][1] == sizes[2][1] and sizes[0][0] < sizes[1][0] < sizes[2][0]


def test_a_sheet_that_cannot_be_is_refused_at_once(run, tmp_path: Path) -> None:
    source = with_samples(tmp_path / "a.exr")
    code, out, err = run("info", source, "--sheet", tmp_path / "sheet.exr")
    assert (code, out) == (console.OUTPUT, "") and "name it sheet.png" in err
    code, out, err = run("info", source, "--sheet", tmp_path / "no" / "sheet.png")
    assert (code, out) == (console.OUTPUT, "") and "cannot be written" in err
    code, _, err = run("info", "split-5", "--sheet", tmp_path / "sheet.png")
    assert code == console.USAGE and "--sheet draws the layers of a picture" in err


def test_names_cannot_steer_a_terminal(run, tmp_path: Path) -> None:
    source = layered(tmp_path / "a.exr", {"": RGB, "\x1b[31mred\u202e": RGB, "[bold]x[/]": RGB})
    out = run("info", source, "--sheet", tmp_path / "sheet.png")[1]
    assert "\x1b" not in out and "\\x1b[31mred\\u202e" in out and "[bold]x[/]" in out


def test_thumbnails_show_a_layer_by_what_it_is() -> None:
    rng = np.random.default_rng(1)
    normal = np.zeros((30, 40, 3), np.float32)
    normal[:, 20:] = [0, 1, 0]
    seen = sheet.thumbnail(sheet.Tile(normal, "normal", "N"), 40)
    assert seen.shape == (30, 40, 3) and seen[5, 5] == pytest.approx(0) and seen[5, 35] == pytest.approx([0.5, 1, 0.5])
    coded = sheet.thumbnail(sheet.Tile(0.5 * normal + 0.5, "normal", "N"), 40)
    assert coded[5, 35] == pytest.approx([0.5, 1, 0.5])
    depth = np.linspace(1, 9, 40, dtype=np.float32)[None, :, None].repeat(30, 0)
    depth[:3] = 1e10
    seen = sheet.thumbnail(sheet.Tile(depth, "depth", "Z"), 40)
    assert (
        (seen[:3] == 0).all() and (np.diff(seen[10, :, 0]) <= 0).all() and seen[10, 0, 0] > 0.9 > 0.2 > seen[10, -1, 0]
    )
    light = rng.gamma(1, 1e4, (30, 40, 3)).astype(np.float32)
    light[4, 4, 1] = np.nan
    seen = sheet.thumbnail(sheet.Tile(light, "color", "C"), 40)
    assert seen[4, 4] == pytest.approx([1, 0, 0.8], abs=1e-6) and 0.2 < np.median(seen) < 0.8


@pytest.mark.parametrize("shape", [(1, 1, 3), (1, 4000, 3), (4000, 1, 1), (900, 1600, 3), (7, 5, 2)])
@pytest.mark.parametrize("value", [0.0, -3.0, 1e-38, 3e38, np.nan, np.inf])
@pytest.mark.parametrize("role", ["color", "albedo", "normal", "depth", "variance", sheet.UNUSED])
def test_thumbnails_of_anything_are_display_values(shape: tuple, value: float, role: str) -> None:
    channels = np.full((*shape[:2], 3 if shape[-1] == 2 else shape[-1]), value, np.float32)
    seen = sheet.thumbnail(sheet.Tile(channels, role, "x"), 32)
    assert seen.shape[1:] == (32, 3) and seen.min() >= -1e-6 and seen.max() <= 1 + 1e-6
