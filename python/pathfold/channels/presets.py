"""What each renderer calls its channels, as data (the .toml files beside this one), and which one wrote a file.

A preset is chosen where the file has all layers of one list of `detect.layers`, or any header entry of
`detect.metadata`; layers' names count there as they are written. In the buffers' rows upper and lower case are alike,
and a `*` stands for the same text (the view layer) in all patterns of one frame. For each buffer the first row that is
in the file counts; a name may be a list of channels ("Nx,Ny,Nz"), and a table instead of a name derives the buffer:
    { sum = [NAMES], times = NAME }          radiance that the renderer splits further, or divides by its colour
    { layer = NAME, divide_by = "ENTRY" }    the variance of one sample, to be divided by the header's sample count
Rows of `[buffers]` mean the same whoever wrote them, so the last preset, common names, has them all. Rows of
`[ambiguous]` mean something else in other writers' files; they count after the others, for their own writer alone.
`[output]` says where a result goes when not in the place it was read from. `miss_albedo` and `miss_depth` say what
stands where a ray hit nothing: a number, or "sky", the background itself.
"""

import tomllib
from collections.abc import Iterable, Mapping
from dataclasses import dataclass, field, replace
from fnmatch import fnmatchcase
from functools import cache
from importlib.resources import files
from typing import Any

from pathfold.images import ImageFile

# Tried in this order: who calls a thing as nobody else does comes first; the last takes whatever is left.
_ORDER = (
    *("pathfold", "luxcore", "octane", "cycles", "unreal", "corona", "vray", "redshift", "3delight", "renderman"),
    *("pbrt", "karma", "arnold", "mitsuba", "appleseed", "falcor", "common"),
)
# Scene units. In millimetres this is a thousand kilometres, and writers put 1e10 and more where there is nothing.
FARTHEST = 1e9

Rows = Mapping[str, list[Any]]


@dataclass(frozen=True)
class Preset:
    """One writer's conventions, as read from its .toml file."""

    name: str
    title: str
    buffers: Rows
    detect: Mapping[str, Any]
    output: Mapping[str, str] = field(default_factory=dict)
    miss_albedo: float | str | None = None  # None: nobody says, so the pixels are asked
    miss_depth: float | None = None

    @property
    def farthest(self) -> float:
        """Depths from here on are misses."""
        return min(FARTHEST, 0.99 * self.miss_depth) if self.miss_depth else FARTHEST


@cache
def presets() -> tuple[Preset, ...]:
    """All presets, in the order they are tried."""
    read = {name: _read(name) for name in _ORDER}
    shared = _joined(data["buffers"] for data in (read["common"], *read.values()))
    return tuple(
        Preset(
            name=name,
            buffers=shared if name == "common" else _joined((data.pop("buffers"), data.pop("ambiguous", {}))),
            **{key: value for key, value in data.items() if key not in ("buffers", "ambiguous")},
        )
        for name, data in read.items()
    )


def detect(file: ImageFile) -> Preset:
    """The preset of the program that wrote the file, as far as it can be told."""
    entries = {name.lower(): str(value) for name, value in file.metadata().items()}
    names = {name for layer in file.layers for name in (*layer.names, *([""] if layer.bare else []))}
    return next(preset for preset in presets() if _wrote(preset, entries, names))


def in_view_layers(preset: Preset) -> Preset:
    """The same names, each with a view layer before it, whoever wrote them so."""

    def within(row: Any) -> Any:
        if isinstance(row, dict):
            return {key: within(value) if key != "divide_by" else value for key, value in row.items()}
        return [within(name) for name in row] if isinstance(row, list) else f"*.{row}"

    rows = {
        buffer: [within(row) for row in entries if row and "*" not in str(row)]
        for buffer, entries in preset.buffers.items()
    }
    return replace(preset, buffers=rows)


def _read(name: str) -> dict[str, Any]:
    return tomllib.loads((files(__package__) / f"{name}.toml").read_text(encoding="utf-8"))


def _joined(parts: Iterable[Rows]) -> Rows:
    """The rows of several tables one after another, each row once."""
    rows: dict[str, list[Any]] = {}
    for part in parts:
        for buffer, entries in part.items():
            known = rows.setdefault(buffer, [])
            known += [entry for entry in entries if entry not in known]
    return rows


def _wrote(preset: Preset, entries: Mapping[str, str], names: set[str]) -> bool:
    said = preset.detect.get("metadata", {}).items()
    if any(
        fnmatchcase(key, known.lower()) and fnmatchcase(entries[key], value) for known, value in said for key in entries
    ):
        return True
    return any(all(_has(names, pattern) for pattern in layers) for layers in preset.detect.get("layers", ()))


def _has(names: set[str], pattern: str) -> bool:
    return any(fnmatchcase(name, pattern) for name in names)
