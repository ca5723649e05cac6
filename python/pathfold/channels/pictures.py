"""Which layers of a file are its pictures: the beauty of every view and view layer."""

from collections.abc import Iterable, Sequence

from pathfold.channels import words
from pathfold.channels.find import describe, listed, named, star
from pathfold.channels.presets import Preset
from pathfold.images import ImageError, ImageFile, Layer, views

Picture = tuple[Layer, str]  # a beauty, and what the star of the preset's rows stands for


def pictures(file: ImageFile, preset: Preset, text: str | None) -> list[Picture]:
    """Every beauty of a file, in the order of its views; `text` is what `--map color=` names.

    Raises ImageError where two layers of a view could be it, or where the named one is not there.
    """
    if text is not None:
        return [(layer, _star(preset, layer)) for layer in _chosen(file, text)]
    found: list[Picture] = []
    seen = sorted(views(file.layers), key=lambda view: not view)  # what has no view comes last
    for view in seen:
        found += _of_view(file, preset, view, alone=not found)
    order = views(file.layers)
    return sorted(found, key=lambda picture: order.index(picture[0].view))


def main(file: ImageFile, view: str) -> Layer | None:
    """The layer that "" means in a view: the only bare R, G, B; of several the one that is called a beauty.

    A part that is called as a guide or as a piece of the light is none.
    """
    candidates = _mains(file, view)
    return candidates[0] if len(candidates) == 1 else None


def none_found(file: ImageFile) -> ImageError:
    """The error of a file without a picture: what it has, and the option that names one."""
    bare = [layer for layer in file.layers if layer.bare]
    lacks = [letter for letter in "RGB" for layer in bare[:1] if letter not in layer.channels]
    missing = f" and lacks {','.join(lacks)}" if len(lacks) in (1, 2) else ""
    return ImageError(f"{file.path}: no color found; it has {describe(file)}{missing}; {_cure(file)}")


def _cure(file: ImageFile) -> str:
    single = [layer.name for layer in file.layers if len(layer.channels) == 1 and layer.name]
    others = [layer for layer in file.layers if layer.pick(3)]
    names = {name.upper(): name for name in single}
    if not others and all(letter in names for letter in "XYZ"):
        chosen = ",".join(names[letter] for letter in "XYZ")
        return f"name its channels with --map color={chosen} (CIE XYZ is filtered as it stands; RGB is better)"
    luminance = next((layer for layer in file.layers if set(layer.channels) - {"A"} == {"Y"}), None)
    if not others and len(single) >= 3:
        example = ",".join(sorted(single, key=lambda name: (len(name), name))[:3])
        return (
            f"each layer has one channel: name three with --map color={example} (Mitsuba names them where the film's "
            "bitmap() is written, or mi.Bitmap(image, channel_names=[...]))"
        )
    if not others and luminance:
        channel = luminance.name or "Y"
        return f"a picture of one channel is named by --map color={','.join([channel] * 3)}"
    could = [
        layer for layer in others if not any(words.data(name) or words.light(name) for name in layer.names if name)
    ]
    example = f", perhaps {could[0].mapped('color')}" if len(could) == 1 else ""
    return f"name it with --map color=LAYER{example}"


def _chosen(file: ImageFile, text: str) -> list[Layer]:
    if text.lower() == "none":
        raise ImageError(f"{file.path}: --map color=none: color is what is denoised; name its layer, or leave it away")
    chosen = []
    for layers in _by_view(named(file, "color", text)):
        layer = main(file, layers[0].view) if len(layers) > 1 else layers[0]
        if layer not in layers:
            parts = " or ".join(layer.mapped("color") for layer in layers)
            raise ImageError(f"{file.path}: --map color={text} could be {listed(layers)}; name one with {parts}")
        chosen.append(layer)
    for layer in chosen:
        if not layer.pick(3):
            has = ", ".join(layer.channels)
            raise ImageError(f"{file.path}: color needs 3 channel(s); {layer.label} has {has}")
    return chosen


def _by_view(layers: Sequence[Layer]) -> list[list[Layer]]:
    return [[layer for layer in layers if layer.view == view] for view in views(layers)]


def _star(preset: Preset, layer: Layer) -> str:
    return next((found for row in preset.buffers["color"] if (found := star(row, layer))), "")


def _of_view(file: ImageFile, preset: Preset, view: str, alone: bool) -> list[Picture]:
    """The pictures of one view; where others have some, what has no view must be called a beauty to be one."""
    mains = _mains(file, view)
    if not alone and not view:
        mains = [layer for layer in mains if any(map(words.beauty, layer.names))]
    groups: dict[str, list[Layer]] = {}  # by what the star stands for, as the rows come
    starred = None
    for row in preset.buffers["color"]:
        for layer, text in _matches(file, row, view, mains):
            group = groups.setdefault(text, [])
            group += [layer] if layer not in group else []
            starred = "*" in row if starred is None else starred
    if starred is False:
        groups = {"": groups[""]}
    elif starred:
        groups.pop("", None)
    for group in groups.values():
        _refuse_two(file, group, preset)
    return [(group[0], text or _star(preset, group[0])) for text, group in groups.items()]


def _refuse_two(file: ImageFile, group: Sequence[Layer], preset: Preset) -> None:
    """A writer's preset knows which of two comes first, but where both are parts with nothing but their names."""
    bare = [layer for layer in group if layer.bare]
    unsure = bare if len(bare) > 1 else group if not group[0].bare and preset.name == "common" else []
    if len(unsure) > 1:
        cures = " or ".join(layer.mapped("color") for layer in unsure)
        raise ImageError(f"{file.path}: {listed(unsure)} could each be the picture; choose with {cures}")


def _matches(file: ImageFile, row: str, view: str, mains: Sequence[Layer]) -> Iterable[Picture]:
    if row == "":
        yield from ((layer, "") for layer in mains)
        return
    for layer in file.layers:
        text = star(row, layer) if layer.view == view and layer.pick(3) else None
        if text is not None and not _is_no_picture(file, layer, text if "*" in row else layer.name):
            yield layer, text


def _is_no_picture(file: ImageFile, layer: Layer, text: str) -> bool:
    """Whether a name says something else; what several layers begin with is a view layer, whatever it is called."""
    if sum(one.name.startswith(f"{text}.") for one in file.layers) > 1 or not text:
        return False
    return words.data(text) or (words.light(text) and len(file.parts) > 1)


def _mains(file: ImageFile, view: str) -> list[Layer]:
    several = len(file.parts) > 1
    fitting = [
        layer
        for layer in file.layers
        if layer.bare and layer.view == view and {"R", "G", "B"} <= set(layer.channels)
        if not any(words.data(name) or (several and words.light(name)) for name in layer.names if name)
    ]
    return [layer for layer in fitting if any(map(words.beauty, layer.names))] or fitting
