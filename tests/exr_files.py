"""EXR files made on the spot, by the writers' conventions, for the tests."""

from pathlib import Path

import numpy as np
import OpenImageIO as oiio  # noqa: N813

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
