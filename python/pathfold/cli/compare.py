"""`pathfold compare`: the error of a picture against a reference."""

import json
from pathlib import Path
from typing import Annotated

import numpy as np
import typer
from numpy.typing import NDArray

from pathfold import channels
from pathfold.bench.reference import Reference, beauty
from pathfold.cli import console
from pathfold.cli.console import InputError
from pathfold.images import ImageFile


def compare(
    image: Annotated[Path, typer.Argument(metavar="IMAGE.exr", help="The picture.")],
    reference: Annotated[Path, typer.Argument(metavar="REFERENCE.exr", help="What it should be.")],
    as_json: Annotated[bool, typer.Option("--json", help="Print one JSON object.")] = False,
) -> None:
    """Measure RelL2, SMAPE, SSIM and FLIP of a picture's beauty against a reference's.

    Where the reference holds two independent halves (half_a, half_b), RelL2 leaves out its own noise. Pictures of one
    frame whose pixels cover other parts of it are compared where both have some.
    """
    x, r, line = overlap(image, reference)
    try:
        values = r.errors(x)
    except ValueError as error:
        raise InputError(f"{image}: {error}") from error
    values.pop("rell2_paper", None)
    if as_json:
        console.say(json.dumps(values | ({"compared": line} if line else {})))
        return
    if line:
        console.say(line)
    for name, value in values.items():
        console.say(f"{name:6} {value:.6g}")


def overlap(image: Path, reference: Path) -> tuple[NDArray[np.float32], Reference, str]:
    """A picture and a reference where both have pixels, and a line on it where that is not all of both.

    Raises InputError where they show unlike frames (display windows), or no pixel is in both.
    """
    files = ImageFile(image), ImageFile(reference)
    x, r = beauty(files[0]), Reference.read(reference)
    frames = [channels.match(file)[0] for file in files]
    (ours, theirs) = (frame.window for frame in frames)
    if ours == theirs:
        return x, r, ""
    shown = [file.display(frame.color_layer.part) for file, frame in zip(files, frames, strict=True)]
    common = ours.common(theirs)
    if common is None or shown[0] != shown[1]:
        places = zip((image, reference), (ours, theirs), shown, strict=True)
        listed = ", ".join(f"{path} is {window} in a frame of {frame}" for path, window, frame in places)
        raise InputError(f"{listed}; only pictures of one frame that overlap can be compared")
    both = x[ours.slices(common)], r.cut(*theirs.slices(common))
    return *both, f"compared where both have pixels: {common} of {ours} and {theirs}"
