"""`pathfold-train evaluate`: the bench at one spp, and manifold against vanilla seed by seed."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from tempfile import TemporaryDirectory

from pathfold.bench import candidates, results, run, subjects
from pathfold.bench.measurement import Measurement
from pathfold.pixels import save_sheet
from pathfold.report import tables
from rich.console import Console
from rich.progress import Progress


def evaluate(scenes: Path, out: Path, models: list[str], spp: int = 8, seeds: int = 3) -> list[Measurement]:
    """Measure every method on every scene and write results.jsonl, table.md and a picture per scene into `out`.

    `scenes` holds folders with scene.xml and reference.exr. Every run measures anew and replaces what `out` held.
    Raises ValueError where no such folder is found, or nothing could be measured.
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
    (out / "table.md").write_text(table(rows, spp), encoding="utf-8")
    return rows


def table(rows: Sequence[Measurement], spp: int) -> str:
    """Markdown: RelL2 per scene and method, all means, then manifold against vanilla."""
    seeds = len({row.seed for row in rows})
    lines = [f"RelL2 at {spp} spp, geometric mean over {seeds} render seeds, noise of the reference removed.", ""]
    lines += [tables.markdown(tables.by_scene(rows, spp)), tables.markdown(tables.by_method(rows))]
    return "\n".join([*lines, *(f"- {note}" for note in tables.notes(rows)), *paired(rows)]) + "\n"


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
