"""`pathfold-train fit`: one preset, one data set, one seed; resumes exactly."""

from __future__ import annotations

import logging
import time
import warnings
from functools import partial
from pathlib import Path

import lightning
import torch
from lightning.pytorch.callbacks import Callback, ModelCheckpoint, RichProgressBar, TQDMProgressBar, WeightAveraging
from lightning.pytorch.loggers import CSVLogger
from rich.console import Console
from torch import Tensor
from torch.utils.data import DataLoader

from ..files import make_folder
from .checkpoint import RECORD, commit, completed_steps, read_record, start_record, write_record
from .crops import Crops
from .finite import FiniteSteps
from .live import Live, LiveViews
from .preset import Config
from .task import Denoising
from .views import Stored, ValidationViews
from .warm_start import warm_start

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
    run: a shipped model's, to go on with it on other data. Raises ValueError if `data` holds no data set, `start_from`
    no weights that fit, or `out` belongs to another preset, seed or number of steps: nothing is written then.
    RuntimeError where the weights do not stay finite, see finite.py.
    """
    source = data if isinstance(data, Live) else Stored(data)
    if isinstance(source, Stored):
        source.held_out()  # what it lacks is said before anything is written
        if config.data.cleaned:
            source.need_cleaned()
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
            FiniteSteps(),  # after the average, so that it sees what is saved of that
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
