"""The data set on disk, format 3: references that are kept, and noisy samples that can be rendered again at any spp.

DIR/index.jsonl                  a line per view: scene description (seeds, camera, licence), spp, size and checksum of
                                 its files; the last line of an id counts.
DIR/references/<id>.safetensors  the whole view, float32 [C, H, W]: reference.color, .diffuse, .diffuse.albedo,
                                 .half_a.color, .half_b.color; importance [H, W], weights of mean 1 for drawing crops.
DIR/samples/<id>.safetensors     a shard with N crops of the view, [N, S, C, h, w]. float32: samples.radiance, .diffuse,
                                 .depth; float16: samples.diffuse.albedo, .albedo, .normal. Of the first `described`
                                 of S samples, float32: samples.density, .first.depth; float16: samples.descriptor,
                                 .position, .alpha, .first.albedo, .first.normal, .visible (pathfold.mitsuba.Samples
                                 says what they are). `crops` in the index says where they lie: [[y, x], ...]. May be
                                 deleted to save space.
DIR/cleaned/<id>-<n>-<key>.npy   crop n of the reference without most of its noise (clean.py), [3, h, w]; may be
                                 deleted.

Tensors are C-contiguous, so a crop of a few samples touches little of the file.
"""

import hashlib
import json
import logging
import math
import os
from collections import OrderedDict
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray
from safetensors import SafetensorError, safe_open
from safetensors.numpy import save

from ..files import write_whole

Arrays = dict[str, NDArray[Any]]
Line = dict[str, Any]
FORMAT = 3
NEEDED = {"format", "id", "files", "scene", "split", "spp", "described"}  # in a line
SCALES = {"exposure", "depth_scale"}  # finite and positive
NEEDED |= {"crop", "crops"} | SCALES
REFERENCES, SAMPLES = KINDS = "references", "samples"
OWN = {  # the facts of a line that belong to a kind of file: what its latest one says counts
    REFERENCES: ("reference_spp", "reference_rell2", "exposure", "depth_scale", "budget"),
    SAMPLES: ("spp", "described"),
}
OPEN_FILES = 128
CLEANING = 1  # counts up when clean.py, what it asks of OIDN or OIDN itself changes: cleaned references are made anew

log = logging.getLogger("pathfold.store")


class DamagedFileError(OSError):
    """A file of the data set is missing, cut short or altered; the text names it."""


def file_path(folder: Path, kind: str, view: str) -> Path:
    """`kind` is REFERENCES or SAMPLES."""
    return folder / kind / f"{view}.safetensors"


def cleaned_path(folder: Path, line: Line, number: int) -> Path:
    """Where crop `number`'s cleaned reference is kept; another one for other files of the view."""
    sums = "".join(line["files"][kind]["sha256"] for kind in KINDS)
    key = hashlib.sha256(f"{CLEANING} {sums}".encode()).hexdigest()[:16]
    return folder / "cleaned" / f"{line['id']}-{number}-{key}.npy"


def read_cleaned(folder: Path, line: Line, number: int) -> NDArray[np.float32] | None:
    """Crop `number`'s cleaned reference [3, h, w]; None where it is missing or damaged."""
    try:
        kept = np.load(cleaned_path(folder, line, number))
    except (OSError, EOFError, ValueError):
        return None
    return kept if kept.shape == (3, line["crop"], line["crop"]) else None


def write(folder: Path, line: Line, tensors: Arrays) -> Line:
    """Writes what `tensors` holds of a view, references or samples or both; returns its index line with `files` added.

    Each file is written beside its final name, then renamed: a file of that name is always whole. Its metadata repeats
    the line, so that the index can be made again. Raises OSError naming the file where the disk is full, say.
    """
    line = line | {"format": FORMAT, "files": dict(line.get("files", {}))}
    for kind in KINDS:
        part = {name: np.ascontiguousarray(v) for name, v in tensors.items() if (kind == SAMPLES) == _of_samples(name)}
        if part:
            facts = {k: v for k, v in line.items() if k != "files"}
            content = save(part, {"view": json.dumps(facts)})
            write_whole(file_path(folder, kind, line["id"]), content)
            line["files"][kind] = {"bytes": len(content), "sha256": hashlib.sha256(content).hexdigest()}
    return line


def _of_samples(name: str) -> bool:
    return name.startswith("samples.")


def begun(folder: Path) -> bool:
    """The folder holds views, though it may have lost its index."""
    return (folder / "index.jsonl").is_file() or any(folder.glob("*/*.safetensors"))


def append_line(folder: Path, line: Line) -> None:
    """One writer only: the process that runs `render`."""
    try:
        with (folder / "index.jsonl").open("a") as file:
            file.write(json.dumps(line) + "\n")
            file.flush()
            os.fsync(file.fileno())
    except OSError as error:
        raise OSError(error.errno, f"cannot write {folder / 'index.jsonl'}: {error.strerror}") from error


def read_index(folder: Path) -> list[Line]:
    """The last line of every view, whatever has become of its files; a line cut short or altered is left out and told.

    Raises ValueError for a data set of another format.
    """
    index = folder / "index.jsonl"
    lines = {}
    for number, text in enumerate(index.read_bytes().splitlines() if index.exists() else [], 1):
        try:
            line = json.loads(text)
        except ValueError:  # no JSON, or no text at all
            line = None
        if isinstance(line, dict) and line.get("format", FORMAT) != FORMAT:
            raise ValueError(
                f"{folder} holds a data set of format {line['format']}, this version reads format {FORMAT}: "
                "render it anew into another folder"
            )
        if _whole(line):
            lines[line["id"]] = line
        elif text.strip():
            log.warning(
                "%s: line %d is cut short or altered and left out; `pathfold-train render --out %s` mends it",
                index, number, folder,
            )  # fmt: skip
    return list(lines.values())


def _whole(line: Any) -> bool:
    """A line of the index that says all that is needed of a view."""
    if not isinstance(line, dict) or not line.keys() >= NEEDED:
        return False
    if not isinstance(line["id"], str) or not isinstance(line["files"], dict):
        return False
    if not all(isinstance(line[scale], int | float) and 0 < line[scale] < math.inf for scale in SCALES):
        return False
    return all(isinstance(seal, dict) and seal.keys() >= {"bytes", "sha256"} for seal in line["files"].values())


def reference_color(folder: Path, view: str) -> NDArray[np.float32]:
    """The reference of a view [3, H, W], linear, whether its samples are there or not."""
    with safe_open(file_path(folder, REFERENCES, view), framework="numpy") as file:
        return file.get_tensor("reference.color")


def present(folder: Path, line: Line, kind: str) -> bool:
    """The file is there and as long as it was."""
    path, sealed = file_path(folder, kind, line["id"]), line["files"].get(kind)
    return sealed is not None and path.exists() and path.stat().st_size == sealed["bytes"]


def damaged(folder: Path, lines: list[Line]) -> Iterator[Path]:
    """Files that are there but no longer what was written, and references that are gone; reads every byte."""
    for line in lines:
        for kind in KINDS:
            path, sealed = file_path(folder, kind, line["id"]), line["files"].get(kind)
            altered = sealed is not None and path.exists() and _digest(path) != sealed["sha256"]
            if altered or (kind == REFERENCES and not path.exists()):
                yield path


def recover(folder: Path) -> list[Line]:
    """Makes index and files agree after an interruption and returns the line of every view; its `files` are whole.

    Damaged files are removed, each with a warning, so that they are rendered again; whole files that the index does not
    know, or of which it knows another version, because the process was killed before it wrote the line, are taken up.
    Cleaned references of other files than a view has now go. Reads every byte.
    """
    lines = {line["id"]: line for line in read_index(folder)}
    for path in damaged(folder, list(lines.values())):
        kind, line = path.parent.name, lines[path.stem]
        facts = _facts(path)
        if facts and any(facts.get(name) != line.get(name) for name in OWN[kind]):
            del line["files"][kind]
            continue
        log.warning("%s is damaged or gone and will be rendered again", path)
        path.unlink(missing_ok=True)
    for kind in KINDS:
        for path in (folder / kind).glob("*.partial"):
            path.unlink()
        for path in sorted((folder / kind).glob("*.safetensors")):
            if kind not in lines.get(path.stem, {"files": {}})["files"]:
                _take_up(lines, kind, path)
    for line in lines.values():
        line["files"] = {k: v for k, v in line["files"].items() if file_path(folder, k, line["id"]).exists()}
    whole = [line for line in lines.values() if all(kind in line["files"] for kind in KINDS)]
    kept = {cleaned_path(folder, line, n) for line in whole for n in range(len(line["crops"]))}
    for path in set((folder / "cleaned").glob("*")) - kept:
        path.unlink()
    write_whole(folder / "index.jsonl", "".join(json.dumps(line) + "\n" for line in lines.values()).encode())
    return list(lines.values())


def _take_up(lines: dict[str, Line], kind: str, path: Path) -> None:
    """Adds a file that the index does not know; removes it if it cannot be read."""
    facts = _facts(path)
    if facts is None:
        path.unlink()
        return
    line = lines.setdefault(path.stem, facts | {"files": {}})
    line |= {name: facts[name] for name in OWN[kind] if name in facts}
    line["files"][kind] = {"bytes": path.stat().st_size, "sha256": _digest(path)}


def _facts(path: Path) -> Line | None:
    """What a file's metadata says of its view; None where it cannot be read."""
    try:
        with safe_open(path, framework="numpy") as file:
            facts = json.loads(file.metadata()["view"])
        return facts if _whole(facts | {"files": {}}) else None
    except (SafetensorError, OSError, KeyError, TypeError, ValueError):
        return None


def _digest(path: Path) -> str:
    with path.open("rb") as file:
        return hashlib.file_digest(file, "sha256").hexdigest()


class Store:
    """Reads a data set by memory map. Every file is checked against its checksum when first opened.

    `lines` are the views whose files are all there. Safe to hand to loader processes.
    """

    def __init__(self, folder: str | Path) -> None:
        self.folder = Path(folder)
        lines = read_index(self.folder)
        self.lines = [line for line in lines if all(present(self.folder, line, kind) for kind in KINDS)]
        again = f"`pathfold-train render --out {self.folder}`"
        if not self.lines and lines:
            raise FileNotFoundError(f"no view in {self.folder} has all its files: render what is missing with {again}")
        if not self.lines:
            raise FileNotFoundError(f"no whole view in {self.folder}: make some with {again}")
        if missing := len(lines) - len(self.lines):
            log.warning("%s: %d views left out, a file is missing or cut short; %s mends it", folder, missing, again)
        self._sealed = {line["id"]: line["files"] for line in self.lines}
        self._checked: set[Path] = set()
        self._open: OrderedDict[Path, Any] = OrderedDict()

    def __getstate__(self) -> dict[str, Any]:
        return self.__dict__ | {"_open": OrderedDict()}

    def split(self, name: str) -> list[Line]:
        """Index lines of "train" or "val"."""
        return [line for line in self.lines if line["split"] == name]

    def tensor(self, view: str, name: str) -> Any:
        """A tensor of a view by name; nothing is read until it is indexed. Raises DamagedFileError."""
        return self._file(SAMPLES if _of_samples(name) else REFERENCES, view).get_slice(name)

    def _file(self, kind: str, view: str) -> Any:
        path = file_path(self.folder, kind, view)
        if path not in self._open:
            try:
                if path not in self._checked and _digest(path) != self._sealed[view][kind]["sha256"]:
                    raise OSError("its checksum differs")
                self._open[path] = safe_open(path, framework="numpy")
            except (SafetensorError, OSError) as error:
                raise DamagedFileError(
                    f"{path} is damaged ({error}), or was rendered again meanwhile; `pathfold-train render --out "
                    f"{self.folder}` mends what is damaged, and this command can then be given again"
                ) from error
            self._checked.add(path)
            if len(self._open) > OPEN_FILES:
                self._open.popitem(last=False)
        self._open.move_to_end(path)
        return self._open[path]
