"""The references of `pathfold check`: every case of pathfold.check.cases through the whole chain in float64 torch.

`python -m pathfold_training.release.check_references MODEL_FOLDER ...` writes them anew from a model, where the
cases have changed or what is made of a frame.
"""

from __future__ import annotations

import copy
import sys
from pathlib import Path
from typing import Any

import numpy as np
import torch
from numpy.typing import NDArray
from pathfold.check import references
from pathfold.check.cases import CASES
from pathfold.check.prepare import Prepared, prepare, reads
from pathfold.check.references import References, frame_hash
from torch import Tensor

from ..fit.checkpoint import read_manifest
from ..fit.preset import Config
from ..fit.task import Denoising
from ..fit.warm_start import warm_start
from ..networks.families import FAMILIES, family


def write_references(task: Denoising, folder: Path, manifest: dict[str, Any]) -> None:
    """Write references.npz into the model folder that `task` was exported to."""
    task = copy.deepcopy(task).double().eval()
    made = References()
    for case in CASES:
        if not reads(manifest, case.needs):
            continue
        buffers = case.make()
        image, made.logits[case.name] = denoise(task, prepare(buffers, manifest))
        made.images[case.name] = image.astype(np.float32)  # half a unit in the last place: far below any tolerance
        made.frames[case.name] = frame_hash(buffers)
    references.write(folder, manifest, made)


def renew_references(folder: Path) -> None:
    """Write references.npz of an exported model anew. Raises ValueError for a folder that `export` did not write."""
    manifest = read_manifest(folder)
    config, network = manifest["training"]["config"], manifest["training"]["config"]["network"]
    known = FAMILIES[family(network)].sizes.model_fields  # what was a choice once may be none any more
    chosen = {"name": config["name"], "description": config["description"]}
    task = Denoising(Config.model_validate(chosen | {"network": {k: v for k, v in network.items() if k in known}}))
    warm_start(task, folder)
    write_references(task.eval(), folder, manifest)


def denoise(task: Denoising, frame: Prepared) -> tuple[NDArray[np.float64], float]:
    """The frame's color H x W x 3 and the largest |logit| (with trust): networks, kernels and sums in float64."""
    total, largest = np.zeros_like(frame.branches[0].radiance), 0.0
    masked = torch.from_numpy(~frame.valid)
    for part in frame.branches:
        radiance, factor = (tensor("radiance", values) for values in (part.radiance, part.factor))
        radiance = radiance.masked_fill(masked, float("nan"))
        with torch.no_grad():
            inputs = {name: tensor(name, block) for name, block in part.inputs.items()}
            filtered, logit = task.model.filter_branch(part.graph, inputs, radiance, factor)
            largest = max(largest, logit)
        total += filtered[0].permute(1, 2, 0).numpy()
    if not np.isfinite(total).all():
        raise ValueError("the network's result is not finite in float64, so it has no reference; train it anew")
    return total, largest


def tensor(name: str, values: NDArray[np.float64]) -> Tensor:
    """A graph input N x C x H x W of an H x W x C or S x H x W x C buffer; scalars as they are."""
    block = torch.from_numpy(values)
    if block.ndim == 1:
        return block
    return (block if name.startswith("samples.") else block[None]).permute(0, 3, 1, 2)


if __name__ == "__main__":
    for model in sys.argv[1:]:
        renew_references(Path(model))
