"""What a person asks of error and time, answered in words and small tables from measured curves.

Nothing is extrapolated: where a curve has ended, the best that was measured stands with a "less than or equal" sign.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from math import ceil, floor, log10

from pathfold.bench.candidates import NOISY
from pathfold.bench.results import Point, names
from pathfold.report.pareto import Reached, best_within, error_at, time_to, timed

MOST = 4  # budgets or targets in a table
BEYOND = "\N{EM DASH}"  # not measured there; it would have to be extrapolated


@dataclass(frozen=True)
class Answer:
    """A question, sentences, and a table (its first row the header) where there is one."""

    question: str
    sentences: list[str]
    table: list[list[str]] = field(default_factory=list)


def answers(points: Sequence[Point], scenes: Sequence[Point]) -> list[Answer]:
    """`points`: the curves to judge, of one scene or of the mean; `scenes`: all scenes' points, for the last answer.

    Empty where no time of rendering is known.
    """
    curves = {method: [p for p in points if p.method == method] for method in names(points, "method")}
    if not timed(points):
        return []
    return [equal_time(curves), equal_error(curves), paying(curves), pick(scenes)]


def equal_time(curves: dict[str, list[Point]]) -> Answer:
    ranges = [[t for t, _, _ in timed(curve)] for curve in curves.values()]
    table, sentences = [["total time", *curves]], []
    for seconds in round_numbers([(min(r), max(r)) for r in ranges if r]):
        reached = {method: error_at(curve, seconds) for method, curve in curves.items()}
        table.append([_time(seconds), *_cells(reached, "{:.4f}".format)])
        if found := _compared(reached, "less"):
            winner, rest = found
            sentences.append(
                f"In {_time(seconds)} {winner} reaches RelL2 {_value(reached[winner], '{:.4f}'.format)}: {rest}."
            )
    return Answer("At equal time, how much less error?", sentences or [_NOTHING], table if sentences else [])


def equal_error(curves: dict[str, list[Point]]) -> Answer:
    ranges = [[e for _, e, _ in timed(curve)] for curve in curves.values()]
    table, sentences = [["RelL2", *curves]], []
    for error in reversed(round_numbers([(min(r), max(r)) for r in ranges if r])):
        took = {method: time_to(curve, error) for method, curve in curves.items()}
        table.append([f"{error:g}", *_cells(took, _time)])
        if found := _compared(took, "faster"):
            winner, rest = found
            sentences.append(f"{winner} comes down to RelL2 {error:g} in {_value(took[winner], _time)}: {rest}.")
    return Answer("At equal error, how much less time?", sentences or [_NOTHING], table if sentences else [])


def _compared(values: dict[str, Reached | None], word: str) -> tuple[str, str] | None:
    """The method of the smallest value, and how many times each other one is larger, as far as that is known."""
    known = {method: reached for method, reached in values.items() if reached}
    if len(known) < 2:
        return None
    winner = min(known, key=lambda method: (known[method].value, known[method].bound))
    best = known[winner]
    rest = []
    for method, reached in known.items():
        if method != winner and not (best.bound and reached.bound):
            hedge = "at least " if best.bound else "at most " if reached.bound else ""
            rest.append(f"{hedge}{reached.value / best.value:.3g} times {word} than {method}")
    return (winner, _listed(rest)) if rest else None


def paying(curves: dict[str, list[Point]]) -> Answer:
    """Against the noisy picture with the same total time."""
    question = "At which spp does denoising stop paying?"
    if not (noisy := curves.get(NOISY)):
        return Answer(question, ["The noisy picture was not measured, so there is nothing to compare with."])
    sentences = []
    for method, curve in curves.items():
        if method != NOISY:
            found = [(p, error, error_at(noisy, t)) for t, error, p in timed(curve)]
            gains = [(p, same.value / error) for p, error, same in found if same and not same.bound]
            beyond = sorted(p.spp for p, _, same in found if same and same.bound)
            sentences.append(_pays(method, gains, beyond))
    return Answer(question, sentences)


def _pays(method: str, gains: list[tuple[Point, float]], beyond: list[int]) -> str:
    limit = f"; at {_listed(map(str, beyond))} spp the noisy curve would have to be extrapolated" if beyond else ""
    if not gains:
        return f"{method}: cannot be told{limit}."
    paid = [(point.spp, gain) for point, gain in gains if gain > 1]
    if not paid:
        spps = _listed([str(point.spp) for point, _ in gains])
        return f"{method} does not pay at {spps} spp: more samples in its time bring less error{limit}."
    before = [point.spp for point, gain in gains if gain <= 1 and point.spp < paid[0][0]]
    after = [point.spp for point, gain in gains if gain <= 1 and point.spp > paid[0][0]]
    starts = f" from {paid[0][0]} spp on" if before else ""
    stops = f" and stops at {after[0]} spp" if after else " as far as was measured"
    figures = _listed([f"{gain:.3g} times at {spp} spp" for spp, gain in dict.fromkeys([paid[0], paid[-1]])])
    return f"{method} pays{starts}{stops}: less error than more samples in the same time, {figures}{limit}."


def pick(points: Sequence[Point]) -> Answer:
    """The measured point of least error within each budget, scene by scene."""
    ranges = [(t, t) for t, _, _ in timed(points)]
    budgets = round_numbers([(min(t for t, _ in ranges), max(t for t, _ in ranges))], wanted=1)
    table = [["scene", *(f"within {_time(seconds)}" for seconds in budgets)]]
    tied = False
    for scene in names(points, "scene"):
        own = [p for p in points if p.scene == scene]
        row = [scene]
        for seconds in budgets:
            chosen = best_within(own, seconds)
            row.append(BEYOND if chosen is None else f"{chosen.method}, {chosen.spp} spp ({chosen.rell2:.4f})")
            if chosen and (others := _as_good(chosen, own, seconds)):
                tied = True
                row[-1] += f"; as good within error bars: {', '.join(others)}"
        table.append(row)
    sentences = ["Measured points only: the method and spp of least error that fit into each time, RelL2 in brackets."]
    if tied:
        sentences.append("Methods whose range over seeds overlaps that of the best are named beside it.")
    return Answer("Which method for this scene and budget?", sentences, table)


def _as_good(chosen: Point, points: Sequence[Point], seconds: float) -> list[str]:
    """Other methods whose best point within the time reaches into the range of the chosen one."""
    found = []
    for method in names(points, "method"):
        other = best_within([p for p in points if p.method == method], seconds)
        if other and method != chosen.method and other.errors["rell2"].low <= chosen.errors["rell2"].high:
            found.append(method)
    return found


_NOTHING = "No two methods were measured over the same range; this needs more spp, or an extrapolation."


def round_numbers(ranges: Sequence[tuple[float, float]], wanted: int = 2) -> list[float]:
    """Up to MOST numbers of the series 1, 2, 5, 10, ... that lie in at least `wanted` of the ranges, spread evenly."""
    if not ranges:
        return []
    low, high = min(r[0] for r in ranges), max(r[1] for r in ranges)
    series = [m * 10.0**e for e in range(floor(log10(low)), ceil(log10(high)) + 1) for m in (1, 2, 5)]
    inside = [n for n in series if sum(a <= n <= b for a, b in ranges) >= wanted]
    if len(inside) <= MOST:
        return inside
    return [inside[round(i * (len(inside) - 1) / (MOST - 1))] for i in range(MOST)]


def _cells(values: dict[str, Reached | None], form: Callable[[float], str]) -> list[str]:
    """Texts of one row, the smallest in bold."""
    least = min((reached.value for reached in values.values() if reached), default=None)
    cells = []
    for reached in values.values():
        text = BEYOND if reached is None else _value(reached, form)
        cells.append(f"**{text}**" if reached and reached.value == least else text)
    return cells


def _value(reached: Reached | None, form: Callable[[float], str]) -> str:
    if reached is None:
        return BEYOND
    return f"\N{LESS-THAN OR EQUAL TO} {form(reached.value)}" if reached.bound else form(reached.value)


def _time(seconds: float) -> str:
    return f"{seconds:.3g} s" if seconds >= 1 else f"{1000 * seconds:.3g} ms"


def _listed(words: "Sequence[str] | map[str]") -> str:
    words = list(words)
    return words[0] if len(words) == 1 else f"{', '.join(words[:-1])} and {words[-1]}"
