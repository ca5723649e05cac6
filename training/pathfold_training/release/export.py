"""`pathfold-train export`: a checkpoint becomes a model folder (ONNX graphs, manifest, model card, references)."""

from __future__ import annotations

import hashlib
import json
from collections.abc import Sequence
from pathlib import Path

import onnx
import torch
from pathfold.models import ALL_SAMPLES
from torch.nn.utils import parametrize

from ..files import make_folder
from ..fit.checkpoint import load_checkpoint, training_seconds
from ..fit.finite import not_finite
from ..fit.task import Denoising
from ..fit.views import Window
from ..networks.family import Graph
from ..networks.narrow import narrow
from .card import model_card
from .check_references import write_references
from .without_paths import samples_without_paths

OPSET = 18


def load_task(checkpoint: Path) -> tuple[Denoising, dict]:
    """The trained task in evaluation mode as it is exported, and the checkpoint's state.

    Weight norm is folded, weights are rounded to what is stored of them. Raises ValueError where one is not finite.
    """
    config, state = load_checkpoint(checkpoint)
    task = Denoising(config)
    task.load_state_dict(state["state_dict"])
    for module in task.modules():
        if parametrize.is_parametrized(module):
            parametrize.remove_parametrizations(module, "weight")
    task.model.round_weights()
    if name := not_finite(task.state_dict()):
        raise ValueError(f"{checkpoint}: weight {name} is too large to be stored; train with a lower learning_rate")
    return task.float().eval(), state


def write_graph(graph: Graph, path: Path) -> dict:
    """Export a module with dynamic height, width and sample count. Returns the graph's entry in the manifest."""
    sizes = {"S": 3, "H": 24, "W": 40, "H/2": 16, "W/2": 24}  # any example: no size is baked in
    shapes = graph.inputs.values()
    example = tuple(torch.rand([n if isinstance(n, int) else sizes[n] for n in shape]) for shape in shapes)
    axes = {
        name: {i: size.replace("/", "_over_") for i, size in enumerate(shape) if isinstance(size, str)}
        for name, shape in (graph.inputs | graph.outputs).items()
    }
    torch.onnx.export(
        graph.module.eval(),
        example,
        path,
        input_names=list(graph.inputs),
        output_names=list(graph.outputs),
        dynamic_axes={n: a for n, a in axes.items() if a},
        opset_version=OPSET,
        dynamo=False,
    )
    model = onnx.load(path)
    narrow(model)
    onnx.checker.check_model(model, full_check=True)
    onnx.save(model, path)
    return {"file": path.name, "sha256": sha256(path), "inputs": graph.inputs, "outputs": graph.outputs}


def sha256(file: Path) -> str:
    return hashlib.sha256(file.read_bytes()).hexdigest()


def export(
    checkpoint: Path, out: Path, record: dict, standalone: bool = False, held_out: Sequence[Window] = ()
) -> Path:
    """Write the model folder `out`; `record` is the training run's record.json. Returns `out`.

    On `held_out` views a model that can do without path descriptors is tried without, see without_paths.py. Raises
    ValueError for a `checkpoint` that is none and for `standalone` where there is no such graph: nothing is written
    then.
    """
    task, state = load_task(checkpoint)
    whole = standalone_graphs(task) if standalone else {}
    make_folder(out)
    graphs = {name: write_graph(graph, out / f"{name}.onnx") for name, graph in task.model.graphs().items()}
    for name, graph in whole.items():
        write_graph(graph, out / f"{name}.onnx")
    manifest = describe(task, state, graphs, record)
    for variant in out.glob("*.int8.onnx"):
        variant.unlink()  # of what the folder held before
    optional = "samples.descriptor" in manifest["uses"]
    if held_out and optional and (spp := samples_without_paths(task.eval(), held_out)):
        manifest["samples_per_pixel"]["without_paths"] = spp
    (out / "manifest.json").write_text(json.dumps(manifest, indent=2) + "\n")
    (out / "README.md").write_text(model_card(manifest))
    write_references(task, out, manifest)
    return out


def standalone_graphs(task: Denoising) -> dict[str, Graph]:
    try:
        return task.model.standalone_graphs()
    except ValueError as error:
        raise ValueError(f"{task.config.name}: {error}") from None


def describe(task: Denoising, state: dict, graphs: dict[str, dict], record: dict) -> dict:
    """The manifest, as sdk/manifest.schema.json has it."""
    own = task.model.describe()
    samples = {"min": task.config.data.spp_min, "max": task.config.data.spp_max}
    if 0 < task.model.sizes.path_samples < ALL_SAMPLES:
        samples["embedded"] = task.model.sizes.path_samples
    return {
        "format": 1,
        "name": task.config.name,
        "description": task.config.description,
        "license": "Apache-2.0",
        "requires": own["requires"],
        "uses": own["uses"],
        "graphs": graphs,
        "reconstruction": own["reconstruction"],
        "tile": own["tile"],
        "exposure": {"rule": "log-average", "key": 0.18},
        "samples_per_pixel": samples,
        "precision": "fp32",
        "training": {**record, "steps": state["global_step"], "kmac_per_pixel": task.model.macs(spp=8) / 1e3}
        | training_seconds(state),
    }
