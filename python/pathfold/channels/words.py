"""What the name of a layer says of it, whoever wrote it: which guide, which other data, or a part of the light."""

import re
from functools import cache

from pathfold.channels.presets import presets

# As parts of a name, upper and lower case alike.
_GUIDES = {
    "albedo": r"albedo|diff(use)?[ _]?(filter|col|color)$|base_?color",
    "normal": r"normal|nrm",
    "depth": r"depth|zfiltered",
    "variance": r"variance|mse",
}
# As whole words of a name, upper and lower case as written: single letters are common in names.
_LETTERS = {"albedo": {"alb"}, "normal": {"N", "Nn", "Ns", "Ng"}, "depth": {"Z", "z"}, "variance": {"var"}}
_DATA = re.compile(
    r"position|motion|veloc|vector|crypto|mask|matte|\bids?\b|object|material|\buvs?\b|\bst\b|\bp(ref|z|world)?\b"
    r"|facing|curvature|occlusion|\bao\b|wire|samples|\bcount\b|heatmap|tangent|coverage|opacity|alpha|\bhit",
    re.IGNORECASE,
)
_LIGHT = re.compile(
    r"diff|spec|direct|refl|refr|emis|emit|subsurf|\bsss\b|\bgi\b|coat|sheen|transm|volum|shadow|light|caustic|gloss"
    r"|backg|environ|\benv\b|\bbg\b|ambient|illumination",
    re.IGNORECASE,
)


@cache
def guide(name: str) -> str | None:
    """The guide (albedo, normal, depth, variance) that a layer of this name seems to be; None where it seems none."""
    for buffer, pattern in _GUIDES.items():
        if re.search(pattern, name, re.IGNORECASE) or _LETTERS[buffer] & set(_words(name)):
            return buffer
    return None


@cache
def data(name: str) -> bool:
    """Whether a layer of this name seems to hold what is no light: a guide, ids, positions ..."""
    return guide(name) is not None or _known_guide(name) or bool(_DATA.search(" ".join(_words(name))))


@cache
def light(name: str) -> bool:
    """Whether a layer of this name seems to be a part of the light and not the beauty."""
    return bool(_LIGHT.search(" ".join(_words(name)))) or any(
        _fits(row, name) for buffer in ("diffuse", "specular") for row in _rows(buffer)
    )


@cache
def beauty(name: str) -> bool:
    """Whether some writer calls its beauty so."""
    return bool(name) and any(_fits(row, name) for row in _rows("color"))


def _known_guide(name: str) -> bool:
    buffers = ("albedo", "normal", "depth", "variance", "diffuse.albedo", "diffuse.variance", "specular.variance")
    return any(_fits(row, name) for buffer in buffers for row in _rows(buffer))


def _words(name: str) -> list[str]:
    return re.findall(r"[A-Z]?[a-z]+|[A-Z]+(?![a-z])|\d+", name)


@cache
def _rows(buffer: str) -> frozenset[str]:
    """Every name that means this buffer whoever wrote it, without a view layer before it."""
    names = [name for entry in presets()[-1].buffers.get(buffer, ()) for name in _names(entry)]
    return frozenset(name.removeprefix("*.") for name in names if name)


def _names(entry: str | dict[str, object]) -> list[str]:
    if isinstance(entry, str):
        return [entry]
    listed = entry.get("sum", [])
    return [*(listed if isinstance(listed, list) else []), *([str(entry["layer"])] if "layer" in entry else [])]


def _fits(row: str, name: str) -> bool:
    """Whether a row's name is the layer's, or that of its last sections."""
    pattern = re.escape(row).replace(r"\*", ".*")
    return re.fullmatch(rf"(.*\.)?{pattern}", name, re.IGNORECASE) is not None
