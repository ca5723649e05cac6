"""What a bench says of measurements: points, curves, answers, tables."""

import math
from dataclasses import replace
from pathlib import Path

import pytest
from pathfold.bench import results
from pathfold.bench.measurement import Measurement
from pathfold.images import ImageError
from pathfold.report import answers, pareto, tables, versus


def measurement(method: str, spp: int, seconds: float, error: float, scene: str = "a", seed: int = 0) -> Measurement:
    denoise = [] if method == "noisy" else [seconds * 500]
    render = [seconds * (1000 if method == "noisy" else 500)]
    return Measurement(scene, spp, seed, method, error, 0.1, 0.9, 0.05, render, denoise, reference_rell2=1e-6)


@pytest.fixture
def measured() -> list[Measurement]:
    """Noisy halves its error with each doubling of time; `clean` costs a second more and has a tenth of the error."""
    noisy = [measurement("noisy", n, n / 4, 1 / n) for n in (1, 2, 4, 8, 16, 32)]
    return [*noisy, *(measurement("clean", n, n / 4 + 1, 0.1 / n) for n in (1, 2, 4, 8, 16, 32))]


def of(measured: list[Measurement], method: str) -> list[results.Point]:
    return [point for point in results.points(measured) if point.method == method]


def test_between_measured_points_curves_are_straight_in_log_log(measured: list[Measurement]) -> None:
    noisy = of(measured, "noisy")
    assert pareto.error_at(noisy, math.sqrt(0.5)) == pareto.Reached(pytest.approx(1 / math.sqrt(8)))
    assert pareto.time_to(noisy, 1 / 6) == pareto.Reached(pytest.approx(6 / 4))


def test_a_model_is_told_against_a_peer_at_the_same_spp_and_time(measured: list[Measurement]) -> None:
    peer = [replace(m, method="oidn") for m in measured if m.method == "clean"]
    # twice the error at each spp, half a second faster: at 16 spp in 4.5 s, where oidn is between 8 spp and 16
    model = [measurement("model", n, n / 4 + 0.5, 0.2 / n, scene) for scene in "ab" for n in (2, 16, 32)]
    other = [replace(m, scene="b", rell2=m.rell2 * 4) for m in peer]
    ((header, *rows),) = versus.versus([*peer, *other, *model, measurement("noisy", 2, 1, 1)]).values()
    rows = {int(row[1]): dict(zip(header, row, strict=True)) for row in rows}
    assert sorted(rows) == [2, 16, 32]
    assert rows[16]["method"] == "model"
    assert float(rows[16]["RelL2, same spp"]) == pytest.approx(1, rel=1e-3)  # 2 and 1/2
    assert float(rows[16]["denoise time"]) == pytest.approx(0.9, rel=1e-3)  # 4.5 / 5
    between = 0.1 / 8 / 2 ** (math.log(4.5 / 3) / math.log(5 / 3))
    assert float(rows[16]["RelL2, same time"]) == pytest.approx(0.2 / 16 / between / 2, rel=1e-2)
    assert rows[16]["RelL2 won, same time"] == "1 of 2"
    assert rows[2]["RelL2, same time"].startswith("~")  # 1 s, before oidn's first point: 0.1 of 0.1 and 0.4
    assert float(rows[2]["RelL2, same time"][1:]) == pytest.approx(0.5, rel=1e-2)
    assert versus.versus(measured) == {}


def test_nothing_is_extrapolated(measured: list[Measurement]) -> None:
    noisy = of(measured, "noisy")
    assert pareto.error_at(noisy, 0.2) is None  # before the first point
    assert pareto.error_at(noisy, 100) == pareto.Reached(pytest.approx(1 / 32), bound=True)  # it had this by then
    assert pareto.time_to(noisy, 0.001) is None
    assert pareto.time_to(noisy, 2) == pareto.Reached(pytest.approx(0.25), bound=True)
    text = " ".join(answers.paying({m: of(measured, m) for m in ("noisy", "clean")}).sentences)
    assert "at 32 spp the noisy curve would have to be extrapolated" in text
    # 1 spp of clean takes 1.25 s, in which noisy reaches 5 spp: 0.2 against 0.1
    assert "clean pays as far as was measured" in text and "2 times at 1 spp" in text


def test_where_denoising_stops_paying_is_said() -> None:
    noisy = [measurement("noisy", n, n, 1 / n) for n in (1, 2, 4, 8, 16)]
    biased = [measurement("biased", n, n + 0.5, 0.2) for n in (1, 2, 4, 8)]
    points = results.points([*noisy, *biased])
    told = answers.paying({m: [p for p in points if p.method == m] for m in ("noisy", "biased")}).sentences
    assert len(told) == 1 and "stops at 8 spp" in told[0]
    slow = results.points([*noisy, *(measurement("slow", n, n + 6, 0.5 / n) for n in (1, 8))])
    told = answers.paying({m: [p for p in slow if p.method == m] for m in ("noisy", "slow")}).sentences
    assert "from 8 spp on" in told[0]


def test_at_equal_time_and_error_the_ratio_is_told(measured: list[Measurement]) -> None:
    equal_time, equal_error, _, pick = answers.answers(results.points(measured), results.points(measured))
    assert any("In 5 s clean reaches RelL2 0.0063: 8 times less than noisy." in s for s in equal_time.sentences)
    assert "clean comes down to RelL2 0.1 in 1.25 s: 2 times faster than noisy." in equal_error.sentences
    assert pick.table[1][0] == "a" and "noisy, 2 spp (0.5000)" in pick.table[1]


def test_what_is_better_from_its_first_point_on_wins_by_at_least_so_much(measured: list[Measurement]) -> None:
    best = [measurement("best", 1, 0.5, 0.001), measurement("best", 2, 0.6, 0.0005)]
    points = results.points([*measured, *best])
    equal_error = answers.answers(points, points)[1]
    told = (
        "best comes down to RelL2 0.1 in \N{LESS-THAN OR EQUAL TO} 500 ms: at least 5 times faster than noisy and at "
    )
    assert told + "least 2.5 times faster than clean." in equal_error.sentences


def test_the_front_holds_what_nothing_beats(measured: list[Measurement]) -> None:
    front = pareto.pareto(results.points([*measured, measurement("worse", 1, 9, 9)]))
    assert [(p.method, p.spp) for p in front[:5]] == [("noisy", n) for n in (1, 2, 4)] + [("clean", n) for n in (1, 2)]
    assert all(p.method == "clean" for p in front[3:])


def test_means_are_over_the_same_scenes_and_ranges_over_seeds() -> None:
    rows = [measurement("noisy", 1, 1, e, s, seed) for s, e in (("a", 1.0), ("b", 4.0)) for seed in (0, 1)]
    rows = [replace(m, rell2=m.rell2 * (1 + m.seed)) for m in rows]
    rows.append(measurement("half", 1, 1, 0.1, "a"))  # failed on b: its mean would be of another set
    (mean,) = results.over_scenes(rows)
    assert (mean.method, mean.scenes) == ("noisy", 2)
    spread = mean.errors["rell2"]
    assert (spread.mean, spread.low, spread.high) == pytest.approx((2 * math.sqrt(2), 2, 4))
    negative = results.points([measurement("x", 1, 1, -1e-5)])[0]
    assert negative.rell2 == pytest.approx(results.FLOOR)  # as good as its reference


def test_scene_table_flags_and_counts_wins() -> None:
    rows = [measurement("noisy", 1, 1, 1.0, scene) for scene in "ab"]
    rows += [measurement("x", 1, 1, 0.1, "a"), measurement("x", 1, 1, 2.0, "b")]
    rows = [replace(m, reference_rell2=0.01 if m.scene == "a" else 1e-4) for m in rows]
    table = {row[0]: row[1:] for row in tables.by_scene(rows, 1)}
    assert table["a"][-1] == "within 20 times the reference's own error" and table["b"][-1] == ""
    assert table["wins"][:2] == ["1", "1"]
    assert table["worst, against the best"][:2] == ["10 (a)", "2 (b)"]
    assert any("a at 1 spp" in note for note in tables.notes(rows))


def test_results_outlive_a_cut_line_but_no_nonsense(tmp_path: Path, measured: list[Measurement]) -> None:
    path = tmp_path / "results.jsonl"
    results.write(path, measured)
    assert list(results.read(path).values()) == measured
    whole = path.read_text()
    path.write_text(whole[:-40])
    assert len(results.read(path)) == len(measured) - 1
    path.write_text("{}\n" + whole)
    with pytest.raises(ImageError, match="line 1: is no measurement"):
        results.read(path)
