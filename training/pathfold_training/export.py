"""`pathfold-train export`: a checkpoint becomes a model folder (ONNX graphs, manifest, model card, references)."""

from __future__ import annotations

import copy
import hashlib
import json
from pathlib import Path

import onnx
import torch
import torch.nn.functional as functional
from torch import Tensor, nn
from torch.nn.utils import parametrize

from .card import model_card
from .config import Config
from .features import DEMODULATION_EPSILON, DESCRIPTOR_CHANNELS, OPTIONAL
from .fit import training_seconds
from .networks import embedding
from .networks.kpcn import BRANCHES, Branch, macs_per_pixel, overlap
from .references import write_references
from .task import Denoising

OPSET = 18
CHANNELS = {"radiance": 3, "variance": 3, "albedo": 3, "normal": 3, "depth": 1, "diffuse.albedo": 3}
CHANNELS |= {"samples.descriptor": DESCRIPTOR_CHANNELS, "samples.density": 1, "samples.valid": 1}


def input_shape(name: str) -> list[int | str]:
    """A graph input's shape as the manifest states it."""
    if name in ("exposure", "depth_scale") or name.endswith(".present"):
        return [1]
    return ["S" if name.startswith("samples.") else 1, CHANNELS[name], "H", "W"]


class Graph(nn.Module):
    """A branch with positional inputs, as the exporter wants them."""

    def __init__(self, branch: Branch) -> None:
        super().__init__()
        self.branch = branch

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


class Standalone(Graph):
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
    """The trained task in evaluation mode, weight norm folded, and the checkpoint's state."""
    state = torch.load(checkpoint, map_location="cpu", weights_only=True)
    task = Denoising(Config.model_validate(state["hyper_parameters"]["config"]))
    task.load_state_dict(state["state_dict"])
    for module in task.modules():
        if parametrize.is_parametrized(module):
            parametrize.remove_parametrizations(module, "weight")
    return task.float().eval(), state


def write_graph(module: Graph, path: Path, output: str) -> None:
    """Export one branch with dynamic height, width and sample count."""
    names = module.branch.input_names()
    height, width, samples = 24, 40, 3  # any example: no size is baked in
    sizes = {"S": samples, "H": height, "W": width}
    example = tuple(torch.rand([n if isinstance(n, int) else sizes[n] for n in input_shape(name)]) for name in names)
    axes = {n: {i: str(s) for i, s in enumerate(input_shape(n)) if isinstance(s, str)} for n in names}
    axes = {n: a for n, a in axes.items() if a} | {output: {2: "H", 3: "W"}}
    torch.onnx.export(
        module.eval(),
        example,
        path,
        input_names=names,
        output_names=[output],
        dynamic_axes=axes,
        opset_version=OPSET,
        dynamo=False,
    )
    onnx.checker.check_model(onnx.load(path), full_check=True)


def export(checkpoint: Path, out: Path, record: dict, standalone: bool = False) -> Path:
    """Write the model folder `out`; `record` is the training run's record.json. Returns `out`."""
    task, state = load_task(checkpoint)
    out.mkdir(parents=True, exist_ok=True)
    for name in BRANCHES:
        branch = task.model.branch(name)
        write_graph(Graph(with_trust_as_last_logit(branch)), out / f"{name}.onnx", "logits")
        if standalone:
            size = task.config.network.kernel_size
            write_graph(Standalone(branch, size), out / f"{name}-standalone.onnx", "filtered")
    manifest = describe(task, state, out, record)
    (out / "manifest.json").write_text(json.dumps(manifest, indent=2) + "\n")
    (out / "README.md").write_text(model_card(manifest))
    write_references(task, out, manifest)
    return out


def describe(task: Denoising, state: dict, out: Path, record: dict) -> dict:
    """The manifest (DESIGN: contract 4.5)."""
    network = task.config.network
    channels = network.kernel_size**2 + network.trust
    graphs = {}
    for name in BRANCHES:
        graphs[name] = {
            "file": f"{name}.onnx",
            "sha256": hashlib.sha256((out / f"{name}.onnx").read_bytes()).hexdigest(),
            "inputs": {n: input_shape(n) for n in task.model.branch(name).input_names()},
            "outputs": {"logits": [1, channels, "H", "W"]},
        }
    paths = ["samples.descriptor", "samples.density"] if network.embedding else []
    uses = ["diffuse", "specular", "diffuse.albedo", "diffuse.variance", "specular.variance"]
    uses += [n for n in OPTIONAL if n != "split"] + (["samples.valid"] if network.embedding else [])
    demodulate = {"by": "diffuse.albedo", "epsilon": DEMODULATION_EPSILON}
    return {
        "format": 1,
        "name": task.config.name,
        "description": task.config.description,
        "license": "Apache-2.0",
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
        "exposure": {"rule": "log-average", "key": 0.18},
        "tile": {"alignment": embedding.ALIGNMENT, "overlap": overlap(network)},
        "samples_per_pixel": {"min": task.config.data.spp_min, "max": task.config.data.spp_max},
        "precision": "fp32",
        "training": {**record, "steps": state["global_step"], "kmac_per_pixel": macs_per_pixel(network, 8) / 1e3}
        | training_seconds(state),
    }
