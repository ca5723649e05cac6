"""From scenes to the data set: which views it has, who renders them, and what is taken in."""

from __future__ import annotations

import logging
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import numpy as np
from rich.console import Console
from rich.progress import BarColumn, MofNCompleteColumn, Progress, TextColumn, TimeRemainingColumn

from ..files import make_folder
from ..scenes import library as scenes
from ..scenes.faults import Gallery
from ..scenes.procedural import GENERATOR
from . import farm, store
from .trace import DESCRIPTION, Task, entropy
from .truth import BUDGET, GOOD

SPP = 16  # of the samples of new views

log = logging.getLogger("pathfold.render")


def render(
    out: Path,
    procedural: int = 0,
    library: Path | None = None,
    budget: float | None = None,
    seed: int = 0,
    size: int = 128,
    spp: int | None = None,
    crop: int = 128,
    crops: int = 1,
    views_per_scene: int = 4,
    held_out: float = 0.1,
    workers: int = 2,
    cluster: str | None = None,
    variant: str = "llvm_ad_rgb",
    console: Console | None = None,
    views_per_generated: int = 1,
    zoom: float = 1,
) -> dict[str, int]:
    """Renders generated scenes and views of library scenes into the data set `out`.

    `procedural` counts generated scenes, which give `views_per_generated` each; every scene in the folder `library`
    gives `views_per_scene`.
    `budget` is core-seconds per view for the reference, BUDGET for new views if it is None. `spp` samples are stored of
    `crops` windows of `crop` pixels. New views are windows of pictures 1 to `zoom` times as wide. Views that exist are
    kept, so the same command continues an interrupted run; those of `out` whose samples are missing, or of another
    number than the given `spp`, get new ones, and those whose references are missing, or had less than the given
    `budget` and are not good, get new references; crops and whatever else there is stay.
    Order and content depend on `seed` alone, the reference's sample count on the machine's speed too. A share
    `held_out` of the scenes is marked "val". `cluster` is the address of a Dask scheduler whose workers render instead
    of `workers` processes. Returns how many views are "done", "kept" and "failed"; reasons are in out/render.log.
    Raises OSError where a file cannot be written; all that was written before is whole.
    """
    spend = BUDGET if budget is None else budget
    common = {"seed": seed, "size": size, "spp": spp or SPP, "budget": spend, "crop": crop, "crops": crops}
    common["zoom"] = zoom
    wanted = plan(procedural, library, views_per_scene, held_out, views_per_generated, variant=variant, **common)
    make_folder(out)
    with _log_file(out / "render.log"):
        lines = {line["id"]: line for line in store.recover(out) if not _lost(line)}
        tasks = _missing(out, wanted, lines, spp, budget, variant)
        total = len({task.id for task in wanted} | set(lines))
        counts = {"done": 0, "kept": total - len(tasks), "failed": 0}
        results = farm.cluster(tasks, cluster) if cluster else farm.local(tasks, workers)
        gallery = _gallery(out, lines)
        report = _Report(out, total, counts["kept"], console or Console(stderr=True))
        with report.bar:
            for task, result in results:
                line = _take_in(out, task, result, gallery)
                counts["failed" if line is None else "done"] += 1
                report.view(task, line)
    return counts


def _lost(line: store.Line) -> bool:
    """Its reference is gone, and so is the generator that made its scene: the view has to be made anew."""
    if store.REFERENCES in line["files"] or line["kind"] != "procedural" or line["generator"] == GENERATOR:
        return False
    made_by = line["generator"]
    log.warning("%s left out: its reference is lost, and generator %s that made its scene is too", line["id"], made_by)
    return True


def _missing(
    out: Path, wanted: list[Task], lines: dict[str, store.Line], spp: int | None, budget: float | None, variant: str
) -> list[Task]:
    """Views to render: those that are new, and of the others what they lack (at `spp` and `budget`, where given)."""
    paths = {task.id: task.path for task in wanted}
    tasks = [task for task in wanted if task.id not in lines]
    for line in lines.values():
        had = line["budget"]
        spend = max(had, budget or 0.0)
        better = spend > had and line["reference_rell2"] >= GOOD  # a good one would come out the same
        lacks = {
            store.REFERENCES: better or not store.present(out, line, store.REFERENCES),
            store.SAMPLES: (spp or line["spp"]) != line["spp"] or not store.present(out, line, store.SAMPLES),
        }
        if any(lacks.values()):
            path = str(paths.get(line["id"], line["path"]))
            if path and not Path(path).exists():
                raise FileNotFoundError(f"{path} is gone; say with --library where the scene of {line['id']} is now")
            facts = {name: line[name] for name in DESCRIPTION} | {"size": line["width"], "spp": spp or line["spp"]}
            kinds = tuple(kind for kind, wanting in lacks.items() if wanting)
            tasks.append(Task(**facts, path=path, budget=spend, variant=variant, known=line, kinds=kinds))
    return tasks


def _take_in(out: Path, task: Task, result: farm.Result, gallery: Gallery) -> store.Line | None:
    """Writes a view and returns its line, or None once the reason why not has been logged."""
    if isinstance(result, str):
        log.warning("%s skipped: %s", task.id, result)
        return None
    line, tensors = result
    if not task.known and (fault := gallery.fault(tensors["reference.color"], "window" in line)):
        log.warning("%s skipped: %s", task.id, fault)
        return None
    if "reference.color" in tensors:
        gallery.add(task.id, tensors["reference.color"])
    line = store.write(out, line | {"files": (task.known or {}).get("files", {})}, tensors)
    store.append_line(out, line)
    return line


def _gallery(out: Path, lines: dict[str, store.Line]) -> Gallery:
    gallery = Gallery()
    for view, line in lines.items():
        if store.present(out, line, store.REFERENCES):
            gallery.add(view, store.reference_color(out, view))
    return gallery


def plan(
    procedural: int,
    library: Path | None,
    views_per_scene: int,
    held_out: float,
    views_per_generated: int = 1,
    **common: Any,
) -> list[Task]:
    """All views of a data set in random order, so that any first part of it is as mixed as the whole.

    `common` are fields that all tasks share, `seed` among them.
    """
    seed = common["seed"]

    def split(name: str) -> str:
        return "val" if entropy(seed, name, "split")[0] < held_out * 2**32 else "train"

    numbers = range(views_per_generated)
    tasks = [procedural_task(index, split, number, **common) for number in numbers for index in range(procedural)]
    for entry in scenes.scan(library) if library else []:
        facts: dict[str, Any] = {"licence": entry.licence, "origin": entry.origin, "path": str(entry.path.resolve())}
        for number in range(views_per_scene):
            where = f"{entry.name}-{seed}-{number}"
            tasks.append(Task(where, "library", entry.name, split(entry.name), number, **common, **facts))
    order = np.random.default_rng(seed).permutation(len(tasks))
    return [tasks[i] for i in order]


def procedural_task(index: int, split: Callable[[str], str], number: int = 0, **common: Any) -> Task:
    """View `number` of generated scene `index`; the first one has the scene's name."""
    name = f"procedural-{common['seed']}-{index:04d}"
    return Task(f"{name}-{number}" if number else name, "procedural", name, split(name), number, **common)


class _Report:
    """How far rendering is: a bar on a terminal, and lines in out/render.log anyway."""

    def __init__(self, out: Path, total: int, kept: int, console: Console) -> None:
        self.total, self.done, self.kept = total, kept, kept
        self.paths, self.start = 0, time.monotonic()
        columns = (
            TextColumn("{task.description}"),
            BarColumn(),
            MofNCompleteColumn(),
            TextColumn("{task.fields[speed]}"),
            TimeRemainingColumn(),
            TextColumn("{task.fields[last]}"),
        )
        self.bar = Progress(*columns, console=console, disable=not console.is_terminal)
        self.views = self.bar.add_task("views", total=total, completed=kept, speed="", last="")
        if not console.is_terminal:
            console.print(f"rendering {total - kept} views; progress is in {out / 'render.log'}")

    def view(self, task: Task, line: store.Line | None) -> None:
        """One more is finished; `line` is None if it was not taken in."""
        self.done += 1
        if line:
            if store.REFERENCES in task.kinds:
                self.paths += line["reference_spp"] * line["width"] * line["height"]
            if store.SAMPLES in task.kinds:
                self.paths += line["spp"] * len(line["crops"]) * line["crop"] ** 2
        seconds = time.monotonic() - self.start
        left = seconds / (self.done - self.kept) * (self.total - self.done)
        speed = f"{self.paths / seconds / 1e6:.2f} Mpaths/s"
        facts = f", {line['reference_spp']} spp, reference RelL2 {line['reference_rell2']:.1e}" if line else ""
        clock = f"{int(left / 60)}:{int(left % 60):02d} min left"
        log.info("%d/%d views, %s, %s: %s%s", self.done, self.total, speed, clock, task.id, facts)
        self.bar.update(self.views, advance=1, speed=speed, last=task.id)


@contextmanager
def _log_file(path: Path) -> Iterator[None]:
    """What `pathfold` logs meanwhile goes to the file too."""
    logger = logging.getLogger("pathfold")
    handler = logging.FileHandler(path)
    handler.setFormatter(logging.Formatter("%(asctime)s %(message)s"))
    handler.handleError = lambda record: None  # type: ignore[method-assign]  # a full disk is told once, by the store
    level = logger.level
    logger.addHandler(handler)
    logger.setLevel(logging.INFO)
    try:
        yield
    finally:
        logger.removeHandler(handler)
        logger.setLevel(level)
        handler.close()
