"""Checkpoints of `fit`, and the record beside one that says how the weights came to be."""

from __future__ import annotations

import json
import platform
import subprocess
from pathlib import Path
from types import NoneType

import torch
from lightning.pytorch.utilities import rank_zero_only
from pydantic import ValidationError

from ..dataset.store import Line
from ..files import read_object
from .finite import not_finite
from .preset import Config, problems

RECORD = "record.json"
START = "give a checkpoint of 'pathfold-train fit' or a model folder of 'pathfold-train export'"


def load_checkpoint(path: Path) -> tuple[Config, dict]:
    """The preset of a checkpoint of `fit`, and its state. Raises ValueError naming a file that is none, damaged,
    or whose weights are not finite."""
    try:
        state = torch.load(path, map_location="cpu", weights_only=True)
        config = Config.model_validate(state["hyper_parameters"]["config"])  # keys newer than the run have defaults
        _ = state["state_dict"], state["global_step"], training_seconds(state)
    except OSError as error:
        raise ValueError(f"cannot read {path}: {error.strerror}; {START}") from error
    except ValidationError as error:
        raise ValueError(f"{path} is of another version, whose preset does not fit: {problems(error)}") from error
    except Exception as error:  # torch's are of many kinds, as the bytes come
        raise ValueError(f"{path} is no checkpoint of 'pathfold-train fit', or is damaged; give another") from error
    if name := not_finite(state["state_dict"]):
        raise ValueError(f"{path}: weight {name} is not finite; train again into another --out, or give another run")
    return config, state


def read_record(run: Path) -> dict:
    """A run's record.json. Raises ValueError naming it where it is gone or damaged."""
    keys = {"config": dict, "seed": int, "started_from": (dict, NoneType), "commit": str, "hardware": str, "data": dict}
    return read_object(run / RECORD, keys, "give another folder of 'pathfold-train fit'")


def read_manifest(folder: Path) -> dict:
    """An exported model's manifest. Raises ValueError naming it where it is gone, damaged or not `export`'s."""
    return read_object(
        folder / "manifest.json", {"name": str, "graphs": dict, "reconstruction": dict, "training": dict}, START
    )


def completed_steps(checkpoint: Path, config: Config) -> int:
    if not checkpoint.is_file():
        return 0
    before, state = load_checkpoint(checkpoint)
    steps = before.optimiser.steps
    if before == config.with_steps(steps) != config:
        raise ValueError(
            f"{checkpoint} is of a run of {steps} steps, whose learning rate falls over all of them: give as many, or "
            f"go on in another --out with --start-from {checkpoint}"
        )
    if before != config:
        raise ValueError(f"{checkpoint} was trained with another preset; choose another --out or the same preset")
    return int(state["global_step"])


@rank_zero_only
def write_record(
    out: Path, config: Config, views: list[Line], seed: int, started: dict | None, code: str, begun: dict
) -> None:
    """record.json beside the checkpoint: all that the model card says about how the weights came to be.

    Of a run that goes on, what it has `begun` with stays; the views may be more.
    """
    train = [v for v in views if v["split"] == "train"]
    record = {
        "config": config.model_dump(),
        "seed": seed,
        "started_from": started,
        "commit": code,
        "hardware": hardware(),
        "torch": torch.__version__,
        "data": {
            "views": len(train),
            "validation_views": len(views) - len(train),
            "scenes": sorted({str(v["scene"]) for v in train if v["kind"] == "library"}),
            "procedural": sum(v["kind"] == "procedural" for v in train),
            "spp": max(v["spp"] for v in train),
            "reference_spp": [min(v["reference_spp"] for v in train), max(v["reference_spp"] for v in train)],
        },
    }
    record |= {name: value for name, value in begun.items() if name != "data"}
    (out / RECORD).write_text(json.dumps(record, indent=2) + "\n")


def start_record(source: Path) -> dict:
    """Name, steps and seconds of the run whose weights this one began with, all its own beginnings included."""
    if source.is_dir():
        manifest = read_manifest(source)
        training = manifest["training"]
        parts = [training, training["started_from"] or {}]
        total = {key: sum(part.get(key, 0) for part in parts) for key in ("steps", "seconds", "cpu_seconds")}
        return {"preset": manifest["name"], "commit": training["commit"], **total}
    config, state = load_checkpoint(source)
    own = {"steps": state["global_step"], **training_seconds(state)}
    before = read_record(source.parent)["started_from"] if (source.parent / RECORD).is_file() else None
    total = {key: value + (before or {}).get(key, 0) for key, value in own.items()}
    return {"preset": config.name, **total}


def training_seconds(state: dict) -> dict[str, float]:
    """Wall and CPU seconds of the whole run a checkpoint comes from."""
    return {key: round(value, 1) for key, value in state["callbacks"]["TrainingSeconds"].items()}


def commit() -> str:
    try:
        here = Path(__file__).resolve().parent
        return subprocess.check_output(
            ["git", "rev-parse", "--short", "HEAD"], cwd=here, text=True, stderr=subprocess.DEVNULL
        ).strip()
    except (OSError, subprocess.CalledProcessError):
        return "unknown"


def hardware() -> str:
    if torch.cuda.is_available():
        return torch.cuda.get_device_name()
    return f"{platform.machine()} CPU, {torch.get_num_threads()} thread(s)"
