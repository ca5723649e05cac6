"""Layers of a file by a name: a preset's row, or what a user wrote."""

import re
from collections.abc import Iterable, Sequence
from typing import Any

from pathfold.channels.source import Source
from pathfold.images import ImageError, ImageFile, Layer


def star(pattern: str, layer: Layer) -> str | None:
    """What the star of a pattern stands for in one of the layer's names; None where none fits."""
    expression = re.escape(pattern).replace(r"\*", "(.*)", 1)
    for name in layer.names:
        if found := re.fullmatch(expression, name, re.IGNORECASE):
            return found.group(1) if found.groups() else ""
    return None


def serves(layer: Layer, view: str, file: ImageFile) -> bool:
    """Whether a layer belongs to a picture of this view: to its own, or to none; a file's only view is everybody's."""
    if layer.view in (view, ""):
        return True
    return not view and len(file.views) == 1


def resolve(
    file: ImageFile, entry: Any, text: str, picture: Layer, main: Layer | None, component: str
) -> Source | None:
    """What a preset's row is in a file, for one picture; None where it is not there.

    `text` stands for the row's star, `main` for its "". A name with commas is a list of channels.
    """

    def look(name: str) -> Layer | None:
        if "," in name:
            lists = channel_list(file, name.split(","))
            return min(lists, key=lambda layer: layer.part != picture.part, default=None)
        return main if name == "" else lookup(file, name.replace("*", text), picture)

    if isinstance(entry, str):
        layer = look(entry)
        return Source((layer,), component) if layer else None
    layers = [look(name) for name in (entry["sum"] if "sum" in entry else [entry["layer"]])]
    factor = look(entry["times"]) if "times" in entry else None
    divisor = file.metadata().get(entry["divide_by"]) if "divide_by" in entry else 1
    if None in layers or ("times" in entry and not factor) or not isinstance(divisor, int | float) or divisor <= 0:
        return None
    return Source(tuple(layer for layer in layers if layer), component, factor, float(divisor))


def lookup(file: ImageFile, name: str, picture: Layer) -> Layer | None:
    """The layer of this name beside a picture: of its view before one of none, spelled so before alike, in its part."""

    def rank(layer: Layer) -> tuple[bool, bool, bool, str]:
        spelled = name in layer.names
        return layer.view != picture.view, not spelled, layer.part != picture.part, layer.name

    fitting = [layer for layer in file.called(name) if serves(layer, picture.view, file)]
    return min(fitting, key=rank, default=None)


def named(file: ImageFile, buffer: str, text: str) -> list[Layer]:
    """What `--map BUFFER=TEXT` names: a layer (in each view that has one of that name), or channels, as "ch0,ch1,ch2".

    Raises ImageError where there is none.
    """
    if found := file.called(text):
        return [layer for layer in found if text in layer.names] or found
    if found := channel_list(file, [name.strip() for name in text.split(",")]):
        return found
    raise ImageError(f"{file.path}: --map {buffer}={text}: no such layer; it has {describe(file)}")


def channel_list(file: ImageFile, names: Sequence[str]) -> list[Layer]:
    """Channels by their full names, with their part's name before them or without: a layer in each part that has all.

    One channel may stand for three: "Y,Y,Y". What is a layer already is that layer.
    """
    found = []
    for number, spec in enumerate(file.parts):
        if spec.deep:
            continue
        title = file.part_name(number)
        known = {full: at for at, full in enumerate(spec.channelnames)}
        known |= {f"{title}.{full}": at for full, at in list(known.items()) if title} | known
        if all(name in known for name in names):
            found.append(_as_layer(file, number, names, [known[name] for name in names]))
    return found


def _as_layer(file: ImageFile, part: int, names: Sequence[str], numbers: Sequence[int]) -> Layer:
    beside = [layer for layer in file.layers if layer.part == part]
    for layer in beside:
        if layer.pick(len(numbers)) == list(numbers):
            return layer
    home = next(layer for layer in beside if numbers[0] in layer.channels.values())
    letters = ("Y",) if len(numbers) == 1 else tuple("RGB"[: len(numbers)]) if len(numbers) <= 3 else tuple(names)
    return Layer(part, (",".join(names),), home.view, home.window, dict(zip(letters, numbers, strict=True)))


def describe(file: ImageFile) -> str:
    """The layers of a file in one line, for messages."""
    names = sorted({layer.label for layer in file.layers if "samples." not in layer.name})
    shown = ", ".join(names[:24])
    return shown + (f" and {len(names) - 24} more layers" if len(names) > 24 else "")


def listed(layers: Iterable[Layer]) -> str:
    """Layers with their parts, for messages."""
    return ", ".join(f"{layer.label} (part {layer.part})" for layer in layers)
