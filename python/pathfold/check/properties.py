"""What must hold for any model, whatever its weights: no reference is needed."""

from __future__ import annotations

import math
import os
from collections.abc import Callable
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from pathfold import _core
from pathfold.check import cases, demodulation
from pathfold.check.cases import RADIANCE, Buffers, Draw
from pathfold.check.measure import tolerance
from pathfold.check.outcome import Row
from pathfold.check.prepare import prepare
from pathfold.denoiser import Denoiser

THICKNESS = 12  # pixels across the long frames that reach beyond a receptive field


@dataclass(frozen=True)
class Subject:
    """The model that is checked."""

    folder: Path
    provider: str = "cpu"
    precision: str = "fp32"

    def denoiser(self, **settings: Any) -> Denoiser:
        return Denoiser(self.folder, **{"provider": self.provider, "precision": self.precision} | settings)

    @cached_property
    def default(self) -> Denoiser:
        return self.denoiser()

    @cached_property
    def exact(self) -> Denoiser:
        return self.denoiser(precision="fp32")

    @cached_property
    def manifest(self) -> dict[str, Any]:
        return self.default.model.manifest


Check = Callable[[Subject, Row], None]


@dataclass(frozen=True)
class Property:
    """`check` runs the model and fills in the row."""

    name: str
    stresses: str
    check: Check
    tolerance: str | None = None  # a key of tolerances.toml
    needs: str = "color"  # a buffer that a model must read for the property to say anything

    def row(self, subject: Subject) -> Row:
        allowed = tolerance(self.tolerance, subject.precision) if self.tolerance else 0.0
        row = Row(self.name, self.stresses, allowed=allowed)
        self.check(subject, row)
        return row.judged()


PROPERTIES: list[Property] = []


def holds(name: str, stresses: str, tolerance: str | None = None, needs: str = "color") -> Callable[[Check], Check]:
    """Adds a property to PROPERTIES."""

    def add(check: Check) -> Check:
        PROPERTIES.append(Property(name, stresses, check, tolerance, needs))
        return check

    return add


@holds("scale equivariance", "radiance 1e-6 to 1e6 times as bright", "scale")
def scale_equivariance(subject: Subject, row: Row) -> None:
    base = cases.frame()
    right = subject.default.run_buffers(base).color.astype(np.float64)
    for scale in (1e-6, 1e-3, 1e3, 1e6):
        row.compare(subject.default.run_buffers(cases.scaled(base, scale)).color, right * np.float32(scale))


@holds("constants", "frames of 1e-30, 0.5 and 1e30 with damaged pixels come out as they are", "constant")
def constants(subject: Subject, row: Row) -> None:
    for value in (1e-30, 0.5, 1e30):
        frame = cases.frame()
        for name in ("diffuse", "specular"):
            frame[name][:] = value
        frame["diffuse.albedo"][:] = frame["albedo"][:] = 0.3  # constant before remodulation too
        frame = cases.with_color(frame)
        for name in RADIANCE:
            frame[name][4:6, 7] = math.nan
        right = np.full(frame["color"].shape, np.float32(value) + np.float32(value))
        for buffers in (frame, cases.unsplit(frame)):
            row.compare(subject.default.run_buffers(buffers).color, right)


@holds("bad pixel", "NaN in every buffer changes nothing beyond the receptive field, to the bit")
def bad_pixel(subject: Subject, row: Row) -> None:
    reach, at = subject.manifest["tile"]["overlap"] + subject.manifest["reconstruction"].get("size", 1) // 2, 2
    reach += demodulation.RADIUS
    clean = cases.frame(THICKNESS, at + reach + 1 + 16)
    clean["depth"][5, at] = 0  # a damaged depth counts as a miss and leaves the depth scale alone
    for buffers in (clean, transposed(clean)):
        spoilt = {name: values.copy() for name, values in buffers.items()}
        y, x = (5, at) if buffers is clean else (at, 5)
        for values in spoilt.values():
            values[..., y, x, :] = math.nan
        before, after = (subject.default.run_buffers(given, exposure=0.5).color for given in (buffers, spoilt))
        row.finite = row.finite and bool(np.isfinite(after).all())
        outside = np.s_[:, at + reach + 1 :] if buffers is clean else np.s_[at + reach + 1 :, :]
        row.compare(after[outside], before[outside])


@holds("tiles", "tiled equals whole", "tiles")
def tiles(subject: Subject, row: Row) -> None:
    alignment, reach = subject.manifest["tile"]["alignment"], subject.manifest["tile"]["overlap"]
    side = -(-32 // alignment) * alignment
    long = cases.frame(THICKNESS, 2 * reach + 3 * side + 5, 2)
    whole, tiled = subject.default, subject.denoiser(tile=side)
    for buffers in (long, transposed(long)):
        result = tiled.run_buffers(buffers)
        row.compare(result.color, whole.run_buffers(buffers).color)
        if result.report["tiles"] < 3:
            row.fail("the frame was not tiled")


@holds("threads", "1 to n threads make no difference", "threads")
def threads(subject: Subject, row: Row) -> None:
    frame = cases.frame(40, 50)
    right = subject.denoiser(threads=1).run_buffers(frame).color
    cores = os.cpu_count() or 1
    for count in sorted({min(2, cores), min(3, cores), cores}):
        row.compare(subject.denoiser(threads=count).run_buffers(frame).color, right)


@holds("sample order", "samples in another order, others for those not looked at", "sample_order", "samples.descriptor")
def sample_order(subject: Subject, row: Row) -> None:
    frame = cases.frame(samples=6)
    right = subject.default.run_buffers(frame).color
    seen = min(6, subject.manifest["samples_per_pixel"].get("embedded", 6))
    order = np.zeros(frame["samples.density"].shape, np.int64)
    order[:seen] = Draw(21).words(seen, *order.shape[1:]).argsort(0)  # each pixel's its own
    blocks = {name: values for name, values in frame.items() if name.startswith("samples.")}
    turned = {name: np.take_along_axis(values, order, 0) for name, values in blocks.items()}
    row.compare(subject.default.run_buffers(frame | turned).color, right)


@holds("saturated logits", "the gather on logits to +-1e4 with masked pixels, against float64", "gather")
def saturated_logits(subject: Subject, row: Row) -> None:
    size, draw = int(subject.manifest["reconstruction"].get("size", 5)), Draw(22)
    image = (draw.uniform(15, 17, 3) / (1.0001 - draw.uniform(15, 17, 3))).astype(np.float32)
    image[draw.uniform(15, 17) < 0.1] = math.nan
    for spread in (1.0, 20.0, 1e4):
        logits = draw.between(-spread, spread, size * size, 15, 17).astype(np.float32)
        row.compare(_core.gather(image, logits), gather(image, logits, size), float(np.nanmax(image)))


@holds("any bits", "random bits in every buffer: finite, within the window")
def any_bits(subject: Subject, row: Row) -> None:
    row.allowed = None
    for seed in range(23, 27):
        draw, frame = Draw(seed), cases.frame()
        for name, values in frame.items():
            words = draw.words(*values.shape) >> np.uint64(32)
            frame[name] = words.astype(np.uint32).view(np.float32)
        for buffers in (frame, cases.unsplit(frame)):
            result = subject.default.run_buffers(buffers)
            row.inspect(result, prepare(buffers, subject.manifest), subject.manifest)


def transposed(buffers: Buffers) -> Buffers:
    """Rows for columns."""
    return {name: np.ascontiguousarray(np.swapaxes(values, -3, -2)) for name, values in buffers.items()}


def gather(image: NDArray[np.float32], logits: NDArray[np.float32], size: int) -> NDArray[np.float64]:
    """The gather in float64: softmax over the valid taps of each pixel; image H x W x C, logits K*K x H x W."""
    radius, (height, width, _) = size // 2, image.shape
    pad = ((radius, radius), (radius, radius), (0, 0))
    padded = np.pad(image.astype(np.float64), pad, constant_values=math.nan)
    taps = np.lib.stride_tricks.sliding_window_view(padded, (size, size), (0, 1))  # H W C K K
    taps = taps.reshape(height, width, -1, size * size)
    valid = np.isfinite(taps).all(2, keepdims=True)
    weights = np.where(valid, logits.astype(np.float64).transpose(1, 2, 0)[:, :, None, :], -math.inf)
    peak = weights.max(-1, keepdims=True)
    weights = np.exp(weights - np.where(np.isfinite(peak), peak, 0))
    total = np.maximum(weights.sum(-1), np.finfo(np.float64).tiny)
    return np.asarray((weights * np.where(valid, taps, 0)).sum(-1) / total)
