"""The `samples` part of a file: one group of channels per camera sample, `samples.NNN.<field>`.

    path.radiance.R/G/B        undivided radiance of the path's dominant contribution      natural logarithm
    path.light.R/G/B           its photon energy                                           natural logarithm
    path.attenuation.V.R/G/B   BSDF times cosine at vertex V = 0, 1, ..., none that no path has; natural logarithm
    path.tag.V                 interaction at vertex V, a pathfold_kind; 0 where the path has ended
    path.roughness.V           roughness of the lobe sampled at vertex V, 0 delta or ended, 1 diffuse
    path.density               sum of the natural logarithms of the sampling densities     float
    valid                      1, or 0 for a sample that was not finite                    only where any is 0
A logarithm of nothing (the raw value is 0) is stored as PATHFOLD_DEAD_LOG. All are half floats but the density.
"""

from collections.abc import Mapping

import numpy as np
from numpy.typing import NDArray

from pathfold._core import MAX_VERTICES, descriptor_vertices
from pathfold.images import ImageError, ImageFile, NewPart, Window, lay

PART = "samples"


def descriptor(vertices: int) -> tuple[str, ...]:
    """The channels of `samples.descriptor` of so many vertices, in the order that the networks read them."""
    return (
        *(f"path.radiance.{c}" for c in "RGB"),
        *(f"path.light.{c}" for c in "RGB"),
        *(f"path.attenuation.{vertex}.{c}" for vertex in range(vertices) for c in "RGB"),
        *(f"path.tag.{vertex}" for vertex in range(vertices)),
        *(f"path.roughness.{vertex}" for vertex in range(vertices)),
    )


DESCRIPTOR = descriptor(MAX_VERTICES)
_FIELDS = {"descriptor": DESCRIPTOR, "density": ("path.density",), "valid": ("valid",)}
_TYPES = {"descriptor": np.float16, "density": np.float32, "valid": np.float16}

Samples = dict[str, NDArray[np.floating]]


def to_part(samples: Mapping[str, NDArray[np.floating]]) -> NewPart:
    """The part of a block of samples: "descriptor" S x H x W x (6 + 5 * vertices), "density" S x H x W x 1, ..."""
    count, height, width, channels = samples["descriptor"].shape
    fields = {**_FIELDS, "descriptor": descriptor(descriptor_vertices(channels))}
    kinds = {name: "float" if _TYPES[name] == np.float32 else "half" for name in samples}
    names = [f"samples.{s:03d}.{field}" for s in range(count) for name in samples for field in fields[name]]
    formats = [kinds[name] for _ in range(count) for name in samples for _ in fields[name]]

    def rows(first: int, last: int) -> NDArray[np.floating]:
        blocks = [samples[name][s, first:last] for s in range(count) for name in samples]
        return np.concatenate(blocks, axis=-1, dtype=np.float32)

    return NewPart(PART, names, formats, (width, height), rows)


def count(file: ImageFile) -> int:
    """How many samples per pixel a file holds; 0 where it holds none."""
    return len(file.samples[1]) if file.samples else 0


def find(file: ImageFile) -> int | None:
    """The part that holds the samples, None where there is none."""
    return file.samples[0] if file.samples else None


def load(file: ImageFile, window: Window | None = None) -> Samples:
    """Read the block of samples, descriptor in float16, in one pass through the part.

    `window`: where the picture lies, if not where they do; its pixels outside theirs have samples that are not valid.
    Raises ImageError where a field of a sample is missing.
    """
    if file.samples is None:
        raise ImageError(f"{file.path}: has no samples; `pathfold render` writes them")
    part, numbers = file.samples
    spec = file.parts[part]
    channels = {name: number for number, name in enumerate(spec.channelnames)}
    block, places = {}, {}
    vertices = sum(f"samples.{numbers[0]}.path.tag.{vertex}" in channels for vertex in range(MAX_VERTICES))
    for name, fields in {**_FIELDS, "descriptor": descriptor(max(vertices, 1))}.items():
        if not any(f"samples.{s}.{fields[0]}" in channels for s in numbers):
            continue
        wanted = [f"samples.{s}.{field}" for s in numbers for field in fields]
        if missing := [channel for channel in wanted if channel not in channels]:
            raise ImageError(f"{file.path}: {missing[0]} is missing ({len(missing)} sample channels in all)")
        places[name] = np.array([channels[channel] for channel in wanted])
        block[name] = np.empty((len(numbers), spec.height, spec.width, len(fields)), _TYPES[name])
    for row, rows in file.bands(part):
        for name, at in places.items():
            picked = rows[..., at].reshape(*rows.shape[:2], len(numbers), -1)
            block[name][:, row : row + len(rows)] = np.moveaxis(picked, 2, 0)
    own = Window(spec.x, spec.y, spec.width, spec.height)
    return block if window is None or window == own else _laid(block, own, window)


def _laid(block: Samples, own: Window, window: Window) -> Samples:
    shape = block["descriptor"].shape[:3]
    block.setdefault("valid", np.ones((*shape, 1), _TYPES["valid"]))
    laid: Samples = {}
    for name, samples in block.items():
        laid[name] = np.stack([lay(sample.astype(np.float32), own, window, 0.0) for sample in samples])
        laid[name] = laid[name].astype(_TYPES[name])
    return laid
