"""What training does to crops beyond cutting them: fireflies, flips and turns, inputs that are absent."""

from __future__ import annotations

import math

import numpy as np
import torch
from pathfold._core import Layout

from ..networks.batch import Inputs
from ..networks.features import OPTIONAL
from .frames import without_paths
from .preset import Data

COLORED_LOGS = Layout().kind  # the first channels of a descriptor: RGB triples
FIREFLIES, FIREFLY_LOG10 = 8, (1.0, 5.0)  # pixels at most that get one in a crop, and how bright a sample is, exposed


def add_fireflies(samples: Inputs, exposure: float, rng: np.random.Generator) -> None:
    """One sample of a few pixels becomes far too bright, in its colour, as if its path were that improbable.

    So its descriptor stays, and its density falls; a black sample stays black. Stored views are too small to show how
    many fireflies a large picture has.
    """
    radiance, density = samples["samples.radiance"], samples.get("samples.density")
    count, _, height, width = radiance.shape
    for _ in range(rng.integers(1, FIREFLIES + 1)):
        number, y, x = (int(rng.integers(n)) for n in (count, height, width))
        brightest = float(radiance[number, :, y, x].max()) * exposure
        if brightest > 1e-6:
            factor = max(1.0, 10 ** rng.uniform(*FIREFLY_LOG10) / brightest)
            radiance[number, :, y, x] *= factor
            if density is not None and number < len(density):
                density[number, :, y, x] -= math.log(factor)


def augment(inputs: Inputs, truth: Inputs, rng: np.random.Generator, normal_turn: float) -> None:
    """Flips, transpose, colour permutation of all that carries colour, and now and then a rotation of the normals.

    Numbers without height and width stay.
    """
    flip_x, flip_y, transpose = rng.random(3) < 0.5
    colors = torch.from_numpy(rng.permutation(3))
    turn = torch.eye(3)
    turn[0, 0], turn[1, 1] = (-1.0 if flip_x else 1.0), (-1.0 if flip_y else 1.0)
    if transpose:
        turn = turn[[1, 0, 2]]
    if rng.random() < normal_turn:
        turn = torch.from_numpy(np.linalg.qr(rng.standard_normal((3, 3)))[0]).float() @ turn
    for group in (inputs, truth):
        for name, value in group.items():
            if value.dim() < 3:
                continue
            dims = [d for d, on in ((-1, flip_x), (-2, flip_y)) if on]
            value = value.flip(dims) if dims else value
            value = value.transpose(-1, -2) if transpose else value
            if name == "normal":
                value = torch.einsum("ij,jhw->ihw", turn, value)
            elif name == "samples.descriptor":
                triples = torch.arange(COLORED_LOGS).reshape(-1, 3)[:, colors].flatten()
                value = value.index_select(1, torch.cat([triples, torch.arange(COLORED_LOGS, value.shape[1])]))
            elif value.shape[-3] == 3:
                value = value[..., colors, :, :]
            group[name] = value.contiguous()


def drop_inputs(inputs: Inputs, rng: np.random.Generator, data: Data) -> None:
    """Absent optional inputs are zeros with presence 0, as the SDK feeds them; absent samples are one invalid one."""
    everything = rng.random() < data.drop_all
    for name in OPTIONAL:
        if everything or rng.random() < (data.drop_split if name == "split" else data.drop):
            inputs[f"{name}.present"] = torch.tensor(0.0)
    for name in ("albedo", "normal", "depth"):
        inputs[name] = inputs[name] * inputs[f"{name}.present"]
    for name in ("variance", "diffuse.variance", "specular.variance"):
        inputs[name] = inputs[name] * inputs["variance.present"]
    if data.drop_paths > 0.0 and rng.random() < data.drop_paths:
        inputs.update(without_paths(inputs))
