"""Which layer is what in files of several parts, views and channels without layers: no position decides."""

import shlex
from itertools import permutations
from pathlib import Path

import pytest
from exr_files import noise, part, write
from pathfold import channels
from pathfold.images import ImageError, ImageFile

RGB = list("RGB")


def parts_of(path: Path, names: list[str], **views: str) -> ImageFile:
    """A file of parts with bare R, G, B each; X, Y, Z where the name is N's, Z where it is a depth's."""
    made = []
    for number, name in enumerate(names):
        letters = list("XYZ") if name == "N" else ["Z"] if "depth" in name else RGB
        header = {"view": views[name]} if name in views else {}
        made.append(part(name, letters, ["float"] * len(letters), noise(len(letters), number), **header))
    return ImageFile(write(path, made))


def one_part(path: Path, names: list[str], **header: object) -> ImageFile:
    return ImageFile(write(path, [part("", names, ["float"] * len(names), noise(len(names)), **header)]))


@pytest.mark.parametrize("names", [("N", "albedo", "C"), ("depth_main", "albedo_main", "rgba_main"), ("N", "beauty")])
def test_the_order_of_parts_changes_nothing(names: tuple[str, ...], tmp_path: Path) -> None:
    beauty = names[-1]
    for order in permutations(names):
        (frame,) = channels.match(parts_of(tmp_path / "a.exr", list(order)))
        assert frame.color_layer.name == beauty and frame.color_layer.part == order.index(beauty)
        guides = {source.layers[0].part for name, source in frame.sources.items() if name not in ("color", "alpha")}
        assert guides == {order.index(name) for name in names[:-1]}
        assert f"color <- {beauty} (part {order.index(beauty)})" in frame.lines()


@pytest.mark.parametrize("names", [["foo", "bar"], ["beauty", "rgba"], ["N", "C", "beauty"], ["rgba", "albedo", "hdr"]])
def test_two_that_could_be_the_picture_are_an_error(names: list[str], tmp_path: Path) -> None:
    file = parts_of(tmp_path / "a.exr", names)
    could = [name for name in names if name not in ("N", "albedo")]
    with pytest.raises(ImageError, match="could each be the picture") as caught:
        channels.match(file)
    assert all(f"{name} (part {names.index(name)})" in str(caught.value) for name in could)
    for name in could:
        assert f"--map color={name}" in str(caught.value)
        assert channels.match(file, {"color": name})[0].color_layer.name == name


def test_a_guide_alone_is_no_picture(tmp_path: Path) -> None:
    for name in ("N", "normals", "albedo", "Denoising Albedo", "depth_extra", "mse", "Z_noice", "cryptomatte00"):
        with pytest.raises(ImageError, match="no color found"):
            channels.match(parts_of(tmp_path / "a.exr", [name]))
        with pytest.raises(ImageError, match="no color found"):
            channels.match(parts_of(tmp_path / "a.exr", [name, "specular"]))
        (frame,) = channels.match(parts_of(tmp_path / "a.exr", [name, "specular", "hero"]))
        assert frame.color_layer.name == "hero"


def test_a_layer_is_one_thing(tmp_path: Path) -> None:
    file = one_part(tmp_path / "a.exr", [*RGB, *(f"albedo.{c}" for c in RGB), *(f"N.{c}" for c in "XYZ")])
    for mapping in ({"albedo": "R,G,B"}, {"color": "albedo", "albedo": "albedo"}, {"albedo": "N", "normal": "N"}):
        with pytest.raises(ImageError, match="already; name another layer, or leave it out with --map"):
            channels.match(file, mapping)
    (frame,) = channels.match(file, {"color": "albedo"})
    assert set(frame.sources) == {"color", "normal"}  # it is the picture now


def test_channels_are_named_one_by_one(tmp_path: Path) -> None:
    file = one_part(tmp_path / "a.exr", [f"ch{i}" for i in range(10)])
    with pytest.raises(ImageError, match="each layer has one channel: name three with --map color=ch0,ch1,ch2"):
        channels.match(file)
    (frame,) = channels.match(file, {"color": "ch0,ch1,ch2", "albedo": "ch6,ch5,ch4", "depth": "ch9"})
    assert frame.lines() == ["color <- ch0,ch1,ch2", "albedo <- ch6,ch5,ch4", "depth <- ch9"]
    pixels = file.read(0, range(10))
    assert (channels.load(file, frame, "albedo") == pixels[..., [6, 5, 4]]).all()
    with pytest.raises(ImageError, match=r"needs 3 channel"):
        channels.match(file, {"color": "ch2,ch3"})
    with pytest.raises(ImageError, match=r"--map albedo=ch1,ch2,ch3: .* is color already"):
        channels.match(file, {"color": "ch0,ch1,ch2", "albedo": "ch1,ch2,ch3"})


@pytest.mark.parametrize(("names", "cure"), [("XYZ", "X,Y,Z"), ("XYZA", "X,Y,Z"), ("Y", "Y,Y,Y"), ("YA", "Y,Y,Y")])
def test_films_in_other_colours_say_how_to_name_them(names: str, cure: str, tmp_path: Path) -> None:
    file = one_part(tmp_path / "a.exr", list(names))
    with pytest.raises(ImageError, match=f"--map color={cure}"):
        channels.match(file)
    (frame,) = channels.match(file, {"color": cure})
    assert [note.split(",")[0] for note in frame.notes] == ["color is CIE XYZ"] * ("X" in names)
    assert ("alpha" in frame.sources) == ("A" in names)
    assert channels.load(file, frame, "color").shape[-1] == 3


def test_names_that_differ_in_case_alone(tmp_path: Path) -> None:
    for names in (["albedo", "Albedo"], ["Albedo", "albedo"]):
        file = one_part(tmp_path / "a.exr", [*RGB, *(f"{name}.{c}" for name in names for c in RGB)])
        (frame,) = channels.match(file)
        assert "albedo <- albedo" in frame.lines()
        assert "not used: Albedo (--map albedo=Albedo)" in frame.notes
        assert "albedo <- Albedo" in channels.match(file, {"albedo": "Albedo"})[0].lines()


def test_what_looks_like_a_guide_is_told(tmp_path: Path) -> None:
    extra = ["my_albedo", "shading.NORMALS", "Depth_1", "pass_variance", "key"]
    file = one_part(tmp_path / "a.exr", [*RGB, *(f"{name}.{c}" for name in extra for c in RGB)])
    (note,) = channels.match(file)[0].notes
    for buffer, name in zip(("albedo", "normal", "depth", "variance"), extra, strict=False):
        assert f"{name} (--map {buffer}={name})" in note
    assert "key" not in note


def test_what_a_cure_names_is_taken(tmp_path: Path) -> None:
    """Whatever an error or a note offers works as it stands, on a shell too."""
    pages = [part("", RGB, ["float"] * 3, noise(3, seed)) for seed in range(2)]
    for name, parts in {
        "pages.tif": pages,
        "spaces.exr": [part(f"my {name}", RGB, ["float"] * 3, noise(3)) for name in "ab"],
        "layers.exr": [part("", [f"{name}.{c}" for name in ("rgba", "hdr") for c in RGB], ["float"] * 6, noise(6))],
    }.items():
        path = tmp_path / name
        for spec, _ in parts if path.suffix == ".tif" else ():
            spec.erase_attribute("compression")
        file = ImageFile(write(path, parts))
        with pytest.raises(ImageError, match="could each be the picture") as caught:
            channels.match(file)
        words = shlex.split(str(caught.value).partition("choose with ")[2])
        offered = [word.split("=", 1) for word in words if "=" in word]
        taken = [channels.match(file, dict([one]))[0].color_layer for one in offered]
        assert len({(layer.part, layer.name) for layer in taken}) == 2
