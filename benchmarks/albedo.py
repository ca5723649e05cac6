"""How well a pathfold network cleans the albedo: python benchmarks/albedo.py runs/balanced/last.ckpt data [--spp 8]

Of held-out views, by how noisy the albedo is: the squared relative error of the pixel mean as it came and as the
network makes it, against the view's other samples, whose own noise is taken off.
"""

from __future__ import annotations

import argparse
from collections.abc import Mapping, Sequence
from functools import partial
from hashlib import sha256
from pathlib import Path
from typing import Any

import numpy as np
import pages
import torch
from numpy.typing import NDArray
from pathfold.report.tables import markdown
from pathfold_training.fit.task import Denoising
from pathfold_training.fit.views import Stored, ValidationViews, Window
from pathfold_training.networks.losses import RELATIVE_EPSILON
from pathfold_training.networks.pathfold.network import Pathfold
from pathfold_training.networks.pathfold.unet import ALBEDO_EPSILON
from pathfold_training.release.score import load

BOUNDS = (0.005, 0.03, 0.1)  # between classes: standard deviation of the pixel's mean albedo over the albedo
CLASSES = ("below 0.005", "to 0.03", "to 0.1", "above")


def errors(task: Denoising, view: Window, spp: int) -> tuple[NDArray[np.int64], NDArray[np.float64]]:
    """Each pixel's class, H x W, and the errors of its noisy and cleaned albedo, 2 x H x W."""
    batch = ValidationViews([view], task.config.network.path_samples, spp)[0]
    with torch.no_grad():
        cleaned = task.model.filter(batch.inputs | {"radiance": batch.inputs["color"]}, batch.counts).cleaned
    samples = np.nan_to_num(view.tensor("samples.albedo")[view.number].astype(np.float64), posinf=0.0, neginf=0.0)
    given, others = samples[:spp], samples[spp:]
    truth = others.mean(0)
    noise = others.var(0, ddof=1) / len(others)
    known = np.stack([given.mean(0), cleaned[0].numpy() - ALBEDO_EPSILON])
    squared = ((known - truth) ** 2 - noise) / (truth**2 + RELATIVE_EPSILON)
    spread = given.std(0, ddof=1).mean(0) / np.sqrt(spp) / (given.mean((0, 1)) + RELATIVE_EPSILON)
    return np.digitize(spread, BOUNDS), squared.mean(1)


def measure(task: Denoising, views: Sequence[Window], spp: int) -> Mapping[str, Any]:
    """By class: its share of pixels, and the mean errors of the albedo as it came and as it was cleaned."""
    found = [errors(task, view, spp) for view in views]
    kinds = np.concatenate([kind.ravel() for kind, _ in found])
    squared = np.concatenate([error.reshape(2, -1) for _, error in found], 1)
    each = [[float((kinds == k).mean()), *squared[:, kinds == k].mean(1).tolist()] for k in range(len(CLASSES))]
    return {"views": len(views), "classes": dict(zip(CLASSES, each, strict=True))}


def tables(rows: Sequence[pages.Row]) -> str:
    parts = []
    for row in rows:
        table = [["deviation of the albedo", "pixels", "error as it came", "cleaned"]]
        for name, (share, came, cleaned) in row["classes"].items():
            table.append([name, f"{share:.1%}", f"{came:.5f}", f"{cleaned:.5f}"])
        parts.append(f"{row['views']} held-out views, {row['spp']} spp:\n\n{markdown(table)}")
    return "\n".join(parts)


PAGE = pages.Page(
    "albedo",
    "How clean the albedo gets",
    "Mean squared relative error of the albedo that a pathfold network divides radiance by, on held-out views, by the "
    "standard deviation of the pixel's mean over its albedo.",
    tables,
)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("checkpoint", type=Path)
    parser.add_argument("data", type=Path)
    parser.add_argument("--spp", type=int, default=8)
    parser.add_argument("-o", "--output", type=Path, default=pages.RESULTS, help="folder for the page and its data")
    options = parser.parse_args()
    torch.set_num_threads(1)
    task = load(options.checkpoint)
    if not isinstance(task.model, Pathfold):
        raise SystemExit(f"{options.checkpoint}: does not clean its albedo; name one of a pathfold preset")
    views = [view for view in Stored(options.data).held_out() if view.samples >= 2 * options.spp]
    if not views:
        raise SystemExit(f"{options.data}: no held-out view has {2 * options.spp} samples; lower --spp")
    findings = pages.Findings(PAGE, options.output, [])
    checkpoint = sha256(options.checkpoint.read_bytes()).hexdigest()[:12]
    findings.row({"spp": options.spp, "checkpoint": checkpoint}, partial(measure, task, views, options.spp))
    findings.finish()


if __name__ == "__main__":
    main()
