"""pathfold: a Monte Carlo denoiser that learns from the paths behind the pixels.

image = pathfold.denoise(color, albedo=albedo, normal=normal)
result = pathfold.Denoiser("kpcn-manifold").run(color=color, samples=samples)
"""

from importlib import import_module
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from pathfold._core import PathfoldError, version
    from pathfold.budget import Budget
    from pathfold.denoiser import Denoiser, Result, auto_exposure
    from pathfold.denoising import denoise

# Nothing is imported before it is used, so that `import pathfold` costs a few milliseconds.
_HOMES = {
    "Budget": "pathfold.budget",
    "Denoiser": "pathfold.denoiser",
    "PathfoldError": "pathfold._core",
    "Result": "pathfold.denoiser",
    "auto_exposure": "pathfold.denoiser",
    "denoise": "pathfold.denoising",
    "version": "pathfold._core",
}
_MODULES = ("channels", "images", "metrics", "models")

__all__ = ["Budget", "Denoiser", "PathfoldError", "Result", "auto_exposure", "denoise", "version"]


def __getattr__(name: str) -> Any:
    if name == "__version__":
        return __getattr__("version")()
    if name in _HOMES:
        return getattr(import_module(_HOMES[name]), name)
    if name in _MODULES:
        return import_module(f"pathfold.{name}")
    raise AttributeError(f"module 'pathfold' has no attribute {name!r}")


def __dir__() -> list[str]:
    return sorted([*__all__, *_MODULES, "__version__"])
