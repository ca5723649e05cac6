"""Channel presets: files with the layers of seven writers, mapped without a flag."""

from pathlib import Path

import numpy as np
import pytest
from exr_files import SIZE, noise, part, write
from pathfold import channels
from pathfold.channels import samples
from pathfold.images import ImageError, ImageFile, write_parts

RGB, XYZ = "RGB", "XYZ"


def one_part(path: Path, layers: dict[str, str], kinds: str = "float", **header: object) -> ImageFile:
    """A file of one part: layer -> its components ("" is the main picture)."""
    names = [f"{layer}.{c}" if layer else c for layer, letters in layers.items() for c in letters]
    return ImageFile(write(path, [part("", names, [kinds] * len(names), noise(len(names)), **header)]))


def mapped(file: ImageFile, **overrides: str) -> dict[str, str]:
    (frame,) = channels.match(file, overrides)
    return {name: str(source) for name, source in frame.sources.items()}


def cycles_layers(prefix: str = "ViewLayer") -> dict[str, str]:
    passes = {
        "Combined": "RGBA",
        "Depth": "V",
        "Denoising Albedo": RGB,
        "Denoising Normal": XYZ,
        "Diffuse Direct": RGB,
        "Diffuse Indirect": RGB,
        "Diffuse Color": RGB,
        "Vector": "XYZW",
        "Combined_key": RGB,
    }
    return {f"{prefix}.{name}": letters for name, letters in passes.items()}


CYCLES = {
    "color": "ViewLayer.Combined",
    "alpha": "ViewLayer.Combined.A",
    "diffuse": "(ViewLayer.Diffuse Direct + ViewLayer.Diffuse Indirect) * ViewLayer.Diffuse Color",
    "specular": "ViewLayer.Combined - ((ViewLayer.Diffuse Direct + ViewLayer.Diffuse Indirect) "
    "* ViewLayer.Diffuse Color)",
    "diffuse.albedo": "ViewLayer.Diffuse Color",
    "albedo": "ViewLayer.Denoising Albedo",
    "normal": "ViewLayer.Denoising Normal",
    "depth": "ViewLayer.Depth",
}


def test_cycles_in_one_part(tmp_path: Path) -> None:
    file = one_part(tmp_path / "a.exr", cycles_layers(), "half")
    assert channels.match(file)[0].preset.name == "cycles"
    assert mapped(file) == CYCLES


def test_cycles_5_with_a_part_per_pass(tmp_path: Path) -> None:
    parts = []
    for seed, (layer, letters) in enumerate(cycles_layers().items()):
        kind = "float" if layer.endswith("Depth") else "half"
        names = [f"{layer}.{letter}" for letter in letters]
        values = noise(len(names), seed)
        if layer.endswith("Depth"):
            values[0, 0] = 1e10
        parts.append(part(layer, names, [kind] * len(names), values))
    parts[0][0].attribute("BlenderMultiChannel", "Blender V2.55.1 and newer")
    file = ImageFile(write(tmp_path / "a.exr", parts))
    assert mapped(file) == CYCLES

    (frame,) = channels.match(file)
    depth = channels.load(file, frame, "depth")
    assert depth[0, 0] == 0 and depth[1:].min() >= 0 and depth.max() < 5
    halves = [channels.load(file, frame, name) for name in ("color", "diffuse", "specular")]
    assert halves[2] == pytest.approx(np.maximum(halves[0] - halves[1], 0))


def test_every_view_layer_is_a_frame(tmp_path: Path) -> None:
    layers = {**cycles_layers("Far"), "Near.Combined": "RGBA", "Near.Denoising Albedo": RGB}
    frames = channels.match(one_part(tmp_path / "a.exr", layers))
    assert [frame.color_layer.name for frame in frames] == ["Far.Combined", "Near.Combined"]
    assert [str(frame.sources["albedo"]).split(".")[0] for frame in frames] == ["Far", "Near"]
    assert "normal" not in frames[1].sources


def test_both_eyes_are_frames(tmp_path: Path) -> None:
    parts = []
    for eye in ("left", "right"):
        for name in ("Combined", "Denoising Albedo"):
            names = [f"VL.{name}.{letter}" for letter in RGB]
            parts.append(part(f"VL.{name}-{eye}", names, ["half"] * 3, noise(3), view=eye))
    frames = channels.match(ImageFile(write(tmp_path / "a.exr", parts)))
    assert [frame.color_layer.part for frame in frames] == [0, 2]
    assert [frame.sources["albedo"].layers[0].part for frame in frames] == [1, 3]


def test_noisy_image_is_read_and_combined_written(tmp_path: Path) -> None:
    (frame,) = channels.match(one_part(tmp_path / "a.exr", {**cycles_layers(), "ViewLayer.Noisy Image": "RGBA"}))
    assert str(frame.sources["color"]) == "ViewLayer.Noisy Image"
    assert frame.color_layer.name == "ViewLayer.Combined"


def test_arnold(tmp_path: Path) -> None:
    layers = {"": "RGBA", "N": XYZ, "denoise_albedo": RGB, "diffuse_direct": RGB, "diffuse_indirect": RGB}
    layers |= {"diffuse_albedo": RGB, "Z": "Z", "variance": RGB}
    file = one_part(tmp_path / "a.exr", layers, **{"exr/arnold/version": "7.3"})
    assert channels.detect(file).name == "arnold"
    found = mapped(file)
    assert found["albedo"] == "denoise_albedo" and found["normal"] == "N" and found["depth"] == "Z"
    assert found["diffuse"] == "diffuse_direct + diffuse_indirect"
    assert found["specular"] == "R,G,B - (diffuse_direct + diffuse_indirect)"
    assert "variance" not in found


def test_vray(tmp_path: Path) -> None:
    names = [*"RGBA", *(f"diffuse.{c}" for c in ("red", "green", "blue"))]
    names += [f"bump_normals.{c}" for c in XYZ] + ["z_depth.Z"]
    values = noise(len(names))
    file = ImageFile(
        write(tmp_path / "a.exr", [part("", names, ["half"] * len(names), values, **{"vrayInfo/build": "7"})])
    )
    found = mapped(file)
    assert {"albedo": "diffuse", "normal": "bump_normals", "depth": "z_depth", "alpha": "A"}.items() <= found.items()
    assert "diffuse" not in found  # V-Ray's diffuse is a colour, not light
    (frame,) = channels.match(file)
    wanted = values[..., 4:7].astype(np.float16).astype(np.float32)
    assert (channels.load(file, frame, "albedo") == wanted).all()


def test_renderman(tmp_path: Path) -> None:
    layers = {"Ci": "rgba", "albedo": "rgb", "normal": "xyz", "mse": "rgb", "diffuse": "rgb", "z": "Z"}
    found = mapped(one_part(tmp_path / "a.exr", layers, "half"))
    assert found["color"] == "Ci" and found["alpha"] == "Ci.A"
    assert found["variance"] == "mse" and found["depth"] == "z"
    assert "diffuse" not in found  # no albedo to divide it by


def test_mitsuba(tmp_path: Path) -> None:
    layers = {"": RGB, "img": "RGBA", "albedo": RGB, "nn": XYZ, "dd.y": "T"}
    file = one_part(tmp_path / "a.exr", layers, generatedBy="Mitsuba version 3.9.1")
    expected = {"color": "R,G,B", "alpha": "img.A", "albedo": "albedo", "normal": "nn", "depth": "dd.y"}
    assert mapped(file) == expected


@pytest.mark.parametrize("spp", [16, None])
def test_pbrt_variance_is_of_one_sample(tmp_path: Path, spp: int | None) -> None:
    layers = {"": RGB, "Albedo": RGB, "N": XYZ, "Ns": XYZ, "P": XYZ, "dzdx": "Y", "Variance": RGB}
    names = [
        n for layer, c in layers.items() for n in ([layer] if c == "Y" else [f"{layer}.{i}" if layer else i for i in c])
    ]
    header = {"samplesPerPixel": spp} if spp else {}
    file = ImageFile(write(tmp_path / "a.exr", [part("", names, ["float"] * len(names), noise(len(names)), **header)]))
    found = mapped(file)
    assert found["normal"] == "Ns" and found["albedo"] == "Albedo"
    assert found.get("variance") == ("Variance / 16" if spp else None)
    if spp:
        frame = channels.match(file)[0]
        expected = file.read(0, [file.parts[0].channelnames.index(f"Variance.{c}") for c in RGB]) / 16
        assert channels.load(file, frame, "variance") == pytest.approx(expected)


def test_common_names_and_color_alone(tmp_path: Path) -> None:
    file = one_part(tmp_path / "a.exr", {"beauty": "RGBA", "alb": RGB, "nrm": RGB, "Z": "Z"})
    found = mapped(file)
    assert found == {"color": "beauty", "alpha": "beauty.A", "albedo": "alb", "normal": "nrm", "depth": "Z"}
    assert mapped(one_part(tmp_path / "b.exr", {"": RGB})) == {"color": "R,G,B"}


def test_overrides(tmp_path: Path) -> None:
    layers = {"": RGB, "albedo": RGB, "mine": RGB, "normal": XYZ, "flat": "Y"}
    file = one_part(tmp_path / "a.exr", layers)
    found = mapped(file, albedo="mine", normal="none")
    assert found == {"color": "R,G,B", "albedo": "mine"}
    assert mapped(file, color="mine")["color"] == "mine"
    with pytest.raises(ImageError, match=r"albedo=nothing: no such layer; it has R,G,B, albedo, flat, mine, normal"):
        channels.match(file, {"albedo": "nothing"})
    with pytest.raises(ImageError, match=r"unknown buffer 'albedoo'.*specular"):
        channels.match(file, {"albedoo": "albedo"})
    with pytest.raises(ImageError, match=r"normal needs 3 channel\(s\); flat has Y"):
        channels.match(file, {"normal": "flat"})


def test_no_color_names_what_there_is(tmp_path: Path) -> None:
    with pytest.raises(ImageError, match=r"no color found; it has diffuse_color, normal; .*--map color=LAYER"):
        channels.match(one_part(tmp_path / "a.exr", {"diffuse_color": RGB, "normal": XYZ}))


def sample_block(count: int = 3) -> dict[str, np.ndarray]:
    rng = np.random.default_rng(5)
    shape = (count, SIZE[1], SIZE[0])
    return {
        "descriptor": rng.normal(-3, 9, (*shape, 36)).astype(np.float16),
        "density": rng.normal(-30, 9, (*shape, 1)).astype(np.float32),
    }


def test_samples_come_back_bit_for_bit(tmp_path: Path) -> None:
    block = sample_block()
    block["valid"] = np.ones_like(block["density"], np.float16)
    write_parts(tmp_path / "a.exr", [samples.to_part(block)], {})
    file = ImageFile(tmp_path / "a.exr")
    assert samples.count(file) == 3
    loaded = samples.load(file)
    assert set(loaded) == set(block)
    assert all(loaded[name].dtype == block[name].dtype for name in block)
    assert all((loaded[name] == block[name]).all() for name in block)
    assert "samples.002.path.attenuation.5.B" in file.parts[0].channelnames


def test_samples_that_lack_a_field_are_named(tmp_path: Path) -> None:
    whole = samples.to_part(sample_block())
    kept = [i for i, name in enumerate(whole.channels) if name != "samples.001.path.tag.2"]
    names = [whole.channels[i] for i in kept]
    write(tmp_path / "a.exr", [part("samples", names, ["half"] * len(names), noise(len(names)))])
    with pytest.raises(ImageError, match=r"samples.001.path.tag.2 is missing \(1 sample channels in all\)"):
        samples.load(ImageFile(tmp_path / "a.exr"))
