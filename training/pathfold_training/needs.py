"""From how many samples per pixel on a model does as well without path descriptors: measured on held-out views."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import replace

import torch

from .data import Batch, ValidationViews, View, without_paths
from .task import Denoising

VIEWS = 16  # held-out windows to measure on, at most
BOUND = 1.02  # of RelL2 without paths over that with them


def samples_without_paths(task: Denoising, views: Sequence[View]) -> int | None:
    """The least power of two from which on the ratio stays below BOUND, None if it does not at the most samples.

    The ratio is the geometric mean over at most VIEWS of `views`, at 2, 4, 8, ... samples per pixel as far as all of
    these have them.
    """
    views = some(views)
    most = min(view.samples for view in views)
    levels = [2**i for i in range(1, int(math.log2(most)) + 1)]
    paths = task.config.network.path_samples
    return least(levels, [ratio(task, ValidationViews(views, paths, spp)) for spp in levels])


def some(views: Sequence[View]) -> Sequence[View]:
    """VIEWS of the views at most, evenly spread."""
    return views[:: -(-len(views) // VIEWS)]


def least(levels: Sequence[int], ratios: Sequence[float]) -> int | None:
    """The first level from which on all ratios are within BOUND."""
    found = None
    for level, value in zip(reversed(levels), reversed(ratios), strict=True):
        if value > BOUND:
            break
        found = level
    return found


def ratio(task: Denoising, frames: ValidationViews) -> float:
    """RelL2 without paths over that with them, geometric mean over the frames."""
    logs = []
    for index in range(len(frames)):
        batch = frames[index]
        blind = replace(batch, inputs=without_paths(batch.inputs), counts=[1])
        logs.append(math.log(error(task, blind) / error(task, batch)))
    return math.exp(sum(logs) / len(logs))


def error(task: Denoising, batch: Batch) -> float:
    """RelL2 of the denoised frame, exposed."""
    exposure = batch.inputs["exposure"].reshape(-1, 1, 1, 1)
    reference = batch.reference["color"] * exposure
    with torch.no_grad():
        picture = task.denoise(batch) * exposure
    return float(((picture - reference).square() / (reference.square() + 0.01)).mean())
