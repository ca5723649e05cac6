"""Whether a denoiser keeps a scene's light, and how much of its error is bias: many render seeds of every scene.

    python benchmarks/energy.py SCENES... [--model pathfold-balanced ... --seeds 16 --spp 2 8]

SCENES as `pathfold bench` takes them; of a sequence the first frame counts. Every seed is rendered and denoised. Energy
is sum(output) / sum(reference): its mean over seeds and that mean's standard error, of noisy input, OIDN and the models
(default: the pathfold family's that are shipped). The bias share is the part of RelL2 that stays the same from seed to
seed: the squared difference of the mean output from the reference, freed of the seeds' and the reference's own noise,
over that and the variance together. Each scene and spp is kept when it is done, and the same command goes on there.
"""

import argparse
import gc
import math
import sys
from collections.abc import Sequence
from pathlib import Path
from statistics import fmean, stdev
from typing import Any

import numpy as np
import pages
from numpy.typing import NDArray
from pathfold import metrics
from pathfold.bench import candidates, peers, subjects
from pathfold.bench.candidates import Candidate, Run
from pathfold.bench.reference import Reference
from pathfold.report.tables import markdown


class Spread:
    """Outputs of one method over seeds: their energies, and pixel by pixel their mean and squared deviations."""

    def __init__(self) -> None:
        self.energies: list[float] = []
        self.mean: Any = 0.0
        self.squares: Any = 0.0

    def add(self, image: NDArray[np.float32], reference: Reference) -> None:
        pixels = image.astype(np.float64)
        self.energies.append(float(pixels.sum() / reference.mean.sum(dtype=np.float64)))
        before = pixels - self.mean
        self.mean = self.mean + before / len(self.energies)
        self.squares = self.squares + before * (pixels - self.mean)

    def summary(self, reference: Reference) -> dict[str, float | list[float]]:
        """Energies of all seeds; RelL2 of the mean output and of the deviations from it."""
        number = len(self.energies)
        variance = self.squares / (number - 1)
        a, b = reference.halves or (reference.mean, reference.mean)
        weight = 1 / (reference.mean.astype(np.float64) ** 2 + metrics.EPSILON)
        bias = float((((self.mean - a) * (self.mean - b) - variance / number) * weight).mean())
        return {"energies": self.energies, "bias": bias, "variance": float((variance * weight).mean())}


def measure(
    subject: subjects.Subject, spp: int, seeds: Sequence[int], methods: dict[str, tuple[Candidate, Run]]
) -> dict[str, Any]:
    """The summary of every method on one scene at one spp."""
    reference = subject.reference(0, lambda done: None)
    recorded = {candidate.path_samples for candidate, _ in methods.values()}
    spreads = {name: Spread() for name in methods}
    for seed in seeds:
        shot = subject.shoot(0, spp, seed, recorded, reference.size, False)
        for name, (candidate, run) in methods.items():
            read = {buffer: shot.buffers[buffer] for buffer in candidate.reads & shot.buffers.keys()}
            spreads[name].add(run(read, None, spp), reference)
        print(f"{subject.name}, {spp} spp, seed {seed}", file=sys.stderr, flush=True)
    return {"methods": {name: spread.summary(reference) for name, spread in spreads.items()}}


def tables(rows: Sequence[pages.Row]) -> str:
    """Energies, then bias shares, a line per scene and spp."""
    names = list(rows[0]["methods"])
    energy, bias = [["scene", "spp", *names]], [["scene", "spp", *names]]
    for row in rows:
        found = [row["methods"][name] for name in names]
        means = [(fmean(f["energies"]), stdev(f["energies"]) / math.sqrt(len(f["energies"]))) for f in found]
        start = [row["scene"], str(row["spp"])]
        energy.append([*start, *(f"{mean:.4f} ± {error:.4f}" for mean, error in means)])
        bias.append([*start, *(f"{100 * share(f):.0f} % of {f['bias'] + f['variance']:.4f}" for f in found)])
    worst = [max(abs(fmean(row["methods"][name]["energies"]) - 1) for row in rows) for name in names]
    energy.append(["furthest from 1", "", *(f"{100 * most:.2f} %" for most in worst)])
    shares = [[100 * share(row["methods"][name]) for row in rows] for name in names]
    bias.append(["least to most", "", *(f"{min(each):.0f} to {max(each):.0f} %" for each in shares)])
    parts = ["Energy, sum(output) / sum(reference):", markdown(energy), "Bias, its share of RelL2:", markdown(bias)]
    return "\n\n".join(part.strip() for part in parts)


def share(found: dict[str, Any]) -> float:
    """Of the bias; where it is below its own noise, 0."""
    bias = max(0.0, found["bias"])
    return bias / max(bias + found["variance"], 1e-30)


PAGE = pages.Page(
    "energy",
    "Energy and bias",
    "Energy: the light of the output over that of the reference, mean over render seeds ± its standard error. Bias: "
    "the part of RelL2 that stays the same from seed to seed.",
    tables,
)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("scenes", type=Path, nargs="+")
    parser.add_argument("--model", nargs="+", help="names or folders")
    parser.add_argument("--seeds", type=int, default=16)
    parser.add_argument("--spp", type=int, nargs="+", default=[2, 8])
    parser.add_argument("-o", "--output", type=Path, default=pages.RESULTS, help="folder for the page and its data")
    options = parser.parse_args()
    if options.seeds < 2:
        parser.error("--seeds: a spread needs 2 or more")
    peers.keep_torch_out()
    found = candidates.find_all([candidates.NOISY, "oidn", *(options.model or pages.family())])
    methods = {candidate.name: (candidate, candidate.load()) for candidate in found}
    settings = subjects.Options(tuple(options.spp), options.seeds, references=Path("out/references"))
    findings = pages.Findings(PAGE, options.output, found)
    for subject in subjects.find_all(options.scenes, settings):
        for spp in sorted({spp for spp, _ in subject.units()}):
            seeds = [seed for level, seed in subject.units() if level == spp]
            key = {"scene": subject.name, "spp": spp, "seeds": seeds, "inputs": subject.fingerprint()}
            key["identities"] = {candidate.name: candidate.identity for candidate in found}
            findings.row(key, lambda subject=subject, spp=spp, seeds=seeds: measure(subject, spp, seeds, methods))
        gc.collect()  # one scene at a time
    findings.finish()


if __name__ == "__main__":
    main()
