"""Weights stored as 16-bit floats: a graph half the size that computes, to the bit, what the rounded weights do.

A Cast widens each stored weight when the graph is loaded; onnxruntime folds it, so that running costs nothing more.
"""

from __future__ import annotations

import numpy as np
import onnx
import torch
from onnx import TensorProto, helper, numpy_helper
from torch import nn

SUFFIX = ".half"  # of the stored weight's name
LARGEST = float(np.finfo(np.float16).max)


def round_weights(model: nn.Module, but: str) -> None:
    """Round weights in place, but for layers that a 16-bit float cannot hold and those whose names begin by `but`.

    Biases stay.
    """
    for name, weight in model.named_parameters():
        if weight.ndim > 1 and not name.startswith(but) and weight.detach().abs().max() <= LARGEST:
            weight.data = weight.data.to(torch.float16).to(weight.dtype)


def narrow(model: onnx.ModelProto) -> None:
    """Store every convolution's weights that are 16-bit floats already as such, each widened by a Cast."""
    casts = []
    for tensor in model.graph.initializer:
        values = numpy_helper.to_array(tensor)
        if values.dtype != np.float32 or values.ndim != 4 or np.abs(values).max() > LARGEST:
            continue
        stored = values.astype(np.float16)
        if np.array_equal(stored.astype(np.float32), values):
            casts.append(helper.make_node("Cast", [tensor.name + SUFFIX], [tensor.name], to=TensorProto.FLOAT))
            tensor.CopyFrom(numpy_helper.from_array(stored, tensor.name + SUFFIX))
    for cast in reversed(casts):
        model.graph.node.insert(0, cast)


def widen(model: onnx.ModelProto) -> None:
    """The inverse of `narrow`: every weight as float32."""
    stored = {tensor.name: tensor for tensor in model.graph.initializer}
    for node in [node for node in model.graph.node if node.op_type == "Cast" and node.input[0] in stored]:
        values = numpy_helper.to_array(stored[node.input[0]]).astype(np.float32)
        stored[node.input[0]].CopyFrom(numpy_helper.from_array(values, node.output[0]))
        model.graph.node.remove(node)
