"""Made-up layouts of EXRs through the mapper: no beauty is a guide, no layer two things, no view left noisy unsaid."""

from collections.abc import Collection
from pathlib import Path

import numpy as np
import pytest
from layouts import Layout, made
from pathfold import channels
from pathfold.buffers import BUFFERS
from pathfold.channels import Frame, Source
from pathfold.images import ImageError, ImageFile, Layer

SOME, MANY = 300, 2000
GUIDES = ("albedo", "normal", "depth", "variance")
# Names that no preset has, or none behind a view layer: refused where the place of the layer does not tell it.
UNKNOWN = {"hero", "mypicture", "rgba_main", "beauty_main"}


def read(file: ImageFile, source: Source, count: int) -> set[tuple[str, str]]:
    """The (part's name, channel) that a buffer reads."""
    return {name for layer in source.layers for name in channels_of(file, layer, source.numbers(layer, count) or ())}


def channels_of(file: ImageFile, layer: Layer, numbers: Collection[int] | None = None) -> set[tuple[str, str]]:
    """A layer's channels, or some of them, as (part's name, channel)."""
    names = file.parts[layer.part].channelnames
    return {(file.part_name(layer.part), names[at]) for at in numbers or layer.channels.values()}


def faults(file: ImageFile, layout: Layout, frames: list[Frame], chosen: str = "") -> list[str]:
    """What is wrong in a mapping, by what the layout was made of; `chosen` is a buffer whose layer was named."""
    found, used = [], set()
    for frame in frames:
        view, roles = frame.color_layer.view, {}
        for buffer, source in frame.sources.items():
            kind = "albedo" if buffer == "diffuse.albedo" else buffer
            right = {"color": "beauty", "alpha": "beauty", "diffuse": "light", "specular": "light"}.get(kind, kind)
            for channel in () if source.subtract else read(file, source, BUFFERS[buffer]):
                used.add(channel)
                if buffer != chosen and layout.roles[channel] != right:
                    found.append(f"{buffer} is {channel}, made to be {layout.roles[channel]}")
                if layout.views[channel] not in (view, ""):
                    found.append(f"{buffer} of view {view!r} is {channel} of {layout.views[channel]!r}")
                if roles.setdefault(channel, kind) != kind:
                    found.append(f"{channel} is {roles[channel]} and {buffer}")
    if not chosen and two_bare(layout):
        found.append(f"{layout.beauties} could each be it")
    seen = {frame.color_layer.view for frame in frames}
    notes = " ".join(note for frame in frames for note in frame.notes)
    for channel, role in layout.roles.items():
        view = layout.views[channel]
        if view not in seen and view and f"view {view} has no picture" not in notes:
            found.append(f"view {view} is left noisy without a line")
        told = any(layer.label in notes for layer in file.layers if channel in channels_of(file, layer))
        if role in GUIDES and channel not in used and view in seen and not chosen and not told:
            found.append(f"{channel} looks like {role} and is not told")
    return found


def two_bare(layout: Layout) -> bool:
    """Whether two parts of one view have nothing but a beauty's name, both a known one or both an unknown one."""
    bare = [
        layout.views[title, name] for (title, name), role in layout.roles.items() if (role, name) == ("beauty", "R")
    ]
    unknown = {"hero", "mypicture"} & set(layout.beauties)
    return len(bare) > len(set(bare)) and len(unknown) != 1


def refused_rightly(layout: Layout, error: ImageError) -> bool:
    told = str(error)
    return bool(UNKNOWN & set(layout.beauties)) or (len(layout.beauties) > 1 and "could each be the picture" in told)


def with_one_named(file: ImageFile, layout: Layout, rng: np.random.Generator) -> list[str]:
    """The faults where a buffer's layer is named at random: a layer has one role, or the naming is refused."""
    buffer = str(rng.choice(["color", *GUIDES]))
    layer = file.layers[rng.integers(len(file.layers))]
    try:
        return faults(
            file,
            layout,
            channels.match(file, {buffer: layer.option}),
            buffer,
        )
    except ImageError:
        return []


def check(seeds: range, folder: Path) -> None:
    wrong, refused = [], []
    for seed in seeds:
        layout = made(seed)
        file = ImageFile(layout.save(folder / "a.exr"))
        try:
            wrong += [(seed, fault) for fault in faults(file, layout, channels.match(file))]
        except ImageError as error:
            refused.append((seed, layout.beauties, str(error), refused_rightly(layout, error)))
        wrong += [(seed, f"one named: {fault}") for fault in with_one_named(file, layout, np.random.default_rng(seed))]
    assert not wrong
    assert not [one for one in refused if not one[-1]]
    assert len(refused) < len(seeds) / 5


def test_some_layouts(tmp_path: Path) -> None:
    check(range(SOME), tmp_path)


@pytest.mark.long
def test_many_layouts(tmp_path: Path) -> None:
    check(range(SOME, SOME + MANY), tmp_path)
