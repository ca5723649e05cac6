"""`pathfold-train fit`: one preset, one data set, one seed; resumes exactly."""

from __future__ import annotations

import json
import logging
import platform
import re
import subprocess
import time
import warnings
from functools import partial
from pathlib import Path

import lightning
import onnx
import torch
from google.protobuf.message import DecodeError  # type: ignore[import-untyped]
from lightning.pytorch.callbacks import Callback, ModelCheckpoint, RichProgressBar, TQDMProgressBar, WeightAveraging
from lightning.pytorch.loggers import CSVLogger
from lightning.pytorch.utilities import rank_zero_only
from onnx import numpy_helper
from pydantic import ValidationError
from rich.console import Console
from torch import Tensor
from torch.nn.utils import parametrize
from torch.utils.data import DataLoader

from . import halves
from .config import Config, problems
from .data import Crops, Stored, ValidationViews
from .live import Live, LiveViews
from .networks.pathfold import Pathfold, Standardised
from .networks.pathfold_graphs import trained_weights
from .store import Line, make_folder, read_object
from .task import Denoising

RECORD = "record.json"
START = "give a checkpoint of 'pathfold-train fit' or a model folder of 'pathfold-train export'"

# an advertisement, and a call of Lightning's own that torch is about to drop
logging.getLogger("lightning.pytorch.utilities.rank_zero").addFilter(lambda line: "litlogger" not in line.getMessage())
warnings.filterwarnings("ignore", ".*LeafSpec.* is deprecated", module="lightning")


class TrainingSeconds(Callback):
    """Adds up the seconds of every part of a resumed run and keeps them, with the machine, in the checkpoint."""

    def __init__(self) -> None:
        self.before = 0.0
        self.start, self.start_cpu = time.monotonic(), time.process_time()  # kept by a run that is done already
        self.before_cpu = 0.0

    def on_train_start(self, trainer: lightning.Trainer, module: lightning.LightningModule) -> None:
        self.start, self.start_cpu = time.monotonic(), time.process_time()

    def state_dict(self) -> dict:
        wall = self.before + time.monotonic() - self.start
        return {"seconds": wall, "cpu_seconds": self.before_cpu + time.process_time() - self.start_cpu}

    def load_state_dict(self, state: dict) -> None:
        self.before, self.before_cpu = state["seconds"], state["cpu_seconds"]


def moving_average(decay: float) -> WeightAveraging:
    """An exponential moving average of the weights, shorter at first: checkpoints and validation use it."""

    def update(average: Tensor, current: Tensor, number: Tensor | int) -> Tensor:
        return average.lerp(current, 1.0 - min(decay, (1.0 + float(number)) / (10.0 + float(number))))

    return WeightAveraging(avg_fn=update)


def fit(
    config: Config,
    data: Path | Live,
    out: Path,
    seed: int = 0,
    threads: int = 0,
    validate_every: int = 500,
    save_every: int = 250,
    log_every: int = 25,
    start_from: Path | None = None,
    devices: int = 1,
    nodes: int = 1,
) -> Path:
    """Train and return the last checkpoint, out/last.ckpt; resumes from it when it is there.

    `data` is the folder of a data set, or says what to render on the fly. With more than one of `devices` or `nodes`,
    as many processes (Lightning's DDP) share each batch of the preset and learn the same as one would.
    `threads` 0 leaves torch's choice. `start_from` is a checkpoint or an exported model folder whose weights begin the
    run: kpcn-vanilla's for the path variants, say (the authors tune R alone first, then attach F), or a shipped model's
    to go on with it on other data. Raises ValueError if `data` holds no data set, `start_from` no weights that fit, or
    `out` belongs to another preset, seed or number of steps: nothing is written then.
    """
    source = data if isinstance(data, Live) else Stored(data)
    if isinstance(source, Stored):
        source.held_out()  # what it lacks is said before anything is written
    if threads:
        torch.set_num_threads(threads)
    lightning.seed_everything(seed, verbose=False)
    last = out / "last.ckpt"
    done = completed_steps(last, config)
    begun = read_record(out) if done and (out / RECORD).is_file() else {}
    if begun.get("seed", seed) != seed:
        raise ValueError(f"{out} was begun with --seed {begun['seed']}: give that, or choose another --out")
    task = Denoising(config)
    if start_from and not done:
        warm_start(task, start_from)
    started = start_record(start_from) if start_from and not begun else None
    on_terminal = Console().is_terminal
    options = config.optimiser
    trainer = lightning.Trainer(
        default_root_dir=out,
        max_steps=options.steps,
        accelerator="auto",
        devices=devices,
        num_nodes=nodes,
        strategy="ddp" if devices * nodes > 1 else "auto",
        use_distributed_sampler=False,  # batches come shared already; every process validates on all views
        precision="bf16-mixed" if uses_bf16(options.precision) else "32-true",
        gradient_clip_val=options.clip,
        val_check_interval=validate_every,
        check_val_every_n_epoch=None,
        num_sanity_val_steps=0,
        log_every_n_steps=log_every,
        logger=CSVLogger(out, name="log"),
        callbacks=[
            ModelCheckpoint(out, save_last=True, save_top_k=0, every_n_train_steps=min(save_every, options.steps)),
            TrainingSeconds(),
            RichProgressBar() if on_terminal else TQDMProgressBar(refresh_rate=50),
            *([moving_average(options.average)] if options.average > 0.0 else []),
        ],
        enable_model_summary=False,
    )
    paths = config.network.path_samples
    process = {"process": trainer.global_rank, "processes": trainer.world_size}
    views = LiveViews(source, seed, **process) if isinstance(source, Live) else source
    held_out = views.held_out()
    views(done)  # on the fly: the first are rendered before the clock of training runs
    crops = Crops(views, config.data, seed, paths, albedo=config.loss.albedo > 0.0, skip=done, **process)
    record = partial(write_record, out, config, views.lines, seed, started, commit(), begun)  # of the code that runs
    make_folder(out)
    record()
    # batches are made whole by the data sets; one process keeps the batch stream and the resume exact
    train = DataLoader(crops, batch_size=None, num_workers=0)
    validation = DataLoader(ValidationViews(held_out, paths), batch_size=None, num_workers=0)
    trainer.fit(task, train, validation, ckpt_path=last if last.is_file() else None, weights_only=False)
    record()  # views rendered on the fly have joined
    trainer.save_checkpoint(last, weights_only=False)  # the callback saves at multiples of `save_every` only
    return last


def uses_bf16(precision: str) -> bool:
    return precision == "bf16" or (precision == "auto" and torch.cuda.is_available())


def warm_start(task: Denoising, source: Path) -> None:
    """Copy the weights of a checkpoint or model folder; what only the new network has keeps its own first values.

    That holds for R's input channels too: begun at zero they stay small for thousands of steps, and R does not read F.
    A network of the pathfold family with wider layers begins as the narrow one: what that had reads nothing new yet.
    Raises ValueError where a layer is narrower, of another kernel size, or missing.
    """
    wider = isinstance(task.model, Pathfold)
    merged = {name: value.clone() for name, value in plain_weights(task).items()}
    for name, value in folder_weights(source).items() if source.is_dir() else checkpoint_weights(source).items():
        name = re.sub(r"^(model\.branches\.\w+)\.head\.", r"\1.kernels.", name)  # as the first models have it
        name = name.replace("model.albedo_kernels.", "model.albedo_heads.0.")  # one 5x5 kernel: the finest level's
        new = merged.get(name)
        if new is None or not fits(value, new, wider and not name.startswith("model.sample.")):
            raise ValueError(
                f"{source}: its weight {name} does not fit preset '{task.config.name}'; give a network of its "
                "family that is no wider"
            )
        if wider and value.dim() > 1:
            new[: value.shape[0], value.shape[1] :] = 0.0
        new[tuple(slice(n) for n in value.shape)] = value
    for name, value in merged.items():
        owner, _, attribute = name.rpartition(".")
        module = task.get_submodule(owner)
        if isinstance(module, Standardised):
            module.unfold(merged[f"{owner}.weight"], merged[f"{owner}.bias"])
            continue
        with torch.no_grad():
            if parametrize.is_parametrized(module, attribute):
                setattr(module, attribute, value)  # weight norm finds its two factors
            else:
                getattr(module, attribute).copy_(value)


def fits(value: Tensor, new: Tensor, wider: bool) -> bool:
    """`value` can be the first channels of `new`: of its inputs, and of its outputs too where it may be wider."""
    if value.dim() != new.dim() or value.shape[2:] != new.shape[2:]:
        return False
    outputs = value.shape[0] <= new.shape[0] if wider else value.shape[0] == new.shape[0]
    return outputs and value.shape[1:2] <= new.shape[1:2]


def plain_weights(task: Denoising) -> dict[str, torch.Tensor]:
    """All weights by name, weight norm multiplied out and scales folded: what an exported graph holds too."""
    weights: dict[str, torch.Tensor] = {}
    for owner, module in task.named_modules():
        names = [name for name, _ in module.named_parameters(recurse=False)]
        names += list(module.parametrizations) if parametrize.is_parametrized(module) else []
        if not owner.endswith(".parametrizations.weight"):
            weights |= {f"{owner}.{name}": getattr(module, name).detach() for name in names}
        if isinstance(module, Standardised):
            folded = zip(("weight", "bias"), module.folded(), strict=True)
            weights |= {f"{owner}.{name}": value.detach() for name, value in folded}
    return weights


def load_checkpoint(path: Path) -> tuple[Config, dict]:
    """The preset of a checkpoint of `fit`, and its state. Raises ValueError naming a file that is none, or damaged."""
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
    return config, state


def read_record(run: Path) -> dict:
    """A run's record.json. Raises ValueError naming it where it is gone or damaged."""
    keys = ("config", "seed", "started_from", "commit", "hardware", "data")
    return read_object(run / RECORD, keys, "give another folder of 'pathfold-train fit'")


def read_manifest(folder: Path) -> dict:
    """An exported model's manifest. Raises ValueError naming it where it is gone, damaged or not `export`'s."""
    return read_object(folder / "manifest.json", ("name", "graphs", "reconstruction", "training"), START)


def checkpoint_weights(checkpoint: Path) -> dict[str, torch.Tensor]:
    config, state = load_checkpoint(checkpoint)
    task = Denoising(config)
    # networks of before cleaned the albedo by one kernel, whose weights go on, or by other features, whose do not
    before = ("model.cleaning.", "model.albedo_kernels.")
    stored = {name: value for name, value in state["state_dict"].items() if not name.startswith(before)}
    fresh = {name: value for name, value in task.state_dict().items() if name.startswith("model.albedo_heads.")}
    task.load_state_dict(fresh | stored)
    one_kernel = {name: value for name, value in state["state_dict"].items() if name.startswith(before[1])}
    return plain_weights(task) | one_kernel


def folder_weights(folder: Path) -> dict[str, torch.Tensor]:
    """The weights in a model folder's graphs: their initialisers keep the modules' names.

    Raises ValueError for graphs that `pathfold-train export` did not write.
    """
    weights = {}
    manifest = read_manifest(folder)
    graphs = {name: graph_weights(folder / graph["file"]) for name, graph in manifest["graphs"].items()}
    if manifest["reconstruction"]["operator"] == "pyramid":
        try:
            return {f"model.{name}": value for name, value in trained_weights(**graphs).items()}
        except (KeyError, TypeError) as error:
            raise ValueError(f"{folder}: not written by 'pathfold-train export' ({error}); give a checkpoint") from None
    for graph, tensors in graphs.items():
        for name, value in tensors.items():
            if name.startswith("branch."):
                weights[name.replace("branch.", f"model.branches.{graph}.", 1)] = value
    if manifest["reconstruction"].get("trust"):  # export made it the last row of the kernels' layer
        for name in [name for name in weights if ".kernels." in name]:
            weights[name.replace(".kernels.", ".trust.")] = weights[name][-1:]
            weights[name] = weights[name][:-1]
    return weights


def graph_weights(file: Path) -> dict[str, torch.Tensor]:
    """A graph's initialisers by name, float32. Raises ValueError where two layers share one, or it cannot be read."""
    try:
        model = onnx.load(file)
    except OSError as error:
        raise ValueError(f"cannot read {file}: {error.strerror}; {START}") from error
    except DecodeError as error:
        raise ValueError(f"{file} is no ONNX graph, or is damaged ({error}); {START}") from error
    if not model.graph.initializer:  # cut short before its weights it is a graph still
        raise ValueError(f"{file} holds no weights; {START}")
    halves.widen(model)
    read = [name for node in model.graph.node if node.op_type == "Conv" for name in node.input[1:]]
    if len(set(read)) < len(read):  # the exporter merges equal ones, those of untrained layers
        raise ValueError(f"{file}: some layers' weights are equal and cannot be told apart; give the run's last.ckpt")
    return {tensor.name: torch.from_numpy(numpy_helper.to_array(tensor).copy()) for tensor in model.graph.initializer}


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
