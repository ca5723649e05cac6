"""The model card, README.md of a model folder: everything in it comes from the manifest."""

from __future__ import annotations

from typing import Any


def model_card(manifest: dict[str, Any]) -> str:
    """Markdown with a YAML head: what the model reads, what it costs, how it was trained and how to do it again."""
    training, data = manifest["training"], manifest["training"]["data"]
    config = training["config"]
    optimiser, crops = config["optimiser"], config["data"]
    start = training["started_from"]
    begun = f"; its weights began as {start['preset']}'s after {start['steps']} steps" if start else ""
    scenes = ", ".join(data["scenes"]) or "none"
    seconds = [training["seconds"], training["cpu_seconds"]]
    if start:
        seconds = [seconds[0] + start["seconds"], seconds[1] + start["cpu_seconds"]]
    side = manifest["reconstruction"].get("size")
    operator = f"both branches, plus the {side}x{side} gather" if side else "plus the gather pyramid"
    cost = f"{training['kmac_per_pixel']:.0f} kMAC per pixel at 8 spp, {operator}"
    steps = f"{training['steps']} of {crops['batch']} crops of {crops['crop']}x{crops['crop']} pixels{begun}"
    precision = manifest["precision"]
    for variant, block in manifest.get("variants", {}).items():
        precision += f"; {variant} with {block['rell2_over_fp32']:.4g} times the RelL2 on held-out views"
    loss = config["loss"]
    weights = f"{loss.get('image', 'robust')} relative error of the image"
    weights += f", {loss['branch']:g} on each branch" if side else ""  # a pyramid has but one
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
| samples per pixel | trained on {crops["spp_min"]} to {crops["spp_max"]} |
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

The commands that train it again are in docs/training.md; errors per scene, pictures and known weaknesses in
docs/results/. The validation scenes were neither trained nor selected on.
"""
