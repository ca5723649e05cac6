"""Times that can be compared."""

from collections.abc import Callable, Mapping
from time import perf_counter
from typing import Any

SLOW_MS = 2000  # what takes longer is timed once per seed: its spread is small, and its time is not


def in_turns(calls: Mapping[Any, Callable[[], Any]], rounds: int) -> dict[Any, list[float]]:
    """Milliseconds of every run; the calls take turns, so that a busy moment hits all alike."""
    took: dict[Any, list[float]] = {name: [] for name in calls}
    for _ in range(rounds):
        for name, call in calls.items():
            start = perf_counter()
            call()
            took[name].append(1000 * (perf_counter() - start))
    return took
