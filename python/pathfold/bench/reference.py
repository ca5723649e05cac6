"""References: what a picture should be, in two independent halves where there are such."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from time import perf_counter
from typing import Any

import numpy as np
from numpy.typing import NDArray

from pathfold import channels, metrics
from pathfold.images import ImageError, ImageFile, NewPart, Window, write_parts

_CHUNK = 16  # samples per pixel and call
_SEED = 100_000  # the first one; noisy pictures have small seeds

Image = NDArray[np.float32]


@dataclass(frozen=True)
class Reference:
    """A reference picture (height x width x 3, linear); with halves, it is their mean."""

    mean: Image
    halves: tuple[Image, Image] | None = None
    spp: int | None = None
    max_depth: int | None = None  # of its paths, in Mitsuba's meaning

    @staticmethod
    def read(path: Path) -> "Reference":
        """Read an EXR: its beauty, `half_a` and `half_b`, and the header's spp and max_depth.

        Raises ImageError where it has no beauty, or pixels that are not finite.
        """
        file = ImageFile(path)
        mean = beauty(file)
        halves = read_halves(file, channels.match(file)[0].window)
        if halves and not all(np.isfinite(half).all() for half in halves):
            raise ImageError(f"{path}: its halves half_a, half_b hold pixels that are not finite; mend or remove them")
        return Reference(mean, halves, header(file, "reference/spp"), header(file, "reference/max_depth"))

    def save(self, path: Path) -> None:
        """Write it so that `read` gives it back."""
        pictures = {"": self.mean}
        if self.halves:
            pictures |= {"half_a.": self.halves[0], "half_b.": self.halves[1]}
        names = [f"{prefix}{letter}" for prefix in pictures for letter in "RGB"]
        stacked = np.concatenate(list(pictures.values()), -1)
        height, width = self.mean.shape[:2]
        part = NewPart("", names, ["float"] * len(names), (width, height), lambda first, last: stacked[first:last])
        facts = {"reference/spp": self.spp, "reference/max_depth": self.max_depth}
        write_parts(path, [part], {name: value for name, value in facts.items() if value is not None})

    @property
    def size(self) -> tuple[int, int]:
        """Width, height."""
        return self.mean.shape[1], self.mean.shape[0]

    def cut(self, rows: slice, columns: slice) -> "Reference":
        """The same of some of its pixels."""
        halves = (self.halves[0][rows, columns], self.halves[1][rows, columns]) if self.halves else None
        return replace(self, mean=self.mean[rows, columns], halves=halves)

    @property
    def own_error(self) -> float | None:
        """RelL2 of the reference itself; None without halves."""
        return metrics.reference_rell2(*self.halves) if self.halves else None

    def errors(self, image: Image, scale: float | None = None) -> dict[str, float]:
        """RelL2, SMAPE, SSIM and FLIP of a picture, and RelL2 as the paper takes it where the picture is large enough.

        With halves both RelL2 are free of the reference's own noise. `scale`: the exposure of SSIM and FLIP.
        Raises ValueError where sizes differ or pixels are not finite.
        """
        if bad := int((~np.isfinite(image)).any(-1).sum()):
            raise ValueError(f"{bad} pixels are not finite, so there is nothing to measure")
        found = metrics.compare(image, self.mean, scale) | {"rell2": self._rell2(image, lambda x: x, metrics.EPSILON)}
        if metrics.cropped(image) is not None:
            found["rell2_paper"] = self._rell2(image, metrics.cropped, metrics.PAPER_EPSILON)
        return found

    def _rell2(self, image: Image, cut: Callable[[Any], Any], epsilon: float) -> float:
        if self.halves:
            return metrics.rell2_halves(cut(image), cut(self.halves[0]), cut(self.halves[1]), epsilon)
        return metrics.rell2(cut(image), cut(self.mean), epsilon)


def shared_exposure(references: Sequence[Reference]) -> float:
    """The exposure of metrics.exposure, taken over the pixels of all frames."""
    return metrics.exposure(np.concatenate([reference.mean.reshape(-1, 3) for reference in references]))


def beauty(file: ImageFile) -> Image:
    """The picture's colour; ImageError where it is not finite."""
    color = channels.load(file, channels.match(file)[0], "color")
    if bad := int((~np.isfinite(color)).any(-1).sum()):
        raise ImageError(f"{file.path}: {bad} pixels are not finite, so there is nothing to measure; denoise it first")
    return color


def read_halves(file: ImageFile, window: Window) -> tuple[Image, Image] | None:
    """The two independent halves of a reference over a window, NaN where it lacks them; None where it holds none."""
    layers = [file.layer(name) for name in ("half_a", "half_b")]
    found = [(layer, at) for layer in layers if layer and (at := layer.pick(3))]
    if len(found) < 2:
        return None
    a, b = (file.read_into(layer, at, window, float("nan")) for layer, at in found)
    return a, b


def header(file: ImageFile, name: str) -> int | None:
    """A whole number in the header; None where there is none."""
    try:
        return int(str(file.metadata()[name]))
    except (KeyError, ValueError):
        return None


def render(
    scene: Any,
    spp: int,
    seconds: float,
    bar: Callable[[float], None],
    *,
    sensor: int = 0,
    max_depth: int | None = None,
) -> Reference:
    """Render two independent halves with Mitsuba's path tracer: `spp` samples in both together at most, and no new
    round after `seconds`.

    `max_depth` replaces the scene's integrator by `path` of that depth; None keeps it.
    """
    import mitsuba as mi

    end = perf_counter() + seconds
    path: Any = {"type": "path", "max_depth": max_depth}
    integrator: Any = mi.load_dict(path) if max_depth else scene.integrator()
    sums: list[Any] = [0.0, 0.0]
    chunk = min(_CHUNK, max(1, spp // 2))
    rounds = max(1, spp // (2 * chunk))
    for done in range(rounds):
        for half in range(2):
            seed = mi.UInt32(_SEED + 2 * done + half)
            image = mi.render(scene, sensor=sensor, integrator=integrator, spp=chunk, seed=seed)
            sums[half] = sums[half] + np.array(image, np.float64)[..., :3]
        bar((done + 1) / rounds)
        if perf_counter() > end:
            break
    a, b = ((total / (done + 1)).astype(np.float32) for total in sums)
    return Reference(((a + b) / 2).astype(np.float32), (a, b), 2 * chunk * (done + 1), max_depth)
