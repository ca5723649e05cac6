"""Many views with cheap references, or few with clean ones? One network, one amount of core time, several budgets.

    python benchmarks/references.py WORK [--budgets 0.5 4 16 --core-minutes 6 --seeds 3 --steps 400]

Every budget (core-seconds per reference, as `pathfold-train render --budget`) gets as many generated views as the core
time allows, refused ones included. The network is trained on them with each loss and seed, and scored on views that
none has seen, whose references had `--clean` core-seconds: RelL2 relative to the noisy input's at 8 spp, geometric
mean. WORK keeps data sets and checkpoints; the same command goes on where it was stopped.
"""

import json
import math
import resource
from argparse import ArgumentParser, Namespace, RawDescriptionHelpFormatter
from collections.abc import Sequence
from functools import partial
from pathlib import Path
from statistics import fmean, median, stdev
from typing import Any
from unittest import mock

import pages
from pathfold.report.tables import markdown
from pathfold_training.dataset import store
from pathfold_training.dataset.clean import clean
from pathfold_training.dataset.render import render
from pathfold_training.fit.preset import Config, load_preset
from pathfold_training.fit.train import fit
from pathfold_training.fit.views import Stored, Window
from pathfold_training.networks.families import FAMILIES
from pathfold_training.networks.pathfold.network import Pathfold
from pathfold_training.release.score import load, score
from variants import Unbiased

ROUND = 8  # views between two looks at the clock
HELD_OUT_SEED = 1000
LOSSES = {"robust": Pathfold, "unbiased": Unbiased}


def core_seconds() -> float:
    """CPU time of this process and of the workers it has waited for."""
    return sum(
        t.ru_utime + t.ru_stime for t in map(resource.getrusage, (resource.RUSAGE_SELF, resource.RUSAGE_CHILDREN))
    )


def render_for(seconds: float, folder: Path, budget: float) -> None:
    """Renders rounds of views, each of its own seed, until the core time is spent; what a stopped one took is lost."""
    done = folder / "rounds.json"
    spent = json.loads(done.read_text()) if done.exists() else []
    while sum(spent) < seconds:
        start = core_seconds()
        render(folder, procedural=ROUND, budget=budget, seed=len(spent), held_out=0.15)
        spent.append(core_seconds() - start)
        done.write_text(json.dumps(spent))


def measure(budget: float, loss: str, preset: Config, held_out: Sequence[Window], options: Namespace) -> dict[str, Any]:
    """What a budget made, and the scores of the networks trained on it with a loss: logs, one per seed."""
    data = options.work / f"budget-{budget:g}"
    render_for(60 * options.core_minutes, data, budget)
    if preset.data.cleaned:
        clean(data)
    views = store.read_index(data)
    optimiser = preset.optimiser.model_copy(update={"steps": options.steps})
    chosen = preset.loss.model_copy(update={"image": "robust"})
    config = preset.model_copy(update={"loss": chosen, "optimiser": optimiser})
    scores = []
    for seed in range(options.seeds):
        run = options.work / "runs" / f"{budget:g}-{loss}-{seed}"
        with mock.patch.dict(FAMILIES, pathfold=FAMILIES["pathfold"]._replace(network=LOSSES[loss])):
            scores.append(score(load(fit(config, data, run, seed, 1, validate_every=10**6)), held_out))
    facts = {name: median(view[name] for view in views) for name in ("reference_spp", "reference_rell2")}
    return {"views": len(views), **facts, "scores": scores}


def tables(rows: Sequence[pages.Row]) -> str:
    head = ["core-seconds a reference", "views", "median reference spp", "their median RelL2", "loss", "error / noisy"]
    table = [[*head, "deviation over seeds"]]
    for row in rows:
        spread = stdev(row["scores"]) if len(row["scores"]) > 1 else 0.0
        cells = [f"{row['budget']:g}", str(row["views"]), f"{row['reference_spp']:.0f}"]
        cells += [f"{row['reference_rell2']:.1e}", row["loss"], f"{math.exp(fmean(row['scores'])):.4f}"]
        table.append([*cells, f"{100 * spread:.1f} %"])
    asked = rows[0]["asked"]
    lead = f"{asked['preset']}, {asked['steps']} steps, {asked['seeds']} seeds, {asked['core_minutes']:g} core-minutes"
    return f"{lead} for each budget:\n\n{markdown(table)}"


PAGE = pages.Page(
    "references",
    "Many cheap references, or few clean ones",
    "One network, trained on as many views as fit into the same core time with references of unlike budgets; RelL2 "
    "over the noisy input's at 8 spp on views that none has seen, geometric mean.",
    tables,
)


def main() -> None:
    parser = ArgumentParser(description=__doc__, formatter_class=RawDescriptionHelpFormatter)
    parser.add_argument("work", type=Path)
    parser.add_argument("--budgets", type=float, nargs="+", default=[0.5, 4, 16])
    parser.add_argument("--core-minutes", type=float, default=6)
    parser.add_argument("--seeds", type=int, default=3)
    parser.add_argument("--steps", type=int, default=400)
    parser.add_argument("--preset", default="pathfold-fast")
    parser.add_argument("--held-out", type=int, default=16, help="views to score on")
    parser.add_argument("--clean", type=float, default=30, help="core-seconds of their references")
    parser.add_argument("-o", "--output", type=Path, default=pages.RESULTS, help="folder for the page and its data")
    options = parser.parse_args()
    scored_on = options.work / "held-out"
    render(scored_on, procedural=options.held_out, budget=options.clean, seed=HELD_OUT_SEED, held_out=0.0)
    preset = load_preset(options.preset)
    held_out = Stored(scored_on).train
    findings = pages.Findings(PAGE, options.output, [])
    asked = {name: getattr(options, name) for name in ("preset", "steps", "seeds", "core_minutes", "held_out", "clean")}
    for budget in options.budgets:
        for loss in LOSSES:
            key = {"budget": budget, "loss": loss, "asked": asked}
            findings.row(key, partial(measure, budget, loss, preset, held_out, options))
    findings.finish()


if __name__ == "__main__":
    main()
