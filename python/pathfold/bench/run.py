"""The bench: measures every method on every scene, spp and seed; keeps what was measured; reports.

Every scene is measured in a process of its own: a crash costs that scene only, and memory is given back.
"""

import gc
import multiprocessing
import traceback
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from datetime import UTC, datetime
from multiprocessing.connection import Connection
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from pathfold import metrics
from pathfold.bench import candidates, machine, peers, results
from pathfold.bench.candidates import Candidate, Run
from pathfold.bench.contest import Contest, Known
from pathfold.bench.measurement import Measurement
from pathfold.bench.reference import Reference, shared_exposure
from pathfold.bench.subjects import Subject
from pathfold.denoiser import auto_exposure
from pathfold.images import OutputError, check_writable
from pathfold.pixels import write_png

RESULTS, PICTURES, REFERENCES = "results.jsonl", "pictures", "references"

Unit = tuple[int, int]  # spp, seed
Send = Callable[[Any], None]


@dataclass(frozen=True)
class Problem:
    """Something that was left out, and why."""

    what: str
    why: str

    def __str__(self) -> str:
        return f"{self.what}: {self.why}"


@dataclass(frozen=True)
class Progress:
    """Work done, in samples per pixel and a constant per frame; what is being done."""

    work: float
    text: str


@dataclass(frozen=True)
class Job:
    """One scene, and the methods that are still to be measured for each unit."""

    subject: Subject
    todo: dict[Unit, list[str]]  # names of candidates
    arguments: tuple[str, ...]  # what candidates.find makes them from
    pictures: Path
    run: str

    @property
    def work(self) -> float:
        return sum(work(self.subject, unit) for unit in self.todo)


def work(subject: Subject, unit: Unit) -> float:
    """How long a unit takes, roughly, against others."""
    spp = unit[0]
    return 2 * spp + 30.0 if is_first_seed(subject, unit) else spp + 6.0


def is_first_seed(subject: Subject, unit: Unit) -> bool:
    """Whether a unit is the first of its spp: the one that costs are taken at."""
    spp, seed = unit
    return seed == min(s for p, s in subject.units() if p == spp)


def measure(
    subjects: Sequence[Subject],
    methods: Sequence[Candidate],
    out: Path,
    pictures: Path,
    tell: Callable[[Progress | Problem, float], None],
    resume: bool = True,
) -> tuple[list[Measurement], list[Problem]]:
    """Measure what `out`/results.jsonl does not hold yet, line by line, and return all that it holds then.

    Lines of the same scene, spp, seed and method stay where scene, reference and method are unchanged; `resume`
    False measures all anew. Pictures of the first seed go to `pictures`. `tell` gets every event with the work that
    is planned. A scene or method that fails is a Problem and left out.
    """
    path = out / RESULTS
    kept = results.read(path) if resume else {}
    results.write(path, kept.values())
    run = datetime.now(UTC).isoformat(timespec="seconds")
    problems: list[Problem] = []
    jobs = []
    for subject in subjects:
        try:
            jobs.append(plan(subject, methods, kept, pictures, run))
        except Exception as error:
            problems.append(Problem(subject.name, _words(error)))
    total = sum(job.work for job in jobs)
    for problem in problems:
        tell(problem, total)
    with path.open("a", encoding="utf-8") as file:
        for job in jobs:
            for event in _events(job) if job.todo else ():
                if isinstance(event, Measurement):
                    kept[event.key] = event
                    file.write(results.line(event))
                    file.flush()
                    continue
                if isinstance(event, Problem):
                    problems.append(event)
                tell(event, total)
    results.write(path, kept.values())
    return list(kept.values()), problems


def plan(subject: Subject, methods: Sequence[Candidate], kept: dict[Any, Measurement], pictures: Path, run: str) -> Job:
    """What is still to be measured of a scene."""
    inputs = subject.fingerprint()
    todo = {}
    for spp, seed in subject.units():
        missing = []
        for method in methods:
            found = kept.get((subject.name, spp, seed, method.name))
            if not found or (found.inputs, found.identity) != (inputs, method.identity):
                missing.append(method.name)
        if missing:
            todo[spp, seed] = missing
    return Job(subject, todo, tuple(method.argument for method in methods), pictures, run)


def _events(job: Job) -> Any:
    """Run a job in a process of its own; yields Measurement, Problem and Progress as they come."""
    context = multiprocessing.get_context("spawn")  # Mitsuba and thread pools do not survive a fork
    receiver, sender = context.Pipe(duplex=False)
    process = context.Process(target=_work, args=(job, sender), daemon=True)
    process.start()
    sender.close()
    done = 0.0
    try:
        while True:
            try:
                event = receiver.recv()
            except EOFError:
                break
            done += event.work if isinstance(event, Progress) else 0
            yield event
        process.join()
        if process.exitcode:
            how = f"signal {-process.exitcode}" if process.exitcode < 0 else f"exit code {process.exitcode}"
            yield Problem(job.subject.name, f"its process ended with {how}; what it had measured is kept")
        yield Progress(job.work - done, job.subject.name)
    finally:
        if process.is_alive():
            process.terminate()
        process.join()


def _work(job: Job, sender: Connection) -> None:
    """The process of a job."""
    peers.keep_torch_out()
    try:
        measure_scene(job, sender.send)
    except KeyboardInterrupt:
        pass  # the parent got it too, and reports
    except Exception as error:
        sender.send(Problem(job.subject.name, _words(error)))
    finally:
        sender.close()


def measure_scene(job: Job, send: Send) -> None:
    """Measure all units of a job."""
    subject = job.subject
    loaded = _load(job, send)
    if not loaded:
        return
    references = []
    for frame in range(subject.frames):
        title = f"{subject.name}: reference {frame + 1} of {subject.frames}"
        send(Progress(0, title))
        bar = lambda done, title=title: send(Progress(0, f"{title}, {done:.0%}"))  # noqa: E731
        references.append(subject.reference(frame, bar))
    scale = shared_exposure(references)
    known = Known()
    for unit, names in job.todo.items():
        spp, seed = unit
        send(Progress(0, f"{subject.name}: {spp} spp, seed {seed}"))
        chosen = {name: loaded[name] for name in names if name in loaded}
        try:
            for measurement in measure_unit(job, unit, chosen, references, scale, known, send):
                send(measurement)
        except Exception as error:
            send(Problem(f"{subject.name}, {spp} spp, seed {seed}", _words(error)))
        gc.collect()
        send(Progress(work(subject, unit), f"{subject.name}: {spp} spp, seed {seed}"))


def _load(job: Job, send: Send) -> dict[str, tuple[Candidate, Run]]:
    needed = {name for names in job.todo.values() for name in names}
    loaded = {}
    for candidate in candidates.find_all(job.arguments):
        if candidate.name in needed:
            try:
                loaded[candidate.name] = candidate, candidate.load()
            except Exception as error:
                send(Problem(f"{job.subject.name}, {candidate.name}", _words(error)))
    return loaded


def measure_unit(
    job: Job,
    unit: Unit,
    chosen: dict[str, tuple[Candidate, Run]],
    references: Sequence[Reference],
    scale: float,
    known: Known,
    send: Send,
) -> Any:
    """All frames of one spp and seed; yields a Measurement for each method that got through."""
    subject, (spp, seed) = job.subject, unit
    recorded = {candidate.path_samples for candidate, _ in chosen.values()}
    first_seed = is_first_seed(subject, unit)
    contest: Contest | None = None

    def complain(name: str, error: Exception) -> None:
        send(Problem(f"{subject.name}, {spp} spp, seed {seed}, {name}", _words(error)))

    for frame, reference in enumerate(references):
        shot = subject.shoot(frame, spp, seed, recorded, reference.size, first_seed)
        if contest is None:
            color = np.ascontiguousarray(shot.buffers["color"])
            exposure = auto_exposure(color) if len(references) > 1 else None
            rounds = subject.options.rounds
            contest = Contest(chosen, scale=scale, exposure=exposure, rounds=rounds, known=known, complain=complain)
        images = contest.add(shot, reference, first_seed)
        if first_seed and frame == len(references) // 2:
            keep_pictures(job.pictures / subject.name, spp, images, reference, scale)
    width, height = references[0].size
    own = [reference.own_error for reference in references]
    common: dict[str, Any] = {
        "width": width,
        "height": height,
        "reference_spp": references[0].spp,
        "reference_rell2": None if None in own else float(np.mean(own)),  # type: ignore[arg-type]
        "inputs": subject.fingerprint(),
        "run": job.run,
        "machine": machine.machine(),
        "versions": machine.versions(),
        "commit": machine.commit(),
        "load": machine.load(),
    }
    for candidate, found in contest.results() if contest else ():
        yield Measurement(subject.name, spp, seed, candidate.name, identity=candidate.identity, **found, **common)


def keep_pictures(
    folder: Path, spp: int, images: dict[str, NDArray[np.float32]], reference: Reference, scale: float
) -> None:
    """METHOD-8spp.png and its FLIP error METHOD-8spp.flip.png (grey) of every picture, and reference.png."""
    folder.mkdir(parents=True, exist_ok=True)
    for name, image in images.items():
        write_png(folder / f"{name}-{spp}spp.png", metrics.display(image, scale))
        write_png(folder / f"{name}-{spp}spp.flip.png", metrics.flip_map(image, reference.mean, scale))
    write_png(folder / "reference.png", metrics.display(reference.mean, scale))


def make_folder(out: Path) -> None:
    """Make the output folder; raises OutputError where that fails or nothing can be written there."""
    try:
        out.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        raise OutputError(f"{out}: cannot be made: {error.strerror}") from error
    check_writable(out / RESULTS)


def _words(error: Exception) -> str:
    """An error in one line; of one that nobody expected, where it came from."""
    text = " ".join(str(error).split()) or type(error).__name__
    if isinstance(error, (KeyError, TypeError, AttributeError, IndexError, AssertionError)):
        place = traceback.extract_tb(error.__traceback__)[-1]
        text = f"{type(error).__name__} {text} ({Path(place.filename).name}, line {place.lineno})"
    return text
