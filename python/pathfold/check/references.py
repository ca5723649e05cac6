"""references.npz of a model folder: what float64 torch makes of every case, written by `pathfold-train export`.

It holds an H x W x 3 float32 image per case (its name is the key) and `about`, JSON as bytes: the format's version,
the SHA-256 of each graph that the references were computed from, and per case the SHA-256 of its frame and the
largest |logit|.
"""

from __future__ import annotations

import hashlib
import json
import zipfile
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from pathfold.check.cases import Buffers

FILE, FORMAT, MAX_BYTES = "references.npz", 1, 1 << 24


class ReferencesError(RuntimeError):
    """References that cannot be used; the message says why and how to mend it."""


@dataclass(frozen=True)
class References:
    images: dict[str, NDArray[np.float32]] = field(default_factory=dict)  # by case
    frames: dict[str, str] = field(default_factory=dict)  # SHA-256 of the case's frame
    logits: dict[str, float] = field(default_factory=dict)  # largest |logit|


def frame_hash(buffers: Buffers) -> str:
    """SHA-256 over names, shapes and bits of a frame."""
    total = hashlib.sha256()
    for name in sorted(buffers):
        values = buffers[name]
        total.update(f"{name} {values.dtype} {values.shape} ".encode())
        total.update(np.ascontiguousarray(values).astype(values.dtype.newbyteorder("<")).tobytes())
    return total.hexdigest()


def write(folder: Path, manifest: dict[str, Any], references: References) -> None:
    """Write references.npz beside the graphs that `manifest` describes."""
    about = {
        "format": FORMAT,
        "graphs": {name: graph["sha256"] for name, graph in manifest["graphs"].items()},
        "frames": references.frames,
        "logits": references.logits,
    }
    packed: dict[str, Any] = {"about": np.frombuffer(json.dumps(about).encode(), np.uint8), **references.images}
    np.savez_compressed(folder / FILE, **packed)


def read(folder: Path, manifest: dict[str, Any]) -> References | None:
    """The references of a model; None where it has none. Raises ReferencesError where they cannot be used."""
    path = folder / FILE
    if not path.is_file():
        return None
    try:
        with zipfile.ZipFile(path) as archive:
            if sum(entry.file_size for entry in archive.infolist()) > MAX_BYTES:
                raise ReferencesError(f"{path} unpacks to more than {MAX_BYTES} bytes; export the model again")
        with np.load(path, allow_pickle=False) as loaded:
            arrays = {name: loaded[name] for name in loaded.files}
        about = json.loads(arrays.pop("about").tobytes())
        graphs, version = about["graphs"], about["format"]
        references = References(arrays, about["frames"], about["logits"])
    except (OSError, ValueError, KeyError, TypeError, zipfile.BadZipFile) as error:
        raise ReferencesError(f"{path} cannot be read: {error}; export the model again") from error
    if version != FORMAT:
        raise ReferencesError(f"{path} has format {version}; this pathfold reads {FORMAT}: export the model again")
    if graphs != {name: graph["sha256"] for name, graph in manifest["graphs"].items()}:
        raise ReferencesError(f"{path} was computed from other weights than the model's; export the model again")
    return references
