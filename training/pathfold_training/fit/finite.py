"""Weights stay finite: a step that cannot be learned from is skipped, and weights that are not finite are not kept."""

from __future__ import annotations

import logging
from collections.abc import Mapping
from typing import Any

import lightning
import torch
from lightning.pytorch.callbacks import Callback
from lightning.pytorch.utilities import rank_zero_only
from torch import Tensor

MOST = 20  # steps in a row that may be skipped: after more, none that follows would be learned from either
_WEIGHTS = ("state_dict", "current_model_state", "averaging_state")

log = logging.getLogger("pathfold.fit")


class FiniteSteps(Callback):
    """Skips every step whose gradient is not finite, counts and tells them; keeps no weights that are not finite.

    Gradients are looked at after they were averaged over processes, so all of these skip the same steps.
    Raises RuntimeError after MOST steps in a row, and instead of saving a checkpoint whose weights are not finite.
    """

    def __init__(self) -> None:
        self.skipped = 0
        self.in_a_row = 0

    def on_before_optimizer_step(
        self, trainer: lightning.Trainer, module: lightning.LightningModule, optimizer: torch.optim.Optimizer
    ) -> None:
        gradients = [p.grad for group in optimizer.param_groups for p in group["params"] if p.grad is not None]
        if torch.isfinite(torch.nn.utils.get_total_norm(gradients)):
            self.in_a_row = 0
            return
        optimizer.zero_grad(set_to_none=True)  # without a gradient the optimiser leaves a weight and its state alone
        self.skipped += 1
        self.in_a_row += 1
        tell(f"step {trainer.global_step}: loss or gradient is not finite, nothing is learned from it ({self.skipped})")
        if self.in_a_row > MOST:
            raise RuntimeError(
                f"stopped at step {trainer.global_step}: loss or gradient was not finite in {self.in_a_row} steps in a "
                "row; lower the learning_rate of the preset, or look for what is wrong with the data with "
                "'pathfold-train dataset info --check'; the last checkpoint is as it was"
            )

    def on_save_checkpoint(
        self, trainer: lightning.Trainer, module: lightning.LightningModule, checkpoint: dict[str, Any]
    ) -> None:
        for weights in _WEIGHTS:
            if name := not_finite(checkpoint.get(weights, {})):
                raise RuntimeError(
                    f"stopped at step {trainer.global_step}: weight {name} is not finite; lower the learning_rate of "
                    "the preset; the last checkpoint is as it was"
                )

    def state_dict(self) -> dict[str, int]:
        return {"skipped": self.skipped}

    def load_state_dict(self, state: dict[str, int]) -> None:
        self.skipped = state["skipped"]


def or_nan(loss: Tensor) -> Tensor:
    """The loss; where it is not finite, one whose gradient is NaN in every weight, so that every process sees it."""
    return loss * torch.where(torch.isfinite(loss.detach()), 1.0, torch.nan)


def not_finite(weights: Mapping[str, Any]) -> str | None:
    """The name of the first weight that is not finite, None where all are."""
    floats = ((name, w) for name, w in weights.items() if isinstance(w, Tensor) and w.is_floating_point())
    return next((name for name, w in floats if not torch.isfinite(w).all()), None)


@rank_zero_only
def tell(line: str) -> None:
    log.warning(line)
