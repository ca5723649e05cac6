"""What int8 would bring a pathfold model: time of its network and error on held-out views, against fp32.

    python benchmarks/int8.py DATA MODEL... [--views 16 --crops 192 --spp 2 8 --fp32 down.0.0 --percentile 99.99]

Quantises as `pathfold-train export --data` does and leaves the model folders as they are. `--fp32` leaves these layers
as they are; without `--percentile` activations range from their least to their
largest value.
"""

import argparse
import json
import tempfile
import time
from collections.abc import Sequence
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
import pages
from onnxruntime import InferenceSession, SessionOptions
from pathfold import models
from pathfold.bench import candidates
from pathfold.bench.results import geometric
from pathfold.report.tables import markdown
from pathfold_training.fit.views import Stored, ValidationViews
from pathfold_training.release.quantise import CROPS, FILE, Feeds, network_feeds, quantised_copy, ratios, trained_on
from pathfold_training.release.without_paths import VIEWS


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


def measure(model: Path, data: Stored, options: argparse.Namespace) -> dict[str, Any]:
    """Size in MB, CPU time of the network over fp32, RelL2 over fp32 by spp (geometric means over views), the worst."""
    source = model / "network.onnx"
    held_out = data.held_out()
    picked = held_out[:: max(1, len(held_out) // options.views)][: options.views]
    _, paths = trained_on(json.loads((model / "manifest.json").read_text()))
    with tempfile.TemporaryDirectory() as scratch:
        folder = quantised_copy(model, Path(scratch), data, options.crops, options.fp32, options.percentile)
        found = {spp: ratios(folder, ValidationViews(picked, paths, spp)) for spp in options.spp}
        sessions = [InferenceSession(model / name) for name in ("embedding.onnx", source.name)]
        feeds = network_feeds(ValidationViews(picked, paths, options.spp[0])[0].inputs, *sessions)
        large = {name: value if value.ndim == 1 else np.tile(value, (1, 1, 2, 3)) for name, value in feeds.items()}
        times = [seconds(path, large, 5) for path in (source, folder / FILE)]
        size = (folder / FILE).stat().st_size / 1e6
    errors = {str(spp): geometric(each) for spp, each in found.items()}
    worst = max(map(max, found.values()))
    return {"views": len(picked), "mb": size, "time": times[1] / times[0], "rell2": errors, "worst": worst}


def tables(rows: Sequence[pages.Row]) -> str:
    head = ["model", "MB", "CPU time of the network", *(f"RelL2, {spp} spp" for spp in rows[0]["rell2"]), "worst view"]
    table = [head]
    for row in rows:
        errors = [f"{error:.4f}" for error in row["rell2"].values()]
        table.append([row["model"], f"{row['mb']:.2f}", f"{row['time']:.2f}", *errors, f"{row['worst']:.3f}"])
    return f"{rows[0]['views']} held-out views, {rows[0]['asked']['crops']} crops, fp32 = 1:\n\n{markdown(table)}"


PAGE = pages.Page(
    "int8",
    "What int8 brings",
    "Networks quantised as `export` does it: CPU time on one thread and RelL2 on held-out views, over fp32.",
    tables,
)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("data", type=Path)
    parser.add_argument("models", nargs="+", help="names or folders")
    parser.add_argument("--views", type=int, default=VIEWS)
    parser.add_argument("--crops", type=int, default=CROPS)
    parser.add_argument("--spp", type=int, nargs="+", default=[2, 8])
    parser.add_argument("--fp32", nargs="*", default=(), help="layers to leave in fp32")
    parser.add_argument("--percentile", type=float, default=0, help="of activations that fits their range; 0: all")
    parser.add_argument("-o", "--output", type=Path, default=pages.RESULTS, help="folder for the page and its data")
    options = parser.parse_args()
    data, found = Stored(options.data), candidates.find_all(options.models)
    findings = pages.Findings(PAGE, options.output, found)
    settings = {name: getattr(options, name) for name in ("views", "crops", "spp", "fp32", "percentile")}
    for model in found:
        key = {"model": model.name, "identity": model.identity, "asked": settings}
        findings.row(key, partial(measure, models.find(model.argument), data, options))
    findings.finish()


if __name__ == "__main__":
    main()
