"""The data set on disk: DIR/views/<id>.safetensors, one per view, and DIR/index.jsonl, one line per whole view.

Tensors are C-contiguous [S, C, H, W] (references [C, H, W]), so a crop of a few samples touches little of the file.
float32: samples.radiance, .diffuse, .depth, .density; reference.color, .diffuse, .diffuse.albedo, .half_a.color,
.half_b.color; importance [H, W], a weight for drawing crops with mean 1.
float16: samples.diffuse.albedo, .albedo, .normal, .descriptor.
"""

import hashlib
import json
import os
from collections import OrderedDict
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray
from safetensors import SafetensorError, safe_open
from safetensors.numpy import save_file

Arrays = dict[str, NDArray[Any]]
Line = dict[str, Any]
OPEN_FILES = 64


class DamagedViewError(Exception):
    """A view's file is missing, cut short or altered; the text names it."""


def write_view(folder: Path, line: Line, tensors: Arrays, extra: dict[str, str] | None = None) -> Line:
    """Writes a view beside its final name, then renames it: a file of that name is always whole.

    Returns the index line with `bytes` and `sha256` of the file added. The line itself is in the file's metadata too.
    """
    path = view_path(folder, line["id"])
    path.parent.mkdir(parents=True, exist_ok=True)
    partial = path.with_suffix(f".{os.getpid()}.partial")  # a killed run may have left a process at the same view
    save_file(
        {k: np.ascontiguousarray(v) for k, v in tensors.items()}, partial, {"view": json.dumps(line)} | (extra or {})
    )
    with partial.open("rb") as file:
        os.fsync(file.fileno())
    partial.replace(path)
    return _sealed(path, line)


def view_path(folder: Path, view: str) -> Path:
    return folder / "views" / f"{view}.safetensors"


def append_line(folder: Path, line: Line) -> None:
    """One writer only: the process that runs `render`."""
    with (folder / "index.jsonl").open("a") as file:
        file.write(json.dumps(line) + "\n")
        file.flush()
        os.fsync(file.fileno())


def read_index(folder: Path) -> list[Line]:
    """The views whose files are there with the right size; a last line cut short is left out."""
    index = folder / "index.jsonl"
    if not index.exists():
        return []
    lines = {}
    for text in index.read_text().splitlines():
        try:
            line = json.loads(text)
        except json.JSONDecodeError:
            continue
        path = view_path(folder, line["id"])
        if path.exists() and path.stat().st_size == line["bytes"]:
            lines[line["id"]] = line
    return list(lines.values())


def recover(folder: Path) -> list[Line]:
    """Makes the index agree with the files after an interruption: lines without a whole file leave, others enter."""
    known = {line["id"]: line for line in read_index(folder)}
    for path in sorted((folder / "views").glob("*.safetensors")):
        if path.stem not in known:
            try:
                with safe_open(path, framework="numpy") as file:
                    known[path.stem] = _sealed(path, json.loads(file.metadata()["view"]))
            except (SafetensorError, KeyError, TypeError):
                path.unlink()
    for path in (folder / "views").glob("*.partial"):
        path.unlink()
    partial = folder / "index.partial"
    partial.write_text("".join(json.dumps(line) + "\n" for line in known.values()))
    partial.replace(folder / "index.jsonl")
    return list(known.values())


def _sealed(path: Path, line: Line) -> Line:
    return line | {"bytes": path.stat().st_size, "sha256": _digest(path)}


def _digest(path: Path) -> str:
    with path.open("rb") as file:
        return hashlib.file_digest(file, "sha256").hexdigest()


class Store:
    """Reads a data set; views may still be added while it is open (`refresh`). Safe to hand to loader processes."""

    def __init__(self, folder: str | Path) -> None:
        self.folder = Path(folder)
        self.refresh()
        if not self.lines:
            raise FileNotFoundError(
                f"no whole view in {self.folder}: make some with `pathfold-train render --out {self.folder}`"
            )

    def refresh(self) -> None:
        """Looks for views that have been finished since."""
        self.lines: list[Line] = read_index(self.folder)
        self._open: OrderedDict[str, Any] = OrderedDict()

    def __getstate__(self) -> dict[str, Any]:
        return self.__dict__ | {"_open": OrderedDict()}

    def split(self, name: str) -> list[Line]:
        """Index lines of "train" or "val"."""
        return [line for line in self.lines if line["split"] == name]

    def crop(
        self,
        view: str,
        y: int,
        x: int,
        height: int,
        width: int,
        names: list[str] | None = None,
        samples: slice = slice(None),
    ) -> Arrays:
        """The tensors called `names` (default: all), cut to a window and a range of samples; the rest is not read."""
        file = self._file(view)
        window = slice(y, y + height), slice(x, x + width)
        result = {}
        for name in names or file.keys():
            lead = (
                (samples, slice(None))
                if name.startswith("samples.")
                else ()
                if name == "importance"
                else (slice(None),)
            )
            result[name] = file.get_slice(name)[(*lead, *window)]
        return result

    def view(self, view: str, names: list[str] | None = None) -> Arrays:
        """Whole tensors."""
        file = self._file(view)
        return {name: file.get_tensor(name) for name in names or file.keys()}

    def exposure(self, view: str) -> float:
        """The exposure of the reference (log-average, key 0.18)."""
        return float(self._file(view).metadata()["exposure"])

    def _file(self, view: str) -> Any:
        if view not in self._open:
            try:
                self._open[view] = safe_open(view_path(self.folder, view), framework="numpy")
            except (SafetensorError, OSError) as error:
                raise DamagedViewError(
                    f"view {view} in {self.folder}: {error}; remove the file and run `pathfold-train render` again"
                ) from error
            if len(self._open) > OPEN_FILES:
                self._open.popitem(last=False)
        self._open.move_to_end(view)
        return self._open[view]

    def damaged(self) -> Iterator[str]:
        """Ids of views whose content no longer has its checksum; reads every byte."""
        for line in self.lines:
            if _digest(view_path(self.folder, line["id"])) != line["sha256"]:
                yield line["id"]
