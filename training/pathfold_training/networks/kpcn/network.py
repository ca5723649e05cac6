"""KPCN as the training tools ask for it: two branches, each filtered by kernels of its own."""

from __future__ import annotations

from typing import Any, ClassVar

import torch
from torch import Tensor, nn

from .. import embedding
from ..batch import Batch, Inputs
from ..embedding import path_features
from ..family import Graph, Shape
from ..features import DEMODULATION_EPSILON, OPTIONAL
from ..losses import Draw, Loss, error_scale, logit_excess, manifold_loss, robust_relative, tone_map
from ..reconstruct import gather
from .branch import BRANCHES, Branch
from .graphs import BranchGraph, Standalone, with_trust_as_last_logit
from .sizes import KpcnSizes, overlap
from .targets import branch_inputs, branch_target, on_lattice


class Kpcn(nn.Module):
    quantised: ClassVar[tuple[str, ...]] = ()

    def __init__(self, sizes: KpcnSizes) -> None:
        super().__init__()
        self.sizes = sizes
        self.branches = nn.ModuleDict({name: Branch(sizes, name == "diffuse") for name in BRANCHES})

    def branch(self, name: str) -> Branch:
        module = self.branches[name]
        assert isinstance(module, Branch)
        return module

    def loss(self, batch: Batch, weights: Loss, draw: Draw) -> tuple[Tensor, dict[str, Tensor]]:
        """Kernels are predicted on a lattice of pixels whose phase is drawn."""
        lattice = self.sizes.lattice
        phase = torch.randint(lattice, (2,), generator=draw.generator)
        offset = (int(phase[0]), int(phase[1]))
        truth = batch.truth["color"] * batch.inputs["exposure"].reshape(-1, 1, 1, 1)
        scale = on_lattice(error_scale(truth), lattice, offset)
        image, terms, excess, manifold = torch.zeros_like(scale), [], [], []
        if self.sizes.embedding:
            batch.inputs["samples.features"] = path_features(batch.inputs, batch.counts).to(
                memory_format=torch.channels_last
            )
        for name in self.branches:
            target = branch_target(batch.inputs, batch.truth, name)
            predicted = self.branch(name)(branch_inputs(batch.inputs, name), batch.counts, lattice, offset)
            with torch.autocast(scale.device.type, enabled=False):
                logits = predicted.logits.float()
                trust = None if predicted.trust is None else predicted.trust.float()
                filtered = gather(logits, target.radiance, self.sizes.kernel_size, lattice, offset, trust)
                filtered = filtered * on_lattice(target.remodulate, lattice, offset)
                excess.append(logit_excess(logits) if trust is None else logit_excess(logits) + logit_excess(trust))
                wanted = on_lattice(target.truth, lattice, offset)
                terms.append(weights.over_images(robust_relative(filtered, wanted, scale)))
                image = image + filtered
                if predicted.paths is not None and weights.manifold > 0.0:
                    label = tone_map(target.label)
                    manifold.append(manifold_loss(predicted.paths, label, batch.counts, weights.manifold_pairs, draw))
        error = robust_relative(image, on_lattice(truth, lattice, offset), scale)
        loss = weights.over_images(error) + weights.branch * sum(terms) + weights.logits * sum(excess)
        logged = {"image": error.mean()}
        if manifold:
            loss = loss + weights.manifold * sum(manifold)
            logged["manifold"] = torch.stack(manifold).sum()
        return loss, logged

    def denoise(self, batch: Batch) -> Tensor:
        image = torch.zeros_like(batch.inputs["color"])
        exposure = batch.inputs["exposure"].reshape(-1, 1, 1, 1)
        for name in self.branches:
            target = branch_target(batch.inputs, batch.truth, name)
            predicted = self.branch(name)(branch_inputs(batch.inputs, name), batch.counts)
            filtered = gather(predicted.logits.float(), target.radiance, self.sizes.kernel_size, trust=predicted.trust)
            image = image + filtered * target.remodulate
        return image / exposure

    def filter_branch(self, graph: str, inputs: Inputs, radiance: Tensor, factor: Tensor) -> tuple[Tensor, float]:
        branch = self.branch(graph)
        predicted = branch({name: inputs[name] for name in branch.input_names()})
        filtered = gather(predicted.logits, radiance / factor, self.sizes.kernel_size, trust=predicted.trust) * factor
        shift = 0.0 if predicted.trust is None else float(predicted.trust.abs().max())
        return filtered, float(predicted.logits.abs().max()) + shift

    def graphs(self) -> dict[str, Graph]:
        logits: Shape = [1, self.sizes.kernel_size**2 + self.sizes.trust, "H", "W"]
        modules = {name: BranchGraph(with_trust_as_last_logit(self.branch(name))) for name in BRANCHES}
        return {name: Graph(module, module.input_shapes(), {"logits": logits}) for name, module in modules.items()}

    def standalone_graphs(self) -> dict[str, Graph]:
        modules = {f"{name}-standalone": Standalone(self.branch(name), self.sizes.kernel_size) for name in BRANCHES}
        return {
            name: Graph(module, module.input_shapes(), {"filtered": [1, 3, "H", "W"]})
            for name, module in modules.items()
        }

    def describe(self) -> dict[str, Any]:
        """Two gathers."""
        paths = ["samples.descriptor", "samples.density"] if self.sizes.embedding else []
        uses = ["diffuse", "specular", "diffuse.albedo", "diffuse.variance", "specular.variance"]
        uses += [n for n in OPTIONAL if n != "split"] + (["samples.valid"] if self.sizes.embedding else [])
        demodulate = {"by": "diffuse.albedo", "epsilon": DEMODULATION_EPSILON}
        return {
            "requires": ["color", *paths],
            "uses": uses,
            "reconstruction": {
                "operator": "gather",
                "size": self.sizes.kernel_size,
                "trust": self.sizes.trust,
                "branches": [
                    {"name": "diffuse", "graph": "diffuse", "radiance": "diffuse", "demodulate": demodulate},
                    {"name": "specular", "graph": "specular", "radiance": "specular", "unsplit": True},
                ],
            },
            "tile": {"alignment": embedding.ALIGNMENT, "overlap": overlap(self.sizes)},
        }

    def macs(self, spp: int) -> float:
        """Both branches, from the layers' sizes."""
        total = 0.0
        for branch in self.branches.values():
            for name, module in branch.named_modules():
                if isinstance(module, nn.Conv2d):
                    share = 1.0
                    if "middle" in name:
                        share = 1 / 4
                    elif "bottom" in name:
                        share = 1 / 16
                    elif name.startswith(("paths.sample", "paths.head_sample")) or name == "paths.head":
                        share = spp
                    total += share * module.weight.numel()
        return total

    def round_weights(self) -> None:
        """None: weights stay 32-bit floats."""

    def may_widen(self, weight: str) -> bool:
        return False

    @staticmethod
    def weights_of(graphs: dict[str, dict[str, Tensor]], reconstruction: dict[str, Any]) -> dict[str, Tensor]:
        weights = {}
        for graph, tensors in graphs.items():
            for name, value in tensors.items():
                if name.startswith("branch."):
                    weights[name.replace("branch.", f"branches.{graph}.", 1)] = value
        if reconstruction.get("trust"):  # export made it the last row of the kernels' layer
            for name in [name for name in weights if ".kernels." in name]:
                weights[name.replace(".kernels.", ".trust.")] = weights[name][-1:]
                weights[name] = weights[name][:-1]
        return weights
