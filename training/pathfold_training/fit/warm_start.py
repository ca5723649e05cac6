"""Weights of another run or of a model folder to begin with: `fit --start-from`."""

from __future__ import annotations

from pathlib import Path

import onnx
import torch
from google.protobuf.message import DecodeError  # type: ignore[import-untyped]
from onnx import numpy_helper
from torch import Tensor
from torch.nn.utils import parametrize

from ..networks import narrow
from ..networks.embedding import Standardised
from ..networks.families import FAMILIES, family
from .checkpoint import START, load_checkpoint, read_manifest
from .finite import not_finite
from .task import Denoising


def warm_start(task: Denoising, source: Path) -> None:
    """Copy the weights of a checkpoint or model folder; what only the new network has keeps its own first values.

    That holds for R's input channels too: begun at zero they stay small for thousands of steps, and R does not read F.
    A network whose family lets it be wider begins as the narrow one: what that had reads nothing new yet.
    Raises ValueError where a layer is narrower, of another kernel size, or missing.
    """
    merged = {name: value.clone() for name, value in plain_weights(task).items()}
    for name, value in folder_weights(source).items() if source.is_dir() else checkpoint_weights(source).items():
        wider = task.model.may_widen(name.removeprefix("model."))
        new = merged.get(name)
        if new is None or not fits(value, new, wider):
            raise ValueError(
                f"{source}: its weight {name} does not fit preset '{task.config.name}'; give a network of its "
                "family that is no wider"
            )
        if wider and value.dim() > 1:
            new[: value.shape[0], value.shape[1] :] = 0.0
        new[tuple(slice(n) for n in value.shape)] = value
    for name, value in merged.items():
        owner, _, attribute = name.rpartition(".")
        module = task.get_submodule(owner)
        if isinstance(module, Standardised):
            module.unfold(merged[f"{owner}.weight"], merged[f"{owner}.bias"])
            continue
        with torch.no_grad():
            if parametrize.is_parametrized(module, attribute):
                setattr(module, attribute, value)  # weight norm finds its two factors
            else:
                getattr(module, attribute).copy_(value)


def fits(value: Tensor, new: Tensor, wider: bool) -> bool:
    """`value` can be the first channels of `new`: of its inputs, and of its outputs too where it may be wider."""
    if value.dim() != new.dim() or value.shape[2:] != new.shape[2:]:
        return False
    outputs = value.shape[0] <= new.shape[0] if wider else value.shape[0] == new.shape[0]
    return outputs and value.shape[1:2] <= new.shape[1:2]


def plain_weights(task: Denoising) -> dict[str, torch.Tensor]:
    """All weights by name, weight norm multiplied out and scales folded: what an exported graph holds too."""
    weights: dict[str, torch.Tensor] = {}
    for owner, module in task.named_modules():
        names = [name for name, _ in module.named_parameters(recurse=False)]
        names += list(module.parametrizations) if parametrize.is_parametrized(module) else []
        if not owner.endswith(".parametrizations.weight"):
            weights |= {f"{owner}.{name}": getattr(module, name).detach() for name in names}
        if isinstance(module, Standardised):
            folded = zip(("weight", "bias"), module.folded(), strict=True)
            weights |= {f"{owner}.{name}": value.detach() for name, value in folded}
    return weights


def checkpoint_weights(checkpoint: Path) -> dict[str, torch.Tensor]:
    config, state = load_checkpoint(checkpoint)
    task = Denoising(config)
    task.load_state_dict(state["state_dict"])
    return plain_weights(task)


def folder_weights(folder: Path) -> dict[str, torch.Tensor]:
    """The weights in a model folder's graphs: their initialisers keep the modules' names.

    Raises ValueError for graphs that `pathfold-train export` did not write.
    """
    manifest = read_manifest(folder)
    graphs = {name: graph_weights(folder / graph["file"]) for name, graph in manifest["graphs"].items()}
    try:
        network = FAMILIES[family(manifest["training"]["config"]["network"])].network
        weights = network.weights_of(graphs, manifest["reconstruction"])
    except (KeyError, TypeError) as error:
        raise ValueError(f"{folder}: not written by 'pathfold-train export' ({error}); give a checkpoint") from None
    return {f"model.{name}": value for name, value in weights.items()}


def graph_weights(file: Path) -> dict[str, torch.Tensor]:
    """A graph's initialisers by name, float32. Raises ValueError where two layers share one, or it cannot be read."""
    try:
        model = onnx.load(file)
    except OSError as error:
        raise ValueError(f"cannot read {file}: {error.strerror}; {START}") from error
    except DecodeError as error:
        raise ValueError(f"{file} is no ONNX graph, or is damaged ({error}); {START}") from error
    if not model.graph.initializer:  # cut short before its weights it is a graph still
        raise ValueError(f"{file} holds no weights; {START}")
    narrow.widen(model)
    read = [name for node in model.graph.node if node.op_type == "Conv" for name in node.input[1:]]
    if len(set(read)) < len(read):  # the exporter merges equal ones, those of untrained layers
        raise ValueError(f"{file}: some layers' weights are equal and cannot be told apart; give the run's last.ckpt")
    weights = {t.name: torch.from_numpy(numpy_helper.to_array(t).copy()) for t in model.graph.initializer}
    if name := not_finite(weights):
        raise ValueError(f"{file}: weight {name} is not finite; {START}")
    return weights
