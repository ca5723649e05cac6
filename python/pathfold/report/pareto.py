"""Curves of error over time: the Pareto front, and what lies between measured points in log-log; never beyond them."""

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import pairwise
from math import exp, log

from pathfold.bench.results import FLOOR, Point


def timed(points: Sequence[Point], metric: str = "rell2") -> list[tuple[float, float, Point]]:
    """(total seconds, error, point) by time; points without a time are left out."""
    known = [(p.total_ms / 1000, max(p.errors[metric].mean, FLOOR), p) for p in points if p.total_ms]
    return sorted(known, key=lambda entry: entry[:2])


def pareto(points: Sequence[Point]) -> list[Point]:
    """The points that no other one beats in both time and error, by time."""
    front: list[Point] = []
    for _, error, point in timed(points):
        if not front or error < max(front[-1].rell2, FLOOR):
            front.append(point)
    return front


@dataclass(frozen=True)
class Reached:
    """A value between measured points; `bound`: the curve ends before, so the true one is at most this."""

    value: float
    bound: bool = False


def error_at(points: Sequence[Point], seconds: float, metric: str = "rell2") -> Reached | None:
    """The error that a method reaches in a time: None before its first point, after its last the least of all."""
    entries = timed(points, metric)
    for (t0, e0, _), (t1, e1, _) in pairwise(entries):
        if t0 <= seconds <= t1:
            return Reached(_between(log(t0), log(e0), log(t1), log(e1), log(seconds)))
    if not entries or seconds < entries[0][0]:
        return None
    return Reached(min(error for _, error, _ in entries), bound=True)


def time_to(points: Sequence[Point], error: float) -> Reached | None:
    """The first time at which a method comes down to an error, that of its first point where this is better already;
    None where no point is so good."""
    entries = timed(points)
    if entries and entries[0][1] < error:
        return Reached(entries[0][0], bound=True)
    for (t0, e0, _), (t1, e1, _) in pairwise(entries):
        if e1 <= error <= e0:
            return Reached(_between(log(e0), log(t0), log(e1), log(t1), log(error)))
    return None


def best_within(points: Sequence[Point], seconds: float) -> Point | None:
    """The measured point of least error that fits into a time."""
    fitting = [(error, at, point) for at, error, point in timed(points) if at <= seconds]
    return min(fitting, key=lambda entry: entry[:2])[2] if fitting else None


def _between(x0: float, y0: float, x1: float, y1: float, x: float) -> float:
    share = (x - x0) / (x1 - x0) if x1 != x0 else 0.0
    return exp(y0 + share * (y1 - y0))
