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
_NEVER_LIGHT = re.compile(  # whatever else the name says: "light id", "shadow matte"
    r"position|\bpos\b|point$|motion|veloc|vector|crypto|mask|matte|\bids?\b|\buvs?\b|\bst\b|\bp(ref|z|world)?\b"
    r"|samples|sample ?count|\bcount\b|heat|confidence",
    re.IGNORECASE,
)
_DATA = re.compile(
    r"object|material|facing|curvature|occlusion|\bao\b|wire|tangent|coverage|opacity|alpha|\bhit|fresnel",
    re.IGNORECASE,
)
_LIGHT = re.compile(
    r"diff|spec|direct|refl|refr|emis|emit|subsurf|\bsss\b|\bgi\b|coat|sheen|transm|volum|shadow|light|caustic|gloss"
    r"|backg|environ|\benv\b|\bbg\b|ambient|illumination",
    re.IGNORECASE,
)


# A guide of a part of the light is none of the picture; of diffuse reflection it may be.
_PARTS = re.compile(r"spec|refl|refr|coat|sheen|transm|light|shadow|emis|emit|subsurf|\bsss\b|volum", re.IGNORECASE)


@cache
def guide(name: str) -> str | None:
    """The guide (albedo, normal, depth, variance) that a layer of this name seems to be; None where it seems none.

    Nor is a guide's own variance, or what is a guide of a part of the light alone.
    """
    found = _guides(name)
    return found[0] if len(found) == 1 and not _PARTS.search(name) else None


@cache
def data(name: str) -> bool:
    """Whether a layer of this name seems to hold what is no light: a guide, ids, positions ..."""
    text = " ".join(_words(name))
    return bool(_guides(name) or _known_guide(name) or _NEVER_LIGHT.search(text) or _DATA.search(text))


@cache
def unlit(name: str) -> bool:
    """Whether a layer of this name is rather data than light: where it says both, ids and the like stay data."""
    certain = bool(_guides(name)) or bool(_NEVER_LIGHT.search(" ".join(_words(name))))
    return certain or (data(name) and not light(name))


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


def _guides(name: str) -> list[str]:
    words = set(_words(name))
    return [
        buffer
        for buffer, pattern in _GUIDES.items()
        if re.search(pattern, name, re.IGNORECASE) or _LETTERS[buffer] & words
    ]


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
