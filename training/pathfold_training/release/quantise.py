"""int8 for a model whose family has it: quantised on training crops, measured on held-out views.

By onnxruntime, static: the U-Net in int8, weights per channel; the layer that reads the buffers, trust, heads, the
embedding and the reconstruction stay in float32.
"""

from __future__ import annotations

import json
import shutil
from collections.abc import Iterator, Sequence
from itertools import islice
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

import numpy as np
import onnx
import torch
from numpy.typing import NDArray
from onnxruntime import InferenceSession
from onnxruntime.quantization import CalibrationDataReader, CalibrationMethod, QuantFormat, QuantType, quantize_static
from pathfold import Denoiser
from pathfold.bench.results import geometric
from pathfold.models import ALL_SAMPLES

from ..fit.crops import Crops
from ..fit.preset import Data
from ..fit.views import Stored, ValidationViews
from ..networks.batch import Batch, Inputs
from ..networks.families import FAMILIES, family
from ..networks.losses import halves_error
from ..networks.narrow import narrow, widen
from .card import model_card
from .export import sha256
from .without_paths import some

GRAPH, FILE = "network", "network.int8.onnx"  # what is quantised, and where it is written
CROPS, FIREFLIES = 192, 0.1  # to calibrate on, and the share of them with fireflies, whatever was trained with
SPPS = (2, 8)  # samples per pixel to measure on
BOUND = 1.02  # of RelL2 over that of fp32
MOST_BYTES = 8_000_000  # of a folder's graphs: models come with every installation
Feeds = dict[str, NDArray[np.float32]]


def add_int8(folder: Path, data: Stored) -> str:
    """Write the int8 variant of a model folder into it: graph, manifest and card. Returns a line that says how it went.

    Nothing is written where it would have more than BOUND times the error, or make the folder larger than MOST_BYTES.
    """
    with TemporaryDirectory() as scratch:
        trial = quantised_copy(folder, Path(scratch), data)
        manifest = json.loads((trial / "manifest.json").read_text())
        views, (_, paths) = some(data.held_out()), trained_on(manifest)
        error = geometric([ratio for spp in SPPS for ratio in ratios(trial, ValidationViews(views, paths, spp))])
        size = sum(path.stat().st_size for path in trial.glob("*.onnx"))
        said = f"RelL2 {error:.4f} times that of fp32 on {len(views)} held-out views"
        if not error <= BOUND:
            return f"no int8: {said}, more than {BOUND:g}; train longer, or with quantisation in the loop"
        if size > MOST_BYTES:
            return f"no int8: with it the folder would hold {size / 1e6:.1f} MB, more than {MOST_BYTES / 1e6:g}"
        manifest["variants"]["int8"]["rell2_over_fp32"] = round(error, 4)
        shutil.copy(trial / FILE, folder)
    (folder / "manifest.json").write_text(json.dumps(manifest, indent=2) + "\n")
    (folder / "README.md").write_text(model_card(manifest))
    return f"int8: {said}; {size / 1e6:.1f} MB in all"


def can_be_quantised(folder: Path) -> bool:
    """Whether the model's family has layers to quantise."""
    return bool(layers(json.loads((folder / "manifest.json").read_text())))


def layers(manifest: dict[str, Any]) -> tuple[str, ...]:
    """How the names of the layers that are quantised begin."""
    return FAMILIES[family(manifest["training"]["config"]["network"])].network.quantised


def quantised_copy(
    folder: Path, scratch: Path, data: Stored, crops: int = CROPS, fp32: Sequence[str] = (), percentile: float = 0
) -> Path:
    """A copy of the model folder in `scratch` that has an int8 variant, whose error is not known yet.

    `fp32` names layers to leave as they are. Activations range from their least to their largest value in the crops, or
    as far as `percentile` of them do.
    """
    manifest = json.loads((folder / "manifest.json").read_text())
    copied = scratch / folder.name
    shutil.copytree(folder, copied)
    model = onnx.load(folder / manifest["graphs"][GRAPH]["file"])
    widen(model)
    source = scratch / "fp32.onnx"  # onnxruntime writes what it infers beside it
    onnx.save(model, source)
    quantize_static(
        source,
        copied / FILE,
        Calibration(calibration_feeds(folder, manifest, data, crops)),
        quant_format=QuantFormat.QDQ,
        per_channel=True,
        activation_type=QuantType.QUInt8,
        weight_type=QuantType.QInt8,
        op_types_to_quantize=["Conv", "MaxPool", "Resize", "Add"],
        nodes_to_quantize=body(model.graph, layers(manifest), fp32),
        calibrate_method=CalibrationMethod.Percentile if percentile else CalibrationMethod.MinMax,
        extra_options={"CalibPercentile": percentile} if percentile else {},
    )
    quantised = onnx.load(copied / FILE)
    narrow(quantised)
    onnx.checker.check_model(quantised, full_check=True)
    onnx.save(quantised, copied / FILE)
    graph = {"file": FILE, "sha256": sha256(copied / FILE)}
    manifest["variants"] = {"int8": {"rell2_over_fp32": 1.0, "graphs": {GRAPH: graph}}}
    (copied / "manifest.json").write_text(json.dumps(manifest))
    return copied


class Calibration(CalibrationDataReader):
    def __init__(self, feeds: Iterator[Feeds]) -> None:
        self.feeds = feeds

    def get_next(self) -> Feeds | None:
        return next(self.feeds, None)


def calibration_feeds(folder: Path, manifest: dict[str, Any], data: Stored, crops: int) -> Iterator[Feeds]:
    """The graph's inputs of augmented training crops; of at least FIREFLIES of them some pixels are far too bright."""
    sessions = [InferenceSession(folder / manifest["graphs"][name]["file"]) for name in ("embedding", GRAPH)]
    trained, paths = trained_on(manifest)
    single = trained.model_copy(
        update={"batch": 1, "fireflies": max(FIREFLIES, trained.fireflies), "cleaned": False}  # truths are not read
    )
    for batch in islice(Crops(data, single, seed=0, paths=paths), crops):
        yield network_feeds(batch.inputs, *sessions)


def trained_on(manifest: dict[str, Any]) -> tuple[Data, int]:
    """How the crops were that a model was trained on, and of how many samples of a pixel it looks at paths."""
    embedded = manifest["samples_per_pixel"].get("embedded", ALL_SAMPLES)
    return Data.model_validate(manifest["training"]["config"]["data"]), embedded


def network_feeds(inputs: Inputs, embedding: InferenceSession, network: InferenceSession) -> Feeds:
    """One frame's inputs of the graph `network`, its samples embedded."""
    arrays = {name: value.numpy() for name, value in (inputs | {"radiance": inputs["color"]}).items()}
    (arrays["embedding"],) = embedding.run(None, {port.name: arrays[port.name] for port in embedding.get_inputs()})
    return {port.name: arrays[port.name] for port in network.get_inputs()}


def body(graph: onnx.GraphProto, layers: tuple[str, ...], fp32: Sequence[str]) -> list[str]:
    """The nodes to quantise: convolutions of `layers` but those of `fp32`, and what joins their results."""
    resized = {output for node in graph.node if node.op_type == "Resize" for output in node.output}

    def inside(node: onnx.NodeProto) -> bool:
        if node.op_type == "Conv":
            layer = node.input[1].removeprefix("model.").removesuffix(".weight")
            return layer.startswith(layers) and layer not in fp32
        return node.op_type in ("MaxPool", "Resize") or (node.op_type == "Add" and bool(resized & set(node.input)))

    return [node.name for node in graph.node if inside(node)]


def ratios(folder: Path, frames: ValidationViews) -> list[float]:
    """RelL2 in int8 over that in fp32, of each frame as the SDK denoises it."""
    exact, rounded = (Denoiser(folder, precision=precision) for precision in ("fp32", "int8"))
    batches = ((frames[index], min(frames.spp, view.samples)) for index, view in enumerate(frames.views))
    return [error(rounded, *frame) / error(exact, *frame) for frame in batches]


def error(denoiser: Denoiser, batch: Batch, spp: int) -> float:
    """RelL2 of the one frame of a batch, exposed, free of the reference's noise."""
    exposure = float(batch.inputs["exposure"])
    known = {*denoiser.model.requires, *denoiser.model.uses}
    buffers = {name: np.moveaxis(value.numpy(), 1, -1) for name, value in batch.inputs.items() if name in known}
    buffers = {name: value if name.startswith("samples.") else value[0] for name, value in buffers.items()}
    if not float(batch.inputs["variance.present"]):
        del buffers["variance"]
    image = denoiser.run_buffers(buffers, samples_per_pixel=spp, exposure=exposure).color * exposure
    halves = (batch.truth[f"half_{name}"] * exposure for name in "ab")
    return float(halves_error(torch.from_numpy(image).movedim(-1, 0)[None], *halves))
