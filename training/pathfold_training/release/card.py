"""The model card, README.md of a model folder: everything in it comes from the manifest."""

from __future__ import annotations

from collections.abc import Sequence
from os.path import relpath
from pathlib import Path
from typing import Any

from pathfold.bench.results import geometric, read

from ..files import read_object

OPERATORS = {"gather": "plus the {size}x{size} gather", "pyramid": "plus the gather pyramid"}
PEERS = ("noisy", "oidn", "oidn-prefiltered")


def model_card(manifest: dict[str, Any], errors: str = "") -> str:
    """Markdown with a YAML head: what the model reads, what it costs, how it was trained and how to do it again.

    `errors` is a section of its own, from error_section.
    """
    training, data = manifest["training"], manifest["training"]["data"]
    config = training["config"]
    optimiser, crops = config["optimiser"], config["data"]
    start = training["started_from"]
    begun = f"; its weights began as {start['preset']}'s after {start['steps']} steps" if start else ""
    scenes = ", ".join(data["scenes"]) or "none"
    seconds = [training["seconds"], training["cpu_seconds"]]
    if start:
        seconds = [seconds[0] + start["seconds"], seconds[1] + start["cpu_seconds"]]
    reconstruction = manifest["reconstruction"]
    several = len(reconstruction["branches"]) > 1
    operator = "both branches, " if several else ""
    operator += OPERATORS[reconstruction["operator"]].format(**reconstruction)
    embedded = manifest["samples_per_pixel"].get("embedded")
    paths = f"; the paths of the first {embedded} are looked at" if embedded else ""
    cost = f"{training['kmac_per_pixel']:.0f} kMAC per pixel at 8 spp, {operator}"
    steps = f"{training['steps']} of {crops['batch']} crops of {crops['crop']}x{crops['crop']} pixels{begun}"
    for other in training.get("averaged_with", ()):
        steps += f"; averaged with the run of seed {other['seed']} and commit {other['commit']}"
    precision = manifest["precision"]
    for variant, block in manifest.get("variants", {}).items():
        precision += f"; {variant} with {block['rell2_over_fp32']:.4g} times the RelL2 on held-out views"
    loss = config["loss"]
    weights = f"{loss.get('image', 'robust')} relative error of the image"
    weights += f", {loss['branch']:g} on each branch" if several else ""
    names = {"energy": "means of 16x16 blocks", "albedo": "the cleaned albedo"}
    weights += "".join(f", {loss[name]:g} on {what}" for name, what in names.items() if loss.get(name))
    weights += f", manifold lambda {loss['manifold']:g}"
    rate = f"{optimiser['learning_rate']:g} with a cosine to {optimiser['final_fraction']:g} of it"
    return f"""---
license: apache-2.0
library_name: pathfold
tags: [monte-carlo-denoising, kernel-prediction]
---

# {manifest["name"]}

{manifest["description"]}.

| | |
|---|---|
| requires | {", ".join(manifest["requires"])} |
| uses if given | {", ".join(manifest["uses"])} |
| cost | {cost} |
| tile | overlap {manifest["tile"]["overlap"]} px, alignment {manifest["tile"]["alignment"]} |
| samples per pixel | trained on {crops["spp_min"]} to {crops["spp_max"]}{paths} |
| precision | {precision} |

## Training

| | |
|---|---|
| steps | {steps} |
| loss | {weights} |
| optimiser | Adam, learning rate {rate} |
| views | {data["views"]} for training ({data["procedural"]} procedural), {data["validation_views"]} held out |
| library scenes | {scenes} |
| references | {data["reference_spp"][0]} to {data["reference_spp"][1]} spp |
| hardware | {training["hardware"]} |
| seconds | {seconds[0]:.0f} wall, {seconds[1]:.0f} CPU, all parts of the run |
| seed, commit | {training["seed"]}, {training["commit"]} |

The table tells the last of a chain of runs. docs/training.md says how to train a model, docs/results/ how well it does.
{errors}"""


def write_card(folder: Path, results: Path) -> None:
    """README.md of a model folder, with its errors in the folder that `pathfold-train evaluate` wrote.

    Raises ValueError without a manifest of `pathfold-train export`, or where the model was not evaluated at one spp
    there.
    """
    again = "make it by pathfold-train export"
    if not (folder / "manifest.json").is_file():
        raise ValueError(f"{folder} is no model folder: it has no manifest.json; {again}")
    manifest = read_object(folder / "manifest.json", {"name": str, "training": dict}, again)
    section = error_section(manifest["name"], results, relpath(results, folder))
    try:
        text = model_card(manifest, section)
    except (KeyError, TypeError) as error:
        raise ValueError(f"{folder / 'manifest.json'} is not whole ({error}); {again}") from error
    (folder / "README.md").write_text(text)


def error_section(name: str, results: Path, link: str) -> str:
    """Markdown: RelL2 scene by scene beside the input's and OIDN's, worst against OIDN first, with pictures."""
    rows = list(read(results / "results.jsonl").values())
    again = f"make it by pathfold-train evaluate SCENES -o {results}"
    methods = [*PEERS, name]
    if missing := [method for method in reversed(methods) if not any(row.method == method for row in rows)]:
        raise ValueError(f"{results} has no measurement of {missing[0]}: {again}")
    if len({row.spp for row in rows}) > 1:
        raise ValueError(f"{results} holds several spp: {again}, which measures at one")

    def mean(method: str, scenes: Sequence[str]) -> float:
        return geometric(
            geometric([row.rell2 for row in rows if (row.method, row.scene) == (method, scene)]) for scene in scenes
        )

    scenes = sorted({row.scene for row in rows}, key=lambda scene: -mean(name, [scene]) / mean("oidn", [scene]))
    spp, seeds = rows[0].spp, len({row.seed for row in rows})
    lines = [f"| scene | {' | '.join(methods)} | / oidn |", "|---" * (len(methods) + 2) + "|"]
    for title, some in [*((f"[{scene}]({link}/{scene}-{spp}spp.jpg)", [scene]) for scene in scenes), ("all", scenes)]:
        means = [mean(method, some) for method in methods]
        lines.append(f"| {title} | {' | '.join(f'{m:.4f}' for m in means)} | {means[-1] / means[1]:.2f} |")
    return f"""
## Errors

RelL2 at {spp} spp, geometric mean of {seeds} render seeds. Where it is weakest against OIDN stands first; a name leads
to a picture.

""" + "\n".join([*lines, ""])
