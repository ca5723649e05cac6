"""`pathfold-train export`: a checkpoint becomes a model folder (ONNX graphs, manifest, model card, references)."""

from __future__ import annotations

import copy
import hashlib
import json
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import onnx
import torch
import torch.nn.functional as functional
from torch import Tensor, nn
from torch.nn.utils import parametrize

from ..files import make_folder
from ..fit.checkpoint import load_checkpoint, training_seconds
from ..fit.task import Denoising
from ..fit.views import Window
from ..networks import embedding, kpcn, pathfold
from ..networks.features import DEMODULATION_EPSILON, DESCRIPTOR_CHANNELS, OPTIONAL
from ..networks.kpcn import BRANCHES, Branch, Kpcn
from ..networks.narrow import narrow, round_weights
from ..networks.pathfold import Pathfold
from ..networks.pathfold_graphs import EmbeddingGraph, NetworkGraph
from .card import model_card
from .check_references import write_references
from .without_paths import samples_without_paths

OPSET = 18
CHANNELS = {"radiance": 3, "variance": 3, "albedo": 3, "normal": 3, "depth": 1, "diffuse.albedo": 3}
CHANNELS |= {"samples.descriptor": DESCRIPTOR_CHANNELS, "samples.density": 1, "samples.valid": 1}

Shape = list[int | str]
Shapes = dict[str, Shape]  # by name, in the graph's order


def input_shape(name: str) -> Shape:
    """The shape of a graph's input that is a buffer or a scalar, as the manifest states it."""
    if name in ("exposure", "depth_scale") or name.endswith(".present"):
        return [1]
    return ["S" if name.startswith("samples.") else 1, CHANNELS[name], "H", "W"]


class BranchGraph(nn.Module):
    """A branch with positional inputs, as the exporter wants them."""

    def __init__(self, branch: Branch) -> None:
        super().__init__()
        self.branch = branch

    def input_shapes(self) -> Shapes:
        return {name: input_shape(name) for name in self.branch.input_names()}

    def forward(self, *tensors: Tensor) -> Tensor:
        return self.branch(dict(zip(self.branch.input_names(), tensors, strict=True))).logits


def with_trust_as_last_logit(branch: Branch) -> Branch:
    """A copy whose last layer predicts kernels and trust at once: joining two outputs would copy 441 channels."""
    if branch.trust is None:
        return branch
    joined = copy.deepcopy(branch)
    for name in ("weight", "bias"):
        both = torch.cat([getattr(branch.kernels, name), getattr(branch.trust, name)])
        setattr(joined.kernels, name, nn.Parameter(both, requires_grad=False))
    joined.trust = None
    return joined


class Standalone(BranchGraph):
    """The branch's filtered radiance [1, 3, H, W]: the graph with the reconstruction inside, linear and unexposed."""

    def __init__(self, branch: Branch, size: int) -> None:
        super().__init__(branch)
        self.size = size

    def forward(self, *tensors: Tensor) -> Tensor:
        inputs = dict(zip(self.branch.input_names(), tensors, strict=True))
        predicted, radiance = self.branch(inputs), inputs["radiance"]
        factor = (
            inputs["diffuse.albedo"] + DEMODULATION_EPSILON if self.branch.demodulate else torch.ones_like(radiance)
        )
        # one exponential and one division; onnxruntime's Softmax over channels is six times as slow
        weights = torch.exp(predicted.logits - predicted.logits.amax(1, keepdim=True))
        height, width = radiance.shape[2], radiance.shape[3]
        source = torch.cat([radiance / factor, torch.ones_like(radiance[:, :1])], 1)
        if predicted.trust is not None:  # clamped so that its exponential neither overflows nor vanishes
            source = source * torch.exp(torch.clamp(predicted.trust, -30.0, 30.0))
        source = functional.pad(source, [self.size // 2] * 4)
        total = torch.zeros_like(source[:, :, :height, :width])
        for tap in range(self.size**2):
            dy, dx = divmod(tap, self.size)
            total = total + weights[:, tap : tap + 1] * source[:, :, dy : dy + height, dx : dx + width]
        return total[:, :3] / torch.clamp(total[:, 3:], min=1e-30) * factor


def load_task(checkpoint: Path) -> tuple[Denoising, dict]:
    """The trained task in evaluation mode as it is exported, and the checkpoint's state.

    Weight norm is folded, a pathfold network's weights are rounded to what is stored of them.
    """
    config, state = load_checkpoint(checkpoint)
    task = Denoising(config)
    task.load_state_dict(state["state_dict"])
    for module in task.modules():
        if parametrize.is_parametrized(module):
            parametrize.remove_parametrizations(module, "weight")
    if isinstance(task.model, Pathfold):
        round_weights(task.model)
    return task.float().eval(), state


def write_graph(module: nn.Module, path: Path, inputs: Shapes, outputs: Shapes) -> dict:
    """Export a module with dynamic height, width and sample count. Returns the graph's entry in the manifest."""
    sizes = {"S": 3, "H": 24, "W": 40, "H/2": 16, "W/2": 24}  # any example: no size is baked in
    example = tuple(torch.rand([n if isinstance(n, int) else sizes[n] for n in shape]) for shape in inputs.values())
    axes = {
        name: {i: size.replace("/", "_over_") for i, size in enumerate(shape) if isinstance(size, str)}
        for name, shape in (inputs | outputs).items()
    }
    torch.onnx.export(
        module.eval(),
        example,
        path,
        input_names=list(inputs),
        output_names=list(outputs),
        dynamic_axes={n: a for n, a in axes.items() if a},
        opset_version=OPSET,
        dynamo=False,
    )
    model = onnx.load(path)
    narrow(model)
    onnx.checker.check_model(model, full_check=True)
    onnx.save(model, path)
    return {"file": path.name, "sha256": sha256(path), "inputs": inputs, "outputs": outputs}


def sha256(file: Path) -> str:
    return hashlib.sha256(file.read_bytes()).hexdigest()


def export(
    checkpoint: Path, out: Path, record: dict, standalone: bool = False, held_out: Sequence[Window] = ()
) -> Path:
    """Write the model folder `out`; `record` is the training run's record.json. Returns `out`.

    On `held_out` views a model that can do without path descriptors is tried without, see needs.py. Raises ValueError
    for a `checkpoint` that is none and for `standalone` where there is no such graph: nothing is written then.
    """
    task, state = load_task(checkpoint)
    if standalone and isinstance(task.model, Pathfold):
        raise ValueError(
            f"{task.config.name}: a gather pyramid has no graph with the reconstruction inside; leave --standalone away"
        )
    make_folder(out)
    if isinstance(task.model, Pathfold):
        own = write_pyramid(task.model, out)
    else:
        own = write_branches(task.model, out, standalone)
    manifest = describe(task, state, own, record)
    if isinstance(task.model, Pathfold) and (most := task.model.network.embedded):
        manifest["samples_per_pixel"]["embedded"] = most
    for variant in out.glob("*.int8.onnx"):
        variant.unlink()  # of what the folder held before
    if held_out and isinstance(task.model, Pathfold) and (spp := samples_without_paths(task.eval(), held_out)):
        manifest["samples_per_pixel"]["without_paths"] = spp
    (out / "manifest.json").write_text(json.dumps(manifest, indent=2) + "\n")
    (out / "README.md").write_text(model_card(manifest))
    write_references(task, out, manifest)
    return out


def describe(task: Denoising, state: dict, own: dict, record: dict) -> dict:
    """The manifest, as sdk/manifest.schema.json has it; `own` is the network family's part."""
    return {
        "format": 1,
        "name": task.config.name,
        "description": task.config.description,
        "license": "Apache-2.0",
        **own,
        "exposure": {"rule": "log-average", "key": 0.18},
        "samples_per_pixel": {"min": task.config.data.spp_min, "max": task.config.data.spp_max},
        "precision": "fp32",
        "training": {**record, "steps": state["global_step"], "kmac_per_pixel": macs_per_pixel(task.model) / 1e3}
        | training_seconds(state),
    }


def macs_per_pixel(model: Kpcn | Pathfold, spp: int = 8) -> float:
    if isinstance(model, Pathfold):
        return pathfold.macs_per_pixel(model.network, spp)
    return kpcn.macs_per_pixel(model.network, spp)


def write_branches(model: Kpcn, out: Path, standalone: bool) -> dict:
    """KPCN's graphs. Returns its own part of the manifest: two gathers."""
    network = model.network
    logits: Shape = [1, network.kernel_size**2 + network.trust, "H", "W"]
    graphs = {}
    for name in BRANCHES:
        branch = model.branch(name)
        graph = BranchGraph(with_trust_as_last_logit(branch))
        graphs[name] = write_graph(graph, out / f"{name}.onnx", graph.input_shapes(), {"logits": logits})
        if standalone:
            whole = Standalone(branch, network.kernel_size)
            filtered: Shapes = {"filtered": [1, 3, "H", "W"]}
            write_graph(whole, out / f"{name}-standalone.onnx", whole.input_shapes(), filtered)
    paths = ["samples.descriptor", "samples.density"] if network.embedding else []
    uses = ["diffuse", "specular", "diffuse.albedo", "diffuse.variance", "specular.variance"]
    uses += [n for n in OPTIONAL if n != "split"] + (["samples.valid"] if network.embedding else [])
    demodulate = {"by": "diffuse.albedo", "epsilon": DEMODULATION_EPSILON}
    return {
        "requires": ["color", *paths],
        "uses": uses,
        "graphs": graphs,
        "reconstruction": {
            "operator": "gather",
            "size": network.kernel_size,
            "trust": network.trust,
            "branches": [
                {"name": "diffuse", "graph": "diffuse", "radiance": "diffuse", "demodulate": demodulate},
                {"name": "specular", "graph": "specular", "radiance": "specular", "unsplit": True},
            ],
        },
        "tile": {"alignment": embedding.ALIGNMENT, "overlap": kpcn.overlap(network)},
    }


def write_pyramid(model: Pathfold, out: Path) -> dict:
    """The pathfold family's graphs. Returns its own part of the manifest: one pyramid, all but color optional."""
    samples, network = EmbeddingGraph(model), NetworkGraph(model)
    sums = samples.output_shapes()
    of_samples = {name: input_shape(name) for name in samples.input_names}
    of_pixels = {name: sums[name] if name in sums else input_shape(name) for name in network.input_names}
    graphs = {
        "embedding": write_graph(samples, out / "embedding.onnx", of_samples, sums),
        "network": write_graph(network, out / "network.onnx", of_pixels, network.output_shapes()),
    }
    branch: dict[str, Any] = {"name": "color", "graph": "network", "radiance": "color", "unsplit": True}
    if model.network.demodulate:
        branch["demodulate"] = {"by": "albedo", "epsilon": pathfold.ALBEDO_EPSILON}
    if model.cleans:
        branch["demodulate"]["clean"] = True
    return {
        "requires": ["color"],
        "uses": [n for n in pathfold.OPTIONAL if n != "paths"] + ["samples.descriptor", "samples.valid"],
        "graphs": graphs,
        "reconstruction": {"operator": "pyramid", "branches": [branch]},
        "tile": {"alignment": pathfold.ALIGNMENT, "overlap": pathfold.overlap(model.network)},
    }
