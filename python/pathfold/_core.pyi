"""The C++ denoiser (python/bindings). Use pathfold.denoise and pathfold.Denoiser."""

from collections.abc import Callable, Mapping, Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float32] | NDArray[np.float16]

class PathfoldError(RuntimeError):
    """A call that failed; the message names the argument, what was given and what would be right."""

    code: str
    """invalid-argument, not-found, invalid-model, engine, unsupported, out-of-memory, cancelled or internal."""

class Model:
    """A model folder, checked and loaded. Immutable: denoisers and threads share it."""

    def __init__(self, folder: str, *, provider: str = "cpu", threads: int = 0, precision: str = "auto") -> None: ...
    @property
    def name(self) -> str: ...
    @property
    def requires(self) -> list[str]: ...
    @property
    def uses(self) -> list[str]: ...
    @property
    def manifest(self) -> dict[str, Any]: ...
    @property
    def folder(self) -> str: ...
    @property
    def precision(self) -> str: ...

class Denoiser:
    """One model applied to frames; keeps its working memory. Threads that share one take turns."""

    def __init__(self, model: Model, *, memory_mb: int = 0, tile: int = 0, leave_out: str = "all") -> None: ...
    def run(
        self,
        buffers: Mapping[str, Array],
        *,
        layers: Mapping[str, Mapping[str, Array]] | None = None,
        exposure: float | None = None,
        progress: Callable[[float], object] | None = None,
        samples_per_pixel: int = 0,
    ) -> tuple[dict[str, NDArray[np.float32]], dict[str, Any]]: ...

def version() -> str: ...
def set_onnxruntime(path: str) -> None: ...
def find_model(name: str, extra_dirs: Sequence[str] = ()) -> str: ...
def auto_exposure(color: NDArray[np.float32] | NDArray[np.float16]) -> float: ...
def gather(image: NDArray[np.float32] | NDArray[np.float16], logits: NDArray[np.float32]) -> NDArray[np.float32]: ...
