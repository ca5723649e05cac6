"""What each part of a pathfold preset is worth: the preset at one modest budget, with one thing changed at a time.

    python benchmarks/ablation.py DATA WORK [--preset pathfold-fast --steps 500 --seeds 3 --only baseline manifold]

DATA is a data set of `pathfold-train render`; as it is at the first start it is kept, so it may grow meanwhile. Every
row of VARIANTS is trained on it with one thread and scored on the held-out views at 2, 8 and 32 spp: RelL2 over the
noisy input's, geometric mean in which each scene counts alike. `all` is the mean of the spp; `/ baseline` compares runs
of equal seeds; `deviation` is that of `all` over seeds, what a difference has to exceed. Every run is printed when it
is done (to stderr) and kept, with all its settings; the same command goes on where it was stopped.

The pathfold family filters color as a whole. "diffuse and specular each" (two sets of kernels, the diffuse part divided
by its own albedo) and "one 11x11 kernel" (41 kMAC per pixel where pathfold-fast's pyramid takes 37) are networks of
this file, for training only.
"""

import argparse
import json
import math
import sys
from collections.abc import Sequence
from contextlib import nullcontext
from dataclasses import dataclass
from functools import partial
from hashlib import sha256
from pathlib import Path
from statistics import fmean, stdev
from typing import Any
from unittest import mock

import pages
import torch
import torch.nn.functional as functional
from pathfold.report.tables import markdown
from pathfold_training.dataset import store
from pathfold_training.files import write_whole
from pathfold_training.fit import task
from pathfold_training.fit.checkpoint import commit, training_seconds
from pathfold_training.fit.preset import Config, load_preset
from pathfold_training.fit.train import fit
from pathfold_training.fit.views import Stored, Window
from pathfold_training.networks import pathfold
from pathfold_training.networks.pathfold import (
    ALBEDO_EPSILON,
    Filtered,
    Pathfold,
    Prediction,
    aligned,
    clean_factor,
    exact,
    reconstruct,
)
from pathfold_training.networks.reconstruct import bounded_exp, normalised, weigh_taps
from pathfold_training.networks.sizes import PathfoldSizes
from pathfold_training.release.score import load, score
from torch import Tensor, nn

SPPS = (2, 8, 32)
SIDE = 11
TAPS = [(dy, dx) for dy in range(SIDE) for dx in range(SIDE)]


class SingleKernel(Pathfold):
    """The same trunk and trust, but one 11x11 kernel per pixel instead of the pyramid."""

    def __init__(self, network: PathfoldSizes) -> None:
        super().__init__(network)
        self.heads = nn.ModuleList([empty_head(network.widths[0], 4 * SIDE * SIDE)])

    def predict(self, entrance: Tensor) -> Prediction:
        trust, cleaning, (finest, *_) = self.features(entrance)
        return Prediction(trust, [exact(self.heads[0](finest))], cleaning)

    def filter(self, inputs: dict[str, Tensor], counts: list[int] | None = None) -> Filtered:
        predicted, paths = self(inputs, counts)
        factor = pathfold.demodulator(inputs) if self.network.demodulate else torch.ones_like(inputs["radiance"])
        factor = clean_factor(predicted, inputs["radiance"], factor)
        image = self.weigh(predicted, inputs["radiance"] / factor)
        return Filtered(image * factor, predicted.logits, paths, factor if self.cleans else None)

    @staticmethod
    def weigh(predicted: Prediction, image: Tensor) -> Tensor:
        height, width = image.shape[-2:]
        weight = torch.exp(functional.pixel_shuffle(predicted.trust, 2))
        source = aligned(torch.cat([image, torch.ones_like(image[:, :1])], 1)) * weight
        kernel = bounded_exp(functional.pixel_shuffle(predicted.logits[0], 2))
        return normalised(weigh_taps(kernel, source, TAPS, SIDE // 2))[0][:, :, :height, :width]


class SplitKernels(Pathfold):
    """Diffuse and specular filtered by kernels of their own, from one trunk that sees the diffuse part too."""

    def __init__(self, network: PathfoldSizes) -> None:
        super().__init__(network)
        self.diffuse = nn.Conv2d(4 * 3, network.widths[0], 3, padding=1, bias=False)  # beside self.first
        self.heads = nn.ModuleList(empty_head(head.in_channels, 2 * head.out_channels) for head in self.heads)

    def entrance(self, inputs: dict[str, Tensor], sums: Tensor) -> Tensor:
        diffuse, _, factor = self.parts(inputs)
        exposed = diffuse / factor * inputs["exposure"].reshape(-1, 1, 1, 1)
        return super().entrance(inputs, sums) + self.diffuse(
            functional.pixel_unshuffle(aligned(torch.log1p(exposed)), 2)
        )

    def filter(self, inputs: dict[str, Tensor], counts: list[int] | None = None) -> Filtered:
        predicted, paths = self(inputs, counts)
        logits = [exact(level) for level in predicted.logits]
        diffuse, specular, factor = self.parts(inputs)
        own, other = zip(*(level.chunk(2, 1) for level in logits), strict=True)
        image, _ = reconstruct(predicted._replace(logits=list(own)), diffuse, factor)
        rest, _ = reconstruct(predicted._replace(logits=list(other)), specular, None)
        return Filtered(image + rest, logits, paths, None)

    @staticmethod
    def parts(inputs: dict[str, Tensor]) -> tuple[Tensor, Tensor, Tensor]:
        """Diffuse radiance, the rest, and what the first is divided by; in frames without a split all is the rest."""
        split = inputs["split.present"].reshape(-1, 1, 1, 1)
        diffuse = inputs["diffuse"] * split
        return diffuse, torch.relu(inputs["radiance"] - diffuse), inputs["diffuse.albedo"] + ALBEDO_EPSILON


def empty_head(inputs: int, outputs: int) -> nn.Conv2d:
    """A 1x1 layer that begins at 0, as the family's heads do: uniform kernels."""
    head = nn.Conv2d(inputs, outputs, 1)
    nn.init.zeros_(head.weight)
    nn.init.zeros_(head.bias)  # type: ignore[arg-type]
    return head


@dataclass(frozen=True)
class Variant:
    """What a row changes: fields of parts of the preset, the share of scenes to train on, the network itself."""

    run: str  # its folder; rows of one run differ in how it is scored
    title: str
    change: dict[str, dict[str, Any]]
    all_seeds: bool = False  # else the first one alone
    paths: bool = True  # whether it is scored with path descriptors
    scenes: float = 1.0
    network: type[Pathfold] = Pathfold


BASELINE = "baseline"
VARIANTS = (
    Variant(BASELINE, "baseline", {}, all_seeds=True),
    Variant(BASELINE, "baseline, scored without paths", {}, all_seeds=True, paths=False),
    Variant("no-paths", "never any paths", {"data": {"drop_paths": 1.0}}, all_seeds=True, paths=False),
    Variant("unscaled", "descriptors not scaled", {"network": {"scaled": False}}),
    Variant("manifold-low", "manifold loss, lambda 0.00125", {"loss": {"manifold": 0.00125}}),
    Variant("manifold", "manifold loss, lambda 0.0125", {"loss": {"manifold": 0.0125}}, all_seeds=True),
    Variant("manifold-high", "manifold loss, lambda 0.0625", {"loss": {"manifold": 0.0625}}),
    Variant("all-samples", "all samples' paths embedded", {"network": {"embedded": 0}}),
    Variant("embedding-4", "4 embedding channels", {"network": {"embedding": 4}}),
    Variant("embedding-16", "16 embedding channels", {"network": {"embedding": 16}}),
    Variant("kernel-11", "one 11x11 kernel instead of the pyramid", {}, network=SingleKernel),
    Variant("robust", "robust loss", {"loss": {"image": "robust"}}),
    Variant("unbiased", "unbiased loss", {"loss": {"image": "unbiased"}}),
    Variant("no-energy", "without the error of block means", {"loss": {"energy": 0.0}}),
    Variant("split", "diffuse and specular each", {}, network=SplitKernels),
    Variant("uncleaned", "albedo not cleaned", {"network": {"clean": False}}),
    Variant("modulated", "not demodulated", {"network": {"demodulate": False}}),
    Variant("scenes-25", "25 % of the scenes", {}, scenes=0.25),
    Variant("scenes-50", "50 % of the scenes", {}, scenes=0.5),
)


def changed(preset: Config, change: dict[str, dict[str, Any]]) -> Config:
    """The preset with some fields of its parts replaced; checked, so that a misspelt one is an error."""
    fields = preset.model_dump()
    for part, values in change.items():
        fields[part] |= values
    return Config.model_validate(fields)


def chosen_scenes(scenes: Sequence[str], share: float) -> set[str]:
    """That share of the scenes, at least one, drawn by their names: a smaller share is part of a larger one."""
    ordered = sorted(set(scenes), key=lambda name: sha256(name.encode()).digest())
    return set(ordered[: max(1, round(share * len(ordered)))])


def subset(data: Path, folder: Path, share: float) -> Path:
    """A data set of a share of the training scenes and all held-out views; files are those of `data`, by links."""
    if not (folder / "index.jsonl").exists():
        lines = store.Store(data).lines
        chosen = chosen_scenes([str(line["scene"]) for line in lines if line["split"] == "train"], share)
        kept = [line for line in lines if line["split"] != "train" or str(line["scene"]) in chosen]
        folder.mkdir(parents=True, exist_ok=True)
        for kind in store.KINDS:
            if not (folder / kind).is_symlink():
                (folder / kind).symlink_to((data / kind).resolve(), target_is_directory=True)
        write_whole(folder / "index.jsonl", "".join(json.dumps(line) + "\n" for line in kept).encode())
    return folder


def measure(
    variant: Variant, config: Config, seed: int, data: Path, run: Path, views: Sequence[Window]
) -> dict[str, Any]:
    """Train, or go on, and score: what a line of results.jsonl says beside its key."""
    unlike = variant.network is not Pathfold
    with mock.patch.object(task, "Pathfold", variant.network) if unlike else nullcontext():
        checkpoint = fit(config, data, run, seed, threads=1, validate_every=10**6)
        network = load(checkpoint)
        spps = [spp for spp in SPPS if spp <= min(view.samples for view in views)]
        logs = {str(spp): score(network, views, spp, variant.paths) for spp in spps}
    state = torch.load(checkpoint, map_location="cpu", weights_only=True)
    return {
        "views": len(views),
        "commit": commit(),
        "logs": logs,
        "parameters": sum(p.numel() for p in network.parameters()),
        **training_seconds(state),
    }


def tables(rows: Sequence[pages.Row]) -> str:
    """A line per variant that has a result, in their order."""
    spps = sorted(rows[0]["logs"], key=int)
    head = ["variant", "seeds", *(f"{spp} spp" for spp in spps), "all", f"/ {BASELINE}", "deviation", "CPU s"]
    table = [head]
    totals = {(r["title"], r["seed"]): fmean(r["logs"].values()) for r in rows}
    for variant in VARIANTS:
        own = [r for r in rows if r["title"] == variant.title]
        if not own:
            continue
        logs = [totals[r["title"], r["seed"]] for r in own]
        against = [
            log - totals[BASELINE, r["seed"]]
            for log, r in zip(logs, own, strict=True)
            if (BASELINE, r["seed"]) in totals
        ]
        means = [math.exp(fmean(r["logs"][spp] for r in own)) for spp in spps]
        cells = [variant.title, str(len(own)), *(f"{mean:.4f}" for mean in means), f"{math.exp(fmean(logs)):.4f}"]
        cells.append(f"{math.exp(fmean(against)):.3f}" if against else "")
        cells.append(f"{100 * stdev(logs):.1f} %" if len(logs) > 1 else "")
        table.append([*cells, f"{fmean(r['cpu_seconds'] for r in own):.0f}"])
    first = rows[0]
    lead = (
        f"{first['config']['name']}, {first['config']['optimiser']['steps']} steps; {first['views']} held-out windows"
    )
    return f"{lead}:\n\n{markdown(table)}"


PAGE = pages.Page(
    "ablation",
    "What each part of the pathfold family is worth",
    "A preset trained at one modest budget with one thing changed at a time, scored on held-out windows: RelL2 over "
    "the noisy input's, geometric mean in which each scene counts alike.",
    tables,
)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("data", type=Path)
    parser.add_argument("work", type=Path)
    parser.add_argument("--preset", default="pathfold-fast")
    parser.add_argument("--steps", type=int, default=500)
    parser.add_argument("--seeds", type=int, default=3, help="of the rows that need more than one")
    parser.add_argument("--only", nargs="+", choices=sorted({v.run for v in VARIANTS}), help="runs to make")
    parser.add_argument("-o", "--output", type=Path, default=pages.RESULTS, help="folder for the page and its data")
    options = parser.parse_args()
    preset = load_preset(options.preset)
    if not isinstance(preset.network, PathfoldSizes):
        raise SystemExit(f"{options.preset} is not of the pathfold family")
    warmup = min(preset.optimiser.warmup, options.steps // 10)
    preset = changed(preset, {"optimiser": {"steps": options.steps, "warmup": max(1, warmup)}})
    part = partial(subset, options.data)
    views = Stored(part(options.work / "data-100", 1.0)).held_out()
    findings = pages.Findings(PAGE, options.output, [])
    for variant in VARIANTS:
        if options.only and variant.run not in options.only:
            continue
        config = changed(preset, variant.change)
        unchanged = (config, variant.scenes, variant.network) == (preset, 1.0, Pathfold)
        name = BASELINE if unchanged else variant.run  # a row may name what the preset has already
        folder = part(options.work / f"data-{100 * variant.scenes:.0f}", variant.scenes)
        for seed in range(options.seeds if variant.all_seeds else 1):
            key = {"title": variant.title, "seed": seed, "config": json.loads(config.model_dump_json())}
            run = options.work / f"{config.name}-{options.steps}" / f"{name}-{seed}"
            found = findings.row(key, partial(measure, variant, config, seed, folder, run, views))
            print(f"{variant.title}, seed {seed}: {found['logs']}", file=sys.stderr, flush=True)
    findings.finish()


if __name__ == "__main__":
    main()
