"""`denoise`: one picture, by a model or inside a budget, in one call."""

import os
from functools import lru_cache
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from pathfold import models
from pathfold.arguments import Array, as_array, check_name, failure, named_buffers, whole
from pathfold.budget import Budget
from pathfold.denoiser import Denoiser


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
            check_name(name, options[name])
        options["threads"] = whole("threads", threads, "a whole number, 0 for all cores")
        folder = models.find(models.DEFAULT if model is None else model).resolve()
        model = _denoiser(folder, os.getpid(), **options)
    return model.run(color, **buffers).color


def _denoise_within(
    seconds: float | None,
    memory_mb: float | None,
    model: str | os.PathLike[str] | Denoiser | None,
    options: dict[str, Any],
    given: dict[str, Any],
) -> NDArray[np.float32]:
    if isinstance(model, Denoiser):
        raise failure("invalid-argument", "model is a Denoiser, which has its tiles already; name the model instead")
    settings = {name: given.pop(name) for name in ("layers", "exposure", "progress") if name in given}
    count = given.pop("samples_per_pixel", 0)
    arrays = {name: as_array(name, value) for name, value in named_buffers(**given).items()}
    for name, pixels in arrays.items():
        if pixels.ndim == (3 if name.startswith("samples.") else 2):  # one channel may come without its axis
            arrays[name] = pixels[..., None]
    budget = Budget(seconds, memory_mb, None if model is None else os.fspath(model), **options)
    choice = budget.choose(arrays, samples_per_pixel=count)
    return choice.run(samples_per_pixel=count, **settings).color


@lru_cache(maxsize=4)
def _denoiser(folder: Path, process: int, **options: Any) -> Denoiser:
    """`process`: what a fork has inherited may have been running in the parent."""
    return Denoiser(folder, **options)
