"""Measurements put together: results.jsonl, points over seeds and scenes, the Pareto front, and curves in log-log."""

import json
from collections.abc import Iterable, Sequence
from dataclasses import dataclass, fields
from pathlib import Path
from statistics import fmean, median

import numpy as np

from pathfold.bench.measurement import ERRORS, Measurement
from pathfold.images import ImageError, replacing

ALL = "geometric mean"  # stands for a scene where points are means over scenes
FLAG = 20  # a best method within so many times the reference's own error is flagged
FLOOR = 1e-6  # differences of halves that came out at or below zero count as this


@dataclass(frozen=True)
class Spread:
    """A mean over seeds, and its range."""

    mean: float
    low: float
    high: float


@dataclass(frozen=True)
class Point:
    """A method at one spp on one scene, or over scenes: errors over seeds, median times."""

    scene: str
    method: str
    spp: int
    errors: dict[str, Spread]
    render_ms: float | None  # None where the time of rendering is not known
    denoise_ms: float  # warm; 0 of the noisy picture
    cold_ms: float | None
    total_ms: float | None  # render and denoise
    cold_total_ms: float | None
    peak_mb: float | None
    flicker: float | None
    scenes: int = 1

    @property
    def rell2(self) -> float:
        return self.errors["rell2"].mean


def read(path: Path) -> dict[tuple[str, int, int, str], Measurement]:
    """The measurements of a results.jsonl, {} where there is none; a last line that was cut off is dropped.

    Raises ImageError that names the line that is no measurement.
    """
    if not path.exists():
        return {}
    known = {entry.name for entry in fields(Measurement)}
    found = {}
    lines = path.read_text(encoding="utf-8").splitlines()
    for number, line in enumerate(lines, start=1):
        try:
            record = json.loads(line)
            measurement = Measurement(**{name: value for name, value in record.items() if name in known})
        except (ValueError, TypeError, AttributeError) as error:
            if number == len(lines):
                break
            raise ImageError(f"{path}, line {number}: is no measurement; remove it or choose another folder") from error
        found[measurement.key] = measurement
    return found


def write(path: Path, measurements: Iterable[Measurement]) -> None:
    """Write results.jsonl anew, whole or not at all."""
    with replacing(path) as unfinished:
        unfinished.write_text("".join(line(m) for m in measurements), encoding="utf-8")


def line(measurement: Measurement) -> str:
    return json.dumps(measurement.record()) + "\n"


def geometric(values: Iterable[float]) -> float:
    """The geometric mean; values at or below zero count as FLOOR."""
    return float(np.exp(np.mean(np.log(np.maximum(list(values), FLOOR)))))


def points(measurements: Sequence[Measurement]) -> list[Point]:
    """One for every scene, method and spp, in the order of their first measurement; spp ascending."""
    groups: dict[tuple[str, str, int], list[Measurement]] = {}
    for m in measurements:
        groups.setdefault((m.scene, m.method, m.spp), []).append(m)
    scenes, methods = names(measurements, "scene"), names(measurements, "method")
    order = sorted(groups, key=lambda key: (scenes.index(key[0]), methods.index(key[1]), key[2]))
    return [_over_seeds(groups[key]) for key in order]


def names(measurements: Iterable[Measurement | Point], what: str) -> list[str]:
    """All scenes or methods, in the order of their appearance."""
    return list(dict.fromkeys(getattr(m, what) for m in measurements))


def _over_seeds(group: list[Measurement]) -> Point:
    first = group[0]
    errors = {}
    for name in ERRORS:
        values = [value for m in group if (value := getattr(m, name)) is not None]
        if values:
            errors[name] = Spread(average(name, values), min(values), max(values))

    render = _median(run for m in group for run in m.render_ms)
    denoise = _median(run for m in group for run in m.denoise_ms) or 0.0
    cold = _median(m.cold_ms for m in group)
    return Point(
        first.scene,
        first.method,
        first.spp,
        errors,
        render_ms=render,
        denoise_ms=denoise,
        cold_ms=cold,
        total_ms=None if render is None else render + denoise,
        cold_total_ms=None if render is None or cold is None else render + cold,
        peak_mb=_median(m.peak_mb for m in group),
        flicker=_median(m.flicker for m in group),
    )


def over_scenes(measurements: Sequence[Measurement]) -> list[Point]:
    """Points of the geometric mean over scenes; the range is that of the means of each seed.

    A method that misses a scene that another has at the same spp has no mean there: it would be of other scenes.
    """
    groups: dict[tuple[str, int], list[Point]] = {}
    for point in points(measurements):
        groups.setdefault((point.method, point.spp), []).append(point)
    most = {spp: max(len(group) for (_, s), group in groups.items() if s == spp) for _, spp in groups}
    means = [_over_scenes(group, measurements) for (_, spp), group in groups.items() if len(group) == most[spp]]
    order = names(measurements, "method")
    return sorted(means, key=lambda point: (order.index(point.method), point.spp))


def _over_scenes(group: list[Point], measurements: Sequence[Measurement]) -> Point:
    first = group[0]
    seeds: dict[int, list[Measurement]] = {}
    for m in measurements:
        if (m.method, m.spp) == (first.method, first.spp):
            seeds.setdefault(m.seed, []).append(m)
    errors = {}
    for name in ERRORS:
        if any(name not in point.errors for point in group):
            continue
        mean = average(name, [point.errors[name].mean for point in group])
        of_seeds = [average(name, [getattr(m, name) for m in ms]) for ms in seeds.values() if len(ms) == len(group)]
        errors[name] = Spread(mean, min([mean, *of_seeds]), max([mean, *of_seeds]))
    costs = ("render_ms", "cold_ms", "total_ms", "cold_total_ms", "peak_mb", "flicker")
    return Point(
        ALL,
        first.method,
        first.spp,
        errors,
        denoise_ms=geometric(point.denoise_ms for point in group) if all(p.denoise_ms for p in group) else 0.0,
        scenes=len(group),
        **{name: _geometric_or_none([getattr(point, name) for point in group]) for name in costs},
    )


def average(metric: str, values: Iterable[float]) -> float:
    """Geometric for errors, arithmetic for SSIM, which is no error."""
    return fmean(values) if metric == "ssim" else geometric(values)


def _median(values: Iterable[float | None]) -> float | None:
    known = [value for value in values if value is not None]
    return median(known) if known else None


def _geometric_or_none(values: Sequence[float | None]) -> float | None:
    known = [value for value in values if value is not None]
    return geometric(known) if known and len(known) == len(values) else None
