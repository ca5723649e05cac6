"""How a part of a picture is stored again: its header promises no more than is written, and nothing is lost unsaid."""

from dataclasses import dataclass
from typing import Any

_DWA = ("dwaa", "dwab")
_LEVEL = "openexr:dwaCompressionLevel"
_DEFAULT_LEVEL = 45  # OpenEXR's
# What OpenImageIO notes of the pixels of a texture, which are others now.
_OF_PIXELS = ("oiio:AverageColor", "oiio:ConstantColor", "oiio:SHA-1")


@dataclass(frozen=True)
class Storage:
    """A part's header as it is written, and a line for all that is not as it was or loses something."""

    spec: Any  # an ImageSpec
    lines: tuple[str, ...] = ()
    rings: bool = False  # its compression may turn a large finite value into an infinite one, next to smaller ones

    def without_loss(self, reason: str) -> "Storage":
        """The same part under a compression that loses nothing."""
        spec = self.spec.copy()
        before = spec.get_string_attribute("compression").partition(":")[0]
        spec.attribute("compression", "zip")
        return Storage(spec, (*self.lines[:-1], f"stored without loss (zip, no {before}): {reason}"))


def storage(spec: Any, changed: bool, suffix: str) -> Storage:
    """How a part that was read with this header is stored in a file of this kind (".exr")."""
    spec = spec.copy()
    lines = []
    if _levels(spec) > 1:
        lines.append(f"mip maps are left out, they would show the picture as it was: 1 of {_levels(spec)} levels stays")
        spec.attribute("openexr:levelmode", 0)
        spec.erase_attribute("oiio:miplevels")
    if changed:
        for name in _OF_PIXELS:
            spec.erase_attribute(name)
    if suffix != ".exr":
        named = all(channel in ("R", "G", "B", "A", "Y") for channel in spec.channelnames)
        lines += [] if named else [f"no names of channels are kept: {suffix} has none; an EXR keeps them"]
        lines += ["stored with loss: RGBE keeps 8 bits of a value"] if suffix == ".hdr" else []
        return Storage(spec, tuple(lines))
    told = spec.get_string_attribute("compression")
    if not _loses(spec) or (told == "pxr24" and not changed):  # which rounds floats once and for all
        return Storage(spec, tuple(lines))
    if told in _DWA:
        level = int(spec.get_float_attribute(_LEVEL, _DEFAULT_LEVEL))
        spec.attribute(
            "compression", f"{told}:{level}"
        )  # OpenImageIO reads a level from _LEVEL and writes it from here
        told += f", level {level}"
    kept = Storage(spec, (*lines, f"stored with loss, as it was ({told})"), rings=True)
    return kept if changed else kept.without_loss("nothing in it was changed")


def _levels(spec: Any) -> int:
    return int(spec.get_int_attribute("oiio:miplevels", 1))


def _loses(spec: Any) -> bool:
    """Whether its compression changes values: DWA's all but integers, B44's halves, PXR24's floats."""
    compression = spec.get_string_attribute("compression")
    kinds = {str(kind) for kind in spec.channelformats or (spec.format,)}
    lossy = {
        "dwaa": {"half", "float"},
        "dwab": {"half", "float"},
        "b44": {"half"},
        "b44a": {"half"},
        "pxr24": {"float"},
    }
    return bool(lossy.get(compression, set()) & kinds)
