"""EXR files made on the spot, by the writers' conventions, for the tests."""

from pathlib import Path

import numpy as np
import OpenImageIO as oiio  # noqa: N813
from pathfold.channels import samples
from pathfold.images import NewPart, write_parts

RGB = ["R", "G", "B"]
SIZE = (12, 9)  # width, height
Parts = list[tuple[oiio.ImageSpec, np.ndarray]]


def part(name: str, channels: list[str], kinds: list[str], values: np.ndarray, **header: object) -> tuple:
    height, width = values.shape[:2]
    spec = oiio.ImageSpec(width, height, len(channels), oiio.TypeDesc(kinds[0]))
    spec.channelnames = tuple(channels)
    spec.channelformats = tuple(oiio.TypeDesc(kind) for kind in kinds)
    spec.attribute("compression", "zips")
    if name:
        spec.attribute("oiio:subimagename", name)
    for key, value in header.items():
        spec.attribute(key, value)
    return spec, np.ascontiguousarray(values, np.float32)


def write(path: Path, parts: Parts) -> Path:
    output = oiio.ImageOutput.create(str(path))
    for number, (spec, values) in enumerate(parts):
        if number:
            assert output.open(str(path), spec, "AppendSubimage")
        else:
            assert output.open(str(path), tuple(spec for spec, _ in parts) if len(parts) > 1 else spec), (
                output.geterror()
            )
        assert output.write_image(values), output.geterror()
    assert output.close()
    return path


def noise(channels: int, seed: int = 0, size: tuple[int, int] = SIZE) -> np.ndarray:
    return np.random.default_rng(seed).uniform(0, 4, (size[1], size[0], channels)).astype(np.float32)


def beauty(path: Path, seed: int = 0, extra: int = 3) -> Path:
    """A half-float picture with alpha, albedo and a layer that nobody knows."""
    names = [*RGB, "A", *(f"albedo.{c}" for c in RGB), *(f"fill.{c}" for c in RGB[:extra])]
    values = noise(len(names), seed)
    values[..., 3:7] = np.clip(values[..., 3:7], 0, 1)
    return write(path, [part("", names, ["half"] * len(names), values, artist="nobody")])


def with_samples(path: Path, count: int = 2, specular: float = 1) -> Path:
    """A picture of our own with split buffers and path descriptors; `specular` scales that radiance."""
    rng = np.random.default_rng(7)
    block = {
        "descriptor": rng.normal(0, 1, (count, SIZE[1], SIZE[0], 36)).astype(np.float16),
        "density": rng.normal(0, 1, (count, SIZE[1], SIZE[0], 1)).astype(np.float32),
    }
    names = [*RGB, *(f"{layer}.{c}" for layer in ("diffuse", "specular", "diffuse.albedo") for c in RGB)]
    values = noise(12)
    values[..., 6:9] *= specular
    values[..., :3] = values[..., 3:6] + values[..., 6:9]
    buffers = NewPart("buffers", names, ["float"] * 12, SIZE, lambda first, last: values[first:last])
    write_parts(path, [buffers, samples.to_part(block)], {"pathfold:version": "0", "pathfold:spp": count})
    return path
