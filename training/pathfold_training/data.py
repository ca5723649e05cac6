"""Crops of stored views as training batches: subsets of samples reduced to buffers, augmented, inputs dropped."""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import torch
from torch import Tensor
from torch.utils.data import Dataset, IterableDataset

from .config import Data
from .features import OPTIONAL
from .store import Line, Store

COLORED_LOGS = 24  # descriptor channels 0..23 are RGB triples
SAMPLE_NAMES = tuple(f"samples.{n}" for n in ("radiance", "diffuse", "diffuse.albedo", "albedo", "normal", "depth"))
PATH_NAMES = ("samples.descriptor", "samples.density")
REFERENCE_NAMES = ("reference.color", "reference.diffuse", "reference.diffuse.albedo")
Inputs = dict[str, Tensor]


@dataclass
class Batch:
    """Buffers B x C x H x W (samples N x C x H x W, `counts` per image), scalars [B], references B x 3 x H x W."""

    inputs: Inputs
    reference: Inputs
    counts: list[int]

    def to(self, device: torch.device) -> Batch:
        move = {k: v.to(device) for k, v in self.inputs.items()}
        return Batch(move, {k: v.to(device) for k, v in self.reference.items()}, self.counts)


def open_split(folder: Path, split: str) -> tuple[Store, list[Line]]:
    """The data set and its views of one split. Raises ValueError where it has none."""
    store = Store(folder)
    lines = store.split(split)
    if not lines:
        raise ValueError(f"{folder} has no view of split '{split}'; render more with 'pathfold-train render'")
    return store, lines


class View:
    """One stored view; `crop` reads only what it needs."""

    def __init__(self, store: Store, line: Line) -> None:
        self.store, self.id = store, line["id"]
        self.samples, self.height, self.width = line["spp"], line["height"], line["width"]
        self.exposure = store.exposure(self.id)
        whole = store.view(self.id, ["importance"])["importance"].astype(np.float64).ravel()
        self.cumulative = np.cumsum(whole / whole.sum())
        depth = store.crop(self.id, 0, 0, self.height, self.width, ["samples.depth"], slice(0, 1))["samples.depth"]
        depth = depth[np.isfinite(depth) & (depth > 0)]
        # the SDK's depth_scale: 1 / geometric mean of the depths seen
        self.depth_scale = float(np.exp(-np.log(depth).mean())) if depth.size else 1.0

    def corner(self, size: int, rng: np.random.Generator) -> tuple[int, int]:
        """Top left of a crop whose centre is drawn by importance, moved inside the view."""
        pixel = int(np.searchsorted(self.cumulative, rng.random()))
        y, x = divmod(min(pixel, self.height * self.width - 1), self.width)
        return (
            int(np.clip(y - size // 2, 0, max(0, self.height - size))),
            int(np.clip(x - size // 2, 0, max(0, self.width - size))),
        )

    def crop(self, y: int, x: int, size: int, first: int, count: int, paths: bool) -> tuple[Inputs, Inputs]:
        """Samples [first, first + count) and references of the window: tensors float32, S x C x h x w and C x h x w.

        Path descriptors are read only where `paths` asks for them. Non-finite samples count as black.
        """
        names = [*SAMPLE_NAMES, *(PATH_NAMES if paths else ()), *REFERENCE_NAMES]
        arrays = self.store.crop(self.id, y, x, size, size, names, slice(first, first + count))
        tensors = {name: torch.nan_to_num(torch.from_numpy(a).float(), 0.0, 0.0, 0.0) for name, a in arrays.items()}
        reference = {name.removeprefix("reference."): tensors.pop(name) for name in REFERENCE_NAMES}
        return tensors, reference


def reduce_samples(samples: Inputs) -> Inputs:
    """Per-pixel buffers of a block of samples: means, and the unbiased variance of the radiance means."""
    n = samples["samples.radiance"].shape[0]
    radiance, diffuse = samples["samples.radiance"], samples["samples.diffuse"]
    out = {}
    for name, value in (
        ("color", radiance),
        ("diffuse", diffuse),
        ("specular", (radiance - diffuse).clamp(min=0.0)),
    ):
        out[name] = value.mean(0)
        variance = value.var(0, unbiased=True) / n if n > 1 else torch.zeros_like(out[name])
        out["variance" if name == "color" else f"{name}.variance"] = variance
    for name in ("diffuse.albedo", "albedo", "normal", "depth"):
        out[name] = samples[f"samples.{name}"].mean(0)
    return out


class Crops(IterableDataset):
    """An endless stream of Batches. `split` 'train' draws at random; the same seed gives the same stream."""

    def __init__(self, folder: Path, data: Data, seed: int, paths: bool, skip: int = 0) -> None:
        super().__init__()
        self.data, self.seed, self.paths, self.skip = data, seed, paths, skip
        store, lines = open_split(folder, "train")
        self.views = [View(store, line) for line in lines]

    def __iter__(self) -> Iterator[Batch]:
        step = self.skip
        while True:
            rng = np.random.default_rng([self.seed, step])  # a step's batch depends on nothing before it: exact resume
            yield collate([self.draw(rng) for _ in range(self.data.batch)])
            step += 1

    def draw(self, rng: np.random.Generator) -> tuple[Inputs, Inputs]:
        view = self.views[int(rng.integers(len(self.views)))]
        low, high = math.log2(self.data.spp_min), math.log2(min(self.data.spp_max, view.samples))
        count = round(2 ** rng.uniform(low, high))
        first = int(rng.integers(view.samples - count + 1))
        samples, reference = view.crop(*view.corner(self.data.crop, rng), self.data.crop, first, count, self.paths)
        augment(samples, reference, rng, self.data.normal_turn)
        inputs = frame_inputs(samples, view.exposure * 2 ** rng.uniform(-1.0, 1.0), view.depth_scale)
        drop_inputs(inputs, rng, self.data)
        return inputs, reference


class ValidationViews(Dataset):
    """Whole held-out views at a fixed number of samples, all inputs present, one Batch each."""

    def __init__(self, folder: Path, paths: bool, spp: int = 8) -> None:
        store, lines = open_split(folder, "val")
        self.views = [View(store, line) for line in lines]
        self.paths, self.spp = paths, spp

    def __len__(self) -> int:
        return len(self.views)

    def __getitem__(self, index: int) -> Batch:
        view = self.views[index]
        samples, reference = view.crop(0, 0, max(view.height, view.width), 0, self.spp, self.paths)
        return collate([(frame_inputs(samples, view.exposure, view.depth_scale), reference)])


def frame_inputs(samples: Inputs, exposure: float, depth_scale: float) -> Inputs:
    """Everything a frame offers the networks, all optional inputs present."""
    n = samples["samples.radiance"].shape[0]
    inputs = reduce_samples(samples)
    inputs |= {name: samples[name] for name in PATH_NAMES if name in samples}
    inputs["samples.valid"] = torch.ones_like(samples["samples.depth"])
    inputs["exposure"], inputs["depth_scale"] = torch.tensor(exposure), torch.tensor(depth_scale)
    for name in OPTIONAL:
        inputs[f"{name}.present"] = torch.tensor(0.0 if name == "variance" and n < 2 else 1.0)
    return inputs


def augment(samples: Inputs, reference: Inputs, rng: np.random.Generator, normal_turn: float) -> None:
    """Flips, transpose, colour permutation of all that carries colour, and now and then a rotation of the normals."""
    flip_x, flip_y, transpose = rng.random(3) < 0.5
    colors = torch.from_numpy(rng.permutation(3))
    turn = torch.eye(3)
    turn[0, 0], turn[1, 1] = (-1.0 if flip_x else 1.0), (-1.0 if flip_y else 1.0)
    if transpose:
        turn = turn[[1, 0, 2]]
    if rng.random() < normal_turn:
        turn = torch.from_numpy(np.linalg.qr(rng.standard_normal((3, 3)))[0]).float() @ turn
    for group in (samples, reference):
        for name, value in group.items():
            dims = [d for d, on in ((-1, flip_x), (-2, flip_y)) if on]
            value = value.flip(dims) if dims else value
            value = value.transpose(-1, -2) if transpose else value
            if name == "samples.normal":
                value = torch.einsum("ij,sjhw->sihw", turn, value)
            elif name == "samples.descriptor":
                triples = value[:, :COLORED_LOGS].unflatten(1, (-1, 3))[:, :, colors].flatten(1, 2)
                value = torch.cat([triples, value[:, COLORED_LOGS:]], 1)
            elif value.shape[-3] == 3:
                value = value[..., colors, :, :]
            group[name] = value.contiguous()


def drop_inputs(inputs: Inputs, rng: np.random.Generator, data: Data) -> None:
    """Absent optional inputs are zeros with presence 0, as the SDK feeds them. Samples are never dropped."""
    everything = rng.random() < data.drop_all
    for name in OPTIONAL:
        if everything or rng.random() < (data.drop_split if name == "split" else data.drop):
            inputs[f"{name}.present"] = torch.tensor(0.0)
    for name in ("albedo", "normal", "depth"):
        inputs[name] = inputs[name] * inputs[f"{name}.present"]
    for name in ("variance", "diffuse.variance", "specular.variance"):
        inputs[name] = inputs[name] * inputs["variance.present"]


def collate(frames: list[tuple[Inputs, Inputs]]) -> Batch:
    counts = [inputs["samples.valid"].shape[0] for inputs, _ in frames]
    names = frames[0][0]
    joined = {n: (torch.cat if n.startswith("samples.") else torch.stack)([i[n] for i, _ in frames]) for n in names}
    return Batch(joined, {n: torch.stack([r[n] for _, r in frames]) for n in frames[0][1]}, counts)
