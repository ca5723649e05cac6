"""What a bench compares: the noisy picture, Open Image Denoise, and every model."""

import json
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from hashlib import sha256
from importlib.metadata import PackageNotFoundError, version
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from pathfold import models
from pathfold.arguments import failure
from pathfold.bench import peers
from pathfold.denoiser import Denoiser

NOISY = "noisy"
PRECISIONS = ("fp32", "int8")  # what a model's name may end in, with a colon before it; without it: the default
PEERS = {"oidn": peers.oidn, "oidn-fast": peers.oidn_fast, "oidn-prefiltered": peers.oidn_prefiltered}
COMPARED = (NOISY, "oidn", "oidn-prefiltered")  # with models, where nobody says otherwise

Image = NDArray[np.float32]
Buffers = Mapping[str, NDArray[Any]]
# Buffers, the exposure (None: its own) and the frame's samples per pixel (0: as many as it has) to the picture.
Run = Callable[[Buffers, float | None, int], Image]


@dataclass(frozen=True)
class Candidate:
    """A way to get a clean picture from buffers."""

    name: str  # what tables call it
    argument: str  # what `find` makes it from
    reads: frozenset[str]
    identity: str  # changes where results may change
    load: Callable[[], Run]  # reads weights and all else that a first frame needs
    path_samples: int = 0  # the most samples of a pixel whose paths it looks at

    @property
    def reads_paths(self) -> bool:
        return self.path_samples > 0


def find(argument: str) -> Candidate:
    """`noisy`, `oidn`, `oidn-fast`, `oidn-prefiltered`, or a model's name or folder, with `:fp32` or `:int8` behind it.

    Raises PathfoldError ("not-found") that says what there is, ("unsupported") where a model has no such precision.
    """
    if argument == NOISY:
        return Candidate(NOISY, argument, frozenset({"color"}), "", lambda: lambda buffers, *_: buffers["color"])
    if argument in PEERS:
        return _peer(argument)
    name, colon, precision = argument.rpartition(":")
    if not colon or precision not in PRECISIONS:
        name, colon, precision = argument, "", "auto"
    try:
        folder = models.find(name)
    except Exception as error:
        others = ", ".join((NOISY, *PEERS))
        raise failure("not-found", f"{error}; besides models there are {others}") from error
    if colon and precision not in (known := models.precisions(folder)):
        raise failure("unsupported", f"{argument}: the model has no {precision}, only {', '.join(known)}")
    reads = frozenset({"color", *models.inputs(folder)})
    title, identity = folder.name + (colon and f":{precision}"), fingerprint(models.manifest(folder), precision)
    paths = models.path_samples(folder)
    return Candidate(title, argument, reads, identity, lambda: _model(folder, precision), paths)


def fingerprint(manifest: dict[str, Any], precision: str = "auto") -> str:
    """Of what a model's results depend on: its graphs, by their hashes, and what is done with what they say."""
    parts = {name: manifest.get(name) for name in ("requires", "uses", "graphs", "reconstruction", "exposure", "tile")}
    if "embedded" in (counts := manifest.get("samples_per_pixel") or {}):
        parts["embedded"] = counts["embedded"]
    if precision != "fp32" and "variants" in manifest:
        parts["variants"] = manifest["variants"]
    return sha256(json.dumps(parts, sort_keys=True).encode()).hexdigest()[:12]


def find_all(arguments: Sequence[str]) -> list[Candidate]:
    """Every one, in order; raises PathfoldError as `find`, or where two would go by one name."""
    found = {argument: find(argument) for argument in dict.fromkeys(arguments)}
    names: dict[str, str] = {}
    for argument, candidate in found.items():
        if (other := names.setdefault(candidate.name, argument)) != argument:
            raise failure("invalid-argument", f"{other} and {argument} are both called {candidate.name}: rename one")
    return list(found.values())


def default_arguments() -> list[str]:
    """The noisy picture, OIDN twice, and the shipped models."""
    return [*COMPARED, *models.available(models.shipped_directories())]


def _peer(name: str) -> Candidate:
    try:
        identity = version("pyoidn")
    except PackageNotFoundError:
        identity = "missing"  # loading it says so

    def load() -> Run:
        run = PEERS[name]
        return lambda buffers, scale, _: run(buffers["color"], buffers.get("albedo"), buffers.get("normal"), scale)

    return Candidate(name, name, frozenset({"color", "albedo", "normal"}), identity, load)


def _model(folder: Path, precision: str) -> Run:
    denoiser = Denoiser(folder, precision=precision)
    return lambda buffers, exposure, spp: denoiser.run_buffers(buffers, exposure=exposure, samples_per_pixel=spp).color
