"""How well `plan` predicts: every measured scene from all others, against what was measured there."""

from collections.abc import Callable, Sequence
from math import exp, log, sqrt
from statistics import fmean

from pathfold.images import ImageError
from pathfold.report import summary
from pathfold.report.prediction import Prediction, Sample, left_out

Pair = tuple[Sample, Prediction]


def markdown(measured: Sequence[Sample]) -> str:
    """Tables: the misses of every method over scenes and spp; predicted and measured, scene by scene at one spp.

    Raises ImageError where fewer than two scenes, or one spp only, were measured.
    """
    pairs = left_out(measured)
    if not pairs:
        raise ImageError("to predict one scene from another takes two scenes and two spp at least; bench more")
    spps = sorted({s.spp for s, _ in pairs})
    spp = spps[len(spps) // 2]
    scenes = len({s.scene for s, _ in pairs})
    lead = (
        f"{scenes} scenes, each predicted from the others and its own noisy picture and times at the lowest spp; "
        f"{', '.join(map(str, spps))} spp. Typical: the factor of the root mean square miss in logarithms."
    )
    at = [pair for pair in pairs if pair[0].spp == spp]
    parts = [
        lead,
        summary.markdown(by_method(pairs)),
        f"RelL2 at {spp} spp, predicted / measured:",
        summary.markdown(by_scene(at, lambda p: f"{p[1].rell2.value:.3g} / {p[0].rell2:.3g}")),
        f"Seconds at {spp} spp, predicted / measured:",
        summary.markdown(by_scene(at, lambda p: f"{p[1].seconds.value:.3g} / {seconds(p[0]):.3g}")),
    ]
    return "\n\n".join(part.strip() for part in parts)


def by_method(pairs: Sequence[Pair]) -> summary.Table:
    """How far predictions were off, and how often the measured value lay in the range that was told."""
    head = ["method", "error: typical factor", "worst", "in range", "time: typical factor", "worst", "in range"]
    rows = []
    for method in dict.fromkeys(s.method for s, _ in pairs):
        own = [pair for pair in pairs if pair[0].method == method]
        error = _misses(own, [(p.rell2.value, s.rell2) for s, p in own], [p.rell2.holds(s.rell2) for s, p in own])
        time = _misses(
            own, [(p.seconds.value, seconds(s)) for s, p in own], [p.seconds.holds(seconds(s)) for s, p in own]
        )
        rows.append([method, *error, *time])
    return [head, *rows]


def by_scene(pairs: Sequence[Pair], cell: Callable[[Pair], str]) -> summary.Table:
    methods = list(dict.fromkeys(s.method for s, _ in pairs))
    scenes = dict.fromkeys(s.scene for s, _ in pairs)
    cells = {(pair[0].scene, pair[0].method): cell(pair) for pair in pairs}
    return [["scene", *methods], *([scene, *(cells.get((scene, m), "") for m in methods)] for scene in scenes)]


def seconds(sample: Sample) -> float:
    """Measured: to render and denoise."""
    return (sample.render_ms + sample.denoise_ms) / 1000


def _misses(own: Sequence[Pair], values: Sequence[tuple[float, float]], held: Sequence[bool]) -> list[str]:
    """Typical factor, the worst with its scene and spp, and how many were in range."""
    logs = [log(predicted / measured) for predicted, measured in values]
    worst = max(range(len(logs)), key=lambda i: abs(logs[i]))
    place = f"{own[worst][0].scene}, {own[worst][0].spp} spp"
    typical = exp(sqrt(fmean(miss**2 for miss in logs)))
    return [f"{typical:.2f}", f"{exp(abs(logs[worst])):.2f} ({place})", f"{sum(held)} of {len(held)}"]
