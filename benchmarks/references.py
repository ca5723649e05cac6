"""Many views with cheap references, or few with clean ones? One network, one amount of core time, several budgets.

    python benchmarks/references.py WORK [--budgets 0.5 4 16 --core-minutes 6 --seeds 3 --steps 400]

Every budget (core-seconds per reference, as `pathfold-train render --budget`) gets as many generated views as the core
time allows, refused ones included. The network is trained on them with each loss and seed, and scored on views that
none has seen, whose references had `--clean` core-seconds: RelL2 relative to the noisy input's at 8 spp, geometric
mean. WORK keeps data sets and checkpoints; the same command goes on where it was stopped.
"""

import argparse
import json
import math
import resource
from pathlib import Path
from statistics import fmean, median, stdev

from pathfold_training import store
from pathfold_training.config import load_preset
from pathfold_training.data import Stored
from pathfold_training.fit import fit
from pathfold_training.render import render
from pathfold_training.score import load, score

ROUND = 8  # views between two looks at the clock
HELD_OUT_SEED = 1000


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


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("work", type=Path)
    parser.add_argument("--budgets", type=float, nargs="+", default=[0.5, 4, 16])
    parser.add_argument("--core-minutes", type=float, default=6)
    parser.add_argument("--seeds", type=int, default=3)
    parser.add_argument("--steps", type=int, default=400)
    parser.add_argument("--preset", default="pathfold-fast")
    parser.add_argument("--held-out", type=int, default=16, help="views to score on")
    parser.add_argument("--clean", type=float, default=30, help="core-seconds of their references")
    arguments = parser.parse_args()
    clean = arguments.work / "held-out"
    render(clean, procedural=arguments.held_out, budget=arguments.clean, seed=HELD_OUT_SEED, held_out=0.0)
    preset = load_preset(arguments.preset)
    held_out = Stored(clean).train
    print(
        "| budget | views | median reference spp | their median RelL2 | loss | error / noisy | deviation over seeds |"
    )
    print("|---|---|---|---|---|---|---|", flush=True)
    for budget in arguments.budgets:
        data = arguments.work / f"budget-{budget:g}"
        render_for(60 * arguments.core_minutes, data, budget)
        views = store.read_index(data)
        facts = f"{budget:g} | {len(views)} | {median(v['reference_spp'] for v in views):.0f}"
        facts += f" | {median(v['reference_rell2'] for v in views):.1e}"
        for loss in ("robust", "unbiased"):
            options = preset.optimiser.model_copy(update={"steps": arguments.steps})
            config = preset.model_copy(
                update={"loss": preset.loss.model_copy(update={"image": loss}), "optimiser": options}
            )
            scores = []
            for seed in range(arguments.seeds):
                run = arguments.work / "runs" / f"{budget:g}-{loss}-{seed}"
                scores.append(score(load(fit(config, data, run, seed, 1, validate_every=10**6)), held_out))
            spread = stdev(scores) if len(scores) > 1 else 0.0
            print(f"| {facts} | {loss} | {math.exp(fmean(scores)):.4f} | {100 * spread:.1f} % |", flush=True)


if __name__ == "__main__":
    main()
