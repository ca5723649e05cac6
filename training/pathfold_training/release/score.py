"""How good a checkpoint is on views it was not trained on: RelL2 over the noisy input's, each scene counting alike."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path
from statistics import fmean

import torch

from ..fit.checkpoint import load_checkpoint
from ..fit.frames import without_paths
from ..fit.task import Denoising
from ..fit.views import ValidationViews, Window


def load(checkpoint: Path) -> Denoising:
    """The network of a checkpoint of `fit`, ready to denoise: its averaged weights where the preset averages.

    Raises ValueError naming a file that is no such checkpoint.
    """
    config, state = load_checkpoint(checkpoint)
    task = Denoising(config).eval()
    task.load_state_dict(state["state_dict"])
    return task


def score(task: Denoising, views: Sequence[Window], spp: int = 8, paths: bool = True) -> float:
    """Mean log of RelL2 over the noisy input's at `spp`, over whole windows; lower is better.

    Free of the references' noise. Scenes weigh alike, however many windows each has. `paths` False takes the
    descriptors away from a network that could use them.
    """
    frames = ValidationViews(views, task.config.network.path_samples, spp)
    logs = []
    with torch.no_grad():
        for index in range(len(frames)):
            batch = frames[index]
            blind = batch if paths else replace(batch, inputs=without_paths(batch.inputs), counts=[1])
            logs.append(float(task.ratio_log(blind)))
    return scene_mean([view.scene for view in views], logs)


def scene_mean(scenes: Sequence[str], values: Sequence[float]) -> float:
    """The mean over scenes of each scene's mean."""
    of_scene: dict[str, list[float]] = {}
    for scene, value in zip(scenes, values, strict=True):
        of_scene.setdefault(scene, []).append(value)
    return fmean(fmean(each) for each in of_scene.values())
