"""The pathfold family as the training tools ask for it: color filtered as a whole, all but color optional."""

from __future__ import annotations

from typing import Any, ClassVar

from torch import Tensor, nn

from ..batch import Batch, Inputs
from ..family import Graph, input_shape
from ..losses import (
    Draw,
    Loss,
    albedo_error,
    energy_error,
    error_scale,
    logit_excess,
    manifold_loss,
    robust_relative,
    tone_map,
)
from ..narrow import round_weights
from .graphs import EmbeddingGraph, NetworkGraph, trained_weights
from .sizes import ALIGNMENT, overlap
from .unet import ALBEDO_EPSILON, OPTIONAL, UNet, reconstruct


class Pathfold(UNet):
    quantised: ClassVar[tuple[str, ...]] = ("down.", "project.", "up.")  # between the first layer and the heads

    def loss(self, batch: Batch, weights: Loss, draw: Draw) -> tuple[Tensor, dict[str, Tensor]]:
        inputs, exposure = batch.inputs | {"radiance": batch.inputs["color"]}, batch.inputs["exposure"]
        image, logits, paths, cleaned = self.filter(inputs, batch.counts)
        truth = batch.truth["color"] * exposure.reshape(-1, 1, 1, 1)
        exposed = image * exposure.reshape(-1, 1, 1, 1)
        target = batch.truth.get("cleaned", batch.truth["color"]) * exposure.reshape(-1, 1, 1, 1)
        error = robust_relative(exposed, target, error_scale(target, noisy="cleaned" not in batch.truth))
        total, logged = error, {"image": error.mean()}
        if weights.energy > 0.0:
            energy = energy_error(exposed, truth)  # not against what is cleaned: OIDN darkens by 1 %
            total = total + weights.energy * energy
            logged["energy"] = energy.mean()
        loss = weights.over_images(total)
        loss = loss + weights.logits * sum(logit_excess(level) for level in logits)
        if weights.albedo > 0.0:
            albedo = albedo_error(cleaned - ALBEDO_EPSILON, batch.truth["albedo"], inputs["albedo.present"])
            loss = loss + weights.albedo * albedo
            logged["albedo"] = albedo
        if weights.manifold > 0.0:
            manifold = manifold_loss(paths, tone_map(target), batch.counts, weights.manifold_pairs, draw)
            loss = loss + weights.manifold * manifold
            logged["manifold"] = manifold
        return loss, logged

    def denoise(self, batch: Batch) -> Tensor:
        return self.filter(batch.inputs | {"radiance": batch.inputs["color"]}, batch.counts).image

    def filter_branch(self, graph: str, inputs: Inputs, radiance: Tensor, factor: Tensor) -> tuple[Tensor, float]:
        predicted, _ = self(inputs)
        filtered, _ = reconstruct(predicted, radiance, factor)
        return filtered, max(float(level.abs().max()) for level in predicted.flat())

    def graphs(self) -> dict[str, Graph]:
        samples, network = EmbeddingGraph(self), NetworkGraph(self)
        sums = samples.output_shapes()
        of_samples = {name: input_shape(name) for name in samples.input_names}
        of_pixels = {name: sums[name] if name in sums else input_shape(name) for name in network.input_names}
        return {
            "embedding": Graph(samples, of_samples, sums),
            "network": Graph(network, of_pixels, network.output_shapes()),
        }

    def standalone_graphs(self) -> dict[str, Graph]:
        raise ValueError("a gather pyramid has no graph with the reconstruction inside; leave --standalone away")

    def describe(self) -> dict[str, Any]:
        """One pyramid."""
        branch: dict[str, Any] = {"name": "color", "graph": "network", "radiance": "color", "unsplit": True}
        branch["demodulate"] = {"by": "albedo", "epsilon": ALBEDO_EPSILON, "clean": True}
        return {
            "requires": ["color"],
            "uses": [n for n in OPTIONAL if n != "paths"] + ["samples.descriptor", "samples.valid"],
            "reconstruction": {"operator": "pyramid", "branches": [branch]},
            "tile": {"alignment": ALIGNMENT, "overlap": overlap(self.sizes)},
        }

    def macs(self, spp: int) -> float:
        """Of the convolutions, from the layers' sizes."""
        total = 0.0
        seen = min(spp, self.sizes.path_samples)
        for name, module in self.named_modules():
            if isinstance(module, nn.Conv2d):
                parts = name.split(".")
                level = int(parts[1]) + 1 if parts[0] in ("down", "up", "heads", "albedo_heads") else 1
                level = int(parts[1]) + 2 if parts[0] == "project" else level
                total += module.weight.numel() * (seen if parts[0] == "sample" else 0.25**level)
        return total

    def round_weights(self) -> None:
        """All of the graph `network`; the embedding's is small, and scales its weights anew."""
        round_weights(self, but="sample.")

    def may_widen(self, weight: str) -> bool:
        return not weight.startswith("sample.")

    @staticmethod
    def weights_of(graphs: dict[str, dict[str, Tensor]], reconstruction: dict[str, Any]) -> dict[str, Tensor]:
        return trained_weights(**graphs)
