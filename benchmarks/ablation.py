"""What each part of a pathfold preset is worth: the preset at one modest budget, with one thing changed at a time.

    python benchmarks/ablation.py DATA WORK [--preset pathfold-fast --steps 500 --seeds 3 --only baseline manifold]

DATA is a data set of `pathfold-train render`; as it is at the first start it is kept, so it may grow meanwhile. Every
row of VARIANTS is trained on it with one thread and scored on the held-out views at 2, 8 and 32 spp: RelL2 over the
noisy input's, geometric mean in which each scene counts alike. `all` is the mean of the spp; `/ baseline` compares runs
of equal seeds; `deviation` is that of `all` over seeds, what a difference has to exceed. Every run is printed when it
is done (to stderr) and kept, with all its settings; the same command goes on where it was stopped.

The pathfold family filters color as a whole. "diffuse and specular each" (two sets of kernels, the diffuse part divided
by its own albedo) and "one 11x11 kernel" (41 kMAC per pixel where pathfold-fast's pyramid takes 37) are networks of
variants.py, for training only.
"""

import argparse
import json
import math
import sys
from collections.abc import Sequence
from dataclasses import dataclass
from functools import partial
from hashlib import sha256
from pathlib import Path
from statistics import fmean, stdev
from typing import Any
from unittest import mock

import pages
import torch
from pathfold.report.tables import markdown
from pathfold_training.dataset import store
from pathfold_training.dataset.clean import clean
from pathfold_training.files import write_whole
from pathfold_training.fit.checkpoint import commit, training_seconds
from pathfold_training.fit.preset import Config, load_preset
from pathfold_training.fit.train import fit
from pathfold_training.fit.views import Stored, Window
from pathfold_training.networks.families import FAMILIES
from pathfold_training.networks.pathfold.network import Pathfold
from pathfold_training.networks.pathfold.sizes import PathfoldSizes
from pathfold_training.release.score import load, score
from variants import Modulated, SingleKernel, SplitKernels, Unbiased, Uncleaned, Unscaled

SPPS = (2, 8, 32)


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
    Variant("unscaled", "descriptors not scaled", {}, network=Unscaled),
    Variant("manifold-low", "manifold loss, lambda 0.00125", {"loss": {"manifold": 0.00125}}),
    Variant("manifold", "manifold loss, lambda 0.0125", {"loss": {"manifold": 0.0125}}, all_seeds=True),
    Variant("manifold-high", "manifold loss, lambda 0.0625", {"loss": {"manifold": 0.0625}}),
    Variant("all-samples", "all samples' paths embedded", {"network": {"embedded": 0}}),
    Variant("embedding-4", "4 embedding channels", {"network": {"embedding": 4}}),
    Variant("embedding-16", "16 embedding channels", {"network": {"embedding": 16}}),
    Variant("kernel-11", "one 11x11 kernel instead of the pyramid", {}, network=SingleKernel),
    Variant("robust", "robust loss", {"loss": {"image": "robust"}}),
    Variant("unbiased", "unbiased loss", {"loss": {"image": "robust"}}, network=Unbiased),
    Variant("no-energy", "without the error of block means", {"loss": {"energy": 0.0}}),
    Variant("split", "diffuse and specular each", {"loss": {"albedo": 0.0}}, network=SplitKernels),
    Variant("uncleaned", "albedo not cleaned", {"loss": {"albedo": 0.0}}, network=Uncleaned),
    Variant("modulated", "not demodulated", {"loss": {"albedo": 0.0}}, network=Modulated),
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
        for kind in (*store.KINDS, "cleaned"):
            if not (folder / kind).is_symlink():
                (folder / kind).symlink_to((data / kind).resolve(), target_is_directory=True)
        write_whole(folder / "index.jsonl", "".join(json.dumps(line) + "\n" for line in kept).encode())
    return folder


def measure(
    variant: Variant, config: Config, seed: int, data: Path, run: Path, views: Sequence[Window]
) -> dict[str, Any]:
    """Train, or go on, and score: what a line of results.jsonl says beside its key."""
    with mock.patch.dict(FAMILIES, pathfold=FAMILIES["pathfold"]._replace(network=variant.network)):
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
    if preset.data.cleaned:
        clean(options.data)
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
