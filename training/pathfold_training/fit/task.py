"""Algorithm 1 as one Lightning task: all parts of a network learn together from the losses of its family."""

from __future__ import annotations

import math
from functools import partial
from typing import Any

import lightning
import torch
from lightning.pytorch.utilities.types import OptimizerLRSchedulerConfig
from torch import Tensor

from ..networks.batch import Batch
from ..networks.families import build
from ..networks.losses import Draw, halves_error
from .finite import or_nan
from .preset import Config


class Denoising(lightning.LightningModule):
    def __init__(self, config: Config) -> None:
        super().__init__()
        self.config = config
        self.save_hyperparameters({"config": config.model_dump()})
        self.model = build(config.network)
        self.to(memory_format=torch.channels_last)
        self.generator = torch.Generator()

    def training_step(self, batch: Batch, step: int) -> Tensor:
        # what is drawn depends on the global step alone, so that a resumed run repeats it
        self.generator.manual_seed(self.global_step)
        loss, terms = self.model.loss(batch, self.config.loss, self.draw())
        for name, value in terms.items():
            self.log(name, value, prog_bar=True, batch_size=len(batch.counts), sync_dist=True)
        return or_nan(loss)

    def draw(self) -> Draw:
        """Of this process's share of the batch.

        DDP averages gradients over processes, and the gradient of a gathered tensor is summed over them, so a loss of
        the whole batch that all of them compute weighs as it would in one process.
        """
        processes = self.trainer.world_size
        gather: Any = partial(self.all_gather, sync_grads=True) if processes > 1 else None
        return Draw(self.generator, self.global_rank, processes, gather)

    def validation_step(self, batch: Batch, step: int) -> None:
        # geometric mean over views of the ratio to the input: no view dominates
        self.log("val_ratio_log", self.ratio_log(batch), prog_bar=True, batch_size=1, sync_dist=True)

    def ratio_log(self, batch: Batch) -> Tensor:
        """Logarithm of the denoised frame's RelL2, exposed, over its noisy input's; of a batch of ValidationViews.

        Both are freed of the truth's noise by its halves: at many samples that noise is as large as the error.
        """
        exposure = batch.inputs["exposure"].reshape(-1, 1, 1, 1)
        a, b = batch.truth["half_a"] * exposure, batch.truth["half_b"] * exposure
        return torch.log(
            halves_error(self.denoise(batch) * exposure, a, b) / halves_error(batch.inputs["color"] * exposure, a, b)
        )

    def denoise(self, batch: Batch) -> Tensor:
        """The whole frame, linear unexposed radiance B x 3 x H x W."""
        return self.model.denoise(batch)

    def configure_optimizers(self) -> OptimizerLRSchedulerConfig:
        options = self.config.optimiser
        adam = torch.optim.Adam(self.parameters(), lr=options.learning_rate)

        def rate(step: int) -> float:
            warm = min(1.0, (step + 1) / options.warmup)
            progress = min(1.0, step / options.steps)
            low = options.final_fraction
            return warm * (low + (1.0 - low) * 0.5 * (1.0 + math.cos(math.pi * progress)))

        schedule = torch.optim.lr_scheduler.LambdaLR(adam, rate)
        return {"optimizer": adam, "lr_scheduler": {"scheduler": schedule, "interval": "step"}}
