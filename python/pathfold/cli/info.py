"""`pathfold info`: what there is: models, a model, a file."""

import json
from collections.abc import Iterator
from importlib.metadata import PackageNotFoundError, version
from pathlib import Path
from typing import Annotated, Any

import typer

from pathfold import _core, models
from pathfold import sheet as sheets
from pathfold.cli import console, picture
from pathfold.denoiser import Denoiser


def info(
    subject: Annotated[str, typer.Argument(metavar="[FILE|MODEL]", help="A picture, or a model.")] = "",
    sheet: Annotated[
        Path | None,
        typer.Option(metavar="SHEET.png", help="Draw each layer of the picture, with what it was taken for."),
    ] = None,
) -> None:
    """Tell about a picture (its layers, and which buffer each would be), a model, or the installation."""
    path = Path(subject)
    if subject and (path.is_file() or (path.suffix.lower() == ".exr" and not path.is_dir())):
        if sheet:
            sheets.check(sheet)
        seen = picture.look(path)
        picture.tell(seen)
        if sheet:
            picture.draw(seen, sheet)
            console.say(f"{sheet}")
        return
    if sheet:
        raise typer.BadParameter("--sheet draws the layers of a picture; name an EXR")
    for line in model(subject) if subject else installation():
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
