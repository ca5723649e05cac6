"""A guide from a file of its own: by the same rows as the picture's, whatever else that file holds."""

from dataclasses import replace

from pathfold.buffers import BUFFERS
from pathfold.channels import words
from pathfold.channels.find import describe, listed, named, resolve, serves
from pathfold.channels.find import star as star_of
from pathfold.channels.pictures import main
from pathfold.channels.presets import detect, presets
from pathfold.channels.source import Source
from pathfold.images import ImageError, ImageFile, Layer, Window


def from_file(side: ImageFile, name: str, text: str | None, color: Layer, star: str, display: Window | None) -> Source:
    """The source of buffer `name` in a file beside the picture.

    First the layer that `text` names, or the rows of the file's preset and the common ones, then a layer that is called
    like it, then the only one that has as many channels. `color`, `star` and `display` are the picture's.
    Raises ImageError where nothing in the file could be meant, or several layers could, or its frame is another.
    """
    found = (
        [Source((layer,)) for layer in _layers(side, name, text, color)] if text else _by_rows(side, name, color, star)
    )
    found = found or [Source((layer,)) for layer in _guessed(side, name, color)]
    if not found:
        raise ImageError(
            f"{side.path}: no {name} found; it has {describe(side)}; name its layer with --map {name}=LAYER"
        )
    if len(found) > 1:
        could = listed(layer for source in found for layer in source.layers)
        raise ImageError(f"{side.path}: {name} could be {could}; name its layer with --map {name}=LAYER")
    _check_frame(side, found[0].layers[0], color, display)
    return replace(found[0], side=side, preset=detect(side))


def _layers(side: ImageFile, name: str, text: str, color: Layer) -> list[Layer]:
    found = named(side, name, text)
    fitting = _of_view([layer for layer in found if layer.pick(BUFFERS[name])], color, side)
    if not fitting:
        raise ImageError(
            f"{side.path}: {name} needs {BUFFERS[name]} channel(s); {found[0].label} has {', '.join(found[0].channels)}"
        )
    return fitting[:1]


def _by_rows(side: ImageFile, name: str, color: Layer, star: str) -> list[Source]:
    """What the first row that is there is, in each view layer; in the picture's own alone where that is there."""
    rows = [row for preset in (detect(side), presets()[-1]) for row in preset.buffers.get(name, ())]
    for row in rows:
        found: dict[str, Source] = {}
        for text in _stars(side, row):
            source = resolve(side, row, text, color, main(side, color.view) or main(side, ""), "")
            if source and all(source.numbers(layer, BUFFERS[name]) for layer in source.layers):
                found.setdefault(text, source)
        if found:
            return [found[star]] if star in found else list(found.values())
    return []


def _stars(side: ImageFile, row: object) -> list[str]:
    pattern = row if isinstance(row, str) else next(iter([*row.get("sum", ()), row.get("layer", "")]), "")  # type: ignore[attr-defined]
    if not pattern:
        return []  # the main picture is the last resort, not a row of its own
    return list(dict.fromkeys(text for layer in side.layers if (text := star_of(pattern, layer)) is not None))


def _guessed(side: ImageFile, name: str, color: Layer) -> list[Layer]:
    could = _of_view(
        [layer for layer in side.layers if layer.pick(BUFFERS[name]) and not _is_sample(layer)], color, side
    )
    called = [layer for layer in could if any(words.guide(known) == name for known in layer.names)]
    if called:
        return called
    return [layer for layer in could if not any(map(words.data, layer.names))] if len(could) == 1 else could[:0]


def _of_view(layers: list[Layer], color: Layer, side: ImageFile) -> list[Layer]:
    fitting = [layer for layer in layers if serves(layer, color.view, side)]
    return [layer for layer in fitting if layer.view == color.view] or fitting


def _is_sample(layer: Layer) -> bool:
    return layer.name.startswith("samples.")


def _check_frame(side: ImageFile, layer: Layer, color: Layer, display: Window | None) -> None:
    """A file of another frame has other pixel coordinates, unless its pixels are just the picture's."""
    frame = side.display(layer.part)
    if display and frame != display and layer.window != color.window:
        raise ImageError(
            f"{side.path}: {layer.window} in a frame of {frame}, the picture is {color.window} in a frame of "
            f"{display}; give it the same frame (display window)"
        )
