"""The cheapest spp and method for a scene: a small rendering of it tells its noise and times, measurements the rest."""

from collections.abc import Sequence
from dataclasses import dataclass, field
from math import log, sqrt
from pathlib import Path
from statistics import median

from pathfold import metrics
from pathfold.bench import candidates, results
from pathfold.bench.candidates import NOISY, Candidate, Run
from pathfold.bench.contest import Image
from pathfold.bench.shot import Buffers
from pathfold.bench.subjects import MitsubaSubject, Options
from pathfold.bench.timing import in_turns
from pathfold.plan.curves import Sample
from pathfold.plan.prediction import Pilot, Prediction, between, noises, predict

PIXELS = 320 * 180  # of a pilot
SPP = 8  # of a pilot; the measured one next to it
ROUNDS = 3


@dataclass(frozen=True)
class Plan:
    """What was found out about a scene. Errors are RelL2; times are for the whole picture on this machine."""

    size: tuple[int, int]
    noise: float  # RelL2 of the noisy picture at one sample per pixel
    measured_noise: tuple[float, float]  # least and largest of the measured scenes
    curves: list[list[Prediction]]
    left_out: dict[str, str]  # method -> why


@dataclass(frozen=True)
class Advice:
    """Predictions to choose from."""

    reached: list[Prediction]  # one per method, the best first; without a target, those that nothing beats
    missed: list[Prediction] = field(default_factory=list)  # methods off the target, with their least error or time
    chosen: Prediction | None = None
    safe: Prediction | None = None  # the cheapest whose whole interval is below the wanted error


class PlanError(RuntimeError):
    """A plan that cannot be made; the message says why, and what would help."""


def look(path: Path, measured: Sequence[Sample], size: tuple[int, int] | None) -> Plan:
    """Render a scene small, run every measured method that is installed on it, and predict.

    `size`: width and height of the picture that is planned; None: the film's. Raises SceneError, PlanError.
    """
    spp = min({s.spp for s in measured if s.method == NOISY}, key=lambda n: abs(log(n / SPP)))
    subject = MitsubaSubject(path, path.stem, Options(rounds=ROUNDS))
    wanted = size or subject.size
    runs, left_out = _load([s.method for s in measured if s.spp == spp])
    recorded = {candidate.path_samples for candidate, _ in runs.values()}
    small = _shrunk(wanted)
    shot = subject.shoot(0, spp, 0, recorded, small, first_seed=True)
    images, took = _denoise(runs, shot.buffers, spp, left_out)
    cleaned = [method for method in images if method != NOISY]
    if not cleaned:
        reasons = "; ".join(f"{method}: {why}" for method, why in left_out.items())
        raise PlanError(f"no measured denoiser runs here ({reasons or 'none was measured'}); give other --measurements")
    errors = {m: results.geometric(s.rell2 for s in measured if (s.method, s.spp) == (m, spp)) for m in cleaned}
    clean = images[min(errors, key=errors.__getitem__)]  # stands for the reference
    scale = wanted[0] * wanted[1] / (small[0] * small[1])
    render = {method: scale * median(shot.rendering_for(runs[method][0])) for method in images}
    noise = metrics.rell2(shot.buffers["color"], clean)
    pilot = Pilot(spp, noise, render, {method: scale * ms for method, ms in took.items()})
    known = noises(measured).values()
    return Plan(wanted, spp * noise, (min(known), max(known)), predict(measured, pilot), left_out)


def cheapest(plan: Plan, error: float) -> Advice:
    """For each method the fewest samples that come down to an error, the least time first.

    Raises PlanError where none does.
    """
    reached: list[Prediction] = []
    missed: list[Prediction] = []
    safe: list[Prediction] = []
    for curve in plan.curves:
        levels = _every_spp(curve)
        enough = [p for p in levels if p.rell2.value <= error]
        (reached if enough else missed).append(enough[0] if enough else min(levels, key=lambda p: p.rell2.value))
        safe += [p for p in levels if p.rell2.high <= error][:1]
    if not reached:
        least = min(missed, key=lambda p: p.rell2.value)
        raise PlanError(
            f"RelL2 {error:.3g} is out of reach; the least that measurements tell of is {least.rell2.value:.3g}, "
            f"{least.method} at {least.spp} spp in {least.seconds.value:.3g} s: ask for that, or bench more spp"
        )
    by_time = sorted(reached, key=lambda p: p.seconds.value)
    return Advice(by_time, missed, by_time[0], min(safe, key=lambda p: p.seconds.value, default=None))


def best(plan: Plan, seconds: float) -> Advice:
    """For each method the spp of least error within a time, the least error first. Raises PlanError where none fits."""
    reached, missed = [], []
    for curve in plan.curves:
        levels = _every_spp(curve)
        fitting = [p for p in levels if p.seconds.value <= seconds]
        if fitting:
            reached.append(min(fitting, key=lambda p: p.rell2.value))
        else:
            missed.append(min(levels, key=lambda p: p.seconds.value))
    if not reached:
        least = min(missed, key=lambda p: p.seconds.value)
        raise PlanError(
            f"{seconds:.3g} s are too few; the least that measurements tell of is {least.seconds.value:.3g} s, "
            f"{least.method} at {least.spp} spp: allow that, plan a smaller --size, or bench fewer spp"
        )
    by_error = sorted(reached, key=lambda p: p.rell2.value)
    return Advice(by_error, missed, by_error[0])


def front(plan: Plan) -> Advice:
    """The measured spp and methods that no other beats in both time and error, by time."""
    found: list[Prediction] = []
    for point in sorted((p for curve in plan.curves for p in curve), key=lambda p: p.seconds.value):
        if not found or point.rell2.value < found[-1].rell2.value:
            found.append(point)
    return Advice(found)


def _every_spp(curve: Sequence[Prediction]) -> list[Prediction]:
    return [between(curve, spp) for spp in range(curve[0].spp, curve[-1].spp + 1)]


def _shrunk(size: tuple[int, int]) -> tuple[int, int]:
    """The size of a pilot: at most some PIXELS, the aspect kept."""
    scale = min(1.0, sqrt(PIXELS / (size[0] * size[1])))
    return max(1, round(scale * size[0])), max(1, round(scale * size[1]))


def _load(methods: Sequence[str]) -> tuple[dict[str, tuple[Candidate, Run]], dict[str, str]]:
    """The measured methods that run here, and why others do not."""
    runs, left_out = {}, {}
    for method in dict.fromkeys(methods):
        try:
            candidate = candidates.find(method)
            runs[method] = candidate, candidate.load()
        except Exception as error:  # whatever is missing or broken is said beside the plan
            left_out[method] = " ".join(str(error).split())
    return runs, left_out


def _denoise(
    runs: dict[str, tuple[Candidate, Run]], buffers: Buffers, spp: int, left_out: dict[str, str]
) -> tuple[dict[str, Image], dict[str, float]]:
    """Pictures and milliseconds of the methods; one that fails goes to `left_out`."""
    images, calls = {}, {}
    for method, (candidate, run) in runs.items():
        read = {name: buffers[name] for name in candidate.reads & buffers.keys()}
        try:
            images[method] = run(read, None, spp)
        except Exception as error:
            left_out[method] = " ".join(str(error).split())
            continue
        if method != NOISY:
            calls[method] = lambda run=run, read=read: run(read, None, spp)
    took = {method: median(runs) for method, runs in in_turns(calls, ROUNDS).items()}
    return images, {NOISY: 0.0, **took}
