"""Crops of rendered views as training batches: subsets of samples reduced to buffers, augmented, inputs dropped."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator, Sequence
from itertools import count

import numpy as np
from torch import Tensor
from torch.utils.data import IterableDataset

from ..networks.batch import Batch, Inputs
from .augment import add_fireflies, augment, drop_inputs
from .frames import PATH_NAMES, collate, frame_inputs
from .magnify import MOST, Magnifier, enough, stored_side
from .preset import Data
from .views import Window


class Crops(IterableDataset):
    """An endless stream of training Batches, each mixed from all views; the same seed gives the same stream.

    `views` gives the views to draw from at a step, `paths` is of how many samples of a pixel descriptors are read at
    most, `albedo` whether a target for a cleaned albedo is. Of `processes` that train together each draws its share of
    every batch; the shares together are what one process would draw.
    """

    def __init__(
        self,
        views: Callable[[int], Sequence[Window]],
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
            size = min(self.data.crop, *(window.side for window in drawn))
            yield collate([self.draw(drawn[item], size, rngs[item]) for item in self.items])

    def draw(self, window: Window, size: int, rng: np.random.Generator) -> tuple[Inputs, Inputs]:
        magnify = self.data.magnified > 0.0 and rng.random() < self.data.magnified
        samples, truth = self.enlarged(window, size, rng) if magnify else self.as_stored(window, size, rng)
        if self.data.fireflies > 0.0 and rng.random() < self.data.fireflies:
            add_fireflies(samples, window.exposure, rng)
        inputs = frame_inputs(samples, window.exposure, window.depth_scale)
        augment(inputs, truth, rng, self.data.normal_turn)  # of means, not of each sample: it is the same
        inputs["exposure"] = inputs["exposure"] * 2 ** rng.uniform(-1.0, 1.0)
        drop_inputs(inputs, rng, self.data)
        return inputs, truth

    def as_stored(self, window: Window, size: int, rng: np.random.Generator) -> tuple[Inputs, Inputs]:
        """Any of the window's samples, a stored pixel each."""
        numbers = window.subset(self.draw_number(window.samples, rng), self.paths, rng)
        y, x = window.corner(size, rng)
        samples, truth = window.crop(y, x, size, numbers, self.paths)
        return samples, truth | self.targets(window, y, x, samples["samples.albedo"])

    def enlarged(self, window: Window, size: int, rng: np.random.Generator) -> tuple[Inputs, Inputs]:
        """Magnified by magnify.py; of fewer samples, as more pixels share those of a stored one."""
        factor = 2 ** rng.uniform(0.0, math.log2(MOST))
        side = min(stored_side(size, factor), window.side)
        y, x = window.corner(side, rng)
        number = self.draw_number(enough(window.samples, factor), rng)
        paths = min(number, self.paths, enough(window.described, factor))
        magnifier = Magnifier(size, side, factor, number, paths, window.samples, window.described, rng)
        numbers = window.subset(int(magnifier.slots.max()) + 1, window.described, rng)
        described = int(magnifier.slots[:paths].max(initial=-1)) + 1
        stored, truth = window.crop(y, x, side, numbers, described)
        samples = {n: magnifier.samples(v, paths if n in PATH_NAMES else number) for n, v in stored.items()}
        truth |= self.targets(window, y, x, stored["samples.albedo"])
        return samples, {name: magnifier.image(image) for name, image in truth.items()}

    def draw_number(self, most: int, rng: np.random.Generator) -> int:
        """Samples of a pixel, at most `most`, log-uniform."""
        low, high = (math.log2(min(number, most)) for number in (self.data.spp_min, self.data.spp_max))
        return round(2 ** rng.uniform(low, high))

    def targets(self, window: Window, y: int, x: int, albedo: Tensor) -> Inputs:
        """What there is beside the truth to learn from; `albedo` is of all samples that are given."""
        height, width = albedo.shape[2:]
        targets = {"albedo": window.albedo(y, x, albedo)} if self.albedo else {}
        return targets | ({"cleaned": window.cleaned[:, y : y + height, x : x + width]} if self.data.cleaned else {})
