"""`pathfold compare`: the error of a picture against a reference."""

import json
from pathlib import Path
from typing import Annotated

import typer

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

    Where the reference holds two independent halves (half_a, half_b), RelL2 leaves out its own noise.
    """
    x, r = beauty(ImageFile(image)), Reference.read(reference)
    if x.shape != r.mean.shape:
        sizes = (f"{path} is {at.shape[1]}x{at.shape[0]}" for path, at in ((image, x), (reference, r.mean)))
        raise InputError(f"{', '.join(sizes)}; only pictures of one size can be compared")
    try:
        values = r.errors(x)
    except ValueError as error:
        raise InputError(f"{image}: {error}") from error
    values.pop("rell2_paper", None)
    if as_json:
        console.say(json.dumps(values))
        return
    for name, value in values.items():
        console.say(f"{name:6} {value:.6g}")
