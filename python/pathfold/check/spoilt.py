"""Guides that are wrong: what holds for any model, and what only weights that have learnt it bear."""

from __future__ import annotations

import math
from typing import Any

import numpy as np
from numpy.typing import NDArray

from pathfold.check import cases
from pathfold.check.cases import Buffers, Draw
from pathfold.check.outcome import Row
from pathfold.check.properties import Property, Subject

SIZE = 96  # of the frames
ALBEDOS = ("albedo", "diffuse.albedo")
SHAPED = (*ALBEDOS, "normal", "depth")


def room(manifest: dict[str, Any]) -> tuple[Buffers, NDArray[np.float64]]:
    """A noisy frame of tiles under a soft light, with guides without noise; and what it should be, H x W x 3.

    With samples, that tell nothing of it, for a model that requires some.
    """
    draw = Draw(31)
    y, x = np.mgrid[:SIZE, :SIZE]
    tile = (x // 12) + 8 * (y // 12)
    albedo = draw.between(0.1, 0.9, 64, 3)[tile]
    light = (0.5 + x / SIZE + y / SIZE)[..., None]
    truth = albedo * light
    noise = draw.uniform(SIZE, SIZE, 1) / (1.05 - draw.uniform(SIZE, SIZE, 1))
    noise = noise / noise.mean()
    turned = draw.between(-0.5, 0.5, 64, 2)[tile]
    normal = np.concatenate([turned, np.sqrt(1 - (turned**2).sum(-1, keepdims=True))], -1)
    made = {"color": truth * noise, "diffuse": truth * noise, "specular": np.zeros_like(truth)}
    made |= {"albedo": albedo, "diffuse.albedo": albedo, "normal": normal, "depth": (2.0 + tile % 5)[..., None]}
    samples = cases.frame(SIZE, SIZE, 2) if "samples.descriptor" in manifest["requires"] else {}
    made |= {name: values for name, values in samples.items() if name.startswith("samples.")}
    return {name: values.astype(np.float32) for name, values in made.items()}, truth


def quotient(subject: Subject, frame: Buffers, truth: NDArray[np.float64], spoilt: Buffers) -> float:
    """RelL2 with spoilt guides over that without them."""

    def error(buffers: Buffers) -> float:
        image = subject.default.run_buffers(buffers).color
        return float(np.mean((image - truth) ** 2 / (truth**2 + 0.01)))

    return error(frame | spoilt) / error({name: values for name, values in frame.items() if name not in spoilt})


def silent_guides(subject: Subject, row: Row) -> None:
    frame, _ = room(subject.manifest)
    for names in (("albedo", "diffuse.albedo"), ("normal",), ("depth",)):
        right = subject.default.run_buffers({n: v for n, v in frame.items() if n not in names}).color
        for value in (0.0, 0.5, 1.0):
            spoilt = {name: np.full_like(frame[name], value) for name in names}
            row.compare(subject.default.run_buffers(frame | spoilt).color, right)


def bright_albedo(subject: Subject, row: Row) -> None:
    frame, _ = room(subject.manifest)
    spoilt = {name: frame[name].copy() for name in ALBEDOS}
    for values in spoilt.values():
        values[30:60, 30:60] *= 96
    cut = {name: np.minimum(values, 1) for name, values in spoilt.items()}
    right = subject.default.run_buffers(frame | cut).color
    row.compare(subject.default.run_buffers(frame | spoilt).color, right)


def unknown_albedo(subject: Subject, row: Row) -> None:
    frame, truth = room(subject.manifest)
    bad = Draw(32).uniform(SIZE, SIZE) < 0.1
    spoilt = {name: np.where(bad[..., None], np.float32(math.nan), frame[name]) for name in ALBEDOS}
    row.error = quotient(subject, frame, truth, spoilt)


def unrelated_albedo(subject: Subject, row: Row) -> None:
    frame, truth = room(subject.manifest)
    noise = frame["color"] / truth
    truth = np.full_like(truth, truth.mean())
    lit = (noise * truth).astype(np.float32)
    frame |= {"color": lit, "diffuse": lit, "normal": np.zeros_like(lit), "depth": np.zeros_like(frame["depth"])}
    spoilt = {name: Draw(33).uniform(SIZE, SIZE, 3).astype(np.float32) for name in ALBEDOS}
    row.error, row.allowed = quotient(subject, frame, truth, spoilt), None


def shifted_guides(subject: Subject, row: Row) -> None:
    frame, truth = room(subject.manifest)
    spoilt = {name: np.roll(frame[name], (2, 2), (0, 1)) for name in SHAPED}
    row.error, row.allowed = quotient(subject, frame, truth, spoilt), None


def noisy_guides(subject: Subject, row: Row) -> None:
    frame, truth = room(subject.manifest)
    spoilt = {name: frame[name] * Draw(34).between(0.5, 1.5, SIZE, SIZE, 1).astype(np.float32) for name in SHAPED}
    spoilt |= {name: np.clip(spoilt[name], 0, 1) for name in ALBEDOS}
    row.error, row.allowed = quotient(subject, frame, truth, spoilt), None


SPOILT = [
    Property(
        "silent guides",
        "guides that are the same everywhere: as without them, to the bit",
        silent_guides,
        None,
        "albedo",
    ),
    Property(
        "albedo beyond 1", "an albedo of up to 96: as one that was cut to 1, to the bit", bright_albedo, None, "albedo"
    ),
    Property(
        "unknown albedo",
        "NaN in a tenth of the albedo: its RelL2 over that without",
        unknown_albedo,
        "guides",
        "albedo",
    ),
    Property(
        "unrelated albedo",
        "even light on a random albedo: its RelL2 over that without, to be learnt",
        unrelated_albedo,
        None,
        "albedo",
    ),
    Property(
        "shifted guides",
        "guides two pixels off: their RelL2 over that without, to be learnt",
        shifted_guides,
        None,
        "albedo",
    ),
    Property(
        "noisy guides",
        "guides of few samples: their RelL2 over that without, to be learnt",
        noisy_guides,
        None,
        "albedo",
    ),
]
