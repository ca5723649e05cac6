"""Which models there are, and where.

A model is a folder with a manifest.json. A name is an existing folder, else looked up in every folder of
PATHFOLD_MODEL_PATH, else in the installed package (in a checkout: the repository's models/).
"""

import json
import os
from pathlib import Path
from typing import Any

from pathfold import _core
from pathfold.arguments import failure

ALL_SAMPLES = 1 << 30  # more than any pixel has
DEFAULT = "pathfold-balanced"  # a third of the time of kpcn-vanilla, the other one that needs nothing but color

_PACKAGE = Path(__file__).parent


def directories() -> list[Path]:
    """The folders that are searched for models, first match wins."""
    listed = [Path(entry) for entry in os.environ.get("PATHFOLD_MODEL_PATH", "").split(os.pathsep) if entry]
    return [*listed, *shipped_directories()]


def shipped_directories() -> list[Path]:
    """Where the models that come with pathfold lie: inside the package, or in the checkout it runs from."""
    candidates = (_PACKAGE / "models", _PACKAGE.parent.parent / "models")
    return [folder for folder in candidates if folder.is_dir()]


def available(folders: list[Path] | None = None) -> dict[str, Path]:
    """Every model that can be named, name -> folder; `folders` defaults to all searched ones."""
    found: dict[str, Path] = {}
    for folder in directories() if folders is None else folders:
        for manifest in sorted(folder.glob("*/manifest.json")):
            found.setdefault(manifest.parent.name, manifest.parent)
    return dict(sorted(found.items()))


def find(name: str | os.PathLike[str]) -> Path:
    """The folder of a model, given its name or its folder.

    Raises PathfoldError ("not-found") that lists what there is.
    """
    return Path(_core.find_model(os.fspath(name), [os.fspath(folder) for folder in shipped_directories()]))


def manifest(name: str | os.PathLike[str]) -> dict[str, Any]:
    """The manifest of a model as it stands in its file (a Denoiser checks it).

    Raises PathfoldError ("not-found", "invalid-model").
    """
    path = find(name) / "manifest.json"
    try:
        loaded = json.loads(path.read_text(encoding="utf-8"))
    except (OSError, ValueError) as error:
        raise failure("invalid-model", f"{path}: cannot be read: {error}; name a folder with a model in it") from error
    for key in ("requires", "uses"):
        names = loaded.get(key) if isinstance(loaded, dict) else None
        if not isinstance(names, list) or not all(isinstance(item, str) for item in names):
            raise failure("invalid-model", f"{path}: is no manifest: `{key}` is not a list of buffer names")
    return loaded


def precisions(name: str | os.PathLike[str]) -> list[str]:
    """The precisions that a model can run in, "fp32" first. Raises PathfoldError as `manifest` does."""
    variants = manifest(name).get("variants", {})
    if not isinstance(variants, dict):
        raise failure("invalid-model", f"{find(name) / 'manifest.json'}: `variants` is no object of precisions")
    return ["fp32", *variants]


def inputs(name: str | os.PathLike[str]) -> set[str]:
    """All buffers that a model reads: those that it requires and those that it can use."""
    entry = manifest(name)
    return {*entry["requires"], *entry["uses"]}


def path_samples(name: str | os.PathLike[str]) -> int:
    """The most samples of a pixel whose paths a model looks at: 0 where it reads none, ALL_SAMPLES without a limit."""
    entry = manifest(name)
    if not any(buffer.startswith("samples.") for buffer in (*entry["requires"], *entry["uses"])):
        return 0
    counts = entry.get("samples_per_pixel")
    limit = counts.get("embedded") if isinstance(counts, dict) else None
    return limit if isinstance(limit, int) and limit > 0 else ALL_SAMPLES


def shipped_path_samples() -> int:
    """The most that any model that comes with pathfold looks at."""
    return max((path_samples(folder) for folder in available(shipped_directories()).values()), default=0)


def shipped_inputs() -> set[str]:
    """All buffers that any model that comes with pathfold reads."""
    return set().union(*(inputs(folder) for folder in available(shipped_directories()).values()))
