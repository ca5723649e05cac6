"""Candidates on the same noisy frames: their pictures, errors and times."""

from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass, field
from statistics import fmean, median
from time import perf_counter
from typing import Any

import numpy as np
from numpy.typing import NDArray

from pathfold import metrics
from pathfold.bench import cold
from pathfold.bench.candidates import NOISY, Candidate, Run
from pathfold.bench.reference import Reference
from pathfold.bench.shot import Shot
from pathfold.bench.timing import SLOW_MS, in_turns

Image = NDArray[np.float32]
Size = tuple[str, frozenset[tuple[int, ...]]]  # a candidate, the shapes of its inputs


@dataclass(frozen=True)
class Known:
    """What a process has found out of candidates on inputs of a size, and need not find out again."""

    cold: dict[Size, tuple[float, float]] = field(default_factory=dict)  # what cold.measure told
    warm: set[Size] = field(default_factory=set)  # they have run before


class Contest:
    """Candidates on the frames of one scene at one spp and seed: all see the same noisy frames."""

    def __init__(
        self,
        candidates: Mapping[str, tuple[Candidate, Run]],
        *,
        scale: float,
        exposure: float | None,
        rounds: int,
        known: Known,
        complain: Callable[[str, Exception], None],
    ) -> None:
        """`scale`: the metrics' exposure; `exposure`: what all frames of a sequence are denoised with.

        Each frame has `rounds` timed runs at the first seed, one later; the first on inputs of a size is a warm-up and
        does not count. `known` is shared by the contests of a scene.

        A candidate that fails is named to `complain` and left out.
        """
        self._candidates = dict(candidates)
        self._scale, self._exposure, self._rounds, self._complain = scale, exposure, rounds, complain
        self._known = known
        self._tallies = {name: _Tally(scale) for name in candidates}

    def add(self, shot: Shot, reference: Reference, first_seed: bool) -> dict[str, Image]:
        """Denoise, measure and time one frame; returns the pictures by candidate."""
        images: dict[str, Image] = {}
        calls: dict[str, Callable[[], Image]] = {}
        for name, (candidate, run) in list(self._candidates.items()):
            tally = self._tallies[name]
            read = {buffer: shot.buffers[buffer] for buffer in candidate.reads & shot.buffers.keys()}
            size = name, frozenset(buffer.shape for buffer in read.values())
            call = lambda run=run, read=read: run(read, self._exposure, shot.spp)  # noqa: E731
            try:
                if first_seed and name != NOISY and tally.cold is None:
                    if size not in self._known.cold:  # first: a process of its own may die of memory
                        self._known.cold[size] = cold.measure(candidate, read)
                    tally.cold = self._known.cold[size]
                start = perf_counter()
                images[name] = call()
                took = 1000 * (perf_counter() - start)
            except Exception as error:  # whatever a method raises is its own failure, not the bench's
                self._drop(name, error)
                continue
            tally.render_ms.append(shot.rendering_for(candidate))
            if name != NOISY:
                tally.denoise_ms.append([took] if size in self._known.warm else [])
                self._known.warm.add(size)
                calls[name] = call
        self._time(calls, self._rounds if first_seed else 1)
        for name, image in list(images.items()):
            try:
                self._tallies[name].add(image, reference)
            except Exception as error:
                self._drop(name, error)
                del images[name]
        return images

    def _time(self, calls: Mapping[str, Callable[[], Image]], rounds: int) -> None:
        """Run each in turn until it was timed so often; once is enough for those that turn out to be slow."""
        taken = {name: self._tallies[name].denoise_ms[-1] for name in calls}
        while missing := {
            name: call
            for name, call in calls.items()
            if len(taken[name]) < (rounds if max(taken[name], default=0) < SLOW_MS else 1)
        }:
            for name, took in in_turns(missing, 1).items():
                taken[name] += took

    def _drop(self, name: str, error: Exception) -> None:
        del self._candidates[name], self._tallies[name]
        self._complain(name, error)

    def results(self) -> Iterator[tuple[Candidate, dict[str, Any]]]:
        """Errors and times of every candidate that got through, by Measurement's names."""
        for name, (candidate, _) in self._candidates.items():
            yield candidate, self._tallies[name].summary()


class _Tally:
    """What one candidate gathers over the frames."""

    def __init__(self, scale: float) -> None:
        self.cold: tuple[float, float] | None = None
        self.render_ms: list[list[float]] = []
        self.denoise_ms: list[list[float]] = []
        self._scale, self._errors, self._flicker = scale, [], metrics.Flicker(scale)  # type: ignore[var-annotated]

    def add(self, image: Image, reference: Reference) -> None:
        self._errors.append(reference.errors(image, self._scale))
        self._flicker.add(image, reference.mean)

    def summary(self) -> dict[str, Any]:
        errors = {name: fmean(frame[name] for frame in self._errors) for name in self._errors[0]}
        milliseconds, megabytes = self.cold or (None, None)
        return errors | {
            "render_ms": _over_frames(self.render_ms),
            "denoise_ms": _over_frames(self.denoise_ms),
            "cold_ms": milliseconds,
            "peak_mb": megabytes,
            "flicker": self._flicker.value,
            "frames": len(self._errors),
        }


def _over_frames(took: list[list[float]]) -> list[float]:
    """The runs of one frame as they are; of several, the mean over frames of each frame's median."""
    known = [runs for runs in took if runs]
    if len(took) == 1 or not known:
        return [round(run, 3) for runs in known for run in runs]
    return [round(fmean(median(runs) for runs in known), 3)]
