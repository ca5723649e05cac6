"""Denoising from Python: `denoise` for one picture, `Denoiser` for many."""

import os
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from functools import lru_cache
from importlib.util import find_spec
from numbers import Integral, Real
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from pathfold import _core, models
from pathfold._core import PathfoldError, version

__all__ = ["Denoiser", "PathfoldError", "Result", "as_array", "auto_exposure", "denoise", "version"]

Array = Any  # whatever has the array interface or DLPack: NumPy, torch on the CPU, Mitsuba, ...
Progress = Callable[[float], bool | None]


@dataclass(frozen=True)
class Result:
    """What one run gives back: float32 arrays, height x width x channels, finite."""

    color: NDArray[np.float32]
    alpha: NDArray[np.float32] | None = None
    diffuse: NDArray[np.float32] | None = None  # with `specular`, where the frame came split
    specular: NDArray[np.float32] | None = None
    layers: dict[str, NDArray[np.float32]] = field(default_factory=dict)
    report: dict[str, Any] = field(default_factory=dict)  # what was used, left out, sanitised and spent

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
    `leave_out` says what is not computed where a frame does not need it: "all" (every exact one: "branches", "tiles",
    "inputs"), "none", or names with commas between; approximate and by name only: "converged" ("all,converged"), tiles
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
                raise _not_a(f"model is {_kind(model)}", "a name, a folder, or the `model` of another Denoiser")
            for name, text in (("provider", provider), ("precision", precision)):
                _check_name(name, text)
            folder = os.fspath(models.find(model))
            count = _whole("threads", threads, "a whole number, 0 for all cores")
            model = _core.Model(folder, provider=provider, threads=count, precision=precision)
        self.model = model
        _check_name("leave_out", leave_out)
        self._core = _core.Denoiser(
            self.model,
            memory_mb=_whole("memory_mb", memory_mb, "whole megabytes, 0 to have it chosen"),
            tile=_whole("tile", tile, "whole pixels, 0 to have it planned"),
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
        `color`, `diffuse`, `specular`: linear radiance >= 0; `diffuse_albedo`, `albedo` in [0, 1]; `normal`
        in [-1, 1]; `depth` > 0, 0 on a miss; `alpha` in [0, 1]; the variances are those of the pixel mean.
        `samples`: {"descriptor": S x H x W x 36, "density": S x H x W x 1, "valid": S x H x W x 1
        (optional)}; the descriptor may have 6 + 5 * vertices channels where no path has 6 vertices.
        `samples_per_pixel` of the frame, 0: as many as there are in `samples`, which may hold the first ones alone
        (a manifest's `samples_per_pixel.embedded` says how many a model looks at).
        `layers`: AOVs to filter alike, {"key light": {"color": ...}} or {..: {"diffuse": ..., "specular":
        ...}}. Give `diffuse`, `specular` and `diffuse_albedo` to models that
        filter the two apart (the kpcn ones), else `color`.
        `exposure` replaces the automatic factor; `progress` gets the fraction done and returns False to
        cancel. Raises PathfoldError that names the buffer, what was given and what would be right.
        """
        named = {
            "color": color,
            "diffuse": diffuse,
            "specular": specular,
            "diffuse.albedo": diffuse_albedo,
            "albedo": albedo,
            "normal": normal,
            "depth": depth,
            "alpha": alpha,
            "variance": variance,
            "diffuse.variance": diffuse_variance,
            "specular.variance": specular_variance,
        }
        named |= {f"samples.{name}": block for name, block in _mapping("samples", samples, _SAMPLES).items()}
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
        given = _mapping("buffers", buffers, '{"color": array, ...}')
        arrays = {name: as_array(name, value) for name, value in given.items() if value is not None}
        extra = {
            layer: {
                part: as_array(f"layer {layer!r}, {part}", value)
                for part, value in _mapping(f"layers[{layer!r}]", parts, _PARTS).items()
            }
            for layer, parts in _mapping("layers", layers, _LAYERS).items()
        }
        if exposure is not None and not isinstance(exposure, Real):
            raise _not_a(f"exposure is {_kind(exposure)}", "a number > 0, or None")
        count = _whole("samples_per_pixel", samples_per_pixel, "a whole number, 0 where it is not known")
        if progress is not None and not callable(progress):
            raise _not_a(f"progress is {_kind(progress)}", "a function that takes the fraction done, or None")
        images, report = self._core.run(
            arrays,
            layers=extra or None,
            samples_per_pixel=count,
            exposure=exposure,
            progress=None if progress is None else lambda done: progress(done) is not False,
        )
        kept = {name: images.pop(name, None) for name in ("alpha", "diffuse", "specular")}
        return Result(color=images.pop("color"), **kept, layers=images, report=report)


def denoise(
    color: Array | None = None,
    *,
    model: str | os.PathLike[str] | Denoiser | None = None,
    precision: str = "auto",
    provider: str = "cpu",
    threads: int = 0,
    leave_out: str = "all",
    seconds: float | None = None,
    memory_mb: float | None = None,
    **buffers: Any,
) -> NDArray[np.float32]:
    """Denoise one frame and return its colour, height x width x 3, float32.

    `model` is a name, a folder or a `Denoiser` (None: pathfold-balanced); everything else is what `Denoiser.run` takes:
    `albedo`, `normal`, `depth`, `diffuse`, `specular`, `diffuse_albedo`, `variance`, `samples`, `exposure`, ...
    `precision`, `provider`, `threads` and `leave_out` are those of `Denoiser`. Loaded models are kept.
    With `seconds` or `memory_mb` a `pathfold.Budget` chooses among the shipped models, or how to run the one that is
    named. Raises PathfoldError, TypeError for a keyword that neither knows.
    """
    if unknown := sorted(buffers.keys() - (Denoiser.run.__kwdefaults__ or {}).keys()):
        raise TypeError(f"denoise() got an unexpected keyword argument {unknown[0]!r}")
    options: dict[str, Any] = {"provider": provider, "threads": threads, "leave_out": leave_out}
    if isinstance(model, Denoiser) and options != {"provider": "cpu", "threads": 0, "leave_out": "all"}:
        raise failure("invalid-argument", f"model is a Denoiser; give {', '.join(options)} where it is made")
    options["precision"] = precision
    if isinstance(model, Denoiser) and precision not in ("auto", model.model.precision):
        raise failure("invalid-argument", f"model is a Denoiser in {model.model.precision}; make one in {precision}")
    if seconds is not None or memory_mb is not None:
        return _denoise_within(seconds, memory_mb, model, options, {"color": color, **buffers})
    if not isinstance(model, Denoiser):
        for name in ("provider", "precision", "leave_out"):
            _check_name(name, options[name])
        options["threads"] = _whole("threads", threads, "a whole number, 0 for all cores")
        model = _denoiser(models.find(models.DEFAULT if model is None else model).resolve(), **options)
    return model.run(color, **buffers).color


def _denoise_within(
    seconds: float | None,
    memory_mb: float | None,
    model: str | os.PathLike[str] | Denoiser | None,
    options: dict[str, Any],
    given: dict[str, Any],
) -> NDArray[np.float32]:
    from pathfold.budget import Budget

    if isinstance(model, Denoiser):
        raise failure("invalid-argument", "model is a Denoiser, which has its tiles already; name the model instead")
    settings = {name: given.pop(name) for name in ("layers", "exposure", "progress") if name in given}
    count = given.pop("samples_per_pixel", 0)
    blocks = _mapping("samples", given.pop("samples", None), _SAMPLES)
    named = {name.replace("_", "."): value for name, value in given.items()}
    named |= {f"samples.{name}": value for name, value in blocks.items()}
    arrays = {name: as_array(name, value) for name, value in named.items() if value is not None}
    for name, pixels in arrays.items():
        if pixels.ndim == (3 if name.startswith("samples.") else 2):  # one channel may come without its axis
            arrays[name] = pixels[..., None]
    budget = Budget(seconds, memory_mb, None if model is None else os.fspath(model), **options)
    choice = budget.choose(arrays, samples_per_pixel=count)
    return choice.run(samples_per_pixel=count, **settings).color


def auto_exposure(color: Array) -> float:
    """The exposure that a run chooses for a picture, height x width x 3, by the rule of the shipped models.

    Log-average luminance to 0.18, hardly moved by outlying pixels; 1 for a black picture. Raises PathfoldError.
    """
    return _core.auto_exposure(as_array("color", color))


@lru_cache(maxsize=4)
def _denoiser(folder: Path, **options: Any) -> Denoiser:
    return Denoiser(folder, **options)


def as_array(name: str, value: Array) -> NDArray[Any]:
    """A float32 or float16 NumPy view of anything array-like on the host, copied where no view exists."""
    if not isinstance(value, np.ndarray):
        value = _from_foreign(name, value)
    if value.dtype in (np.float32, np.float16):
        return value
    if value.dtype.kind == "f":  # float64, or foreign byte order
        return value.astype(np.float32)
    raise failure(
        "invalid-argument",
        f"{name}: given {value.dtype} values; pass linear float32 or float16, say array.astype('float32')",
    )


def _from_foreign(name: str, value: Array) -> NDArray[Any]:
    try:
        if hasattr(value, "__dlpack__"):
            try:
                return np.from_dlpack(value)
            except (BufferError, RuntimeError, TypeError, ValueError):
                pass  # Mitsuba tensors on a GPU and read-only exports still have __array__
        return np.asarray(value)
    except Exception as error:
        raise failure(
            "invalid-argument",
            f"{name}: {_kind(value)} cannot be read as a host array "
            f"({str(error).splitlines()[0] if str(error) else type(error).__name__}); "
            "pass NumPy, or torch after .detach().cpu()",
        ) from error


_SAMPLES = '{"descriptor": S x H x W x 36, "density": S x H x W x 1}'
_PARTS = '{"color": array}, or {"diffuse": array, "specular": array}'
_LAYERS = f"{{NAME: {_PARTS}}}"


def _mapping(name: str, value: object, like: str) -> Mapping[str, Any]:
    """`value` itself if its keys are names; a PathfoldError that shows what it should be like, if not."""
    if value is None:
        return {}
    if not isinstance(value, Mapping):
        raise _not_a(f"{name} is {_kind(value)}", like)
    for key in value:
        if not isinstance(key, str):
            raise _not_a(f"{name} has the key {key!r}, {_kind(key)}", like)
    return value


def _whole(name: str, value: object, like: str) -> int:
    """`value` if it is a whole number of the SDK's 32 bits; a PathfoldError that says what to give, if not."""
    if not isinstance(value, Integral):
        raise _not_a(f"{name} is {_kind(value)}", like)
    if not -(2**31) <= int(value) < 2**31:
        raise _not_a(f"{name} is {value}", f"{like}, of 31 bits")
    return int(value)


def _check_name(name: str, value: object) -> None:
    if not isinstance(value, str):
        raise _not_a(f"{name} is {_kind(value)}", "its name as a str")


def _not_a(given: str, like: str) -> PathfoldError:
    return failure("invalid-argument", f"{given}; give {like}")


def _kind(value: object) -> str:
    kind = type(value)
    return f"a {kind.__qualname__}" if kind.__module__ == "builtins" else f"a {kind.__module__}.{kind.__qualname__}"


def failure(code: str, message: str) -> PathfoldError:
    """A PathfoldError with its code, ready to be raised."""
    error = PathfoldError(message)
    error.code = code
    return error


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
