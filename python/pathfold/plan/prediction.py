"""What a method would cost and give on a scene that was not measured, from a pilot and from the scenes that were.

Error: over scenes, log RelL2 of a method at an spp goes with the log noise of the scene, its slope 1 for the noisy
picture and about 1/2 for denoisers, whose error grows more slowly than the noise (`pathfold plan --check` shows how
well this does). Time: that of the pilot, times how it grew with spp on the measured scenes. How sure: each measured
scene is predicted from the others, and the misses give the interval.
"""

from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from math import ceil, exp, inf, log
from statistics import fmean

from pathfold.bench import results
from pathfold.bench.candidates import NOISY
from pathfold.plan.curves import Sample

SHARE = 0.8  # of new scenes that an interval is to hold


@dataclass(frozen=True)
class Pilot:
    """What is known of a new scene: its noise, and the times of every method, at one spp that was measured."""

    spp: int
    noise: float  # RelL2 of the noisy picture at this spp
    render_ms: dict[str, float]  # method -> time; with descriptors where it reads them
    denoise_ms: dict[str, float]  # 0 of the noisy picture


@dataclass(frozen=True)
class Estimate:
    """A value, and the factor up or down that it may be off by; infinite where one scene was measured only."""

    value: float
    factor: float

    @property
    def low(self) -> float:
        return self.value / self.factor

    @property
    def high(self) -> float:
        return self.value * self.factor

    def holds(self, value: float) -> bool:
        return self.low <= value <= self.high


@dataclass(frozen=True)
class Prediction:
    """A method at an spp on the new scene."""

    method: str
    spp: int
    rell2: Estimate
    seconds: Estimate
    scenes: int  # that it comes from


def predict(measured: Sequence[Sample], pilot: Pilot) -> list[list[Prediction]]:
    """The curve of every method that the pilot knows, at every measured spp from the pilot's methods."""
    noise = noises(measured)
    table = {(s.scene, s.method, s.spp): s for s in measured if s.scene in noise}
    curves = []
    for method in dict.fromkeys(s.method for s in measured if s.method in pilot.render_ms):
        curve = []
        for spp in sorted({s.spp for s in measured if s.method == method}):
            pairs = [
                (table[scene, method, pilot.spp], table[scene, method, spp])
                for scene in noise
                if (scene, method, spp) in table and (scene, method, pilot.spp) in table
            ]
            if pairs:
                rell2 = _error([at for _, at in pairs], noise, pilot)
                curve.append(Prediction(method, spp, rell2, _seconds(pairs, pilot), len(pairs)))
        if curve:
            curves.append(curve)
    return curves


def noises(measured: Sequence[Sample]) -> dict[str, float]:
    """Scene -> RelL2 of the noisy picture at one sample per pixel, from all its spp."""
    levels: dict[str, list[float]] = {}
    for sample in measured:
        if sample.method == NOISY:
            levels.setdefault(sample.scene, []).append(sample.rell2 * sample.spp)
    return {scene: results.geometric(values) for scene, values in levels.items()}


def between(curve: Sequence[Prediction], spp: int) -> Prediction:
    """A curve at any spp from its first to its last: straight in log-log between the measured ones."""
    below = max((p for p in curve if p.spp <= spp), key=lambda p: p.spp)
    above = min((p for p in curve if p.spp >= spp), key=lambda p: p.spp)
    share = log(spp / below.spp) / log(above.spp / below.spp) if above.spp > below.spp else 0.0

    def mixed(a: Estimate, b: Estimate) -> Estimate:
        return Estimate(exp((1 - share) * log(a.value) + share * log(b.value)), max(a.factor, b.factor))

    return Prediction(
        below.method,
        spp,
        mixed(below.rell2, above.rell2),
        mixed(below.seconds, above.seconds),
        min(below.scenes, above.scenes),
    )


def cross_validated(measured: Sequence[Sample]) -> list[tuple[Sample, Prediction]]:
    """Each scene predicted from all others, its own lowest spp the pilot: (measured, predicted).

    At that spp itself the time is no prediction, but what the pilot tells.
    """
    pairs = []
    for scene in dict.fromkeys(s.scene for s in measured):
        own = [s for s in measured if s.scene == scene]
        lowest = min(s.spp for s in own)
        first = {s.method: s for s in own if s.spp == lowest}
        if NOISY not in first:
            continue
        pilot = Pilot(
            lowest,
            first[NOISY].rell2,
            {method: s.render_ms for method, s in first.items()},
            {method: s.denoise_ms for method, s in first.items()},
        )
        found = {(s.method, s.spp): s for s in own}
        for curve in predict([s for s in measured if s.scene != scene], pilot):
            pairs += [(found[p.method, p.spp], p) for p in curve if (p.method, p.spp) in found]
    return pairs


def _error(at: Sequence[Sample], noise: dict[str, float], pilot: Pilot) -> Estimate:
    slope = 1.0 if at[0].method == NOISY else 0.5
    levels = [log(s.rell2) - slope * log(noise[s.scene]) for s in at]
    value = exp(fmean(levels) + slope * log(max(pilot.noise * pilot.spp, results.FLOOR)))
    return Estimate(value, _factor(level - mean for level, mean in zip(levels, _means_of_others(levels), strict=True)))


def _seconds(pairs: Sequence[tuple[Sample, Sample]], pilot: Pilot) -> Estimate:
    """`pairs`: a method at the pilot's spp and at the wanted one, scene by scene."""
    method = pairs[0][0].method
    render = [log(at.render_ms / first.render_ms) for first, at in pairs]
    denoise = [log(at.denoise_ms / first.denoise_ms) if first.denoise_ms else 0.0 for first, at in pairs]
    value = pilot.render_ms[method] * exp(fmean(render)) + pilot.denoise_ms[method] * exp(fmean(denoise))
    misses = [
        log((at.render_ms + at.denoise_ms) / (first.render_ms * exp(r) + first.denoise_ms * exp(d)))
        for (first, at), r, d in zip(pairs, _means_of_others(render), _means_of_others(denoise), strict=True)
    ]
    return Estimate(value / 1000, _factor(misses))


def _means_of_others(values: Sequence[float]) -> list[float]:
    """For each value the mean of the others; nan where there is none."""
    if len(values) < 2:
        return [float("nan")] * len(values)
    return [(sum(values) - value) / (len(values) - 1) for value in values]


def _factor(misses: Iterable[float]) -> float:
    """What holds SHARE of new scenes at least, if they are like the measured ones and these are enough."""
    sizes = sorted(abs(miss) for miss in misses)
    return inf if len(sizes) < 2 else exp(sizes[held(len(sizes)) - 1])


def held(scenes: int) -> int:
    """How many of the measured scenes, each predicted from the others, an interval holds: the k-th smallest miss of n
    holds a new one with probability k / (n + 1) (conformal prediction)."""
    return min(scenes, ceil(SHARE * (scenes + 1)))
