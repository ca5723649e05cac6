"""A `Denoiser`: a model that is loaded and ready for many frames."""

import os
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from functools import lru_cache
from importlib.util import find_spec
from numbers import Real
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from pathfold import _core, models
from pathfold.arguments import (
    LAYERS,
    PARTS,
    Array,
    as_array,
    check_name,
    kind,
    mapping,
    named_buffers,
    not_a,
    whole,
)

Progress = Callable[[float], object]  # what is false cancels, but for None


@dataclass(frozen=True)
class Result:
    """What one run gives back: float32 arrays, height x width x channels, finite."""

    color: NDArray[np.float32]
    alpha: NDArray[np.float32] | None = None
    diffuse: NDArray[np.float32] | None = None  # with `specular`, where the frame came split
    specular: NDArray[np.float32] | None = None
    layers: dict[str, NDArray[np.float32]] = field(default_factory=dict)
    # what was used, left out and spent, `sanitised` (by buffer: what was wrong, in how many pixels), `notes`
    report: dict[str, Any] = field(default_factory=dict)

    def images(self) -> dict[str, NDArray[np.float32]]:
        """The denoised buffers that there are, by name."""
        named = {"color": self.color, "alpha": self.alpha, "diffuse": self.diffuse, "specular": self.specular}
        return {name: pixels for name, pixels in named.items() if pixels is not None}


class Denoiser:
    """A model that is loaded and ready; keep it for repeated frames.

    `model` is a name (`pathfold.models.available()`), a folder, or the `model` of another Denoiser, which they then
    share (with its `provider`, `threads` and `precision`). `provider` names the onnxruntime execution
    provider ("cpu", "cuda", ...); one that is not there is an error, never replaced. `threads` 0 means all cores that
    the process may use.
    `precision` of the networks: "fp32", "int8" where the model has it, or "auto", the faster one (int8 where the model
    has it, on CPUs that multiply bytes: VNNI, ARM's dot product); what ran is `report["precision"]`.
    `memory_mb` bounds the working memory of a tile (0: chosen), `tile` forces the tile's side in pixels (0: planned).
    `leave_out` says what is not computed where a frame does not need it: "all" (every exact one: "branches",
    "tiles"), "none", or names with commas between; approximate and by name only: "converged" ("all,converged"), tiles
    of at least 16 samples and known variance whose expected RelL2 is at most 1e-4 already; "paths": the samples, where
    the frame has as many as the model's manifest says it does as well without.
    Raises PathfoldError, whose `code` says what kind of fault it is.
    """

    def __init__(
        self,
        model: str | os.PathLike[str] | _core.Model = models.DEFAULT,
        *,
        provider: str = "cpu",
        threads: int = 0,
        precision: str = "auto",
        memory_mb: int = 0,
        tile: int = 0,
        leave_out: str = "all",
    ) -> None:
        _point_to_onnxruntime()
        if not isinstance(model, _core.Model):
            if not isinstance(model, (str, os.PathLike)):
                raise not_a(f"model is {kind(model)}", "a name, a folder, or the `model` of another Denoiser")
            for name, text in (("provider", provider), ("precision", precision)):
                check_name(name, text)
            folder = os.fspath(models.find(model))
            count = whole("threads", threads, "a whole number, 0 for all cores")
            model = _core.Model(folder, provider=provider, threads=count, precision=precision)
        self.model = model
        check_name("leave_out", leave_out)
        self._core = _core.Denoiser(
            self.model,
            memory_mb=whole("memory_mb", memory_mb, "whole megabytes, 0 to have it chosen"),
            tile=whole("tile", tile, "whole pixels, 0 to have it planned"),
            leave_out=leave_out,
        )

    def run(
        self,
        color: Array | None = None,
        *,
        diffuse: Array | None = None,
        specular: Array | None = None,
        diffuse_albedo: Array | None = None,
        albedo: Array | None = None,
        normal: Array | None = None,
        depth: Array | None = None,
        alpha: Array | None = None,
        variance: Array | None = None,
        diffuse_variance: Array | None = None,
        specular_variance: Array | None = None,
        samples: Mapping[str, Array] | None = None,
        layers: Mapping[str, Mapping[str, Array]] | None = None,
        samples_per_pixel: int = 0,
        exposure: float | None = None,
        progress: Progress | None = None,
    ) -> Result:
        """Denoise one frame.

        Images are height x width x channels (one-channel ones may be height x width), float32 or float16,
        any strides:
        `color`, `diffuse`, `specular`: linear radiance, below 0 only in colours outside of the gamut;
        `diffuse_albedo` in [0, 1]; `albedo` in [0, 1],
        1 on a miss and on visible lights; `normal` in [-1, 1], in camera space, 0 on a miss; `depth` > 0, 0 on a
        miss; `alpha` in [0, 1]; the variances are those of the pixel mean.
        `samples`: {"descriptor": S x H x W x C, "density": S x H x W x 1, "valid": S x H x W x 1
        (optional)}; C is 6 + 5 * vertices, at most 6 of them, fewer where no path of the frame has more.
        `samples_per_pixel` of the frame, 0: as many as there are in `samples`, which may hold the first ones alone
        (a manifest's `samples_per_pixel.embedded` says how many a model looks at).
        `layers`: AOVs to filter alike, {"key light": {"color": ...}} or {..: {"diffuse": ..., "specular":
        ...}}. Give `diffuse`, `specular` and `diffuse_albedo` to models that
        filter the two apart (the kpcn ones), else `color`.
        `exposure` replaces the automatic factor; `progress` gets the fraction done, on this thread, and returns
        False (0, np.False_) to cancel, anything else or None to go on. Ctrl-C ends a run soon, with or without it.
        Threads that share a Denoiser take turns. Raises PathfoldError that names the buffer, what was given and what
        would be right.
        """
        named = named_buffers(
            samples,
            color=color,
            diffuse=diffuse,
            specular=specular,
            diffuse_albedo=diffuse_albedo,
            albedo=albedo,
            normal=normal,
            depth=depth,
            alpha=alpha,
            variance=variance,
            diffuse_variance=diffuse_variance,
            specular_variance=specular_variance,
        )
        return self.run_buffers(
            named, layers=layers, samples_per_pixel=samples_per_pixel, exposure=exposure, progress=progress
        )

    def run_buffers(
        self,
        buffers: Mapping[str, Array | None],
        *,
        layers: Mapping[str, Mapping[str, Array]] | None = None,
        samples_per_pixel: int = 0,
        exposure: float | None = None,
        progress: Progress | None = None,
    ) -> Result:
        """`run` with the buffers under their own names ("diffuse.albedo", "samples.descriptor", ...)."""
        arrays, extra = _arrays(buffers, layers)
        if exposure is not None and not isinstance(exposure, Real):
            raise not_a(f"exposure is {kind(exposure)}", "a number > 0, or None")
        count = whole("samples_per_pixel", samples_per_pixel, "a whole number, 0 where it is not known")
        if progress is not None and not callable(progress):
            raise not_a(f"progress is {kind(progress)}", "a function that takes the fraction done, or None")
        images, report = self._core.run(
            arrays,
            layers=extra,
            samples_per_pixel=count,
            exposure=exposure,
            progress=progress,
        )
        kept = {name: images.pop(name, None) for name in ("alpha", "diffuse", "specular")}
        return Result(color=images.pop("color"), **kept, layers=images, report=report)

    def plan_buffers(
        self,
        buffers: Mapping[str, Array | None],
        *,
        layers: Mapping[str, Mapping[str, Array]] | None = None,
        samples_per_pixel: int = 0,
    ) -> _core.Plan:
        """What `run_buffers` would come to, by sizes and settings alone: tiles, pixels of their windows, bytes held."""
        arrays, extra = _arrays(buffers, layers)
        count = whole("samples_per_pixel", samples_per_pixel, "a whole number, 0 where it is not known")
        return self._core.plan(arrays, layers=extra, samples_per_pixel=count)


def _arrays(
    buffers: Mapping[str, Array | None], layers: Mapping[str, Mapping[str, Array]] | None
) -> tuple[dict[str, NDArray[Any]], dict[str, dict[str, NDArray[Any]]] | None]:
    """Buffers and layers as the SDK takes them."""
    given = mapping("buffers", buffers, '{"color": array, ...}')
    arrays = {name: as_array(name, value) for name, value in given.items() if value is not None}
    extra = {
        layer: {
            part: as_array(f"layer {layer!r}, {part}", value)
            for part, value in mapping(f"layers[{layer!r}]", parts, PARTS).items()
        }
        for layer, parts in mapping("layers", layers, LAYERS).items()
    }
    return arrays, extra or None


def auto_exposure(color: Array) -> float:
    """The exposure that a run chooses for a picture, height x width x 3, by the rule of the shipped models.

    Log-average luminance to 0.18, hardly moved by outlying pixels; 1 for a black picture. Raises PathfoldError.
    """
    return _core.auto_exposure(as_array("color", color))


@lru_cache(maxsize=1)
def _point_to_onnxruntime() -> None:
    """Tell the SDK where the onnxruntime package keeps its library; PATHFOLD_ONNXRUNTIME goes first."""
    if "PATHFOLD_ONNXRUNTIME" in os.environ:
        return
    package = find_spec("onnxruntime")
    for folder in (package.submodule_search_locations or []) if package else []:
        for pattern in ("libonnxruntime.so*", "libonnxruntime*.dylib", "onnxruntime.dll"):
            for library in sorted((Path(folder) / "capi").glob(pattern)):
                _core.set_onnxruntime(str(library))
                return
