"""A pattern of layers means radiance: what is something else stays to the bit, with a line; named exactly, an error."""

from pathlib import Path

import numpy as np
import pytest
from exr_files import RGB, part, write
from pathfold.denoiser import Denoiser
from pathfold.files import Denoised, denoise_file
from pathfold.images import ImageError, ImageFile

SIZE = 16
rng = np.random.default_rng(5)
LIGHT = rng.gamma(2, 0.5, (SIZE, SIZE, 3))
UNIT = rng.normal(0, 1, (SIZE, SIZE, 3))
UNIT /= np.linalg.norm(UNIT, axis=-1, keepdims=True)
HASHES = rng.integers(1, 2**31 - 2**24, (SIZE, SIZE, 3)).astype(np.uint32).view(np.float32)
FAR = np.where(rng.random((SIZE, SIZE, 1)) < 0.2, 3e38, 5.0)


def picture(
    path: Path, layers: dict[str, tuple[list[str], str, np.ndarray]], beauty: str = "half", **header: object
) -> Path:
    names, kinds, values = [*RGB], [beauty] * 3, [LIGHT]
    for layer, (letters, kind, pixels) in layers.items():
        names += [f"{layer}.{letter}" if letter else layer for letter in letters]
        kinds += [kind] * len(letters)
        values.append(pixels[..., : len(letters)])
    return write(path, [part("", names, kinds, np.dstack(values).astype(np.float32), **header)])


def run(source: Path, *patterns: str) -> Denoised:
    return denoise_file(source, source.with_name("out.exr"), Denoiser("single-3"), layers=patterns, exposures=[1.0])[0]


def changed(source: Path) -> set[str]:
    before, after = ImageFile(source), ImageFile(source.with_name("out.exr"))
    names = before.parts[0].channelnames
    a, b = (file.read(0, range(len(names))).view(np.uint32) for file in (before, after))
    return {name.rpartition(".")[0] or name for at, name in enumerate(names) if (a[..., at] != b[..., at]).any()}


NAMED = {
    "N": ([*"XYZ"], "half", abs(UNIT)),
    "Z": ([""], "half", FAR % 7),
    "P": ([*"XYZ"], "half", LIGHT),
    "uv": ([*RGB], "half", LIGHT),
    "motionvector": ([*RGB], "half", LIGHT),
    "objectId": ([""], "half", LIGHT),
    "diffuse_albedo": ([*RGB], "half", LIGHT),
    "crypto_asset00": ([*RGB], "half", LIGHT),
    "RenderLayer.Depth": ([""], "half", LIGHT),
    "light_id": ([""], "half", LIGHT),
    "lightMask": ([*RGB], "half", LIGHT),
    "shadow_matte": ([*RGB], "half", LIGHT),
    "worldPos": ([*"XYZ"], "half", LIGHT),
    "surfacepoint": ([*RGB], "half", LIGHT),
    "samplecount": ([""], "half", LIGHT),
    "confidence": ([""], "half", LIGHT),
    "albedo_variance": ([*RGB], "half", LIGHT),
}


@pytest.mark.parametrize("name", NAMED)
def test_what_its_name_says_is_no_radiance(tiny: Path, tmp_path: Path, name: str) -> None:
    source = picture(tmp_path / "in.exr", {name: NAMED[name], "key": (RGB, "half", LIGHT / 2)})
    done = run(source, "*")
    assert done.layers == ("key",)
    assert len(done.left) == 1
    assert changed(source) == {*RGB, "key"}
    with pytest.raises(ImageError, match=r"nothing to filter: .* is no radiance but"):
        run(source, f"{name[:-1]}?" if "." not in name else "Render*")
    exact = name.removesuffix(".Depth")
    with pytest.raises(ImageError, match=f"--layer {exact}: is no radiance but"):
        run(source, exact)


VALUES = {
    "normals": ("half", UNIT, "partly negative"),
    "hashes": ("float", HASHES, "32-bit|not finite"),
    "far": ("float", np.dstack([FAR] * 3), "beyond 1e30"),
    "nan": ("half", np.where(rng.random((SIZE, SIZE, 1)) < 0.2, np.nan, LIGHT), "not finite"),
    "ids": ("uint", LIGHT / 100, "integers"),
    "float": ("float", LIGHT, "32-bit values beside a half beauty"),
}


@pytest.mark.parametrize("what", VALUES)
def test_what_its_values_say_is_no_radiance(tiny: Path, tmp_path: Path, what: str) -> None:
    kind, pixels, _ = VALUES[what]
    layers = {"custom": (RGB, kind, pixels), "key": (RGB, "half", LIGHT / 2)}
    if kind == "uint":
        layers = {"custom": ([""], kind, pixels / 1e9), "key": layers["key"]}
    source = picture(tmp_path / "in.exr", layers)
    done = run(source, "*")
    assert done.layers == ("key",)
    assert changed(source) == {*RGB, "key"}
    assert any(reason in done.left["custom"] for reason in VALUES[what][2].split("|"))


@pytest.mark.parametrize("called", ["Render.Objects", "Objects", "uCryptoThing"])
def test_the_header_says_what_is_a_cryptomatte(tiny: Path, tmp_path: Path, called: str) -> None:
    plain = called.rpartition(".")[2]
    layers = {f"{plain}0{n}": (RGB, "half", LIGHT) for n in range(2)} | {"key": (RGB, "half", LIGHT / 2)}
    source = picture(tmp_path / "in.exr", layers, **{"cryptomatte/1234567/name": called})
    done = run(source, "*")
    assert set(done.left.values()) == {"cryptomatte"}
    assert changed(source) == {*RGB, "key"}


@pytest.mark.parametrize(
    "layer", ["key", "diffuse_direct", "lgt_rim", "C_background", "pointLight1", "specular_transmission"]
)
def test_light_is_filtered_whatever_its_type(tiny: Path, tmp_path: Path, layer: str) -> None:
    wide = LIGHT * [1, 1, -0.3]  # outside the gamut: its luminance is positive
    for pixels in (LIGHT, wide):
        source = picture(tmp_path / "in.exr", {layer: (RGB, "float", pixels)}, beauty="float")
        assert run(source, "*").layers == (layer,)


def test_a_guide_in_use_stays_whatever_it_is_called(tiny: Path, tmp_path: Path) -> None:
    layers = {"first": (RGB, "half", LIGHT.clip(0, 1)), "key": (RGB, "half", LIGHT / 2)}
    source = picture(tmp_path / "in.exr", layers)
    target = tmp_path / "out.exr"
    (done,) = denoise_file(source, target, Denoiser("single-3"), layers=["*"], mapping={"albedo": "first"})
    assert done.left == {"first": "albedo"}
    assert changed(source) == {*RGB, "key"}


def test_nothing_but_data_is_an_error_that_says_what_it_is(tiny: Path, tmp_path: Path) -> None:
    source = picture(tmp_path / "in.exr", {"N": NAMED["N"], "Z": NAMED["Z"]})
    with pytest.raises(ImageError, match=r"--layer \*: nothing to filter: .*(normal|depth)"):
        run(source, "*")
