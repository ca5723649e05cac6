"""Windows of views that samples were kept of, as they are read to train or to validate on."""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from functools import cached_property, partial
from pathlib import Path
from typing import Any

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor
from torch.utils.data import Dataset

from ..dataset import store
from ..dataset.store import Line, Store
from ..dataset.truth import window_halves
from ..dataset.values import known
from ..networks.batch import Batch, Inputs
from .frames import collate, frame_inputs

SAMPLE_NAMES = tuple(f"samples.{n}" for n in ("radiance", "diffuse", "diffuse.albedo", "albedo", "normal", "depth"))
TRUTH_NAMES = ("reference.color", "reference.diffuse", "reference.diffuse.albedo")


class Stored:
    """The windows of a data set; called with a step, gives those to train on, whatever the step.

    Raises ValueError where the data set has none to train or to validate on.
    """

    def __init__(self, folder: Path) -> None:
        self.store = Store(folder)
        self.lines = self.store.lines
        self.train = self._split("train")

    def held_out(self) -> list[Window]:
        """The windows to validate on."""
        return self._split("val")

    def _split(self, name: str) -> list[Window]:
        lines = self.store.split(name)
        if not lines:
            raise ValueError(
                f"{self.store.folder} has no view of split '{name}': at random one scene in ten is 'val', the others "
                "'train'; render some 30 scenes with 'pathfold-train render'"
            )
        return [
            Window(line, partial(self.store.tensor, line["id"]), n, partial(self._cleaned, line, n))
            for line in lines
            for n in range(len(line["crops"]))
        ]

    def _cleaned(self, line: Line, number: int) -> NDArray[np.float32]:
        kept = store.read_cleaned(self.store.folder, line, number)
        if kept is None:
            raise self._lack(line)
        return kept

    def need_cleaned(self) -> None:
        """Raises FileNotFoundError where a window to train on has no cleaned reference."""
        for line in self.store.split("train"):
            for number in range(len(line["crops"])):
                if not store.cleaned_path(self.store.folder, line, number).is_file():
                    raise self._lack(line)

    def _lack(self, line: Line) -> FileNotFoundError:
        folder = self.store.folder
        return FileNotFoundError(
            f"{folder} lacks the cleaned reference of {line['id']}, which the preset learns from; "
            f"`pathfold-train dataset clean {folder}` makes what is missing"
        )

    def __call__(self, step: int) -> list[Window]:
        return self.train


class Window:
    """A window of a view that samples were kept of. `tensor` gives the view's tensors by name; what is cut is read.

    `read_cleaned` gives its cleaned reference.
    """

    def __init__(
        self,
        line: Line,
        tensor: Callable[[str], Any],
        number: int,
        read_cleaned: Callable[[], NDArray[np.float32]],
    ) -> None:
        self.line, self.tensor, self.number, self.read_cleaned = line, tensor, number, read_cleaned
        self.scene = str(line["scene"])
        self.samples: int = line["spp"]
        self.described: int = line["described"]
        self.side = line["crop"]
        self.top, self.left = line["crops"][number]
        self.exposure, self.depth_scale = line["exposure"], line["depth_scale"]

    @cached_property
    def cumulative(self) -> NDArray[np.float64]:
        weight = self.tensor("importance")[self.top : self.top + self.side, self.left : self.left + self.side]
        whole = np.maximum(known(weight).astype(np.float64).ravel(), 0.0)
        return np.cumsum(whole / whole.sum() if whole.any() else np.full(whole.size, 1 / whole.size))

    def halves(self) -> tuple[NDArray[np.float32], ...]:
        """The window's truth [3, H, W] twice, of independent samples."""
        return window_halves(self.line, self.tensor, self.number)

    @cached_property
    def cleaned(self) -> Tensor:
        """The window's truth [3, H, W] without most of its noise, see dataset/clean.py."""
        return torch.from_numpy(known(self.read_cleaned()))

    @cached_property
    def albedo_sum(self) -> Tensor:
        """Sum of all samples' albedo [3, H, W], float32; reads them all, once."""
        stored = self.tensor("samples.albedo")
        total = torch.zeros(3, self.side, self.side)
        for sample in range(self.samples):
            total += torch.from_numpy(known(stored[self.number, sample]))
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
        """Samples by number and the truth of the crop: tensors S x C x h x w and C x h x w, float32.

        Path descriptors are read of the first `paths` of `numbers`, or of as many of these as they are stored of, and
        stay float16. Unknown values count as black.
        """
        inside = slice(y, min(y + size, self.side)), slice(x, min(x + size, self.side))
        whole = [slice(s.start + o, s.stop + o) for s, o in zip(inside, (self.top, self.left), strict=True)]
        described = numbers[: np.cumprod(numbers < self.described).sum()][:paths]

        def read(name: str, chosen: NDArray[np.intp]) -> Tensor:
            stored = self.tensor(name)  # indexed by one number at a time: safetensors takes no lists
            values = np.stack([stored[self.number, int(sample), :, *inside] for sample in chosen])
            return torch.from_numpy(known(values))

        inputs = {name: read(name, numbers).float() for name in SAMPLE_NAMES}
        if len(described):
            inputs["samples.descriptor"] = read("samples.descriptor", described)
            inputs["samples.density"] = read("samples.density", described)
        truth = {
            name.removeprefix("reference."): torch.from_numpy(known(self.tensor(name)[:, *whole]))
            for name in TRUTH_NAMES
        }
        return inputs, truth

    def albedo(self, y: int, x: int, own: Tensor) -> Tensor:
        """Mean albedo [3, h, w] of a crop over all samples but its `own`, S x 3 x h x w; NaN if these are over half."""
        if 2 * len(own) > self.samples:
            return torch.full(own.shape[1:], math.nan)
        others = self.albedo_sum[:, y : y + own.shape[2], x : x + own.shape[3]] - own.sum(0)
        return others.clamp(min=0.0) / (self.samples - len(own))


class ValidationViews(Dataset):
    """Whole held-out windows, a Batch each: `spp` samples or all there are, all inputs; `paths` as of Crops.

    References have `half_a` and `half_b` too.
    """

    def __init__(self, views: Sequence[Window], paths: int, spp: int = 8) -> None:
        self.views, self.paths, self.spp = views, paths, spp

    def __len__(self) -> int:
        return len(self.views)

    def __getitem__(self, index: int) -> Batch:
        view = self.views[index]
        samples, truth = view.crop(0, 0, view.side, np.arange(min(self.spp, view.samples)), self.paths)
        truth |= {f"half_{name}": torch.from_numpy(h) for name, h in zip("ab", view.halves(), strict=True)}
        return collate([(frame_inputs(samples, view.exposure, view.depth_scale), truth)])
