"""From how many samples per pixel on a model does as well without path descriptors: measured on held-out views."""

from __future__ import annotations

import math
from collections.abc import Sequence

from ..fit.task import Denoising
from ..fit.views import Window
from .score import score

VIEWS = 16  # held-out windows to measure on, at most
BOUND = 1.02  # of RelL2 without paths over that with them


def samples_without_paths(task: Denoising, views: Sequence[Window]) -> int | None:
    """The least power of two from which on the ratio stays below BOUND, None if it does not at the most samples.

    It is taken over at most VIEWS of `views`, at 2, 4, 8, ... samples per pixel as far as all of these have them.
    """
    views = some(views)
    most = min(view.samples for view in views)
    levels = [2**i for i in range(1, int(math.log2(most)) + 1)]
    return least(levels, [ratio(task, views, spp) for spp in levels])


def some(views: Sequence[Window]) -> Sequence[Window]:
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


def ratio(task: Denoising, views: Sequence[Window], spp: int) -> float:
    """RelL2 without paths over that with them, geometric mean over scenes, free of the references' noise."""
    return math.exp(score(task, views, spp, paths=False) - score(task, views, spp))
