"""Crops of rendered views as training batches: subsets of samples reduced to buffers, augmented, inputs dropped."""

from __future__ import annotations

import io
import math
from collections.abc import Callable, Iterator, Sequence
from contextlib import suppress
from dataclasses import dataclass
from functools import cached_property, partial
from itertools import count
from pathlib import Path
from typing import Any

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor
from torch.utils.data import Dataset, IterableDataset

from . import store
from .clean import cleaned
from .config import Data
from .features import OPTIONAL
from .magnify import MOST, Magnifier, enough, window
from .store import Line, Store

COLORED_LOGS = 24  # descriptor channels 0..23 are RGB triples
FIREFLIES, FIREFLY_LOG10 = 8, (1.0, 5.0)  # pixels at most that get one in a crop, and how bright a sample is, exposed
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


class Stored:
    """The windows of a data set; called with a step, gives those to train on, whatever the step.

    Raises ValueError where the data set has none to train or to validate on.
    """

    def __init__(self, folder: Path) -> None:
        self.store = Store(folder)
        self.lines = self.store.lines
        self.train = self._split("train")

    def held_out(self) -> list[View]:
        """The windows to validate on."""
        return self._split("val")

    def _split(self, name: str) -> list[View]:
        lines = self.store.split(name)
        if not lines:
            raise ValueError(
                f"{self.store.folder} has no view of split '{name}': at random one scene in ten is 'val', the others "
                "'train'; render some 30 scenes with 'pathfold-train render'"
            )
        return [
            View(line, partial(self.store.tensor, line["id"]), n, store.cleaned_path(self.store.folder, line, n))
            for line in lines
            for n in range(len(line["crops"]))
        ]

    def __call__(self, step: int) -> list[View]:
        return self.train


class View:
    """A window of a view that samples were kept of. `tensor` gives the view's tensors by name; what is cut is read.

    `kept` is the file that its cleaned reference is kept in.
    """

    def __init__(self, line: Line, tensor: Callable[[str], Any], number: int, kept: Path | None = None) -> None:
        self.tensor, self.number, self.scene, self.kept = tensor, number, str(line["scene"]), kept
        self.samples: int = line["spp"]
        self.described: int = line.get("described") or self.samples  # data sets kept all paths at first
        self.side = line["crop"]
        self.top, self.left = line["crops"][number]
        self.exposure, self.depth_scale = line["exposure"], line["depth_scale"]

    @cached_property
    def cumulative(self) -> NDArray[np.float64]:
        weight = self.tensor("importance")[self.top : self.top + self.side, self.left : self.left + self.side]
        whole = weight.astype(np.float64).ravel()
        return np.cumsum(whole / whole.sum())

    def halves(self) -> tuple[NDArray[np.float32], NDArray[np.float32]]:
        """The window's reference [3, H, W] twice, of independent samples."""
        y, x = slice(self.top, self.top + self.side), slice(self.left, self.left + self.side)
        a, b = (np.nan_to_num(self.tensor(f"reference.half_{name}.color")[:, y, x], posinf=0.0) for name in "ab")
        return a, b

    @cached_property
    def cleaned(self) -> Tensor:
        """The window's reference [3, H, W] by clean.cleaned; takes a third of a second for 128 x 128 pixels.

        It is kept beside the data set's files, and in memory.
        """
        if self.kept:
            with suppress(OSError, EOFError, ValueError):  # one that is gone or damaged is made again
                kept = np.load(self.kept)
                if kept.shape == (3, self.side, self.side):
                    return torch.from_numpy(kept)
        a, b = self.halves()
        albedo, normal = (
            np.nan_to_num(self.tensor(f"samples.{name}")[self.number].astype(np.float32).mean(0), posinf=0.0)
            for name in ("albedo", "normal")
        )
        result = cleaned(a, b, albedo, normal, self.exposure)
        if self.kept:
            content = io.BytesIO()
            np.save(content, result)
            with suppress(OSError):  # a data set that cannot be written to is cleaned by every run
                store.write_whole(self.kept, content.getvalue())
        return torch.from_numpy(result)

    @cached_property
    def albedo_sum(self) -> Tensor:
        """Sum of all samples' albedo [3, H, W], float32; reads them all, once."""
        stored = self.tensor("samples.albedo")
        total = torch.zeros(3, self.side, self.side)
        for sample in range(self.samples):
            total += torch.nan_to_num(torch.from_numpy(stored[self.number, sample]), 0.0, 0.0, 0.0)
        return total

    def corner(self, size: int, rng: np.random.Generator) -> tuple[int, int]:
        """Top left of a crop whose centre is drawn by importance, moved inside the window."""
        pixel = int(np.searchsorted(self.cumulative, rng.random()))
        y, x = divmod(min(pixel, self.side**2 - 1), self.side)
        most = max(0, self.side - size)
        return int(np.clip(y - size // 2, 0, most)), int(np.clip(x - size // 2, 0, most))

    def subset(self, count: int, paths: int, rng: np.random.Generator) -> NDArray[np.intp]:
        """Numbers of `count` samples, any subset; paths are stored of the first `paths`, or of as many as can be."""
        head = rng.choice(self.described, min(count, paths, self.described), replace=False)
        others = np.setdiff1d(np.arange(self.samples), head)
        return np.concatenate([head, rng.choice(others, count - len(head), replace=False)])

    def crop(self, y: int, x: int, size: int, numbers: NDArray[np.intp], paths: int) -> tuple[Inputs, Inputs]:
        """Samples by number and references of the crop: tensors S x C x h x w and C x h x w, float32.

        Path descriptors are read of the first `paths` of `numbers`, or of as many of these as they are stored of, and
        stay float16. Non-finite samples count as black.
        """
        inside = slice(y, min(y + size, self.side)), slice(x, min(x + size, self.side))
        whole = [slice(s.start + o, s.stop + o) for s, o in zip(inside, (self.top, self.left), strict=True)]
        described = numbers[: np.cumprod(numbers < self.described).sum()][:paths]

        def read(name: str, chosen: NDArray[np.intp]) -> Tensor:
            stored = self.tensor(name)  # indexed by one number at a time: safetensors takes no lists
            values = np.stack([stored[self.number, int(sample), :, *inside] for sample in chosen])
            return torch.nan_to_num(torch.from_numpy(values), 0.0, 0.0, 0.0)

        inputs = {name: read(name, numbers).float() for name in SAMPLE_NAMES}
        if len(described):
            inputs["samples.descriptor"] = read("samples.descriptor", described)
            inputs["samples.density"] = read("samples.density", described)
        reference = {
            name.removeprefix("reference."): torch.nan_to_num(
                torch.from_numpy(self.tensor(name)[:, *whole]), 0.0, 0.0, 0.0
            )
            for name in REFERENCE_NAMES
        }
        return inputs, reference

    def albedo(self, y: int, x: int, own: Tensor) -> Tensor:
        """Mean albedo [3, h, w] of a crop over all samples but its `own`, S x 3 x h x w; NaN if these are over half."""
        if 2 * len(own) > self.samples:
            return torch.full(own.shape[1:], math.nan)
        others = self.albedo_sum[:, y : y + own.shape[2], x : x + own.shape[3]] - own.sum(0)
        return others.clamp(min=0.0) / (self.samples - len(own))


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
        # torch's own var is several times as slow along the first dimension
        variance = (value - out[name]).square().sum(0) / (max(1, n - 1) * n)
        out["variance" if name == "color" else f"{name}.variance"] = variance
    for name in ("diffuse.albedo", "albedo", "normal", "depth"):
        out[name] = samples[f"samples.{name}"].mean(0)
    return out


class Crops(IterableDataset):
    """An endless stream of training Batches, each mixed from all views; the same seed gives the same stream.

    `views` gives the views to draw from at a step, `paths` is of how many samples of a pixel descriptors are read at
    most, `albedo` whether a target for a cleaned albedo is. Of `processes` that train together each draws its share of
    every batch; the shares together are what one process would draw.
    """

    def __init__(
        self,
        views: Callable[[int], Sequence[View]],
        data: Data,
        seed: int,
        paths: int,
        albedo: bool = False,
        skip: int = 0,
        process: int = 0,
        processes: int = 1,
    ) -> None:
        super().__init__()
        if data.batch % processes:
            raise ValueError(f"a batch of {data.batch} cannot be shared by {processes} processes; make it a multiple")
        self.views, self.data, self.seed, self.paths, self.albedo, self.skip = views, data, seed, paths, albedo, skip
        share = data.batch // processes
        self.items = range(process * share, (process + 1) * share)

    def __iter__(self) -> Iterator[Batch]:
        for step in count(self.skip):
            views = self.views(step)
            # a batch depends on seed and step alone: exact resume, and the same whoever draws its items
            rngs = [np.random.default_rng([self.seed, step, item]) for item in range(self.data.batch)]
            drawn = [views[int(rng.integers(len(views)))] for rng in rngs]
            size = min(self.data.crop, *(view.side for view in drawn))
            yield collate([self.draw(drawn[item], size, rngs[item]) for item in self.items])

    def draw(self, view: View, size: int, rng: np.random.Generator) -> tuple[Inputs, Inputs]:
        magnify = self.data.magnified > 0.0 and rng.random() < self.data.magnified
        samples, reference = self.enlarged(view, size, rng) if magnify else self.as_stored(view, size, rng)
        if self.data.fireflies > 0.0 and rng.random() < self.data.fireflies:
            add_fireflies(samples, view.exposure, rng)
        inputs = frame_inputs(samples, view.exposure, view.depth_scale)
        augment(inputs, reference, rng, self.data.normal_turn)  # of means, not of each sample: it is the same
        inputs["exposure"] = inputs["exposure"] * 2 ** rng.uniform(-1.0, 1.0)
        drop_inputs(inputs, rng, self.data)
        return inputs, reference

    def as_stored(self, view: View, size: int, rng: np.random.Generator) -> tuple[Inputs, Inputs]:
        """Any of the view's samples, a stored pixel each."""
        numbers = view.subset(self.draw_number(view.samples, rng), self.paths, rng)
        y, x = view.corner(size, rng)
        samples, reference = view.crop(y, x, size, numbers, self.paths)
        return samples, reference | self.targets(view, y, x, samples["samples.albedo"])

    def enlarged(self, view: View, size: int, rng: np.random.Generator) -> tuple[Inputs, Inputs]:
        """Magnified by magnify.py; of fewer samples, as more pixels share those of a stored one."""
        factor = 2 ** rng.uniform(0.0, math.log2(MOST))
        side = min(window(size, factor), view.side)
        y, x = view.corner(side, rng)
        number = self.draw_number(enough(view.samples, factor), rng)
        paths = min(number, self.paths, enough(view.described, factor))
        magnifier = Magnifier(size, side, factor, number, paths, view.samples, view.described, rng)
        numbers = view.subset(int(magnifier.slots.max()) + 1, view.described, rng)
        described = int(magnifier.slots[:paths].max(initial=-1)) + 1
        stored, reference = view.crop(y, x, side, numbers, described)
        samples = {n: magnifier.samples(v, paths if n in PATH_NAMES else number) for n, v in stored.items()}
        reference |= self.targets(view, y, x, stored["samples.albedo"])
        return samples, {name: magnifier.image(image) for name, image in reference.items()}

    def draw_number(self, most: int, rng: np.random.Generator) -> int:
        """Samples of a pixel, at most `most`, log-uniform."""
        low, high = (math.log2(min(number, most)) for number in (self.data.spp_min, self.data.spp_max))
        return round(2 ** rng.uniform(low, high))

    def targets(self, view: View, y: int, x: int, albedo: Tensor) -> Inputs:
        """What there is beside the reference to learn from; `albedo` is of all samples that are given."""
        height, width = albedo.shape[2:]
        targets = {"albedo": view.albedo(y, x, albedo)} if self.albedo else {}
        return targets | ({"cleaned": view.cleaned[:, y : y + height, x : x + width]} if self.data.cleaned else {})


class ValidationViews(Dataset):
    """Whole held-out windows, a Batch each: `spp` samples or all there are, all inputs; `paths` as of Crops.

    References have `half_a` and `half_b` too.
    """

    def __init__(self, views: Sequence[View], paths: int, spp: int = 8) -> None:
        self.views, self.paths, self.spp = views, paths, spp

    def __len__(self) -> int:
        return len(self.views)

    def __getitem__(self, index: int) -> Batch:
        view = self.views[index]
        samples, reference = view.crop(0, 0, view.side, np.arange(min(self.spp, view.samples)), self.paths)
        reference |= {f"half_{name}": torch.from_numpy(h) for name, h in zip("ab", view.halves(), strict=True)}
        return collate([(frame_inputs(samples, view.exposure, view.depth_scale), reference)])


def frame_inputs(samples: Inputs, exposure: float, depth_scale: float) -> Inputs:
    """Everything a frame offers the networks, all optional inputs present."""
    n = samples["samples.radiance"].shape[0]
    inputs = reduce_samples(samples)
    inputs |= {name: samples[name].float() for name in PATH_NAMES if name in samples}
    inputs["samples.valid"] = torch.ones_like(samples.get("samples.density", samples["samples.depth"]))
    inputs["exposure"], inputs["depth_scale"] = torch.tensor(exposure), torch.tensor(depth_scale)
    for name in OPTIONAL:
        inputs[f"{name}.present"] = torch.tensor(0.0 if name == "variance" and n < 2 else 1.0)
    inputs["paths.present"] = torch.tensor(1.0 if "samples.descriptor" in samples else 0.0)
    return inputs


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


def augment(inputs: Inputs, reference: Inputs, rng: np.random.Generator, normal_turn: float) -> None:
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
    for group in (inputs, reference):
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


def without_paths(inputs: Inputs) -> Inputs:
    """What the networks see of one frame without path descriptors: a sample that is not valid, and presence 0."""
    absent = {name: torch.zeros_like(inputs[name][:1]) for name in (*PATH_NAMES, "samples.valid") if name in inputs}
    return inputs | absent | {"paths.present": torch.zeros_like(inputs["paths.present"])}


def collate(frames: list[tuple[Inputs, Inputs]]) -> Batch:
    counts = [inputs["samples.valid"].shape[0] for inputs, _ in frames]
    names = frames[0][0]
    joined = {n: (torch.cat if n.startswith("samples.") else torch.stack)([i[n] for i, _ in frames]) for n in names}
    return Batch(joined, {n: torch.stack([r[n] for _, r in frames]) for n in frames[0][1]}, counts)
