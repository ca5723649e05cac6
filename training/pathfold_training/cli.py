"""`pathfold-train render | fit | export | evaluate`: the commands; each does its work in the module of that name."""

from __future__ import annotations

import json
import sys
from pathlib import Path
from typing import Annotated

import typer
from rich.console import Console

app = typer.Typer(
    no_args_is_help=True,
    add_completion=False,
    help="Render training data, train a model, export and evaluate it.",
)
console = Console(stderr=True)

DataFolder = Annotated[Path, typer.Option("--data", help="data set made by 'pathfold-train render'")]


@app.command()
def render(
    out: Annotated[Path, typer.Option("--out", help="data set folder; views already in it are kept")],
    procedural: Annotated[int, typer.Option(help="number of procedural views")] = 0,
    library: Annotated[Path | None, typer.Option(help="folder of Mitsuba scenes")] = None,
    cameras: Annotated[int, typer.Option(help="views of each library scene")] = 4,
    budget: Annotated[float, typer.Option(help="core-seconds of reference rendering per view")] = 10.0,
    size: Annotated[int, typer.Option(help="width and height of a view in pixels")] = 160,
    spp: Annotated[int, typer.Option(help="samples with descriptors stored per pixel")] = 16,
    workers: Annotated[int, typer.Option(help="views rendered at once")] = 2,
    seed: int = 0,
) -> None:
    """Render views with path descriptors and references."""
    from .render import render as run

    counts = run(out, procedural, library, budget, seed, size, spp, cameras, workers=workers, console=console)
    console.print(f"{out}: {counts['done']} views made, {counts['kept']} kept, {counts['failed']} failed")


@app.command()
def fit(
    preset: Annotated[str, typer.Argument(help="a preset's name (training/presets) or a .yaml file")],
    data: DataFolder,
    out: Annotated[Path, typer.Option("--out", help="folder of checkpoints; resumes from its last one")],
    seed: int = 0,
    threads: Annotated[int, typer.Option(help="CPU threads; 0 lets torch choose")] = 0,
    steps: Annotated[int | None, typer.Option(help="instead of the preset's")] = None,
    start_from: Annotated[Path | None, typer.Option(help="checkpoint or model folder to begin with")] = None,
) -> None:
    """Train a preset (Algorithm 1)."""
    from .config import load_preset
    from .fit import fit as run

    config = load_preset(preset)
    if steps is not None:
        config = config.model_copy(update={"optimiser": config.optimiser.model_copy(update={"steps": steps})})
    last = run(config, data, out, seed=seed, threads=threads, start_from=start_from)
    console.print(f"checkpoint: {last}")


@app.command()
def export(
    run: Annotated[Path, typer.Argument(help="folder of 'fit', with last.ckpt and record.json")],
    out: Annotated[Path, typer.Option("--out", "-o", help="model folder to write")],
    standalone: Annotated[bool, typer.Option(help="also graphs with the reconstruction inside")] = False,
) -> None:
    """Write a model folder: ONNX graphs, manifest and model card."""
    from .export import export as write

    checkpoint = run / "last.ckpt"
    if not checkpoint.is_file():
        raise ValueError(f"{run} holds no last.ckpt; give the --out folder of 'pathfold-train fit'")
    console.print(f"model: {write(checkpoint, out, json.loads((run / 'record.json').read_text()), standalone)}")


@app.command()
def evaluate(
    scenes: Annotated[Path, typer.Argument(help="folder of scene folders, each with scene.xml and reference.exr")],
    out: Annotated[Path, typer.Option("--out", "-o", help="folder for tables and pictures")],
    model: Annotated[list[str] | None, typer.Option(help="model name or folder; repeat for more")] = None,
    spp: int = 8,
    seeds: int = 3,
) -> None:
    """Compare models with the noisy input and OIDN on scenes with references."""
    from .evaluate import evaluate as run

    run(scenes, out, model or ["kpcn-vanilla", "kpcn-path", "kpcn-manifold"], spp=spp, seeds=seeds)


def main() -> None:
    """Entry point: errors that a user can mend are one line, without a traceback."""
    try:
        app()
    except ModuleNotFoundError as error:
        console.print(
            f"pathfold-train: {error.name} is not installed; pip install 'pathfold[train,mitsuba,bench]'",
            style="red",
        )
        sys.exit(2)
    except (ValueError, OSError, RuntimeError) as error:
        console.print(f"pathfold-train: {error}", style="red", highlight=False)
        sys.exit(1)
