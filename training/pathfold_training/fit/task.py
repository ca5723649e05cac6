"""Algorithm 1 as one Lightning task: F and R learn together from the image loss and the manifold loss."""

from __future__ import annotations

import math
from dataclasses import dataclass
from functools import partial
from typing import Any

import lightning
import torch
from lightning.pytorch.utilities.types import OptimizerLRSchedulerConfig
from torch import Tensor

from ..networks.batch import Batch, Inputs
from ..networks.features import DEMODULATION_EPSILON
from ..networks.kpcn import Kpcn, path_features
from ..networks.losses import (
    albedo_error,
    energy_error,
    error_scale,
    geometric,
    halves_error,
    logit_excess,
    manifold_loss,
    robust_relative,
    tone_map,
    unbiased_relative,
)
from ..networks.pathfold import ALBEDO_EPSILON, Pathfold
from ..networks.reconstruct import gather
from ..networks.sizes import PathfoldSizes
from .preset import Config


@dataclass
class Target:
    """What one branch is to filter, and against what: exposed radiance B x 3 x H x W."""

    radiance: Tensor  # the branch's noisy radiance, demodulated
    remodulate: Tensor  # noisy factor of the result
    reference: Tensor  # remodulated
    label: Tensor  # the manifold's: reference before remodulation


def branch_inputs(inputs: Inputs, branch: str) -> Inputs:
    """A branch graph's own inputs: `radiance` and `variance` are the branch's, or color's in frames without a split."""
    split = inputs["split.present"].reshape(-1, 1, 1, 1)
    own, unsplit = (
        inputs[branch],
        inputs["color"] if branch == "specular" else torch.zeros_like(inputs["color"]),
    )
    own_variance, variance = inputs[f"{branch}.variance"], inputs["variance"]
    return inputs | {
        "radiance": own * split + unsplit * (1.0 - split),
        "variance": own_variance * split + variance * (1.0 - split),
    }


def branch_target(inputs: Inputs, reference: Inputs, branch: str) -> Target:
    exposure = inputs["exposure"].reshape(-1, 1, 1, 1)
    split = inputs["split.present"].reshape(-1, 1, 1, 1)
    radiance = branch_inputs(inputs, branch)["radiance"] * exposure
    total, diffuse = reference["color"] * exposure, reference["diffuse"] * exposure
    if branch == "diffuse":
        factor = inputs["diffuse.albedo"] + DEMODULATION_EPSILON
        clean = reference["diffuse.albedo"] + DEMODULATION_EPSILON
        return Target(radiance / factor, factor, diffuse * split, diffuse / clean)
    wanted = total - diffuse * split
    return Target(radiance, torch.ones_like(radiance), wanted, wanted)


class Denoising(lightning.LightningModule):
    def __init__(self, config: Config) -> None:
        super().__init__()
        self.config = config
        self.save_hyperparameters({"config": config.model_dump()})
        self.model = Pathfold(config.network) if isinstance(config.network, PathfoldSizes) else Kpcn(config.network)
        self.model.to(memory_format=torch.channels_last)  # type: ignore[call-overload]
        self.generator = torch.Generator()

    def training_step(self, batch: Batch, step: int) -> Tensor:
        # pairs and lattice phase depend on the global step alone, so that a resumed run repeats them
        self.generator.manual_seed(self.global_step)
        if isinstance(self.model, Pathfold):
            return self.pyramid_loss(self.model, batch)
        return self.kpcn_loss(self.model, batch)

    def kpcn_loss(self, model: Kpcn, batch: Batch) -> Tensor:
        lattice = self.config.optimiser.lattice
        phase = torch.randint(lattice, (2,), generator=self.generator)
        offset = (int(phase[0]), int(phase[1]))
        reference = batch.reference["color"] * batch.inputs["exposure"].reshape(-1, 1, 1, 1)
        scale = on_lattice(error_scale(reference), lattice, offset)
        image, terms, excess, manifold = torch.zeros_like(scale), [], [], []
        if model.network.embedding:
            batch.inputs["samples.features"] = path_features(batch.inputs, batch.counts).to(
                memory_format=torch.channels_last
            )
        for name in model.branches:
            target = branch_target(batch.inputs, batch.reference, name)
            predicted = model.branch(name)(branch_inputs(batch.inputs, name), batch.counts, lattice, offset)
            with torch.autocast(self.device.type, enabled=False):
                logits = predicted.logits.float()
                trust = None if predicted.trust is None else predicted.trust.float()
                filtered = gather(logits, target.radiance, model.network.kernel_size, lattice, offset, trust)
                filtered = filtered * on_lattice(target.remodulate, lattice, offset)
                excess.append(logit_excess(logits) if trust is None else logit_excess(logits) + logit_excess(trust))
                wanted = on_lattice(target.reference, lattice, offset)
                terms.append(self.over_images(self.image_error(filtered, wanted, scale)))
                image = image + filtered
                if predicted.paths is not None and self.config.loss.manifold > 0.0:
                    pairs = self.config.loss.manifold_pairs
                    manifold.append(
                        manifold_loss(
                            predicted.paths,
                            tone_map(target.label),
                            batch.counts,
                            pairs,
                            self.generator,
                            **self.sharing(),
                        )
                    )
        error = self.image_error(image, on_lattice(reference, lattice, offset), scale)
        loss = self.over_images(error) + self.config.loss.branch * sum(terms) + self.config.loss.logits * sum(excess)
        if manifold:
            loss = loss + self.config.loss.manifold * sum(manifold)
            self.log("manifold", sum(manifold), prog_bar=True, batch_size=len(batch.counts), sync_dist=True)
        self.log("image", error.mean(), prog_bar=True, batch_size=len(batch.counts), sync_dist=True)
        return loss

    def pyramid_loss(self, model: Pathfold, batch: Batch) -> Tensor:
        inputs, exposure = batch.inputs | {"radiance": batch.inputs["color"]}, batch.inputs["exposure"]
        image, logits, paths, cleaned = model.filter(inputs, batch.counts)
        reference = batch.reference["color"] * exposure.reshape(-1, 1, 1, 1)
        exposed = image * exposure.reshape(-1, 1, 1, 1)
        target = batch.reference.get("cleaned", batch.reference["color"]) * exposure.reshape(-1, 1, 1, 1)
        error = self.image_error(exposed, target, error_scale(target, noisy="cleaned" not in batch.reference))
        total = error
        if self.config.loss.energy > 0.0:
            energy = energy_error(exposed, reference)  # not against what is cleaned: OIDN darkens by 1 %
            total = total + self.config.loss.energy * energy
            self.log("energy", energy.mean(), prog_bar=True, batch_size=len(batch.counts), sync_dist=True)
        loss = self.over_images(total)
        loss = loss + self.config.loss.logits * sum(logit_excess(level) for level in logits)
        if self.config.loss.albedo > 0.0 and cleaned is not None:
            albedo = albedo_error(cleaned - ALBEDO_EPSILON, batch.reference["albedo"], inputs["albedo.present"])
            loss = loss + self.config.loss.albedo * albedo
            self.log("albedo", albedo, prog_bar=True, batch_size=len(batch.counts), sync_dist=True)
        if self.config.loss.manifold > 0.0:
            pairs = self.config.loss.manifold_pairs
            manifold = manifold_loss(paths, tone_map(target), batch.counts, pairs, self.generator, **self.sharing())
            loss = loss + self.config.loss.manifold * manifold
            self.log("manifold", manifold, prog_bar=True, batch_size=len(batch.counts), sync_dist=True)
        self.log("image", error.mean(), prog_bar=True, batch_size=len(batch.counts), sync_dist=True)
        return loss

    def image_error(self, output: Tensor, reference: Tensor, scale: Tensor) -> Tensor:
        """Each image's [B]."""
        if self.config.loss.image == "unbiased":
            return unbiased_relative(output, reference)
        return robust_relative(output, reference, scale)

    def over_images(self, errors: Tensor) -> Tensor:
        """Errors [B] as one number."""
        return geometric(errors) if self.config.loss.image == "geometric" else errors.mean()

    def sharing(self) -> dict[str, Any]:
        """Which of how many processes this is, and how to fetch what the others hold: manifold_loss's arguments.

        DDP averages gradients over processes, and the gradient of a gathered tensor is summed over them, so a loss of
        the whole batch that all of them compute weighs as it would in one process.
        """
        processes = self.trainer.world_size
        gather = partial(self.all_gather, sync_grads=True) if processes > 1 else None
        return {"process": self.global_rank, "processes": processes, "gather": gather}

    def validation_step(self, batch: Batch, step: int) -> None:
        # geometric mean over views of the ratio to the input: no view dominates
        self.log("val_ratio_log", self.ratio_log(batch), prog_bar=True, batch_size=1, sync_dist=True)

    def ratio_log(self, batch: Batch) -> Tensor:
        """Logarithm of the denoised frame's RelL2, exposed, over its noisy input's; of a batch of ValidationViews.

        Both are freed of the reference's noise by its halves: at many samples that noise is as large as the error.
        """
        exposure = batch.inputs["exposure"].reshape(-1, 1, 1, 1)
        a, b = batch.reference["half_a"] * exposure, batch.reference["half_b"] * exposure
        return torch.log(
            halves_error(self.denoise(batch) * exposure, a, b) / halves_error(batch.inputs["color"] * exposure, a, b)
        )

    def denoise(self, batch: Batch) -> Tensor:
        """The whole frame, linear unexposed radiance B x 3 x H x W."""
        if isinstance(self.model, Pathfold):
            return self.model.filter(batch.inputs | {"radiance": batch.inputs["color"]}, batch.counts)[0]
        image = torch.zeros_like(batch.inputs["color"])
        exposure = batch.inputs["exposure"].reshape(-1, 1, 1, 1)
        for name in self.model.branches:
            target = branch_target(batch.inputs, batch.reference, name)
            predicted = self.model.branch(name)(branch_inputs(batch.inputs, name), batch.counts)
            size = self.model.network.kernel_size
            filtered = gather(predicted.logits.float(), target.radiance, size, trust=predicted.trust)
            image = image + filtered * target.remodulate
        return image / exposure

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


def on_lattice(x: Tensor, lattice: int, offset: tuple[int, int]) -> Tensor:
    return x[:, :, offset[0] :: lattice, offset[1] :: lattice]
