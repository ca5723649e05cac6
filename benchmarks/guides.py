"""Guides that are wrong: how much worse is the picture with them than without?

    python benchmarks/guides.py SCENES/validation RENDERS [--spp 2 8 --model pathfold-balanced ...]

SCENES as `pathfold bench` takes them. Every scene is rendered at each spp, its guides are spoilt in each way of
`hostile.py`, and every model denoises the frame with them and without the guides that were spoilt: the quotient of
RelL2, against both halves of the reference. Scenes that are made here add what the others lack: a fence and leaves out
of focus before a lit sky. RENDERS keeps all that is rendered; the same command goes on where it was stopped.
"""

import argparse
import gc
import sys
from collections.abc import Sequence
from functools import partial
from pathlib import Path
from typing import Any

import hostile
import numpy as np
import pages
from numpy.typing import NDArray
from pathfold import metrics
from pathfold.bench import candidates, subjects
from pathfold.bench.candidates import Candidate, Run
from pathfold.bench.reference import Reference
from pathfold.bench.results import FLOOR, geometric
from pathfold.images import replacing
from pathfold.report.tables import markdown

MODELS = ["pathfold-fast", "pathfold-balanced", "pathfold-high", "kpcn-vanilla"]
ALLOWED = 1.10  # of the error without the guide
REFERENCE_SPP, REFERENCE_SECONDS = 2048, 120.0  # of the scenes made here

Buffers = dict[str, NDArray[Any]]


class Shots:
    """Frames of scenes, rendered once and kept in a folder, and what models make of them."""

    def __init__(self, folder: Path) -> None:
        self._folder = folder
        self._references: dict[str, Reference] = {}
        folder.mkdir(parents=True, exist_ok=True)

    def frame(self, subject: subjects.Subject, spp: int, seed: int, size: tuple[int, int]) -> Buffers:
        """All buffers of pixels, width x height of them."""
        path = self._folder / f"{subject.name}-{spp}-{seed}.npz"
        if not path.exists():
            made = subject.shoot(0, spp, seed, {0}, size, False).buffers
            with replacing(path) as unfinished, unfinished.open("wb") as file:
                np.savez(file, **made)  # type: ignore[arg-type]
            print(f"{subject.name}, {spp} spp", file=sys.stderr, flush=True)
        with np.load(path) as found:
            return dict(found)

    def reference(self, subject: subjects.Subject) -> Reference:
        if subject.name not in self._references:
            self._references[subject.name] = subject.reference(0, lambda done: None)
        return self._references[subject.name]

    def measure(
        self,
        subject: subjects.Subject,
        other: subjects.Subject,
        pinhole: subjects.Subject | None,
        spp: int,
        candidate: Candidate,
        run: Run,
    ) -> dict[str, Any]:
        """By way of spoiling: the error with the spoilt guides and without them; "true": with the right ones."""
        reference = self.reference(subject)
        frame = self.frame(subject, spp, 0, reference.size)
        shape = frame["color"].shape[:2]
        foreign = {
            name: tiled(values, shape) for name, values in self.frame(other, spp, 0, self.reference(other).size).items()
        }
        sharp = self.frame(pinhole, 8 * spp, 1, reference.size) if pinhole else None
        others = hostile.Others(self.frame(subject, 1, 1, reference.size), foreign, sharp)
        known: dict[frozenset[str], float] = {}

        def error(buffers: Buffers) -> float:
            image = run({name: values for name, values in buffers.items() if name in candidate.reads}, None, spp)
            a, b = reference.halves or (reference.mean, reference.mean)
            return max(FLOOR, metrics.rell2_halves(image, a, b))

        def without(names: frozenset[str]) -> float:
            if names not in known:
                known[names] = error({name: values for name, values in frame.items() if name not in names})
            return known[names]

        found = {}
        for name, case in hostile.CASES.items():
            spoilt = case(frame, others) or {}
            if read := frozenset(spoilt) & candidate.reads:
                found[name] = [error(frame | spoilt), without(read)]
        return {"true": without(frozenset()), "errors": found}


def tiled(values: NDArray[Any], shape: tuple[int, ...]) -> NDArray[Any]:
    """Brought to another height and width, repeated where it is smaller."""
    rows, columns = (np.arange(wanted) % given for wanted, given in zip(shape, values.shape[:2], strict=True))
    return values[rows][:, columns]


def quotients(rows: Sequence[pages.Row], model: str, case: str) -> dict[tuple[str, int], float]:
    """By scene and spp."""
    found = [row for row in rows if row["model"] == model and case in row["errors"]]
    return {(row["scene"], row["spp"]): row["errors"][case][0] / row["errors"][case][1] for row in found}


def tables(rows: Sequence[pages.Row]) -> str:
    names = list(dict.fromkeys(row["model"] for row in rows))
    parts = []
    for made, title in ((False, "Scenes of other people"), (True, "Scenes made here, out of focus before a sky")):
        chosen = [row for row in rows if row["made"] == made]
        if not chosen:
            continue
        table = [["guides", *names]]
        for case in hostile.CASES:
            cells = []
            for model in names:
                found = list(quotients(chosen, model, case).values())
                cells.append(f"{geometric(found):.3f} ({max(found):.2f})" if found else "-")
            table.append([case, *cells])
        parts += [f"{title}; geometric mean over scenes and spp, and the worst:", markdown(table)]
    return "\n\n".join(part.strip() for part in [*parts, *beyond(rows, names)])


def beyond(rows: Sequence[pages.Row], names: Sequence[str]) -> list[str]:
    """The cases of which some frame is above ALLOWED, with the worst frame."""
    table = [["guides", "model", f"above {ALLOWED:.2f}", "worst", "where"]]
    for case in hostile.CASES:
        for model in names:
            found = quotients(rows, model, case)
            many = sum(quotient > ALLOWED for quotient in found.values())
            if many:
                (scene, spp), worst = max(found.items(), key=lambda item: item[1])
                table.append([case, model, f"{many} of {len(found)}", f"{worst:.2f}", f"{scene}, {spp} spp"])
    return [f"What harms by more than {100 * ALLOWED - 100:.0f} %, for training to mend:", markdown(table)]


PAGE = pages.Page(
    "guides",
    "Guides that are wrong",
    "RelL2 with spoilt guides over that without them: above 1 they harm. Pixels alone, without paths; of kpcn an "
    "albedo is the diffuse one too, without which a frame is not split. Whether a guide is of the picture at all could "
    "not be told from the frame: over cells of 8 x 8 pixels the rank correlation between the steps of a guide and of "
    "the noisy light was down to 0.016 with the right guide at 2 spp, and up to 0.263 with one of another scene.",
    tables,
)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("scenes", type=Path)
    parser.add_argument("renders", type=Path, help="folder for what is rendered")
    parser.add_argument("--spp", type=int, nargs="+", default=[2, 8])
    parser.add_argument("--model", nargs="+", default=MODELS, help="names or folders")
    parser.add_argument("-o", "--output", type=Path, default=pages.RESULTS, help="folder for the page and its data")
    options = parser.parse_args()
    found = candidates.find_all(options.model)
    methods = [(candidate, candidate.load()) for candidate in found]
    findings = pages.Findings(PAGE, options.output, found)
    settings = subjects.Options(
        tuple(options.spp), 1, REFERENCE_SPP, REFERENCE_SECONDS, references=options.renders / "references"
    )
    shots = Shots(options.renders)
    own = subjects.find_all(hostile.write_scenes(options.renders / "scenes"), settings)
    pinholes = {subject.name.removesuffix(hostile.PINHOLE): subject for subject in own[1::2]}
    chosen = [*subjects.find_all([options.scenes], settings), *own[::2]]
    for subject, other in zip(chosen, [*chosen[1:], chosen[0]], strict=True):
        for spp in options.spp:
            key = {"scene": subject.name, "spp": spp, "made": subject.name in pinholes}
            key |= {"inputs": subject.fingerprint(), "foreign": other.name, "cases": list(hostile.CASES)}
            for candidate, run in methods:
                measure = partial(shots.measure, subject, other, pinholes.get(subject.name), spp, candidate, run)
                findings.row(key | {"model": candidate.name, "identity": candidate.identity}, measure)
        gc.collect()
    findings.finish()


if __name__ == "__main__":
    main()
