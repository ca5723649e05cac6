"""`pathfold info`: what there is: models, a model, a file."""

import json
from collections.abc import Iterator
from importlib.metadata import PackageNotFoundError, version
from pathlib import Path
from typing import Annotated, Any

import typer

from pathfold import _core, channels, models
from pathfold.buffers import BUFFERS
from pathfold.channels import samples
from pathfold.cli import console
from pathfold.cli.denoise import frame_lines
from pathfold.denoiser import Denoiser
from pathfold.images import ImageError, ImageFile


def info(
    subject: Annotated[str, typer.Argument(metavar="[FILE|MODEL]", help="A picture, or a model.")] = "",
) -> None:
    """Tell about a picture (its layers, and which buffer each would be), a model, or the installation."""
    if not subject:
        lines = installation()
    elif Path(subject).is_file() or (Path(subject).suffix.lower() == ".exr" and not Path(subject).is_dir()):
        lines = picture(Path(subject))
    else:
        lines = model(subject)
    for line in lines:
        console.say(line)


def installation() -> Iterator[str]:
    """The version, where models are searched and which there are."""
    yield f"pathfold {_core.version()}"
    for package in ("onnxruntime", "mitsuba"):
        try:
            yield f"{package} {version(package)}"
        except PackageNotFoundError:
            yield f"{package} is not installed"
    yield "models:"
    for name, folder in models.available().items():
        yield f"  {name:18} {folder}"


def model(name: str) -> Iterator[str]:
    """What a model reads and how it was made; the model is checked on the way."""
    loaded = Denoiser(name).model
    entry = loaded.manifest
    yield f"{entry['name']}: {entry.get('description', '')}"
    yield f"  folder        {loaded.folder}"
    yield f"  requires      {', '.join(entry['requires'])}"
    yield f"  can use       {', '.join(entry.get('uses', ()))}"
    yield f"  filters with  {reconstruction(entry['reconstruction'])}"
    yield f"  precision     {precision(entry)}; runs in {loaded.precision} here unless told otherwise"
    yield f"  tile overlap  {entry['tile']['overlap']} px"
    yield f"  licence       {entry.get('license', '')}"
    for key, value in entry.get("training", {}).items():
        yield f"  training.{key:12} {value if isinstance(value, str | int | float) else json.dumps(value)}"


def precision(entry: dict[str, Any]) -> str:
    """The model's own, and the variants with their error."""
    variants = entry.get("variants", {})
    errors = (f", {name} (RelL2 {block['rell2_over_fp32']:.4g} of fp32's)" for name, block in variants.items())
    return "".join([entry["precision"], *errors])


def reconstruction(block: dict[str, Any]) -> str:
    branches = ", ".join(branch["name"] for branch in block["branches"])
    size = f" {block['size']}x{block['size']}" if "size" in block else ""
    return f"{block['operator']}{size} ({branches})"


def picture(path: Path) -> Iterator[str]:
    """The parts and layers of a file and the buffers that they would be."""
    file = ImageFile(path)
    for number, spec in enumerate(file.parts):
        name = f" '{file.part_name(number)}'" if file.part_name(number) else ""
        kinds = ", ".join(sorted({str(kind) for kind in spec.channelformats or (spec.format,)}))
        yield f"part {number}{name}: {spec.width}x{spec.height}, {spec.nchannels} channels, {kinds}"
        for layer in file.layers:
            if layer.part == number and not layer.name.startswith("samples."):
                yield f"  {layer.name or '(main)'}: {', '.join(layer.channels)}"
        if samples.find(file) == number:
            count, spp = samples.count(file), file.metadata().get("pathfold:spp", 0)
            of_all = f" of {spp}" if isinstance(spp, int) and spp > count else ""
            yield f"  {count}{of_all} samples per pixel with path descriptors"
    try:
        for frame in channels.match(file):
            yield from frame_lines(path, frame)
            if absent := [buffer for buffer in BUFFERS if buffer not in frame.sources]:
                yield f"  not found: {', '.join(absent)}"
    except ImageError as error:
        yield str(error)
