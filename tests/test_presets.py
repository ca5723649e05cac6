"""Presets of renderers: a made-up file after each one's published layout, mapped without a flag."""

import re
import tomllib
from importlib.resources import files
from pathlib import Path

import numpy as np
import pytest
from exr_files import noise, part, write
from pathfold import channels
from pathfold.images import ImageFile

RGB, RGBA, XYZ, xyz = "RGB", "RGBA", "XYZ", "xyz"
LONG = ("red", "green", "blue")
Layers = dict[str, tuple[str, ...] | str]


def written(path: Path, parts: dict[str, Layers] | Layers, **header: object) -> ImageFile:
    """A file of parts, {part: {layer: components}}, or of one, {layer: components}; "" is the main picture."""
    split = parts if all(isinstance(value, dict) for value in parts.values()) else {"": parts}
    made = []
    for number, (name, layers) in enumerate(split.items()):
        names = [
            f"{layer}.{c}" if layer and c else layer or c for layer, given in layers.items() for c in given or [""]
        ]
        extra = header if number == 0 else {}
        made.append(part(name, names, ["float"] * len(names), noise(len(names), number), **extra))
    return ImageFile(write(path, made))


# renderer -> case -> (layout, header, what each buffer is taken from)
LAYOUTS: dict[str, dict[str, tuple[dict, dict, dict[str, str]]]] = {
    "cycles": {
        "an AOV of the user's own": (
            {"VL.Combined": RGBA, "VL.Albedo": RGB, "VL.Denoising Albedo": RGB},
            {"BlenderMultiChannel": "Blender V2.55.1 and newer"},
            {"color": "VL.Combined", "albedo": "VL.Denoising Albedo"},
        ),
        "an AOV of the user's own alone": (
            {"VL.Combined": RGBA, "VL.Albedo": RGB},
            {},
            {"color": "VL.Combined", "albedo": "VL.Albedo"},
        ),
        "one part": (
            {"VL.Combined": RGBA, "VL.Depth": "V", "VL.Denoising Albedo": RGB, "VL.Denoising Normal": XYZ},
            {},
            {
                "color": "VL.Combined",
                "albedo": "VL.Denoising Albedo",
                "normal": "VL.Denoising Normal",
                "depth": "VL.Depth",
            },
        ),
    },
    "arnold": {
        "merged AOVs": (
            {"": RGBA, "N": XYZ, "Z": "", "denoise_albedo": RGB, "variance": RGB},
            {"arnold/version": "7.3"},
            {"color": "R,G,B", "albedo": "denoise_albedo", "normal": "N", "depth": "Z"},
        ),
        "noice": (
            {"": RGBA, "N_noice": XYZ, "Z_noice": "", "diffuse_albedo_noice": RGB, "N": XYZ, "variance": RGB},
            {},
            {"color": "R,G,B", "albedo": "diffuse_albedo_noice", "normal": "N_noice", "depth": "Z_noice"},
        ),
        "denoise": (
            {"": RGBA, "N_denoise": XYZ, "albedo_denoise": RGB, "Z": ""},
            {"exr/arnold/version": "7.3"},
            {"color": "R,G,B", "albedo": "albedo_denoise", "normal": "N_denoise", "depth": "Z"},
        ),
    },
    "vray": {
        "Maya": (
            {"": RGBA, "diffuse": LONG, "bumpnormals": XYZ, "zDepth": "Z", "rawGI": LONG, "rawLight": LONG},
            {"vrayInfo/build": "7"},
            {"color": "R,G,B", "albedo": "diffuse", "normal": "bumpnormals", "depth": "zDepth"},
        ),
        "3ds Max": (
            {"": RGBA, "VRayDiffuseFilter": LONG, "VRayBumpNormals": XYZ, "VRayZDepth": "Z"},
            {},
            {"color": "R,G,B", "albedo": "VRayDiffuseFilter", "normal": "VRayBumpNormals", "depth": "VRayZDepth"},
        ),
        "Houdini": (
            {"": RGBA, "Albedo": RGB, "Diffuse_Filter": RGB, "Raw_Lighting": RGB, "Raw_GI": RGB, "Bump_Normals": XYZ},
            {"vrayInfo/build": "7"},
            {
                "color": "R,G,B",
                "albedo": "Albedo",
                "normal": "Bump_Normals",
                "diffuse.albedo": "Diffuse_Filter",
                "diffuse": "(Raw_Lighting + Raw_GI) * Diffuse_Filter",
            },
        ),
        "after Nuke": (
            {"": RGBA, "diffuse": LONG, "bumpNormals": LONG, "Z_Depth": ("Z",)},
            {"nuke/version": "15"},
            {"color": "R,G,B", "albedo": "diffuse", "normal": "bumpNormals", "depth": "Z_Depth"},
        ),
    },
    "renderman": {
        "denoising AOVs": (
            {"Ci": "rgba", "albedo": "rgb", "normal": xyz, "mse": "rgb", "zfiltered": "", "albedo_var": "rgb"},
            {},
            {"color": "Ci", "albedo": "albedo", "normal": "normal", "depth": "zfiltered", "variance": "mse"},
        ),
    },
    "karma": {
        "layers of one part": (
            {"C": RGBA, "albedo": RGB, "N": XYZ, "depth_extra": "Z", "P": XYZ},
            {},
            {"color": "C", "albedo": "albedo", "normal": "N", "depth": "depth_extra"},
        ),
        "parts": (
            {"N": {"": RGB}, "albedo": {"": RGB}, "C": {"": RGBA}, "__depth": {"": "Z"}},
            {},
            {"color": "C", "albedo": "albedo", "normal": "N", "depth": "__depth"},
        ),
        "split": (
            {"C": RGBA, "combineddiffuse": RGB, "albedodiffuse": RGB, "N_camera": XYZ, "N": XYZ},
            {},
            {"color": "C", "diffuse": "combineddiffuse", "diffuse.albedo": "albedodiffuse", "normal": "N_camera"},
        ),
    },
    "redshift": {
        "Maya": (
            {"": RGBA, "DiffuseFilter": RGB, "BumpNormals": XYZ, "Z": "", "DiffuseLighting": RGB, "GI": RGB},
            {},
            {
                "color": "R,G,B",
                "albedo": "DiffuseFilter",
                "normal": "BumpNormals",
                "depth": "Z",
                "diffuse": "DiffuseLighting + GI",
            },
        ),
    },
    "octane": {
        "standalone": (
            {"": RGBA, "Denoise albedo": RGB, "Denoise normal": RGB, "Z-depth": "Z"},
            {},
            {"color": "R,G,B", "albedo": "Denoise albedo", "normal": "Denoise normal", "depth": "Z-depth"},
        ),
        "Blender": (
            {"VL.Combined": RGBA, "VL.Denoise albedo": RGB, "VL.Denoise normal": XYZ},
            {},
            {"color": "VL.Combined", "albedo": "VL.Denoise albedo", "normal": "VL.Denoise normal"},
        ),
    },
    "luxcore": {
        "Blender": (
            {"VL.Combined": RGBA, "VL.ALBEDO": RGB, "VL.AVG_SHADING_NORMAL": XYZ, "VL.Depth": "Z"},
            {"BlenderMultiChannel": "Blender V2.55.1 and newer"},
            {"color": "VL.Combined", "albedo": "VL.ALBEDO", "normal": "VL.AVG_SHADING_NORMAL", "depth": "VL.Depth"},
        ),
        "Blender, albedo alone": (
            {"VL.Combined": RGBA, "VL.ALBEDO": RGB},
            {"BlenderMultiChannel": "Blender V2.55.1 and newer"},
            {"color": "VL.Combined", "albedo": "VL.ALBEDO"},
        ),
        "itself": (
            {"": RGBA, "ALBEDO": RGB, "AVG_SHADING_NORMAL": XYZ, "DEPTH": "Z"},
            {},
            {"color": "R,G,B", "albedo": "ALBEDO", "normal": "AVG_SHADING_NORMAL", "depth": "DEPTH"},
        ),
    },
    "appleseed": {
        "AOVs": (
            {"": RGBA, "albedo": RGBA, "normal": XYZ, "depth": "ZA"},
            {"Software": "appleseed 2.1.0-beta"},
            {"color": "R,G,B", "albedo": "albedo", "normal": "normal", "depth": "depth"},
        ),
    },
    "3delight": {
        "builtin variables": (
            {"Ci": "rgba", "N.camera": xyz, "N.world": xyz, "z": "", "albedo": "rgb"},
            {},
            {"color": "Ci", "albedo": "albedo", "normal": "N.camera", "depth": "z"},
        ),
    },
    "corona": {
        "3ds Max": (
            {"": RGBA, "CShading_Albedo": RGB, "CGeometry_NormalsShading": RGB, "CGeometry_ZDepth": RGB},
            {},
            {"color": "R,G,B", "albedo": "CShading_Albedo", "normal": "CGeometry_NormalsShading"},
        ),
    },
    "unreal": {
        "multi-layer": (
            {"FinalImage": RGBA, "FinalImageMovieRenderQueue_WorldDepth": RGBA, "ActorHitProxyMask00": RGBA},
            {},
            {"color": "FinalImage", "depth": "FinalImageMovieRenderQueue_WorldDepth"},
        ),
        "bare": (
            {"": RGBA, "FinalImageMovieRenderQueue_WorldNormal": RGBA, "ActorHitProxyMask00": RGBA},
            {},
            {"color": "R,G,B", "normal": "FinalImageMovieRenderQueue_WorldNormal"},
        ),
    },
    "pbrt": {
        "GBufferFilm at first": (
            {"": RGB, "Albedo": RGB, **dict.fromkeys(("Nx", "Ny", "Nz", "Nsx", "Nsy", "Nsz", "dzdx"), ("",))},
            {},
            {"color": "R,G,B", "albedo": "Albedo", "normal": "Nsx,Nsy,Nsz"},
        ),
        "GBufferFilm": (
            {"": RGB, "Albedo": RGB, "Ns": XYZ, "N": XYZ, "dzdx": "", "Variance": RGB},
            {"samplesPerPixel": 16},
            {"color": "R,G,B", "albedo": "Albedo", "normal": "Ns", "variance": "Variance / 16"},
        ),
    },
    "mitsuba": {
        "aov": (
            {"": RGB, "my_image": RGBA, "albedo": RGB, "nn": XYZ, "dd.y": "T"},
            {"generatedBy": "Mitsuba version 3.9.1"},
            {"color": "R,G,B", "albedo": "albedo", "normal": "nn", "depth": "dd.y"},
        ),
    },
    "falcor": {
        "merged": (
            {
                "Mogwai.AccumulatePass.output": RGBA,
                "Mogwai.PathTracer.albedo": RGBA,
                "Mogwai.PathTracer.guideNormal": RGBA,
            },
            {},
            {
                "color": "Mogwai.AccumulatePass.output",
                "albedo": "Mogwai.PathTracer.albedo",
                "normal": "Mogwai.PathTracer.guideNormal",
            },
        ),
    },
    "common": {
        "a camera's parts": (
            {"depth_main": {"": "Z"}, "normal_main": {"": RGB}, "rgba_main": {"": RGBA}},
            {},
            {"color": "rgba_main", "normal": "normal_main", "depth": "depth_main"},
        ),
        "Natron": (
            {"Color": RGBA, "albedo": RGB, "normals": XYZ, "depth": "Z"},
            {},
            {"color": "Color", "albedo": "albedo", "normal": "normals", "depth": "depth"},
        ),
        "Nuke": (
            {"rgba": (*LONG, "alpha"), "albedo": LONG, "N": LONG, "depth": "Z"},
            {"nuke/version": "15"},
            {"color": "rgba", "albedo": "albedo", "normal": "N", "depth": "depth"},
        ),
    },
}
CASES = [(name, case) for name, cases in LAYOUTS.items() for case in cases]


@pytest.mark.parametrize(("name", "case"), CASES)
def test_a_layout_is_mapped_without_a_flag(name: str, case: str, tmp_path: Path) -> None:
    layout, header, expected = LAYOUTS[name][case]
    (frame,) = channels.match(written(tmp_path / "a.exr", layout, **header))
    assert frame.preset.name == name
    found = {buffer: re.sub(r" \(part.*?\)", "", str(source)) for buffer, source in frame.sources.items()}
    left = {"alpha", "specular", *({"diffuse", "diffuse.albedo"} - set(expected))}
    assert {buffer: text for buffer, text in found.items() if buffer not in left} == expected


def data(name: str) -> dict:
    return tomllib.loads((files("pathfold.channels") / f"{name}.toml").read_text(encoding="utf-8"))


def test_every_file_of_rows_is_a_preset_and_common_comes_last() -> None:
    shipped = {
        entry.name.removesuffix(".toml")
        for entry in files("pathfold.channels").iterdir()
        if entry.name.endswith(".toml")
    }
    names = [preset.name for preset in channels.presets()]
    assert set(names) == shipped and len(names) == len(shipped) and names[-1] == "common"


@pytest.mark.parametrize("preset", channels.presets(), ids=lambda preset: preset.name)
def test_common_names_are_all_that_is_unmistakable(preset: channels.Preset) -> None:
    common = channels.presets()[-1]
    rows = data(preset.name)
    for buffer, entries in rows["buffers"].items():
        assert [entry for entry in entries if entry not in common.buffers[buffer]] == []
    for buffer, entries in rows.get("ambiguous", {}).items():
        own = data("common")["buffers"].get(buffer, [])
        assert [entry for entry in entries if entry in common.buffers.get(buffer, ()) and entry not in own] == []
        assert preset.buffers[buffer][-len(entries) :] == entries  # they count last


@pytest.mark.parametrize("name", [preset.name for preset in channels.presets() if preset.name != "pathfold"])
def test_every_row_names_its_source(name: str) -> None:
    text = (files("pathfold.channels") / f"{name}.toml").read_text(encoding="utf-8")
    rows = [line for line in text.partition("[buffers]")[2].splitlines() if line.startswith("    ")]
    assert rows and [row for row in rows if "# " not in row] == []
    noted = set(re.findall(r"^#   \[(\d)\]", text, re.MULTILINE))
    assert set(re.findall(r"# .*?\[(\d)\]", text.partition("[detect]")[2])) <= noted


def test_the_table_of_renderers_says_what_presets_say() -> None:
    table = (Path(__file__).parent.parent / "docs/renderers.md").read_text(encoding="utf-8")
    rows = [
        [cell.strip() for cell in line.strip("|").split("|")] for line in table.splitlines() if line.startswith("| ")
    ]
    says = {None: "as seen", "sky": "the sky"}
    expected = {preset.title: says.get(preset.miss_albedo, str(preset.miss_albedo)) for preset in channels.presets()}
    assert {row[0]: row[-1] for row in rows[1:]} == expected
    for row, preset in zip(rows[1:], channels.presets(), strict=True):
        for buffer, cell in zip(("color", "albedo", "normal", "depth"), row[1:5], strict=True):
            named = re.findall(r"`([^`]+)`", cell)
            known = [str(entry).removeprefix("*.") for entry in preset.buffers.get(buffer, ())]
            assert [
                name
                for name in named
                if name.removeprefix("*.") not in known and not any(k.endswith(name.strip(".")) for k in known)
            ] == []


@pytest.mark.parametrize(
    ("layer", "header"),
    [("depth", {}), ("VRayZDepth", {}), ("dd", {"generatedBy": "Mitsuba 3"}), ("depth", {"pathfold:version": "1"})],
)
@pytest.mark.parametrize("far", [1e9, 1e10, 1e30, float(np.finfo(np.float32).max)])
def test_depths_too_far_to_be_any_are_misses(layer: str, header: dict, far: float, tmp_path: Path) -> None:
    file = written(tmp_path / "a.exr", {"": RGB, layer: "Z"}, **header)
    depth = file.read(0, [3])
    pixels = np.concatenate([file.read(0, [0, 1, 2]), depth], -1)
    pixels[2, 3, 3] = far
    kinds = ["float"] * 4
    file = ImageFile(write(tmp_path / "b.exr", [part("", file.parts[0].channelnames, kinds, pixels, **header)]))
    (frame,) = channels.match(file)
    depth[2, 3] = 0
    assert np.array_equal(channels.load(file, frame, "depth"), depth) and depth.max() > 0


def test_a_header_tells_rows_that_mean_something_else_elsewhere(tmp_path: Path) -> None:
    """`diffuse` is V-Ray's albedo and Arnold's light; where nobody says whose it is, it is no albedo."""
    layers = {"": RGB, "diffuse": RGB}
    for header, albedo in (({"vrayInfo/build": "7"}, "diffuse"), ({"arnold/version": "7"}, None), ({}, None)):
        (frame,) = channels.match(written(tmp_path / "a.exr", layers, **header))
        assert (str(frame.sources["albedo"]) if "albedo" in frame.sources else None) == albedo
