"""How well `plan` predicts: every measured scene from all others, against what was measured there."""

from collections.abc import Callable, Sequence
from math import exp, isfinite, log, sqrt
from statistics import fmean

from pathfold.images import ImageError
from pathfold.plan.curves import Sample
from pathfold.plan.prediction import Estimate, Prediction, cross_validated
from pathfold.report import tables

Pair = tuple[Sample, Prediction]


def markdown(measured: Sequence[Sample], command: str) -> str:
    """A page: the misses of every method over scenes and spp; predicted and measured, scene by scene at one spp.

    `command` is what it says that it was made by.

    Raises ImageError where fewer than two scenes were measured.
    """
    pairs = cross_validated(measured)
    if not pairs:
        raise ImageError("to predict one scene from another takes two scenes that were measured at the same spp")
    spps = sorted({s.spp for s, _ in pairs})
    spp = spps[len(spps) // 2]
    scenes = len({s.scene for s, _ in pairs})
    lead = (
        f"{scenes} scenes, each predicted from the others and its own noisy picture and times at the lowest spp; "
        f"{', '.join(map(str, spps))} spp. Typical: the factor of the root mean square miss in logarithms."
    )
    at = [pair for pair in pairs if pair[0].spp == spp]
    parts = [
        "# How well `plan` predicts",
        lead,
        f"    {command}",
        tables.markdown(by_method(pairs)),
        f"RelL2 at {spp} spp, predicted / measured:",
        tables.markdown(by_scene(at, lambda p: f"{p[1].rell2.value:.3g} / {p[0].rell2:.3g}")),
    ]
    if spp > spps[0]:
        parts.append(f"Seconds at {spp} spp, predicted / measured:")
        parts.append(tables.markdown(by_scene(at, lambda p: f"{p[1].seconds.value:.3g} / {seconds(p[0]):.3g}")))
    return "\n\n".join(part.strip("\n") for part in parts) + "\n"


def by_method(pairs: Sequence[Pair]) -> tables.Table:
    """How far predictions were off, and how often the measured value lay in the range that was told."""
    lowest = min(s.spp for s, _ in pairs)  # its times are the pilot's, not predicted
    rows = []
    for method in dict.fromkeys(s.method for s, _ in pairs):
        own = [pair for pair in pairs if pair[0].method == method]
        error = _misses([(s, p.rell2, s.rell2) for s, p in own])
        time = _misses([(s, p.seconds, seconds(s)) for s, p in own if s.spp > lowest])
        rows.append([method, *error, *time])
    head = ["method", "error: typical factor", "worst", "in range", "time: typical factor", "worst", "in range"]
    return tables.drop_empty([head, *rows])


def by_scene(pairs: Sequence[Pair], cell: Callable[[Pair], str]) -> tables.Table:
    methods = list(dict.fromkeys(s.method for s, _ in pairs))
    scenes = dict.fromkeys(s.scene for s, _ in pairs)
    cells = {(pair[0].scene, pair[0].method): cell(pair) for pair in pairs}
    return [["scene", *methods], *([scene, *(cells.get((scene, m), "") for m in methods)] for scene in scenes)]


def seconds(sample: Sample) -> float:
    """Measured: to render and denoise."""
    return (sample.render_ms + sample.denoise_ms) / 1000


def _misses(entries: Sequence[tuple[Sample, Estimate, float]]) -> list[str]:
    """Of predicted and measured values: the typical factor, the worst with its scene and spp, how many in range."""
    if not entries:
        return ["", "", ""]
    misses = [(abs(log(told.value / measured)), f"{s.scene}, {s.spp} spp") for s, told, measured in entries]
    worst, place = max(misses)
    ranged = [told.holds(measured) for _, told, measured in entries if isfinite(told.factor)]
    typical = exp(sqrt(fmean(miss**2 for miss, _ in misses)))
    inside = f"{sum(ranged)} of {len(ranged)}" if ranged else "no range"
    return [f"{typical:.2f}", f"{exp(worst):.2f} ({place})", inside]
