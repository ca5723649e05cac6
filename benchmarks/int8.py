"""What int8 would bring a pathfold model: time of its network and error on held-out views, against fp32.

    python benchmarks/int8.py MODEL_FOLDER DATA [--views 16 --crops 192 --spp 2 8 --fp32 down.0.0 --percentile 99.99]

Quantises as `pathfold-train export --data` does, prints a Markdown table and leaves the folder as it is. `--fp32`
leaves these layers as they are; without `--percentile` activations range from their least to their
largest value.
"""

import argparse
import tempfile
import time
from pathlib import Path

import numpy as np
from onnxruntime import InferenceSession, SessionOptions
from pathfold.report.results import geometric
from pathfold_training.data import Stored, ValidationViews
from pathfold_training.needs import VIEWS
from pathfold_training.quantise import CROPS, FILE, Feeds, network_feeds, quantised_copy, ratios, trained_as


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


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("model", type=Path)
    parser.add_argument("data", type=Path)
    parser.add_argument("--views", type=int, default=VIEWS)
    parser.add_argument("--crops", type=int, default=CROPS)
    parser.add_argument("--spp", type=int, nargs="+", default=[2, 8])
    parser.add_argument("--fp32", nargs="*", default=(), help="layers to leave in fp32")
    parser.add_argument("--percentile", type=float, default=0, help="of activations that fits their range; 0: all")
    options = parser.parse_args()
    data, source = Stored(options.data), options.model / "network.onnx"
    held_out = data.held_out()
    picked = held_out[:: max(1, len(held_out) // options.views)][: options.views]
    paths = trained_as(options.model).network.path_samples
    with tempfile.TemporaryDirectory() as scratch:
        folder = quantised_copy(options.model, Path(scratch), data, options.crops, options.fp32, options.percentile)
        found = {spp: ratios(folder, ValidationViews(picked, paths, spp)) for spp in options.spp}
        sessions = [InferenceSession(options.model / name) for name in ("embedding.onnx", source.name)]
        feeds = network_feeds(ValidationViews(picked, paths, options.spp[0])[0].inputs, *sessions)
        large = {name: value if value.ndim == 1 else np.tile(value, (1, 1, 2, 3)) for name, value in feeds.items()}
        times = [seconds(path, large, 5) for path in (source, folder / FILE)]
        size = (folder / FILE).stat().st_size / 1e6
    print(f"{options.model.name}, {len(picked)} held-out views, {options.crops} crops, fp32 = 1\n")
    columns = ["MB", "CPU time of the network", *(f"RelL2, {spp} spp" for spp in found), "worst view"]
    print("| " + " | ".join(columns) + " |")
    print("|" + "---|" * len(columns))
    cells = [f"{size:.2f}", f"{times[1] / times[0]:.2f}", *(f"{geometric(each):.4f}" for each in found.values())]
    print("| " + " | ".join([*cells, f"{max(map(max, found.values())):.3f}"]) + " |")


if __name__ == "__main__":
    main()
