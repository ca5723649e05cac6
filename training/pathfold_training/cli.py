"""`pathfold-train render | dataset | fit | average | export | evaluate | card`: each works in its module."""

from __future__ import annotations

import json
import math
import sys
from pathlib import Path
from typing import Annotated, Any, Literal

import typer
from pathfold import models
from pathfold.bench import about
from pathfold.cli.console import run as run_application
from rich.console import Console
from rich.progress import Progress
from rich.table import Table

from .dataset import contents, store
from .dataset.clean import clean
from .dataset.truth import BUDGET
from .release.card import write_card
from .release.evaluate import evaluate as run_evaluation

app = typer.Typer(
    no_args_is_help=True,
    add_completion=False,
    pretty_exceptions_enable=False,
    context_settings={"help_option_names": ["-h", "--help"]},
    help="Render training data, train a model, export and evaluate it.",
)
console = Console(stderr=True)

dataset = typer.Typer(no_args_is_help=True, help="What a data set holds; references to learn from.")
app.add_typer(dataset, name="dataset")


def _folder(out: Path) -> Path:
    """Callback of --out: refuses a file, before any work."""
    if out.is_file():
        raise ValueError(f"--out {out} is a file; give a folder")
    return out


Variant = Annotated[Literal["llvm_ad_rgb", "cuda_ad_rgb"], typer.Option(help="Mitsuba's; cuda_ad_rgb needs a GPU")]


@app.command()
def render(
    out: Annotated[Path, typer.Option("--out", callback=_folder, help="data set folder; views already in it are kept")],
    procedural: Annotated[int, typer.Option(min=0, help="number of generated scenes")] = 0,
    views: Annotated[
        int, typer.Option(min=1, help="views of each generated scene (--cameras: of a library scene)")
    ] = 1,
    library: Annotated[Path | None, typer.Option(help="folder of Mitsuba scenes")] = None,
    cameras: Annotated[int, typer.Option(min=1, help="views of each library scene")] = 4,
    budget: Annotated[
        float | None,
        typer.Option(
            min=0, help=f"core-seconds for a view's reference, {BUDGET} for new views; views that had less get new ones"
        ),
    ] = None,
    size: Annotated[int, typer.Option(min=16, help="width and height of a view in pixels")] = 128,
    spp: Annotated[
        int | None,
        typer.Option(min=1, help="samples per pixel, 16 for new views; views of another number get new ones"),
    ] = None,
    crop: Annotated[int, typer.Option(min=16, help="width and height of the windows that keep samples")] = 128,
    crops: Annotated[int, typer.Option(min=1, help="windows of a view, if it is larger than one")] = 1,
    zoom: Annotated[
        float,
        typer.Option(min=1, max=1000, help="views show windows of pictures 1 to this many times as wide as --size"),
    ] = 1,
    workers: Annotated[int, typer.Option(min=1, help="views rendered at once on this machine")] = 2,
    cluster: Annotated[str | None, typer.Option(help="address of a Dask scheduler whose workers render")] = None,
    variant: Variant = "llvm_ad_rgb",
    seed: Annotated[int, typer.Option(min=0)] = 0,
) -> None:
    """Render views: references, and samples with path descriptors.

    Without --procedural and --library it completes the views that are there.
    """
    from .dataset.render import render as run

    if budget is not None and not math.isfinite(budget):
        raise ValueError(f"--budget {budget}: give core-seconds per view, such as {BUDGET}")
    if not (procedural or library or store.begun(out)):
        raise ValueError(
            f"{out} holds no views to complete, and none are asked for: give --procedural N or --library DIR"
        )
    counts = run(
        out, procedural, library, budget, seed, size, spp, crop, crops, cameras,
        workers=workers, cluster=cluster, variant=variant, console=console, views_per_generated=views, zoom=zoom,
    )  # fmt: skip
    console.print(f"{out}: {counts['done']} views made, {counts['kept']} kept, {counts['failed']} failed")
    if counts["failed"]:
        console.print(f"reasons are in {out / 'render.log'}")
        if not counts["done"] + counts["kept"]:
            raise typer.Exit(1)


@dataset.command("info")
def dataset_info(
    folder: Annotated[Path, typer.Argument(metavar="DIR", help="data set made by 'pathfold-train render'")],
    as_json: Annotated[bool, typer.Option("--json", help="all figures as JSON on standard output")] = False,
    check: Annotated[
        bool, typer.Option("--check", help="read every byte; exit with 1 if a file is damaged or a reference gone")
    ] = False,
) -> None:
    """Say what a data set holds."""
    facts = contents.info(folder, check)
    if as_json:
        print(json.dumps(facts, indent=2))
    else:
        table = Table(show_header=False, box=None)
        for name, value in facts.items():
            table.add_row(name.replace("_", " "), _words(value))
        Console().print(table, highlight=False)
    if facts.get("damaged"):
        console.print(f"render them again: pathfold-train render --out {folder}", style="red")
        raise typer.Exit(1)


def _words(value: Any) -> str:
    """A figure, list or dictionary for people."""
    if isinstance(value, dict):
        return ", ".join(f"{key}: {_words(entry)}" for key, entry in value.items()) or "none"
    if isinstance(value, list):
        return ", ".join(map(_words, value)) or "none"
    return f"{value:.2g}" if isinstance(value, float) else str(value)


@dataset.command("clean")
def dataset_clean(
    folder: Annotated[Path, typer.Argument(metavar="DIR", help="data set made by 'pathfold-train render'")],
) -> None:
    """Make the references without noise that the pathfold presets learn from, by OIDN; those that are there stay."""
    with Progress(console=console, disable=not console.is_terminal) as progress:
        bar = progress.add_task("windows")
        made = clean(folder, lambda done, total: progress.update(bar, completed=done, total=total))
    console.print(f"{folder}: {made} references cleaned")


@dataset.command("sheet")
def dataset_sheet(
    folder: Annotated[Path, typer.Argument(metavar="DIR", help="data set made by 'pathfold-train render'")],
    out: Annotated[Path, typer.Option("--out", "-o", help="picture to write, .jpg or .png")],
    columns: Annotated[int, typer.Option(min=1, help="pictures in a row")] = 12,
) -> None:
    """Draw a contact sheet of all references."""
    if out.suffix.lower() not in (".jpg", ".jpeg", ".png"):
        raise ValueError(f"-o {out}: a contact sheet is written as .jpg or .png")
    console.print(f"{out}: {contents.sheet(folder, out, columns)} views")


@app.command()
def fit(
    preset: Annotated[str, typer.Argument(help="a preset's name (training/presets) or a .yaml file")],
    out: Annotated[
        Path, typer.Option("--out", callback=_folder, help="folder of checkpoints; resumes from its last one")
    ],
    data: Annotated[Path | None, typer.Option("--data", help="data set made by 'pathfold-train render'")] = None,
    render_on_the_fly: Annotated[
        bool, typer.Option("--render-on-the-fly", help="instead of --data: render generated scenes while training")
    ] = False,
    variant: Variant = "llvm_ad_rgb",
    seed: Annotated[int, typer.Option(min=0)] = 0,
    threads: Annotated[int, typer.Option(min=0, help="CPU threads; 0 lets torch choose")] = 0,
    devices: Annotated[int, typer.Option(min=1, help="GPUs (or processes, without one) that share each batch")] = 1,
    nodes: Annotated[int, typer.Option(min=1, help="machines, each with as many devices")] = 1,
    steps: Annotated[int | None, typer.Option(min=1, help="instead of the preset's")] = None,
    start_from: Annotated[Path | None, typer.Option(help="checkpoint or model folder to begin with")] = None,
) -> None:
    """Train a preset (Algorithm 1)."""
    from lightning.pytorch.utilities import rank_zero_only

    from .fit.live import Live
    from .fit.preset import load_preset
    from .fit.train import fit as run

    if (data is None) != render_on_the_fly:
        raise ValueError("give --data DIR, or --render-on-the-fly, and not both")
    config = load_preset(preset)
    if steps is not None:
        config = config.with_steps(steps)
    source = data or Live(variant)
    last = run(config, source, out, seed, threads, start_from=start_from, devices=devices, nodes=nodes)
    rank_zero_only(console.print)(f"checkpoint: {last}")


@app.command()
def average(
    runs: Annotated[list[Path], typer.Argument(metavar="RUN...", help="folders of 'fit', of one network")],
    out: Annotated[Path, typer.Option("--out", "-o", callback=_folder, help="folder of the averaged run")],
) -> None:
    """Average the weights of runs that went from one to the next. What else is recorded is the first one's."""
    from .release.average import average as run

    console.print(f"checkpoint: {run(runs, out)}")


@app.command()
def export(
    run: Annotated[Path, typer.Argument(help="folder of 'fit', with last.ckpt and record.json")],
    out: Annotated[Path, typer.Option("--out", "-o", callback=_folder, help="model folder to write")],
    standalone: Annotated[bool, typer.Option(help="also graphs with the reconstruction inside")] = False,
    data: Annotated[
        Path | None,
        typer.Option(
            help="data set to calibrate the int8 variant on, and on whose held-out views to measure its error and "
            "from which spp on paths can be left out"
        ),
    ] = None,
) -> None:
    """Write a model folder: ONNX graphs, manifest and model card. Of the pathfold family in int8, too, with --data."""
    from .fit.checkpoint import read_record
    from .fit.views import Stored
    from .release.export import export as write
    from .release.quantise import add_int8, can_be_quantised

    checkpoint = run / "last.ckpt"
    if not checkpoint.is_file():
        raise ValueError(f"{run} holds no last.ckpt; give the --out folder of 'pathfold-train fit'")
    stored = Stored(data) if data else None
    held_out = stored.held_out() if stored else ()
    record = read_record(run)
    console.print(f"model: {write(checkpoint, out, record, standalone, held_out)}")
    if stored and can_be_quantised(out):
        console.print(add_int8(out, stored), highlight=False)


@app.command()
def evaluate(
    scenes: Annotated[Path, typer.Argument(help="folder of scene folders, each with scene.xml and reference.exr")],
    out: Annotated[Path, typer.Option("--out", "-o", help="folder for tables and pictures")],
    model: Annotated[
        list[str] | None, typer.Option(help="model name or folder; repeat for more  [default: every shipped one]")
    ] = None,
    spp: Annotated[int, typer.Option(min=1, help="samples per pixel")] = 8,
    seeds: Annotated[int, typer.Option(min=1, help="render seeds of each scene")] = 3,
) -> None:
    """Compare models with the noisy input and OIDN on scenes with references."""
    chosen = model or list(models.available(models.shipped_directories()))
    run_evaluation(scenes, out, chosen, spp, seeds, about.command(["pathfold-train", *sys.argv[1:]]))


@app.command()
def card(
    folders: Annotated[list[Path], typer.Argument(metavar="MODEL...", help="model folders")],
    results: Annotated[Path, typer.Option(help="folder that 'evaluate' wrote")],
) -> None:
    """Write model cards anew, with the errors that were measured."""
    for folder in folders:
        write_card(folder, results)
        console.print(f"{folder / 'README.md'}")


def main() -> None:
    """Entry point: errors that a user can mend are one line, without a traceback."""
    sys.exit(run_application(app, "pathfold-train", mendable=(ValueError, OSError, RuntimeError)))
