"""Scenes made in code from one seed, and where their cameras may stand."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from . import outdoor, rooms, tabletop
from .cameras import Propose
from .stage import Stage

GENERATOR = 3  # to be raised when a seed gives another scene: samples must not be rendered to an older reference
KINDS = {  # who builds it, and its share of the scenes
    "room": (rooms.room, 0.5),
    "hall": (rooms.hall, 0.08),
    "still-life": (tabletop.still_life, 0.1),
    "close-up": (tabletop.close_up, 0.07),
    "arrangement": (tabletop.arrangement, 0.09),
    "garden": (outdoor.garden, 0.06),
    "street": (outdoor.street, 0.05),
    "land": (outdoor.land, 0.05),
}


class Built(NamedTuple):
    """A stage to load, its kind, the path depth that suits it, and where cameras may stand."""

    stage: Stage
    kind: str
    max_depth: int
    propose: Propose


def build(seed: int, kind: str | None = None) -> Built:
    """The same seed always gives the same scene; a Mitsuba variant must be set."""
    rng = np.random.default_rng(seed)
    kind = kind or str(rng.choice(list(KINDS), p=[share for _, share in KINDS.values()]))
    stage = Stage(rng)
    sharp = 0.4 if kind == "close-up" else 0.7
    blur = float(rng.choice([0, rng.uniform(0.005, 0.03)], p=[sharp, 1 - sharp]))
    stage.camera(blur)
    propose = KINDS[kind][0](stage, blur)
    return Built(stage, kind, int(rng.choice([6, 6, 7, 8])), propose)
