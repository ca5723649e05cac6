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
    def plan(
        self,
        buffers: Mapping[str, Array],
        *,
        layers: Mapping[str, Mapping[str, Array]] | None = None,
        samples_per_pixel: int = 0,
    ) -> Plan: ...

class Plan:
    """What a run comes to. A tile's window is the tile and its overlap."""

    @property
    def tile_width(self) -> int: ...
    @property
    def tile_height(self) -> int: ...
    @property
    def tiles(self) -> int: ...
    @property
    def window_pixels(self) -> int: ...  # of the largest window
    @property
    def pixels(self) -> int: ...  # of all windows
    @property
    def window_bytes(self) -> int: ...  # held for the largest window, as far as it is known
    @property
    def frame_bytes(self) -> int: ...  # held for the frame, beside what the caller gives and gets
    @property
    def result_bytes(self) -> int: ...  # of the arrays that a run returns

class Layout:
    """Where the channels of a path descriptor lie: the first of each kind."""

    def __init__(self, vertices: int = ...) -> None: ...
    @property
    def radiance(self) -> int: ...
    @property
    def light(self) -> int: ...
    @property
    def attenuation(self) -> int: ...
    @property
    def kind(self) -> int: ...
    @property
    def roughness(self) -> int: ...
    @property
    def channels(self) -> int: ...

MAX_VERTICES: int
DEAD_LOG: float
LEAST_VALUE: float
KINDS: dict[str, int]

def descriptor_vertices(channels: int) -> int: ...
def buffers() -> list[tuple[str, int, bool]]: ...
def describe_path(
    light: Sequence[float],
    path: Sequence[tuple[Sequence[float], int, float, float]],
    vertices: int = ...,
) -> tuple[list[float], float]: ...
def version() -> str: ...
def set_onnxruntime(path: str) -> None: ...
def find_model(name: str, extra_dirs: Sequence[str] = ()) -> str: ...
def auto_exposure(color: NDArray[np.float32] | NDArray[np.float16]) -> float: ...
def gather(image: NDArray[np.float32] | NDArray[np.float16], logits: NDArray[np.float32]) -> NDArray[np.float32]: ...
