"""`pathfold-train average`: runs of one network as one, whose weights are the mean of theirs."""

from __future__ import annotations

import json
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import torch

from ..files import make_folder
from ..fit.checkpoint import RECORD, load_checkpoint, read_record


def average(runs: Sequence[Path], out: Path) -> Path:
    """Write out/last.ckpt and its record, of the first of `runs` but for the weights, and return the checkpoint.

    Each run counts alike, by its moving average. It pays for runs that went from one to the next, which lie in one
    valley of the loss (Izmailov et al. 2018, "Averaging Weights Leads to Wider Optima and Better Generalization"), not
    for runs from different first weights. Raises ValueError for fewer than two runs, for one given twice, for different
    networks, where `out` holds a run and where a run has no checkpoint or record.
    """
    if len(runs) < 2:
        raise ValueError("give two runs or more to average")
    if (out / "last.ckpt").exists():
        raise ValueError(f"-o {out} holds a run already; give another folder")
    for number, run in enumerate(runs):
        if run.resolve() in [other.resolve() for other in runs[:number]]:
            raise ValueError(f"{run} is given twice; give different runs to average")
    configs, states = zip(*(load_checkpoint(run / "last.ckpt") for run in runs), strict=True)
    records = [read_record(run) for run in runs]
    weights = [state["state_dict"] for state in states]
    for run, config, own in zip(runs, configs, weights, strict=True):
        if config.network != configs[0].network or own.keys() != weights[0].keys():
            raise ValueError(f"{run} has another network than {runs[0]}; average runs of one preset")
    for name, value in weights[0].items():
        if value.is_floating_point():
            weights[0][name] = torch.stack([each[name] for each in weights]).mean(0)
    others = [
        {"commit": record["commit"], "seed": record["seed"], "steps": state["global_step"]}
        for record, state in zip(records[1:], states[1:], strict=True)
    ]
    make_folder(out)
    record: dict[str, Any] = records[0] | {"averaged_with": others}
    (out / RECORD).write_text(json.dumps(record, indent=2) + "\n")
    torch.save(states[0], out / "last.ckpt")
    return out / "last.ckpt"
