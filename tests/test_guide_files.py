"""Guides from files of their own: by the rows that the picture itself goes by."""

from pathlib import Path

import numpy as np
import pytest
from exr_files import SIZE, noise, part, write
from pathfold import channels
from pathfold.images import ImageError, ImageFile

RGB, XYZ = list("RGB"), list("XYZ")
SIDECAR = {"": RGB, "albedo": RGB, "normal": XYZ, "mse": RGB, "__depth": [""], "variance": RGB}
OPTIONS = {"albedo": "--alb", "normal": "--nrm", "depth": "--depth", "variance": "--var"}


@pytest.fixture
def picture(tmp_path: Path) -> ImageFile:
    return ImageFile(write(tmp_path / "in.exr", [part("", RGB, ["float"] * 3, noise(3))]))


def side(path: Path, layers: dict[str, list[str]], **header: object) -> Path:
    names = [
        f"{layer}.{letter}" if layer and letter else layer or letter
        for layer, given in layers.items()
        for letter in given
    ]
    return write(path, [part("", names, ["float"] * len(names), noise(len(names), 3), **header)])


def taken(picture: ImageFile, path: Path, buffer: str, **mapping: str) -> str:
    (frame,) = channels.match(picture, mapping, {buffer: path})
    (line,) = [line for line in frame.lines() if line.startswith(f"{buffer} <- ")]
    return line.removeprefix(f"{buffer} <- ")


def test_the_named_layer_comes_before_the_main_picture(picture: ImageFile, tmp_path: Path) -> None:
    path = side(tmp_path / "side.exr", SIDECAR)
    for buffer, layer in {"albedo": "albedo", "normal": "normal", "depth": "__depth", "variance": "mse"}.items():
        assert taken(picture, path, buffer) == f"side.exr: {layer}"
    (frame,) = channels.match(picture, {}, {"normal": path})
    beside = ImageFile(path)
    numbers = [beside.parts[0].channelnames.index(f"normal.{letter}") for letter in XYZ]
    assert (channels.load(picture, frame, "normal") == beside.read(0, numbers)).all()


@pytest.mark.parametrize(
    ("layers", "buffer", "layer"),
    [
        ({"": RGB}, "albedo", "R,G,B"),
        ({"": [*RGB, "A"]}, "normal", "R,G,B"),
        ({"": RGB}, "depth", "R,G,B"),
        ({"Y": [""]}, "depth", "Y"),
        ({"noice_N": RGB, "": RGB}, "normal", "noice_N"),
        ({"VL.Combined": RGB, "VL.Denoising Albedo": RGB, "VL.Denoising Normal": XYZ}, "albedo", "VL.Denoising Albedo"),
        ({"bumpnormals": XYZ, "diffuse_filter": RGB}, "normal", "bumpnormals"),
        ({"Variance": RGB, "Albedo": RGB}, "variance", "Variance"),
        ({"foo": RGB, "Z": [""]}, "albedo", "foo"),
    ],
)
def test_what_could_be_meant(
    layers: dict[str, list[str]], buffer: str, layer: str, picture: ImageFile, tmp_path: Path
) -> None:
    assert taken(picture, side(tmp_path / "side.exr", layers), buffer) == f"side.exr: {layer}"


@pytest.mark.parametrize(
    ("layers", "buffer"),
    [
        ({"": RGB, "albedo": RGB}, "normal"),
        ({"": RGB, "foo": RGB}, "albedo"),
        ({"N": XYZ}, "albedo"),
        ({"albedo_a": RGB, "albedo_b": RGB}, "albedo"),
        ({"": RGB, "N": XYZ}, "variance"),
    ],
)
def test_what_cannot_be_known_is_refused(
    layers: dict[str, list[str]], buffer: str, picture: ImageFile, tmp_path: Path
) -> None:
    path = side(tmp_path / "side.exr", layers)
    with pytest.raises(ImageError, match=f"side.exr: .*name its layer with --map {buffer}=LAYER"):
        channels.match(picture, {}, {buffer: path})
    name = list(layers)[-1]
    assert taken(picture, path, buffer, **{buffer: name}) == f"side.exr: {name}"


def test_misses_of_the_file_beside_are_converted(picture: ImageFile, tmp_path: Path) -> None:
    depth = np.full((SIZE[1], SIZE[0], 1), 5.0, np.float32)
    depth[2, 3] = 1e10
    path = write(tmp_path / "side.exr", [part("depth", ["Z"], ["float"], depth, **{"vrayInfo/build": "7"})])
    (frame,) = channels.match(picture, {}, {"depth": path})
    assert frame.writer("depth").name == "vray"
    assert channels.load(picture, frame, "depth")[2, 3] == 0


def test_every_option_is_printed(run, picture: ImageFile, tmp_path: Path) -> None:
    path = side(tmp_path / "side.exr", SIDECAR)
    options = [argument for option in OPTIONS.values() for argument in (option, path)]
    code, out, err = run("denoise", picture.path, "-o", tmp_path / "out.exr", "-m", "single-3", *options)
    assert code == 0, err
    for line in ("albedo <- side.exr: albedo", "normal <- side.exr: normal", "depth <- side.exr: __depth"):
        assert f"  {line}\n" in out
    assert "  variance <- side.exr: mse\n" in out
    code, _, err = run("denoise", picture.path, "-o", tmp_path / "o.exr", "--alb", path, "--map", "albedo=none")
    assert code == 3 and "--map albedo=none leaves it out; give one of them" in err
