"""From scenes to the data set: noisy samples with descriptors, and references in two independent halves."""

import logging
import multiprocessing
import time
import zlib
from collections.abc import Iterator
from dataclasses import asdict, dataclass
from multiprocessing.connection import wait
from multiprocessing.process import BaseProcess
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray
from pathfold import auto_exposure
from rich.console import Console
from rich.progress import BarColumn, MofNCompleteColumn, Progress, TextColumn, TimeRemainingColumn

from . import store
from .scenes.cameras import RejectedError

Array = NDArray[np.float32]
LIBRARY_DEPTH = (
    6  # scenes of a library state depths from 6 to 65; one value keeps the data alike, and cost grows with it
)
STUCK = 1200  # seconds after which a view's process is given up
ROUND = 32  # reference samples per pixel and half between two looks at clock and error
GOOD, POOR = 2e-4, 1e-2  # reference RelL2 at which rendering stops early, or may take HARD times the budget
HARD = 2
WORTHLESS = 0.25  # a reference noisier than this after all that teaches nothing

log = logging.getLogger("pathfold.render")


@dataclass(frozen=True)
class Task:
    """One view to render: a procedural seed, or camera `number` of a scene file."""

    id: str
    kind: str  # procedural | library
    scene: str
    split: str
    number: int
    seed: int
    size: int
    spp: int
    budget: float
    licence: str = "CC0-1.0"
    origin: str = "made in code"
    path: str = ""


def render(
    out: Path,
    procedural: int = 0,
    library: Path | None = None,
    budget: float = 10,
    seed: int = 0,
    size: int = 160,
    spp: int = 16,
    views_per_scene: int = 4,
    held_out: float = 0.1,
    workers: int = 2,
    console: Console | None = None,
) -> dict[str, int]:
    """Renders generated scenes and views of library scenes into the data set `out`, one process per view.

    `procedural` counts generated scenes, one view each; every scene in the folder `library` gives `views_per_scene`.
    `budget` is core-seconds per view for the reference. Views that exist are kept, so the same command continues an
    interrupted run; order and content depend on `seed` alone, the reference's sample count on the machine's speed
    too. A share `held_out` of the scenes is marked "val". Returns how many views are "done", "kept" and "failed";
    reasons are in out/render.log.
    """
    out.mkdir(parents=True, exist_ok=True)
    log.handlers = [logging.FileHandler(out / "render.log")]
    log.handlers[0].setFormatter(logging.Formatter("%(asctime)s %(message)s"))
    log.setLevel(logging.INFO)
    known = {line["id"] for line in store.recover(out)}
    wanted = plan(procedural, library, budget, seed, size, spp, views_per_scene, held_out)
    tasks = [task for task in wanted if task.id not in known]
    counts = {"done": 0, "kept": len(wanted) - len(tasks), "failed": 0}
    columns = (
        TextColumn("{task.description}"),
        BarColumn(),
        MofNCompleteColumn(),
        TimeRemainingColumn(),
        TextColumn("{task.fields[last]}"),
    )
    with Progress(*columns, console=console) as progress:
        bar = progress.add_task("views", total=len(wanted), completed=counts["kept"], last="")
        for task, line in _run(out, tasks, workers):
            if line is None:
                counts["failed"] += 1
            else:
                store.append_line(out, line)
                counts["done"] += 1
                log.info("%s: %d spp, reference RelL2 %.1e", task.id, line["reference_spp"], line["reference_rell2"])
            progress.update(bar, advance=1, last=task.id)
    return counts


def plan(
    procedural: int,
    library: Path | None,
    budget: float,
    seed: int,
    size: int,
    spp: int,
    views_per_scene: int,
    held_out: float,
) -> list[Task]:
    """All views of a data set in random order, so that any first part of it is as mixed as the whole."""
    from .scenes import library as scenes

    def split(name: str) -> str:
        return "val" if _entropy(seed, name, "split")[0] < held_out * 2**32 else "train"

    tasks = []
    for index in range(procedural):
        name = f"procedural-{seed}-{index:04d}"
        tasks.append(Task(name, "procedural", name, split(name), 0, seed, size, spp, budget))
    for entry in scenes.scan(library) if library else []:
        facts = {"licence": entry.licence, "origin": entry.origin, "path": str(entry.path)}
        for number in range(views_per_scene):
            where = f"{entry.name}-{seed}-{number}"
            tasks.append(
                Task(where, "library", entry.name, split(entry.name), number, seed, size, spp, budget, **facts)
            )
    order = np.random.default_rng(seed).permutation(len(tasks))
    return [tasks[i] for i in order]


def _entropy(seed: int, *words: object) -> NDArray[np.uint32]:
    """Four 32-bit seeds that belong to these words."""
    words_hash = zlib.crc32("/".join(map(str, words)).encode())
    return np.random.SeedSequence([seed, words_hash]).generate_state(4).astype(np.uint32)


def _run(out: Path, tasks: list[Task], workers: int) -> Iterator[tuple[Task, store.Line | None]]:
    """Each view in a process of its own: scenes are freed for good, and a crash costs that view only."""
    context = multiprocessing.get_context("spawn")
    waiting = list(reversed(tasks))
    running: dict[Any, tuple[Any, Task, Any, float]] = {}
    try:
        while waiting or running:
            while waiting and len(running) < workers:
                task = waiting.pop()
                mine, theirs = context.Pipe(duplex=False)
                process = context.Process(target=_work, args=(task, out, theirs))
                process.start()
                theirs.close()
                running[process.sentinel] = process, task, mine, time.monotonic()
            for sentinel in wait(list(running), timeout=5):
                process, task, pipe, _ = running.pop(sentinel)
                yield task, _collect(process, task, pipe)
            for process, _, _, start in running.values():
                if time.monotonic() - start > STUCK:
                    process.kill()
    finally:
        for process, *_ in running.values():
            process.kill()


def _collect(process: BaseProcess, task: Task, pipe: Any) -> store.Line | None:
    """The index line of a finished process, or None once the reason has been logged."""
    process.join()
    try:
        result = pipe.recv()
    except EOFError:
        result = f"its process died with exit code {process.exitcode}"
    if isinstance(result, str):
        log.warning("%s skipped: %s", task.id, result)
        return None
    return result


def _work(task: Task, out: Path, answer: Any) -> None:
    try:
        answer.send(render_view(task, out))
    except RejectedError as error:
        answer.send(str(error))
    except Exception as error:
        answer.send(f"{type(error).__name__}: {error}")


def render_view(task: Task, out: Path) -> store.Line:
    """Renders one view into the store and returns its index line; RejectedError where no view is worth its cost."""
    import drjit as dr
    import mitsuba as mi

    if mi.variant() != "llvm_ad_rgb":
        mi.set_variant("llvm_ad_rgb")
    from pathfold.mitsuba import trace

    begin = time.process_time()
    scene, kind, depth = _scene(task)
    seeds = [int(s) for s in _entropy(task.seed, task.id, "samples")]
    reference = _reference(scene, task.budget, depth, seeds[1:])
    if not reference["rell2"] < WORTHLESS:
        raise RejectedError(f"its reference has RelL2 {reference['rell2']:.2g} after {reference['spp']} spp")
    samples = trace(scene, spp=task.spp, seed=seeds[0], max_depth=depth)
    tensors = _tensors(samples, reference)
    line = {k: v for k, v in asdict(task).items() if k not in ("size", "path", "budget")}
    line |= {
        "content": kind,
        "width": task.size,
        "height": task.size,
        "reference_spp": reference["spp"],
        "max_depth": depth,
    }
    line |= {"reference_rell2": reference["rell2"], "cpu_seconds": round(time.process_time() - begin, 1)}
    del scene
    dr.flush_malloc_cache()
    return store.write_view(out, line, tensors, {"exposure": str(exposure(tensors["reference.color"]))})


def _draft(depth: int) -> Any:
    from pathfold.mitsuba import trace_mean

    return lambda scene: trace_mean(scene, spp=8, seed=1, max_depth=depth)["color"]


def _scene(task: Task) -> tuple[Any, str, int]:
    """The scene with its camera aimed, what it shows, and the path depth."""
    import drjit as dr

    from .scenes import cameras, library, procedural

    size = task.size, task.size
    if task.kind == "library":
        scene = library.load(library.Entry(Path(task.path), task.scene, task.licence, task.origin))
        dr.set_thread_count(1)  # after loading: Mitsuba's image readers wait for a second thread
        rng = np.random.default_rng(_entropy(task.seed, task.scene, "cameras"))
        library.choose(scene, task.number, _draft(LIBRARY_DEPTH), rng, size)
        return scene, "library", LIBRARY_DEPTH
    reasons = []
    for attempt in range(4):
        dr.set_thread_count(2)
        state = _entropy(task.seed, task.id, attempt)
        built = procedural.build(int(state[0]))
        scene = built.stage.load()
        dr.set_thread_count(1)
        try:
            cameras.find(scene, built.propose, _draft(built.max_depth), np.random.default_rng(state[1]), size)
            return scene, built.kind, built.max_depth
        except RejectedError as error:
            reasons.append(f"{built.kind} ({error})")
    raise RejectedError("; ".join(reasons))


def _reference(scene: Any, budget: float, depth: int, seeds: list[int]) -> dict[str, Any]:
    """Means of two independent halves, rendered in rounds until the error is small or the core-seconds are spent."""
    from pathfold.mitsuba import trace_mean

    halves: list[dict[str, Any]] = [{}, {}]
    rounds, start, rell2 = 0, time.process_time(), np.inf
    while True:
        for half, seed in zip(halves, seeds, strict=False):
            mean = trace_mean(scene, spp=ROUND, seed=(seed + rounds) % 2**32, max_depth=depth)
            for name in ("color", "diffuse", "diffuse.albedo"):
                half[name] = half.get(name, 0) + (mean[name].astype(np.float64) - half.get(name, 0)) / (rounds + 1)
        rounds += 1
        if rounds == 1:
            compiled = time.process_time() - start
        a, b = (half["color"] for half in halves)
        scale = exposure(np.moveaxis((a + b) / 2, -1, 0))
        rell2 = half_error(scale * a, scale * b)  # exposed: the metric's 0.01 would hide all noise of a dark scene
        spent = time.process_time() - start - (compiled if rounds > 1 else 0)
        if rounds > 1 and (rell2 < GOOD or spent > budget * (HARD if rell2 > POOR else 1)):
            return {"halves": halves, "spp": 2 * ROUND * rounds, "rell2": rell2}


def half_error(a: NDArray[Any], b: NDArray[Any]) -> float:
    """RelL2 against the truth of the mean of two independent, equally noisy halves."""
    return float(np.mean((a - b) ** 2 / 4 / (((a + b) / 2) ** 2 + 1e-2)))


def _tensors(samples: Any, reference: dict[str, Any]) -> store.Arrays:
    """A view's arrays in the store's names and layout."""

    def channels_first(values: Any, kind: type) -> NDArray[Any]:
        return np.moveaxis(np.asarray(values), -1, -3).astype(kind)

    single = {
        "radiance": samples.radiance,
        "diffuse": samples.diffuse,
        "depth": samples.depth,
        "density": samples.density,
    }
    half = {
        "diffuse.albedo": samples.diffuse_albedo,
        "albedo": samples.albedo,
        "normal": samples.normal,
        "descriptor": samples.descriptor,
    }
    tensors = {f"samples.{k}": channels_first(v, np.float32) for k, v in single.items()}
    tensors |= {f"samples.{k}": channels_first(v, np.float16) for k, v in half.items()}
    a, b = reference["halves"]
    tensors |= {f"reference.{k}": channels_first((a[k] + b[k]) / 2, np.float32) for k in a}
    tensors |= {f"reference.half_{n}.color": channels_first(h["color"], np.float32) for n, h in (("a", a), ("b", b))}
    tensors["importance"] = importance(tensors["samples.radiance"], tensors["reference.color"])
    return tensors


def importance(radiance: Array, reference: Array) -> Array:
    """Weight [H, W] with mean 1 for drawing crops: noise of the samples [S, 3, H, W], detail of the reference."""
    level = reference.mean(0) + 0.1 * float(reference.mean()) + 1e-6
    noise = np.minimum(np.nan_to_num(radiance.mean(1), posinf=0).std(0) / level, 10)
    detail = sum(np.abs(g) for g in np.gradient(np.log(level)))
    weight = 0.3 + sum(np.minimum(part / max(float(part.mean()), 1e-6), 4) for part in (noise, detail))
    reach = min(9, *weight.shape)
    for axis in (0, 1):
        weight = np.apply_along_axis(
            lambda row: np.convolve(np.pad(row, reach // 2, "edge"), np.ones(reach) / reach, "valid"), axis, weight
        )
    return (weight / weight.mean()).astype(np.float32)


def exposure(color: NDArray[Any]) -> float:
    """Scale that brings the log-average luminance of [3, H, W] to 0.18, by the SDK's own rule; 1 if black."""
    return auto_exposure(np.moveaxis(color, 0, -1).astype(np.float32))
