"""Stereo: whose view a layer is, by header, part and channel names; what has none serves all."""

from pathlib import Path

import numpy as np
import OpenImageIO as oiio  # noqa: N813
import pytest
from exr_files import noise, part, write
from pathfold import Denoiser, channels
from pathfold.channels import Frame
from pathfold.files import denoise_file
from pathfold.images import ImageFile

RGB = list("RGB")
EYES = ("left", "right")
MULTI_VIEW = {"multiView": (oiio.TypeDesc("string[2]"), EYES)}


def named(path: Path, names: list[str], declared: bool = True, **header: object) -> ImageFile:
    """One part with R, G, B of each layer; "" is the main picture."""
    full = [f"{name}.{letter}" if name else letter for name in names for letter in RGB]
    made = part("", full, ["float"] * len(full), noise(len(full)), **header)
    if declared:
        made[0].attribute("multiView", *MULTI_VIEW["multiView"])
    return ImageFile(write(path, [made]))


def of_parts(path: Path, parts: dict[str, str], names: dict[str, list[str]] | None = None) -> ImageFile:
    """Parts with their view ("" is none said) and their channels (bare R, G, B)."""
    made = [
        part(name, (names or {}).get(name, RGB), ["float"] * 3, noise(3, at), **({"view": view} if view else {}))
        for at, (name, view) in enumerate(parts.items())
    ]
    return ImageFile(write(path, made))


def channels_of(file: ImageFile, frame: Frame) -> dict[str, str]:
    """The first channel that each buffer reads, with its part."""
    taken = {}
    for name, source in frame.sources.items():
        (layer,) = source.layers
        number = (source.numbers(layer, 3) or [0])[0]
        where = f"{file.part_name(layer.part)}:" if len(file.parts) > 1 else ""
        taken[name] = where + file.parts[layer.part].channelnames[number]
    return taken


def mapped(file: ImageFile) -> dict[str, dict[str, str]]:
    return {frame.color_layer.view: channels_of(file, frame) for frame in channels.match(file)}


LAYOUTS = {
    "bare and right": (["", "albedo", "right", "albedo.right"], "R", "right.R", "albedo.R", "albedo.right.R"),
    "view before layer": (
        ["left", "left.albedo", "right", "right.albedo"],
        "left.R",
        "right.R",
        "left.albedo.R",
        "right.albedo.R",
    ),
    "one albedo for both": (["", "right", "albedo"], "R", "right.R", "albedo.R", "albedo.R"),
    "Blender": (
        [f"VL.{name}.{eye}" for eye in EYES for name in ("Combined", "Denoising Albedo")],
        *(f"VL.{name}.{eye}.R" for name in ("Combined", "Denoising Albedo") for eye in EYES),
    ),
    "Arnold": (
        ["", "denoise_albedo", "right", "denoise_albedo.right"],
        "R",
        "right.R",
        "denoise_albedo.R",
        "denoise_albedo.right.R",
    ),
}


@pytest.mark.parametrize("layout", LAYOUTS)
def test_views_of_channel_names(layout: str, tmp_path: Path) -> None:
    names, left, right, *albedo = LAYOUTS[layout]
    found = mapped(named(tmp_path / "a.exr", names))
    assert found == {
        eye: {"color": color, "albedo": guide} for eye, color, guide in zip(EYES, (left, right), albedo, strict=True)
    }


PARTS = {
    "view attributes, one albedo": ({"l": "left", "r": "right", "albedo": ""}, ("l", "r"), ("albedo", "albedo")),
    "part names alone": (
        {"rgba.left": "", "albedo.left": "", "rgba.right": "", "albedo.right": ""},
        ("rgba.left", "rgba.right"),
        ("albedo.left", "albedo.right"),
    ),
    "both": (
        {"albedo-left": "left", "C-left": "left", "albedo-right": "right", "C-right": "right"},
        ("C-left", "C-right"),
        ("albedo-left", "albedo-right"),
    ),
    "view first": ({"right_rgba": "right", "left_rgba": "left", "N": ""}, ("left_rgba", "right_rgba"), None),
}


@pytest.mark.parametrize("layout", PARTS)
@pytest.mark.parametrize("turned", [False, True])
def test_views_of_parts(layout: str, turned: bool, tmp_path: Path) -> None:
    views, colors, albedo = PARTS[layout]
    found = mapped(of_parts(tmp_path / "a.exr", dict(reversed(views.items())) if turned else views))
    assert set(found) == set(EYES)
    for at, eye in enumerate(EYES):
        assert found[eye]["color"] == f"{colors[at]}:R"
        if albedo:
            assert found[eye]["albedo"] == f"{albedo[at]}:R"
        else:
            assert found[eye]["normal"] == "N:R"


def test_a_guide_of_the_only_view_serves_the_picture(tmp_path: Path) -> None:
    for parts in ({"rgba_main": "main", "albedo": ""}, {"rgba": "", "albedo": "main"}):
        (frame,) = channels.match(of_parts(tmp_path / "a.exr", parts))
        assert set(frame.sources) == {"color", "albedo"}


def test_both_eyes_are_written(tiny: Path, tmp_path: Path) -> None:
    file = named(tmp_path / "in.exr", ["", "right", "albedo", "key", "key.right"])
    done = denoise_file(file.path, tmp_path / "out.exr", Denoiser("single-3"), layers=["key*"], exposures=[1.0])
    assert [one.frame.color_layer.view for one in done] == list(EYES)
    names = file.parts[0].channelnames
    before, after = (ImageFile(tmp_path / name).read(0, range(len(names))) for name in ("in.exr", "out.exr"))
    changed = {name for at, name in enumerate(names) if not np.array_equal(before[..., at], after[..., at])}
    assert changed == {name for name in names if not name.startswith("albedo")}


def test_a_view_without_a_picture_is_told(tmp_path: Path) -> None:
    (frame,) = channels.match(named(tmp_path / "a.exr", ["", "albedo", "beautyful.right", "albedo.right"]))
    assert any("view right has no picture" in note and "--map color=LAYER" in note for note in frame.notes)
    (frame,) = channels.match(of_parts(tmp_path / "b.exr", {"rgba": "left", "N": "right"}))
    assert any("view right has no picture" in note for note in frame.notes)


def test_a_named_color_is_that_of_each_view(tmp_path: Path) -> None:
    file = of_parts(
        tmp_path / "a.exr", {"my.left": "left", "my.right": "right", "foo.left": "left", "foo.right": "right"}
    )
    assert [frame.color_layer.part for frame in channels.match(file, {"color": "foo"})] == [2, 3]
    (frame,) = channels.match(file, {"color": "foo.right"})
    assert frame.color_layer.part == 3 and any("view left has no picture" in note for note in frame.notes)
    names = named(tmp_path / "b.exr", ["", "right"])
    assert [frame.color_layer.view for frame in channels.match(names, {"color": "R,G,B"})] == ["left"]


def test_without_any_view_left_is_a_name(tmp_path: Path) -> None:
    (frame,) = channels.match(named(tmp_path / "a.exr", ["", "left"], declared=False))
    assert frame.color_layer.view == "" and ImageFile(tmp_path / "a.exr").layer("left") is not None
    assert frame.notes == ("left is no view by the header and stays as it is; --map color=left",)
