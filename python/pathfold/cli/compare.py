"""`pathfold compare`: the error of a picture against a reference."""

import json
import math
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from pathfold.cli import console
from pathfold.cli.console import InputError

if TYPE_CHECKING:
    import numpy as np
    from numpy.typing import NDArray


def compare(
    image: Annotated[Path, typer.Argument(metavar="IMAGE.exr", help="The picture.")],
    reference: Annotated[Path, typer.Argument(metavar="REFERENCE.exr", help="What it should be.")],
    as_json: Annotated[bool, typer.Option("--json", help="Print one JSON object.")] = False,
) -> None:
    """Measure RelL2, SMAPE, SSIM and FLIP of a picture's beauty against a reference's.

    Where the reference holds two independent halves (half_a, half_b), RelL2 leaves out its own noise.
    """
    from pathfold import metrics

    x, r = beauty(image), beauty(reference)
    if x.shape != r.shape:
        sizes = (f"{path} is {at.shape[1]}x{at.shape[0]}" for path, at in ((image, x), (reference, r)))
        raise InputError(f"{', '.join(sizes)}; only pictures of one size can be compared")
    try:
        values = metrics.compare(x, r)
        if halves := read_halves(reference):
            values["rell2"] = metrics.rell2_halves(x, *halves)
    except ValueError as error:
        raise InputError(f"{image}: {error}") from error
    if not math.isfinite(sum(values.values())):
        raise InputError(f"{reference}: its halves half_a, half_b hold pixels that are not finite; mend or remove them")
    if as_json:
        console.say(json.dumps(values))
        return
    for name, value in values.items():
        console.say(f"{name:6} {value:.6g}")


def beauty(path: Path) -> "NDArray[np.float32]":
    """The picture's colour; InputError where it is not finite."""
    import numpy as np

    from pathfold import channels
    from pathfold.images import ImageFile

    file = ImageFile(path)
    color = channels.load(file, channels.match(file)[0], "color")
    if bad := int((~np.isfinite(color)).any(-1).sum()):
        raise InputError(f"{path}: {bad} pixels are not finite, so there is nothing to measure; denoise it first")
    return color


def read_halves(path: Path) -> "tuple[NDArray[np.float32], NDArray[np.float32]] | None":
    """The two independent halves of a reference, where it holds them."""
    from pathfold.images import ImageFile

    file = ImageFile(path)
    layers = [file.layer(name) for name in ("half_a", "half_b")]
    found = [(layer.part, at) for layer in layers if layer and (at := layer.pick(3))]
    return (file.read(*found[0]), file.read(*found[1])) if len(found) == 2 else None
