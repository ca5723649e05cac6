"""`plan`: what it predicts from measured scenes, what it chooses, what it says."""

import json
import math
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from pathfold.cli import app, console
from pathfold.cli.plan import point_record, record
from pathfold.images import ImageError
from pathfold.plan import check, choose, curves, prediction
from pathfold.plan.curves import Sample
from pathfold.plan.prediction import Estimate, Pilot, Prediction

TINY = Path(__file__).parent / "assets" / "library" / "tiny"
SPPS = (2, 4, 8, 16)


def scene(name: str, noise: float, speed: float = 1.0, scatter: Callable[[], float] = lambda: 1.0) -> list[Sample]:
    """Noise falls as 1 / spp; `clean` has an error in its square root, and takes 50 ms and descriptors."""
    times = {spp: speed * (30 + 100 * spp) for spp in SPPS}
    noisy = [Sample(name, "noisy", n, noise / n, times[n], 0) for n in SPPS]
    factor = scatter()
    return [*noisy, *(Sample(name, "clean", n, factor * math.sqrt(noise) * n**-0.7, 1.2 * times[n], 50) for n in SPPS)]


def test_a_law_that_holds_is_found() -> None:
    measured = [*scene("a", 1), *scene("b", 5), *scene("c", 30)]
    pilot = Pilot(4, 12 / 4, {"noisy": 860, "clean": 1032}, {"noisy": 0, "clean": 70})
    found = {curve[0].method: curve for curve in prediction.predict(measured, pilot)}
    for spp, noisy, clean in zip(SPPS, found["noisy"], found["clean"], strict=True):
        assert noisy.spp == clean.spp == spp and noisy.scenes == 3
        assert noisy.rell2.value == pytest.approx(12 / spp)
        assert clean.rell2.value == pytest.approx(math.sqrt(12) * spp**-0.7)
        assert clean.rell2.factor == pytest.approx(1)
        assert clean.seconds.value == pytest.approx((2.4 * (30 + 100 * spp) + 70) / 1000)
    pairs = prediction.cross_validated(measured)
    assert len(pairs) == 3 * 2 * len(SPPS)
    assert all(p.rell2.value == pytest.approx(s.rell2) for s, p in pairs)


def test_ranges_hold_as_many_new_scenes_as_they_should() -> None:
    rng = np.random.default_rng(3)
    hits = []
    for _ in range(300):
        named = [scene(str(i), rng.uniform(1, 9), scatter=lambda: rng.lognormal(0, 0.6)) for i in range(9)]
        pilot = Pilot(2, named[8][0].rell2, {"clean": 1}, {"clean": 1})
        (curve,) = prediction.predict([s for own in named[:8] for s in own], pilot)
        hits.append(curve[0].rell2.holds(named[8][len(SPPS)].rell2))
    assert prediction.held(8) == 8 and prediction.held(19) == 16
    assert abs(np.mean(hits) - 8 / 9) < 4 * math.sqrt(8 / 81 / 300)


def test_one_scene_predicts_but_cannot_tell_how_well() -> None:
    (curve, _) = prediction.predict(scene("a", 1), Pilot(2, 1, {"noisy": 1, "clean": 1}, {"noisy": 0, "clean": 1}))
    assert curve[0].rell2.factor == math.inf and curve[0].scenes == 1
    with pytest.raises(ImageError, match="takes two scenes"):
        check.markdown(scene("a", 1), "pathfold plan --check")


def curve(method: str, *points: tuple[int, float, float]) -> list[Prediction]:
    return [Prediction(method, n, Estimate(error, 1.5), Estimate(seconds, 1.1), 8) for n, error, seconds in points]


@pytest.fixture
def planned() -> choose.Plan:
    noisy = curve("noisy", (2, 1, 1), (8, 0.25, 4), (32, 0.0625, 16))
    clean = curve("clean", (2, 0.1, 2), (8, 0.05, 5), (32, 0.03, 17))
    return choose.Plan((64, 32), 2.0, (1.0, 9.0), [noisy, clean], {})


def test_the_cheapest_and_the_best_are_chosen_between_measured_spp(planned: choose.Plan) -> None:
    advice = choose.cheapest(planned, 0.0707)  # half way from 2 to 8 in log-log, and a little below
    assert advice.chosen and (advice.chosen.method, advice.chosen.spp) == ("clean", 5)
    assert [(p.method, p.spp) for p in advice.reached] == [("clean", 5), ("noisy", 29)]
    assert advice.safe and advice.safe.method == "clean" and advice.safe.rell2.high <= 0.0707 and advice.safe.spp > 5
    advice = choose.cheapest(planned, 0.04)
    assert [p.method for p in advice.missed] == ["noisy"] and advice.missed[0].spp == 32 and advice.safe is None
    advice = choose.best(planned, 1.5)
    assert advice.chosen and (advice.chosen.method, advice.chosen.spp) == ("noisy", 3)
    assert [(p.method, p.spp) for p in advice.missed] == [("clean", 2)]
    assert [(p.method, p.spp) for p in choose.front(planned).reached] == [
        ("noisy", 2),
        ("clean", 2),
        ("clean", 8),
        ("clean", 32),
    ]


def test_out_of_reach_tells_the_best_there_is(planned: choose.Plan) -> None:
    with pytest.raises(choose.PlanError, match=r"RelL2 0.001 is out of reach; .* is 0.03, clean at 32 spp in 17 s"):
        choose.cheapest(planned, 0.001)
    with pytest.raises(choose.PlanError, match=r"0.5 s are too few; .* is 1 s, noisy at 2 spp"):
        choose.best(planned, 0.5)


def test_measurements_are_read_as_written(tmp_path: Path) -> None:
    measured = [*scene("a", 1), *scene("b", 4)]
    curves.save(tmp_path / "curves.json", measured)
    for path in (tmp_path, tmp_path / "curves.json"):
        read = curves.read(path)
        assert [(s.scene, s.method, s.spp) for s in read] == [(s.scene, s.method, s.spp) for s in measured]
        np.testing.assert_allclose([s.rell2 for s in read], [s.rell2 for s in measured], rtol=1e-4)
    for text, words in (("[{}]", "is no curves.json"), ("[]", "no noisy picture"), ("{", "is no curves.json")):
        (tmp_path / "curves.json").write_text(text)
        with pytest.raises(ImageError, match=words):
            curves.read(tmp_path)


def test_the_check_compares_with_what_was_measured(capsys: pytest.CaptureFixture[str], tmp_path: Path) -> None:
    curves.save(tmp_path / "curves.json", [*scene("a", 1), *scene("b", 4), *scene("c", 16, speed=3)])
    assert command("plan", "--check", "--measurements", tmp_path) == 0
    told = capsys.readouterr().out
    assert "3 scenes, each predicted from the others" in told and "| clean | 1.00 | 1.00 (" in told
    assert "| b | 0.5 / 0.5 | 0.467 / 0.467 |" in told


def command(*arguments: object) -> int:
    import sys

    old, sys.argv = sys.argv, ["pathfold", *map(str, arguments)]
    try:
        return console.run(app)
    finally:
        sys.argv = old


def test_a_scene_is_planned_for(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    pytest.importorskip("mitsuba")
    pytest.importorskip("pyoidn")
    measured = [*scene("a", 1), *scene("b", 4)]
    measured += [Sample(s.scene, "oidn", s.spp, s.rell2, s.render_ms, s.denoise_ms) for s in measured if s.denoise_ms]
    curves.save(tmp_path / "curves.json", measured)
    arguments = ("plan", TINY / "scene.xml", "--measurements", tmp_path, "--size", "96x54")
    assert command(*arguments, "--error", 0.9) == 0
    text = " ".join(capsys.readouterr().out.split())
    assert "96x54; its noise at one sample per pixel is RelL2" in text
    assert "How sure: of 2 measured scenes" in text and "Left out: clean: " in text  # no such model
    assert "\N{RIGHTWARDS ARROW} " in text and "Render " in text
    assert command(*arguments, "--error", 1e-9) == console.INPUT
    assert "out of reach" in capsys.readouterr().err


def test_a_plan_as_data(planned: choose.Plan) -> None:
    told = json.loads(json.dumps(record(planned, choose.cheapest(planned, 0.04))))
    assert told["chosen"] == told["reached"][0] and told["chosen"]["engine"] == "onnxruntime"
    assert told["chosen"]["rell2"] <= 0.04 and told["chosen"]["rell2_range"][1] > 0.04
    assert [p["method"] for p in told["missed"]] == ["noisy"] and told["safe"] is None
    noisy = curve("noisy", (2, 1, 1))[0]
    assert point_record(replace(noisy, rell2=Estimate(1, math.inf)))["rell2_range"] is None


@pytest.mark.parametrize(
    ("arguments", "words"),
    [
        (["--error", 1], "either name a SCENE.xml"),
        ([TINY / "scene.xml", "--check"], "either name a SCENE.xml"),
        ([TINY / "scene.xml", "--error", 1, "--seconds", 1], "not both"),
        ([TINY / "scene.xml", "--seconds", 0], "not > 0"),
    ],
)
def test_wrong_arguments(arguments: list[object], words: str, capsys: pytest.CaptureFixture[str]) -> None:
    assert command("plan", *arguments) == console.USAGE
    assert words in capsys.readouterr().err


def test_the_shipped_curves_are_those_of_the_published_bench() -> None:
    published = Path(__file__).parent.parent / "docs" / "results" / "bench" / curves.FILE
    assert curves.SHIPPED.read_bytes() == published.read_bytes()
