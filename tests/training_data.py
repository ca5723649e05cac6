"""A tiny data set and preset for the tests of training: smooth colours, exponential noise, made with a seed."""

from pathlib import Path

import numpy as np
from pathfold_training.dataset.store import append_line, write
from pathfold_training.fit.preset import Config, Data, Optimiser
from pathfold_training.networks.kpcn.sizes import KpcnSizes
from pathfold_training.networks.losses import Loss

SAMPLES, SIDE = 8, 40

TINY = Config(
    name="tiny",
    description="a network for tests",
    network=KpcnSizes(width=8, layers=3, kernel_size=5, embedding=3, embedding_width=4),
    loss=Loss(manifold=0.0125, manifold_pairs=256),
    data=Data(crop=24, batch=2, spp_max=4),
    optimiser=Optimiser(steps=4, precision="fp32", warmup=1),
)


def write_data_set(folder: Path, views: int = 3) -> Path:
    """`views` views of 40 x 40 pixels at 8 spp, the last one held out."""
    folder.mkdir(parents=True)
    for number in range(views):
        split = "val" if number == views - 1 else "train"
        line = {"id": f"view-{number}", "scene": "smooth", "kind": "procedural", "split": split, "seed": number}
        line |= {"licence": "CC0-1.0", "width": SIDE, "height": SIDE, "spp": SAMPLES, "described": SAMPLES}
        line |= {"reference_spp": 1024, "reference_rell2": 0.0, "max_depth": 6, "content": "room", "path": ""}
        line |= {"exposure": 0.5, "depth_scale": 0.4, "crop": SIDE, "crops": [[0, 0]], "cpu_seconds": 0.0}
        append_line(folder, write(folder, line, view_tensors(number)))
    return folder


def view_tensors(seed: int) -> dict[str, np.ndarray]:
    rng = np.random.default_rng(seed)
    y, x = np.mgrid[0:SIDE, 0:SIDE] / SIDE
    clean = np.stack([0.2 + x, 0.3 + y, 0.5 + x * y]).astype(np.float32)
    radiance = (clean * rng.exponential(1.0, (SAMPLES, 3, SIDE, SIDE))).astype(np.float32)
    half = {"samples.diffuse.albedo": np.full((SAMPLES, 3, SIDE, SIDE), 0.5), "samples.albedo": radiance * 0 + clean}
    half["samples.normal"] = rng.uniform(-1, 1, (SAMPLES, 3, SIDE, SIDE))
    logs = np.log(np.maximum(radiance, 1e-30))
    descriptor = [
        logs,
        logs,
        rng.normal(0, 2, (SAMPLES, 18, SIDE, SIDE)),
        rng.choice([0, 5, 9, 17], (SAMPLES, 6, SIDE, SIDE)),
    ]
    half["samples.descriptor"] = np.concatenate([*descriptor, rng.uniform(0, 1, (SAMPLES, 6, SIDE, SIDE))], 1)
    full = {"samples.radiance": radiance, "samples.diffuse": radiance * 0.6}
    full["samples.depth"] = rng.uniform(1, 5, (SAMPLES, 1, SIDE, SIDE))
    full["samples.density"] = rng.normal(0, 5, (SAMPLES, 1, SIDE, SIDE))
    full |= {"reference.color": clean, "reference.diffuse": clean * 0.6, "reference.half_a.color": clean}
    full |= {"reference.half_b.color": clean, "reference.diffuse.albedo": np.full((3, SIDE, SIDE), 0.5)}
    full["importance"] = np.ones((SIDE, SIDE))
    tensors = {name: value.astype(np.float16) for name, value in half.items()}
    tensors |= {name: value.astype(np.float32) for name, value in full.items()}
    return {name: value[None] if name.startswith("samples.") else value for name, value in tensors.items()}
