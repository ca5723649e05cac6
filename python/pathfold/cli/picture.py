"""What `pathfold info` tells of a picture: which layer is which buffer, what is made of it, and what is not used."""

import sys
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path
from shlex import quote

import numpy as np
from numpy.typing import NDArray
from rich.console import Console
from rich.table import Table
from rich.text import Text

from pathfold import channels, sheet
from pathfold.buffers import BUFFERS
from pathfold.channels import Frame, samples, words
from pathfold.cli.console import harmless
from pathfold.files import open_linear, read
from pathfold.images import ImageError, ImageFile, Layer

_COLUMNS = ("layer", "part", "channels", "type", "window")


@dataclass(frozen=True)
class Picture:
    """A file as it would be denoised; `problem` says why it would not be."""

    file: ImageFile
    frames: Sequence[Frame]
    problem: str = ""

    def roles(self, layer: Layer) -> list[str]:
        """The buffers that a layer is, or is a part of."""
        own = set(layer.channels.values())
        return [
            name
            for frame in self.frames
            for name in BUFFERS
            if name in frame.sources
            for read in frame.sources[name].read
            if read.part == layer.part and own & set(read.channels.values())
        ]


def look(path: Path) -> Picture:
    """Open a picture and map it. Raises ImageError where it is none; `problem` is why it could not be denoised."""
    file, frames = ImageFile(path), []
    try:
        frames = channels.match(file)
        open_linear(path)
    except ImageError as error:
        return Picture(file, frames, str(error))
    return Picture(file, frames)


def tell(picture: Picture) -> None:
    """Print the mapping, with what is made of each buffer, and the layers that are not used."""
    terminal = sys.stdout.isatty()
    out = Console(file=sys.stdout, width=None if terminal else 1000, highlight=False, emoji=False)
    with out.capture() as told:
        _print(out, picture)
    text = told.get()
    print(text if terminal else "\n".join(line.rstrip() for line in text.splitlines()), flush=True)


def _print(out: Console, picture: Picture) -> None:
    out.print(_plain(_headline(picture), "bold"))
    for frame in picture.frames:
        out.print("\n", _plain(f"{_title(frame)}, channel names of {frame.preset.title}"), sep="")
        out.print(_mapping(picture.file, frame))
        notes = [note for note in frame.notes if not note.startswith("not used")]  # they have a table below
        for line in (*_derived(frame), *_conversions(picture.file, frame), *notes):
            out.print(_plain(f"  {line}"))
        if absent := [buffer for buffer in BUFFERS if buffer not in frame.sources]:
            out.print(_plain(f"  not found: {', '.join(absent)}", "dim"))
    if unused := [layer for layer in _shown(picture.file) if not picture.roles(layer)]:
        table = _table(("not used", *_COLUMNS[1:], "why"))
        for layer in unused:
            table.add_row(*_cells(picture.file, layer), _plain(_reason(picture, layer)))
        out.print("", table, sep="\n")
    for line in _sample_lines(picture.file):
        out.print("\n", _plain(line), sep="")
    if picture.problem:
        out.print("\n", _plain(picture.problem, "bold"), sep="")


def draw(picture: Picture, path: Path) -> None:
    """Write the sheet of thumbnails. Raises OutputError."""
    tiles = [_tile(picture, layer) for layer in _shown(picture.file)]
    said = [frame.preset.title for frame in picture.frames[:1]] or ["no color found"]
    title, *rest = _headline(picture).split("  ")
    sheet.write(path, harmless(title), harmless(" · ".join([*rest, *said])), tiles)


def _tile(picture: Picture, layer: Layer) -> sheet.Tile:
    name, part, letters, kind, window = (cell.plain for cell in _cells(picture.file, layer))
    role = ", ".join(dict.fromkeys(picture.roles(layer))) or sheet.UNUSED
    notes = f"part {part} · {letters} · {kind} · {window}" + (f" · view {layer.view}" if layer.view else "")
    at = layer.pick(3) or layer.pick(1) or list(layer.channels.values())[:3]
    try:
        pixels: NDArray[np.float32] | None = picture.file.read(layer.part, at)
    except ImageError:
        return sheet.Tile(None, role, name, f"damaged · {notes}")
    if pixels is not None and pixels.shape[-1] == 2:
        pixels = np.concatenate([pixels, np.zeros_like(pixels[..., :1])], -1)
    return sheet.Tile(pixels, role, name, harmless(notes))


def _headline(picture: Picture) -> str:
    parts = picture.file.parts
    return f"{picture.file.path.name}  {parts[0].width}x{parts[0].height}  {len(parts)} part{'s'[: len(parts) > 1]}"


def _title(frame: Frame) -> str:
    view = f" (view {frame.color_layer.view})" if frame.color_layer.view else ""
    return f"picture {frame.color_layer.label}{view}"


def _mapping(file: ImageFile, frame: Frame) -> Table:
    table = _table(("buffer", *_COLUMNS))
    for name, source in ((name, frame.sources[name]) for name in BUFFERS if name in frame.sources):
        for number, layer in enumerate(source.read):
            first = _plain("" if number else name, "yellow" if name == "color" else "cyan")
            table.add_row(first, *_cells(file, layer, source.numbers(layer, BUFFERS[name])))
    return table


def _derived(frame: Frame) -> Iterator[str]:
    for name, source in frame.sources.items():
        if not source.direct:
            yield f"{name} = {source}"


def _conversions(file: ImageFile, frame: Frame) -> Iterator[str]:
    """What denoising makes of the frame's buffers when it reads them."""
    wanted = [name for name in ("albedo", "normal", "depth") if name in frame.sources]
    try:
        buffers, converted = read(file, frame, ["color"], wanted)
    except ImageError as error:
        yield str(error)
        return
    yield from converted
    if "normal" in buffers and channels.encoded(buffers["normal"]):
        yield "normal is stored as 0.5 n + 0.5: decoded"


def _shown(file: ImageFile) -> list[Layer]:
    """The layers that people look at: all but the samples'."""
    return [layer for layer in file.layers if layer.part != samples.find(file) or not layer.name.startswith("samples.")]


def _reason(picture: Picture, layer: Layer) -> str:
    """Why a layer is not used, and what would use it."""
    if not picture.frames:
        return "no color was found"
    guide = words.guide(layer.label)
    if guide and layer.pick(BUFFERS[guide]):
        return f"no known name, or another is used; {layer.mapped(guide)} would use it"
    if not words.unlit(layer.label) and {"R", "G", "B"} <= set(layer.channels):
        return f"no buffer; --layer {quote(layer.option)} filters it alike, if it is light"
    return "no buffer; kept as it is"


def _sample_lines(file: ImageFile) -> Iterator[str]:
    if samples.find(file) is not None:
        count, spp = samples.count(file), file.metadata().get("pathfold:spp", 0)
        of_all = f" of {spp}" if isinstance(spp, int) and spp > count else ""
        yield f"part {samples.find(file)}: {count}{of_all} samples per pixel with path descriptors"


def _cells(file: ImageFile, layer: Layer, numbers: Sequence[int] | None = None) -> tuple[Text, ...]:
    spec = file.parts[layer.part]
    formats = spec.channelformats or (spec.format,) * spec.nchannels
    used = {letter: at for letter, at in layer.channels.items() if numbers is None or at in numbers}
    kinds = dict.fromkeys(str(formats[at]) for at in used.values())
    part = f"{layer.part}" + (f" {file.part_name(layer.part)}" if file.part_name(layer.part) else "")
    window = str(layer.window).removesuffix(" at 0,0")
    return tuple(map(_plain, (layer.label, part, ",".join(used), ",".join(kinds), window)))


def _table(columns: Sequence[str]) -> Table:
    table = Table(box=None, pad_edge=False, padding=(0, 2, 0, 0), header_style="dim")
    for column in columns:
        table.add_column(column, overflow="fold")
    return table


def _plain(text: str, style: str = "") -> Text:
    return Text(harmless(text), style)
