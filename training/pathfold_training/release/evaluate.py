"""`pathfold-train evaluate`: the bench at one spp, and manifold against vanilla seed by seed."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from tempfile import TemporaryDirectory

from pathfold.bench import candidates, results, run, subjects
from pathfold.bench.about import About
from pathfold.bench.measurement import Measurement
from pathfold.images import replacing
from pathfold.pixels import save_sheet
from pathfold.report import tables, write
from rich.console import Console
from rich.progress import Progress


def evaluate(
    scenes: Path, out: Path, models: list[str], spp: int = 8, seeds: int = 3, command: str = "pathfold-train evaluate"
) -> list[Measurement]:
    """Measure every method on every scene and write results.jsonl, table.md and a picture per scene into `out`.

    `command` is what the table says that it was made by. `scenes` holds folders with scene.xml and reference.exr. Every
    run measures anew and replaces what `out` held. Raises ValueError where no such folder is found, or nothing could be
    measured.
    """
    folders = sorted(p.parent for p in scenes.glob("*/reference.exr") if (p.parent / "scene.xml").is_file())
    if not folders:
        raise ValueError(f"{scenes} has no folder with scene.xml and reference.exr")
    found = subjects.find_all(folders, subjects.Options(spps=(spp,), seeds=seeds))
    methods = candidates.find_all([*candidates.COMPARED, *models])
    run.make_folder(out)
    terminal = Console(stderr=True)
    with TemporaryDirectory(prefix="pathfold-") as folder, Progress(console=terminal) as progress:
        bar = progress.add_task("scenes")

        def tell(event: run.Progress | run.Problem, total: float) -> None:
            if isinstance(event, run.Problem):
                progress.console.print(f"left out: {event}", style="red", highlight=False)
            else:
                progress.update(bar, advance=event.work, total=total, description=event.text)

        pictures = Path(folder)
        rows, problems = run.measure(found, methods, out, pictures, tell, resume=False)
        if not rows:
            raise ValueError(f"nothing could be measured: {problems[0]}")
        for scene in results.names(rows, "scene"):
            sheet = [pictures / scene / f"{method.name}-{spp}spp.png" for method in methods]
            shown = [path for path in [*sheet, pictures / scene / "reference.png"] if path.is_file()]
            save_sheet(out / f"{scene}-{spp}spp.jpg", shown)
    About(command, tuple(map(str, problems))).save(out)
    with replacing(out / write.TABLE) as unfinished:
        unfinished.write_text(table(*write.read(out)), encoding="utf-8")
    return rows


def table(rows: Sequence[Measurement], about: About) -> str:
    """Markdown: RelL2 per scene and method, all means, then manifold against vanilla."""
    spp, seeds = rows[0].spp, len({row.seed for row in rows})
    scenes, methods = results.names(rows, "scene"), results.names(rows, "method")
    pictures = ", ".join(f"[{scene}]({scene}-{spp}spp.jpg)" for scene in scenes)
    lines = [f"# Errors at {spp} spp", ""]
    lines += [f"RelL2, geometric mean over {seeds} render seeds, noise of the reference removed.", ""]
    order = ", ".join([*methods, "the reference"])
    lines += [f"    {about.command}", "", f"Pictures, in rows of three {order}: {pictures}.", ""]
    lines += [tables.markdown(tables.by_scene(rows, spp)), tables.markdown(tables.by_method(rows))]
    lines += [f"- {note}" for note in write.notes_of(rows, about)]
    lines += [f"- {name}: {value}" for name, value in write.facts_of(rows).items()]
    return "\n".join([*lines, *paired(rows)]) + "\n"


def paired(rows: Sequence[Measurement]) -> list[str]:
    """Manifold against vanilla, scene by scene and seed by seed."""
    by = {(row.scene, row.seed, row.method): row.rell2 for row in rows}
    pairs: dict[str, list[float]] = {}
    for (scene, seed, method), error in by.items():
        if method == "kpcn-manifold" and (base := by.get((scene, seed, "kpcn-vanilla"))):
            pairs.setdefault(scene, []).append(error / base)
    if not pairs:
        return []
    lines = ["", "| kpcn-manifold / kpcn-vanilla | RelL2 ratio per seed | geometric mean |", "|---|---|---|"]
    for scene, ratios in pairs.items():
        lines.append(f"| {scene} | {', '.join(f'{r:.3f}' for r in ratios)} | {results.geometric(ratios):.3f} |")
    every = results.geometric([r for rs in pairs.values() for r in rs])
    return [*lines, f"| **all** | | **{every:.3f}** |"]
