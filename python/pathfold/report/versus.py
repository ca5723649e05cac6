"""Models against each peer, scene by scene: at the same spp, and at the same time of rendering and denoising."""

from collections.abc import Sequence

from pathfold.bench.candidates import NOISY, PEERS
from pathfold.bench.measurement import Measurement
from pathfold.bench.results import Point, geometric, names, points
from pathfold.report.pareto import Reached, error_at, timed
from pathfold.report.tables import Table

METRICS = {"rell2": "RelL2", "flip": "FLIP"}
HEADER = (
    *("method", "spp"),
    *(f"{name}, same spp" for name in METRICS.values()),
    "denoise time",
    *(f"{name}, same time" for name in METRICS.values()),
    "RelL2 won, same time",
)
NOTE = (
    "Geometric means over scenes of quotients: below 1 the method is better. At the same time: the other one's curve "
    "between its spp. ~: on some scenes the time lies outside that curve, whose first point or least error then stands "
    "for it."
)


def versus(measurements: Sequence[Measurement]) -> dict[str, Table]:
    """Peer -> a row for each model and spp, of the scenes where both were measured and timed."""
    measured = points(measurements)
    found = {}
    for peer in names(measurements, "method"):
        if peer in PEERS:
            rows = [
                row
                for spp in sorted({p.spp for p in measured})
                for method in names(measurements, "method")
                if method not in (NOISY, *PEERS) and (row := _row(measured, peer, method, spp))
            ]
            if rows:
                found[peer] = [list(HEADER), *rows]
    return found


def _row(measured: Sequence[Point], peer: str, method: str, spp: int) -> list[str]:
    pairs = []
    for own in measured:
        if (own.method, own.spp) == (method, spp) and own.total_ms and own.denoise_ms:
            curve = [p for p in measured if (p.scene, p.method) == (own.scene, peer) and p.total_ms and p.denoise_ms]
            if same := [p for p in curve if p.spp == spp]:
                pairs.append((own, same[0], curve))
    if not pairs:
        return []
    same_spp = [f"{geometric(_quotient(own, other, m) for own, other, _ in pairs):.3g}" for m in METRICS]
    time = geometric(own.denoise_ms / other.denoise_ms for own, other, _ in pairs)
    same_time = []
    for metric in METRICS:
        reached = [_reached(curve, own, metric) for own, _, curve in pairs]
        quotients = [own.errors[metric].mean / at.value for (own, _, _), at in zip(pairs, reached, strict=True)]
        same_time.append(f"{'~' if any(at.bound for at in reached) else ''}{geometric(quotients):.3g}")
    wins = sum(own.rell2 < _reached(curve, own, "rell2").value for own, _, curve in pairs)
    return [method, str(spp), *same_spp, f"{time:.3g}", *same_time, f"{wins} of {len(pairs)}"]


def _quotient(own: Point, other: Point, metric: str) -> float:
    return own.errors[metric].mean / other.errors[metric].mean


def _reached(curve: Sequence[Point], own: Point, metric: str) -> Reached:
    """What a curve comes down to in the time of a point; its first point where it begins later."""
    assert own.total_ms
    entries = timed(curve, metric)
    return error_at(curve, own.total_ms / 1000, metric) or Reached(entries[0][1], bound=True)
