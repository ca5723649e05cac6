"""Training views rendered while training goes on, in the same process and without a disk: `fit --render-on-the-fly`."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import partial
from itertools import count
from typing import Any

from ..dataset.clean import cleaned_window
from ..dataset.render import procedural_task
from ..dataset.store import Line
from ..dataset.trace import render_view
from ..dataset.truth import BUDGET
from ..scenes.faults import RejectedError
from .views import Window

FIRST = 4  # views that are there before the first step
POOL = 32  # views that are kept; the oldest makes room
HELD_OUT = 4  # views that are validated on
ATTEMPTS = 1 << 20  # apart from each other are the scenes tried for one view, where some show nothing worth rendering


@dataclass(frozen=True)
class Live:
    """What is rendered. The defaults suit a preset's crops of 96 pixels and up to 8 samples."""

    variant: str = "llvm_ad_rgb"
    budget: float = BUDGET  # seconds for a reference
    size: int = 128
    spp: int = 16
    every: int = 10  # steps between two new views


class LiveViews:
    """Called with a step, gives the views to draw from: the last POOL of a sequence that grows by one every few steps.

    Which scenes they show depends on seed, process and step alone; a resumed run renders its pool again.
    """

    def __init__(self, live: Live, seed: int, process: int = 0, processes: int = 1) -> None:
        self.live, self.seed, self.process, self.processes = live, seed, process, processes
        self.lines: list[Line] = []
        self._pool: dict[int, Window] = {}

    def __call__(self, step: int) -> Sequence[Window]:
        newest = FIRST + step // self.live.every
        for number in range(max(0, newest - POOL), newest):
            if number not in self._pool:
                self._pool[number] = self._render(2 * (number * self.processes + self.process), "train")
        for number in [n for n in self._pool if n < newest - POOL]:
            del self._pool[number]
        return list(self._pool.values())

    def held_out(self) -> list[Window]:
        """Views of scenes that training never sees; the same for every process."""
        return [self._render(2 * number + 1, "val") for number in range(HELD_OUT)]

    def _render(self, index: int, split: str) -> Window:
        live = self.live
        common: dict[str, Any] = {"seed": self.seed, "size": live.size, "spp": live.spp, "crop": live.size}
        common |= {"budget": live.budget, "variant": live.variant}
        for attempt in count():
            task = procedural_task(index + ATTEMPTS * attempt, lambda _: split, **common)
            try:
                line, tensors = render_view(task)
            except RejectedError:
                continue
            self.lines.append(line)
            tensor = tensors.__getitem__
            return Window(line, tensor, 0, partial(cleaned_window, line, tensor, 0))
        raise AssertionError  # count() does not end
