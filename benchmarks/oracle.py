"""How far an operator alone could go: free kernel logits, no network, fitted on some noise seeds, scored on others.

    python benchmarks/oracle.py DATA [--crop 96 --views 3 --steps 200]

DATA is a data set of `pathfold-train render`. Each noise seed is the mean of four of a view's stored samples. Fitting
one seed would select its lucky pixels, so logits are shared by four seeds and scored on four others. RelL2 of the
exposed image against the view's reference, relative to the noisy input's: lower is better.
"""

import argparse
import math
from collections.abc import Callable, Sequence
from functools import partial
from pathlib import Path

import numpy as np
import pages
import torch
from pathfold.report.tables import markdown
from pathfold_training.fit.views import Stored, Window
from pathfold_training.networks.losses import error_scale, robust_relative
from pathfold_training.networks.pathfold.unet import ALBEDO_EPSILON
from pathfold_training.networks.reconstruct import COARSEST_LOGITS, LEVEL_LOGITS, gather, gather_pyramid
from torch import Tensor

SEEDS, SPP = 8, 4
Operator = Callable[[Tensor], Tensor]


def noisy_crop(view: Window, size: int, seed: int) -> tuple[Tensor, Tensor, Tensor]:
    """Exposed radiance of SEEDS renders, their albedos, and the reference: 8 x 3 x h x w, and 1 x 3 x h x w."""
    rng = np.random.default_rng(seed)
    samples, reference = view.crop(*view.corner(size, rng), size, np.arange(SEEDS * SPP), 0)
    color = samples["samples.radiance"].unflatten(0, (SEEDS, SPP)).mean(1) * view.exposure
    albedo = samples["samples.albedo"].unflatten(0, (SEEDS, SPP)).mean(1)
    return color, albedo, reference["color"][None] * view.exposure


def pyramid(size: int, levels: int, trust: bool) -> tuple[list[Tensor], Operator]:
    free = [torch.zeros(1, LEVEL_LOGITS, size >> i, size >> i) for i in range(levels - 1)]
    free += [torch.zeros(1, COARSEST_LOGITS, size >> (levels - 1), size >> (levels - 1)), torch.zeros(1, 1, size, size)]

    def apply(radiance: Tensor) -> Tensor:
        # logits are of the place, not of the noise: every seed gets the same
        shared = [f.expand(radiance.shape[0], -1, -1, -1) for f in free]
        return gather_pyramid(-9.0 * torch.sigmoid(shared[-1] - 2.0) * trust, shared[:-1], radiance)

    return free, apply


def single_kernel(size: int, kernel: int) -> tuple[list[Tensor], Operator]:
    free = [torch.zeros(1, kernel**2, size, size)]
    return free, lambda radiance: gather(free[0].expand(radiance.shape[0], -1, -1, -1), radiance, kernel)


def fitted(free: list[Tensor], apply: Operator, color: Tensor, factor: Tensor, reference: Tensor, steps: int) -> float:
    """Log of the RelL2 on the second half of the seeds over that of the noisy input."""
    half = SEEDS // 2
    optimiser = torch.optim.Adam([f.requires_grad_() for f in free], lr=0.1)
    scale = error_scale(reference)
    for _ in range(steps):
        optimiser.zero_grad()
        clean = apply((color / factor)[:half]) * factor[:half]
        robust_relative(clean, reference, scale).mean().backward()
        optimiser.step()
    with torch.no_grad():
        clean = apply((color / factor)[half:]) * factor[half:]
    error, noise = (((x - reference).square() / (reference.square() + 0.01)).mean() for x in (clean, color[half:]))
    return math.log(float(error / noise))


Crops = list[tuple[Tensor, Tensor, Tensor]]


def measure(make: Callable[[], tuple[list[Tensor], Operator]], demodulate: bool, crops: Crops, steps: int) -> pages.Row:
    """The log that `fitted` gives of every crop."""
    logs = []
    for color, albedo, reference in crops:
        factor = albedo + ALBEDO_EPSILON if demodulate else torch.ones_like(albedo)
        logs.append(fitted(*make(), color, factor, reference, steps))
    return {"logs": logs}


def tables(rows: Sequence[pages.Row]) -> str:
    crops = len(rows[0]["logs"])
    table = [["operator", *(f"crop {number}" for number in range(crops)), "geometric mean"]]
    for row in rows:
        values = [*row["logs"], sum(row["logs"]) / crops]
        table.append([row["operator"], *(f"{math.exp(value):.3f}" for value in values)])
    size = rows[0]["size"]
    return f"{crops} crops of {size}x{size}, {SPP} spp, {rows[0]['steps']} steps:\n\n{markdown(table)}"


PAGE = pages.Page(
    "oracle",
    "How far an operator alone could go",
    "Free kernel logits, no network, fitted on four noise seeds of a crop and scored on four others: RelL2 over the "
    "noisy input's.",
    tables,
)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("data", type=Path)
    parser.add_argument("--crop", type=int, default=96, help="a multiple of 16")
    parser.add_argument("--views", type=int, default=3)
    parser.add_argument("--steps", type=int, default=200)
    parser.add_argument("-o", "--output", type=Path, default=pages.RESULTS, help="folder for the page and its data")
    options = parser.parse_args()
    torch.set_num_threads(1)
    size = options.crop
    variants: dict[str, tuple[Callable[[], tuple[list[Tensor], Operator]], bool]] = {
        "pyramid, 5 levels": (lambda: pyramid(size, 5, True), True),
        "without trust": (lambda: pyramid(size, 5, False), True),
        "without demodulation": (lambda: pyramid(size, 5, True), False),
        "3 levels": (lambda: pyramid(size, 3, True), True),
        "one 11x11 kernel": (lambda: single_kernel(size, 11), True),
    }
    usable = [view for view in Stored(options.data).train if view.samples >= SEEDS * SPP and view.side >= size]
    if not usable:
        raise SystemExit(f"{options.data} has no view with {SEEDS * SPP} samples in {size}x{size} pixels")
    crops = [noisy_crop(view, size, seed) for seed, view in enumerate(usable[: options.views])]
    findings = pages.Findings(PAGE, options.output, [])
    for name, variant in variants.items():
        key = {"operator": name, "size": size, "steps": options.steps, "views": options.views}
        findings.row(key, partial(measure, *variant, crops, options.steps))
    findings.finish()


if __name__ == "__main__":
    main()
