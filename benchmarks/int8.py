"""What int8 would bring a pathfold model: time of its network and error on held-out views, against fp32.

    python benchmarks/int8.py MODEL_FOLDER DATA [--views 8 --crops 48 --spp 2 8 --fp32 down.0.0 --percentile 99.99]

Static quantisation by onnxruntime, calibrated on augmented training crops: the U-Net in int8 (weights per channel), the
first layer, trust, heads, embedding and reconstruction in fp32. Prints a Markdown table. `--fp32` leaves layers as they
are; without `--percentile` activations range from their least to their largest value.
"""

import argparse
import json
import math
import shutil
import tempfile
import time
from collections.abc import Iterator
from itertools import islice
from pathlib import Path

import numpy as np
import onnx
import torch
from numpy.typing import NDArray
from onnxruntime import InferenceSession, SessionOptions
from onnxruntime.quantization import CalibrationDataReader, CalibrationMethod, QuantFormat, QuantType, quantize_static
from pathfold_training.config import Config
from pathfold_training.data import Batch, Crops, Inputs, Stored, ValidationViews
from pathfold_training.networks.pathfold import Pathfold, demodulator

BODY = ("down.", "project.", "up.")  # the layers to quantise
Feeds = dict[str, NDArray[np.float32]]


class Calibration(CalibrationDataReader):
    def __init__(self, feeds: Iterator[Feeds]) -> None:
        self.feeds = feeds

    def get_next(self) -> Feeds | None:
        return next(self.feeds, None)


def network_feeds(inputs: Inputs, embedding: InferenceSession, network: InferenceSession) -> Feeds:
    """One frame's inputs of the graph `network`, its samples embedded."""
    arrays = {name: value.numpy() for name, value in (inputs | {"radiance": inputs["color"]}).items()}
    (arrays["embedding"],) = embedding.run(None, {port.name: arrays[port.name] for port in embedding.get_inputs()})
    return {port.name: arrays[port.name] for port in network.get_inputs()}


def body(graph: onnx.GraphProto, fp32: list[str]) -> list[str]:
    """The nodes to quantise: the U-Net between the first layer and the heads, without the layers of `fp32`."""
    resized = {output for node in graph.node if node.op_type == "Resize" for output in node.output}

    def inside(node: onnx.NodeProto) -> bool:
        if node.op_type == "Conv":
            layer = node.input[1].removeprefix("model.").removesuffix(".weight")
            return layer.startswith(BODY) and layer not in fp32
        return node.op_type in ("MaxPool", "Resize") or (node.op_type == "Add" and bool(resized & set(node.input)))

    return [node.name for node in graph.node if inside(node)]


def seconds(path: Path, feeds: Feeds, runs: int) -> float:
    """The least CPU time of several runs on one thread: what a busy machine disturbs least."""
    options = SessionOptions()
    options.intra_op_num_threads = 1
    session = InferenceSession(path, options)
    taken = []
    for _ in range(runs + 1):
        start = time.process_time()
        session.run(None, feeds)
        taken.append(time.process_time() - start)
    return min(taken[1:])


def error(session: InferenceSession, feeds: Feeds, batch: Batch) -> float:
    """RelL2 of the frame."""
    trust, *logits = (torch.from_numpy(part) for part in session.run(None, feeds))
    inputs, exposure = batch.inputs, batch.inputs["exposure"].reshape(-1, 1, 1, 1)
    factor = demodulator(inputs)
    image = Pathfold.reconstruct(trust, logits, inputs["color"] / factor) * factor * exposure
    reference = batch.reference["color"] * exposure
    return float(((image - reference).square() / (reference.square() + 0.01)).mean())


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("model", type=Path)
    parser.add_argument("data", type=Path)
    parser.add_argument("--views", type=int, default=8)
    parser.add_argument("--crops", type=int, default=48)
    parser.add_argument("--spp", type=int, nargs="+", default=[2, 8])
    parser.add_argument("--fp32", nargs="*", default=[], help="layers to leave in fp32")
    parser.add_argument("--percentile", type=float, help="of activations that fits into their range; default: all")
    options = parser.parse_args()
    stored, source = Stored(options.data), options.model / "network.onnx"
    embedding, exact = InferenceSession(options.model / "embedding.onnx"), InferenceSession(source)
    manifest = json.loads((options.model / "manifest.json").read_text())
    config = Config.model_validate(manifest["training"]["config"]).data.model_copy(update={"batch": 1})
    crops = islice(Crops(stored, config, seed=0, paths=True), options.crops)
    with tempfile.TemporaryDirectory() as scratch:
        quantised, copied = Path(scratch) / "network.int8.onnx", Path(scratch) / source.name
        shutil.copy(source, copied)  # onnxruntime writes what it infers beside it
        quantize_static(
            copied,
            quantised,
            Calibration(network_feeds(batch.inputs, embedding, exact) for batch in crops),
            quant_format=QuantFormat.QDQ,
            per_channel=True,
            activation_type=QuantType.QUInt8,
            weight_type=QuantType.QInt8,
            op_types_to_quantize=["Conv", "MaxPool", "Resize", "Add"],
            nodes_to_quantize=body(onnx.load(source).graph, options.fp32),
            calibrate_method=CalibrationMethod.Percentile if options.percentile else CalibrationMethod.MinMax,
            extra_options={"CalibPercentile": options.percentile} if options.percentile else {},
        )
        session = InferenceSession(quantised)
        held_out = stored.held_out()
        picked = held_out[:: max(1, len(held_out) // options.views)][: options.views]
        ratios: dict[int, list[float]] = {}
        for spp in options.spp:
            for batch in (ValidationViews(picked, True, spp)[i] for i in range(len(picked))):
                feeds = network_feeds(batch.inputs, embedding, exact)
                ratios.setdefault(spp, []).append(error(session, feeds, batch) / error(exact, feeds, batch))
        large = {name: value if value.ndim == 1 else np.tile(value, (1, 1, 2, 3)) for name, value in feeds.items()}
        times = [seconds(path, large, 5) for path in (source, quantised)]
        print(f"{options.model.name}, {len(picked)} held-out views, {options.crops} crops, fp32 = 1\n")
        columns = ["MB", "CPU time of the network", *(f"RelL2, {spp} spp" for spp in ratios), "worst view"]
        print("| " + " | ".join(columns) + " |")
        print("|" + "---|" * len(columns))
        means = [math.exp(sum(map(math.log, each)) / len(each)) for each in ratios.values()]
        cells = [f"{quantised.stat().st_size / 1e6:.2f}", f"{times[1] / times[0]:.2f}", *(f"{m:.4f}" for m in means)]
        print("| " + " | ".join([*cells, f"{max(map(max, ratios.values())):.3f}"]) + " |")


if __name__ == "__main__":
    main()
