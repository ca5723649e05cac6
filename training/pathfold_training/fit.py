"""`pathfold-train fit`: one preset, one data set, one seed; resumes exactly."""

from __future__ import annotations

import json
import platform
import subprocess
import time
from pathlib import Path

import lightning
import torch
from lightning.pytorch.callbacks import Callback, ModelCheckpoint, RichProgressBar, TQDMProgressBar
from lightning.pytorch.loggers import CSVLogger
from rich.console import Console
from torch.utils.data import DataLoader

from .config import Config
from .data import Crops, ValidationViews
from .store import read_index
from .task import Denoising


class TrainingSeconds(Callback):
    """Adds up the seconds of every part of a resumed run and keeps them, with the machine, in the checkpoint."""

    def __init__(self) -> None:
        self.before = 0.0
        self.start = self.start_cpu = 0.0
        self.before_cpu = 0.0

    def on_train_start(self, trainer: lightning.Trainer, module: lightning.LightningModule) -> None:
        self.start, self.start_cpu = time.monotonic(), time.process_time()

    def state_dict(self) -> dict:
        wall = self.before + time.monotonic() - self.start
        return {"seconds": wall, "cpu_seconds": self.before_cpu + time.process_time() - self.start_cpu}

    def load_state_dict(self, state: dict) -> None:
        self.before, self.before_cpu = state["seconds"], state["cpu_seconds"]


def fit(
    config: Config,
    data: Path,
    out: Path,
    seed: int = 0,
    threads: int = 0,
    validate_every: int = 500,
    save_every: int = 250,
    start_from: Path | None = None,
) -> Path:
    """Train and return the last checkpoint, out/last.ckpt; resumes from it when it is there.

    `threads` 0 leaves torch's choice. `start_from` is a checkpoint whose weights begin the run, kpcn-vanilla's for the
    path variants, say (the authors tune R alone first, then attach F). Raises ValueError if `data` holds no data set
    or `out` belongs to another preset.
    """
    if threads:
        torch.set_num_threads(threads)
    lightning.seed_everything(seed, verbose=False)
    out.mkdir(parents=True, exist_ok=True)
    last = out / "last.ckpt"
    done = completed_steps(last, config)
    on_terminal = Console().is_terminal
    options = config.optimiser
    trainer = lightning.Trainer(
        default_root_dir=out,
        max_steps=options.steps,
        accelerator="auto",
        devices=1,
        precision="bf16-mixed" if options.precision == "bf16" else "32-true",
        gradient_clip_val=options.clip,
        val_check_interval=validate_every,
        check_val_every_n_epoch=None,
        num_sanity_val_steps=0,
        log_every_n_steps=25,
        logger=CSVLogger(out, name="log"),
        callbacks=[
            ModelCheckpoint(out, save_last=True, save_top_k=0, every_n_train_steps=min(save_every, options.steps)),
            TrainingSeconds(),
            RichProgressBar() if on_terminal else TQDMProgressBar(refresh_rate=50),
        ],
        enable_model_summary=False,
    )
    paths = config.network.embedding > 0
    crops = Crops(data, config.data, seed, paths, skip=done)
    held_out = ValidationViews(data, paths)
    write_record(out, config, data, seed, start_from)
    # batches are made whole by the data sets; one process keeps the batch stream and the resume exact
    train = DataLoader(crops, batch_size=None, num_workers=0)
    validation = DataLoader(held_out, batch_size=None, num_workers=0)
    task = Denoising(config)
    if start_from and not last.is_file():
        warm_start(task, start_from)
    trainer.fit(task, train, validation, ckpt_path=last if last.is_file() else None, weights_only=False)
    trainer.save_checkpoint(last)  # the callback saves at multiples of `save_every` only
    return last


def warm_start(task: Denoising, checkpoint: Path) -> None:
    """Copy the weights that both have; input channels that only the new network has start at zero."""
    own = task.state_dict()
    for name, value in torch.load(checkpoint, map_location="cpu", weights_only=True)["state_dict"].items():
        if name not in own or own[name].shape[:1] + own[name].shape[2:] != value.shape[:1] + value.shape[2:]:
            raise ValueError(f"{checkpoint}: its weight {name} does not fit preset '{task.config.name}'")
        if value.dim() > 1:
            own[name].zero_()
        own[name][tuple(slice(n) for n in value.shape)] = value
    task.load_state_dict(own)


def completed_steps(checkpoint: Path, config: Config) -> int:
    if not checkpoint.is_file():
        return 0
    state = torch.load(checkpoint, map_location="cpu", weights_only=True)
    if state["hyper_parameters"]["config"] != config.model_dump():
        raise ValueError(f"{checkpoint} was trained with another preset; choose another --out or the same preset")
    return int(state["global_step"])


def write_record(out: Path, config: Config, data: Path, seed: int, start_from: Path | None) -> None:
    """record.json beside the checkpoint: all that the model card says about how the weights came to be."""
    views = read_index(data)
    train = [v for v in views if v["split"] == "train"]
    record = {
        "config": config.model_dump(),
        "seed": seed,
        "started_from": start_record(start_from),
        "commit": commit(),
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
    (out / "record.json").write_text(json.dumps(record, indent=2) + "\n")


def start_record(checkpoint: Path | None) -> dict | None:
    """Name, steps and seconds of the run whose weights this one began with."""
    if checkpoint is None:
        return None
    state = torch.load(checkpoint, map_location="cpu", weights_only=True)
    return {
        "preset": state["hyper_parameters"]["config"]["name"],
        "steps": state["global_step"],
        **training_seconds(state),
    }


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
