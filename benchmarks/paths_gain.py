"""What path descriptors gain a model, scene by scene, and where in the picture.

    python benchmarks/paths_gain.py SCENES... [--model pathfold-balanced --spp 2 8 32 --seeds 3]

SCENES as `pathfold bench` takes them; of a sequence the first frame counts. Every frame is denoised twice by the same
model, with its samples and without them, from the same buffers. RelL2 and FLIP of both and their ratios are
told (geometric means over seeds, then scenes; below 1 the paths help), and the ratio of RelL2 by class of pixel:

- `first event`, of most samples: diffuse, glossy, delta (mirror, glass), or none (a light or the sky is seen).
- `light`: after one event (direct), several, or a caustic, where a sharp event follows a diffuse one; of most samples.
- `diffuse share` of the input's radiance, and the input's `deviation` relative to its mean, quartiles of the frame;
  both of 5x5 pixels.

Each frame is kept when it is done, so the same command goes on where it was stopped. out/paths_gain/SCENE-8spp.jpg
shows the first seed: with paths, without, the reference, and the difference of their RelL2 in 7x7 pixels, blue where
paths are better, red where worse, in full colour from the difference on that its title states. The one of the scene
that gains most, at the lowest spp, goes beside the page.
"""

import argparse
import gc
import math
import shutil
import sys
from collections.abc import Sequence
from functools import partial
from pathlib import Path
from statistics import fmean
from typing import Any

import numpy as np
import pages
from numpy.typing import NDArray
from pathfold import metrics
from pathfold._core import KINDS, Layout
from pathfold.bench import candidates, peers, subjects
from pathfold.bench.reference import Reference
from pathfold.bench.results import geometric
from pathfold.images import replacing
from pathfold.models import ALL_SAMPLES
from pathfold.report.tables import markdown
from scipy.ndimage import uniform_filter

Plane = NDArray[np.float64]
Buffers = dict[str, NDArray[Any]]
LEAST_PIXELS = 20  # of a class in a frame that counts
MOST_BYTES = 300_000  # of a picture


def error_map(image: NDArray[np.float32], reference: Reference) -> Plane:
    """The squared relative error of every pixel, height x width, of mean RelL2; with halves it may be negative."""
    x, r = image.astype(np.float64), reference.mean.astype(np.float64)
    a, b = reference.halves or (r, r)
    return np.asarray(((x - a) * (x - b) / (r**2 + metrics.EPSILON)).mean(-1))


def classes(buffers: Buffers) -> dict[str, NDArray[np.bool_]]:
    """Masks of pixels by name."""
    at = Layout()
    kinds = buffers["samples.descriptor"][..., at.kind : at.roughness].astype(np.int32)  # S x H x W x vertices
    diffuse, glossy, delta = (
        np.isin(kinds, [KINDS[f"{lobe}-reflection"], KINDS[f"{lobe}-transmission"]])
        for lobe in ("diffuse", "glossy", "delta")
    )
    sharp, events = delta | glossy, (kinds != KINDS["none"]).sum(-1)
    caustic = (sharp & (np.cumsum(diffuse, -1) > 0)).any(-1)  # a lobe is one or the other
    first = most_often(
        {
            "diffuse": diffuse[..., 0],
            "delta": delta[..., 0],
            "none": events == 0,
            "glossy": (events > 0) & ~diffuse[..., 0] & ~delta[..., 0],
        }
    )
    light = most_often(
        {"direct": events <= 1, "several events": (events > 1) & ~caustic, "caustic": (events > 1) & caustic}
    )
    color = smooth(buffers["color"].astype(np.float64).mean(-1), 5)
    variance = np.maximum(smooth(buffers["variance"].astype(np.float64).mean(-1), 5), 0)  # running sums round below 0
    deviation = np.sqrt(variance) / (color + 1e-3 * color.mean() + 1e-30)
    quartile = np.digitize(deviation, np.quantile(deviation, [0.25, 0.5, 0.75]))
    share = smooth(buffers["diffuse"].astype(np.float64).mean(-1), 5) / np.maximum(color, 1e-30)
    masks = {f"first event {name}": mask for name, mask in first.items()}
    masks |= {f"light: {name}": mask for name, mask in light.items()}
    masks |= {"diffuse share below 1/2": share < 0.5, "diffuse share 1/2 and more": share >= 0.5}
    return masks | {f"deviation, quartile {number + 1}": quartile == number for number in range(4)}


def most_often(kinds: dict[str, NDArray[np.bool_]]) -> dict[str, NDArray[np.bool_]]:
    """S x H x W of what each sample is -> H x W of what most of a pixel's are; the first of equals."""
    winner = np.stack([kind.sum(0) for kind in kinds.values()]).argmax(0)
    return {name: winner == number for number, name in enumerate(kinds)}


def smooth(plane: Plane, size: int) -> Plane:
    """The mean of size x size pixels."""
    return np.asarray(uniform_filter(plane, size, mode="nearest"))


def measure(
    buffers: Buffers, spp: int, reference: Reference, run: candidates.Run, picture: Path | None
) -> dict[str, Any]:
    """Errors with and without the samples, and their sums over each class of pixels."""
    pixels = {name: values for name, values in buffers.items() if not name.startswith("samples.")}
    images = {"with": run(buffers, None, spp), "without": run(pixels, None, spp)}
    maps = {name: error_map(image, reference) for name, image in images.items()}
    found: dict[str, Any] = {}
    for name, image in images.items():
        errors = reference.errors(image)
        found[name] = {metric: errors[metric] for metric in ("rell2", "flip")}
    found["classes"] = {
        name: [int(mask.sum()), *(float(maps[way][mask].sum()) for way in ("with", "without"))]
        for name, mask in classes(buffers).items()
    }
    if picture:
        save(picture, images, maps, reference, found)
    return found


def save(
    path: Path,
    images: dict[str, NDArray[np.float32]],
    maps: dict[str, Plane],
    reference: Reference,
    found: dict[str, Any],
) -> None:
    """The strip as a JPEG."""
    from matplotlib.backends.backend_agg import FigureCanvasAgg
    from matplotlib.figure import Figure

    gain = smooth(maps["without"] - maps["with"], 7)
    limit = max(float(np.quantile(np.abs(gain), 0.98)), 1e-12)
    scale = metrics.exposure(reference.mean)
    titles = [f"{way} paths, RelL2 {found[way]['rell2']:.4f}" for way in images] + ["reference"]
    panels = [metrics.display(image, scale) for image in (*images.values(), reference.mean)]
    titles.append(f"blue: paths better; full at {limit:.2g}")
    width, height = reference.size
    for quality in (92, 85, 75, 60):
        figure = Figure(figsize=(4 * width / 100, (height + 18) / 100), dpi=100, facecolor="white")
        FigureCanvasAgg(figure)
        for number, title in enumerate(titles):
            axes = figure.add_axes((number / 4, 0, 1 / 4, height / (height + 18)))
            if number < len(panels):
                axes.imshow(panels[number], interpolation="nearest", aspect="auto")
            else:
                axes.imshow(gain, cmap="RdBu", vmin=-limit, vmax=limit, interpolation="nearest", aspect="auto")
            axes.set_axis_off()
            axes.set_title(title, fontsize=7.5 * min(1, width / 240), pad=3)
        with replacing(path) as unfinished:
            figure.savefig(unfinished, format="jpg", pil_kwargs={"quality": quality})
        if path.stat().st_size <= MOST_BYTES:
            break


def ratio(rows: Sequence[dict[str, Any]], metric: str) -> float:
    return geometric(r["with"][metric] for r in rows) / geometric(r["without"][metric] for r in rows)


def scene_table(rows: Sequence[pages.Row], metric: str, title: str) -> str:
    """Errors with paths, and over those without: a line per scene, two columns per spp."""
    spps = sorted({row["spp"] for row in rows})
    table = [["scene", *(text for spp in spps for text in (f"{title} with, {spp} spp", "/ without"))]]
    found: dict[int, list[float]] = {spp: [] for spp in spps}
    for scene in dict.fromkeys(r["scene"] for r in rows):
        cells = [scene]
        for spp, of_scenes in found.items():
            here = [r for r in rows if (r["scene"], r["spp"]) == (scene, spp)]
            of_scenes.append(ratio(here, metric))
            cells += [f"{geometric(r['with'][metric] for r in here):.4f}", f"{of_scenes[-1]:.3f}"]
        table.append(cells)
    means = [text for each in found.values() for text in ("", f"{geometric(each):.3f}")]
    wins = [text for each in found.values() for text in ("", f"{sum(r < 1 for r in each)} of {len(each)}")]
    return markdown([*table, ["geometric mean", *means], ["smaller with paths", *wins]])


def class_table(rows: Sequence[pages.Row]) -> str:
    """By class: its share of pixels and of the squared error without paths, and the geometric mean ratio per spp."""
    spps = sorted({row["spp"] for row in rows})
    table = [["pixels", "share of pixels", "of RelL2 without", "scenes", *(f"{spp} spp" for spp in spps)]]
    whole = [r["classes"] for r in rows]
    pixels = sum(entry[0] for classes in whole for entry in classes.values()) / 4  # every pixel is in four classes
    for name in whole[0]:
        entries = [classes[name] for classes in whole]
        weights = [share_of_error(classes, name) for classes in whole]
        counted: set[str] = set()
        cells = []
        for spp in spps:
            logs = []
            for scene in dict.fromkeys(r["scene"] for r in rows):
                at = [r["classes"][name] for r in rows if (r["scene"], r["spp"]) == (scene, spp)]
                count, with_paths, without = (sum(entry[k] for entry in at) for k in range(3))
                if count >= LEAST_PIXELS * len(at) and with_paths > 0 and without > 0:
                    logs.append(math.log(with_paths / without))
                    counted.add(scene)
            cells.append(f"{math.exp(fmean(logs)):.3f}" if logs else "")
        share = sum(entry[0] for entry in entries) / pixels
        table.append([name, f"{share:.1%}", f"{fmean(weights):.1%}", str(len(counted)), *cells])
    return markdown(table)


def share_of_error(entries: dict[str, list[float]], name: str) -> float:
    """Of one frame's squared error without paths, what lies in a class."""
    total = sum(entry[2] for entry in entries.values()) / 4
    return entries[name][2] / total if total > 0 else 0.0


def picture(rows: Sequence[pages.Row]) -> str:
    """The name of the picture that the page shows: of the scene that gains most, at the lowest spp."""
    scenes = dict.fromkeys(row["scene"] for row in rows)
    best = min(scenes, key=lambda scene: ratio([row for row in rows if row["scene"] == scene], "rell2"))
    return f"{best}-{min(row['spp'] for row in rows)}spp.jpg"


def tables(rows: Sequence[pages.Row]) -> str:
    lead = f"{rows[0]['model']}, {len({row['seed'] for row in rows})} seeds; below 1 paths help."
    parts = [lead, scene_table(rows, "rell2", "RelL2"), scene_table(rows, "flip", "FLIP")]
    parts += ["RelL2 with paths over without, by class of pixels:", class_table(rows)]
    shown = picture(rows)
    parts.append(f"![{shown}: with paths, without, the reference, and the difference]({PAGE.name}/{shown})")
    return "\n\n".join(part.strip() for part in parts)


PAGE = pages.Page(
    "paths_gain",
    "With paths and without",
    "A model denoises each frame with its path descriptors and without them, from the same buffers; geometric means "
    "over render seeds, then scenes.",
    tables,
)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("scenes", type=Path, nargs="+")
    parser.add_argument("--model", default="pathfold-balanced", help="name or folder")
    parser.add_argument("--spp", type=int, nargs="+", default=[2, 8, 32])
    parser.add_argument("--seeds", type=int, default=3)
    parser.add_argument("-o", "--output", type=Path, default=pages.RESULTS, help="folder for the page and its data")
    options = parser.parse_args()
    peers.keep_torch_out()
    model = candidates.find(options.model)
    if not model.reads_paths:
        raise SystemExit(f"{model.name} reads no paths; name a model that does")
    run = model.load()
    settings = subjects.Options(tuple(options.spp), options.seeds, references=Path("out/references"))
    pictures = Path("out") / PAGE.name
    pictures.mkdir(parents=True, exist_ok=True)
    findings = pages.Findings(PAGE, options.output, [model])

    def compared(subject: subjects.Subject, reference: Reference, spp: int, seed: int) -> dict[str, Any]:
        shot = subject.shoot(0, spp, seed, [ALL_SAMPLES], reference.size, False)
        if "samples.descriptor" not in shot.buffers:
            raise SystemExit(f"{subject.name} has no samples: paths cannot be compared; render it with them")
        print(f"{subject.name}, {spp} spp, seed {seed}", file=sys.stderr, flush=True)
        return measure(
            shot.buffers, spp, reference, run, pictures / f"{subject.name}-{spp}spp.jpg" if not seed else None
        )

    for subject in subjects.find_all(options.scenes, settings):
        reference = subject.reference(0, lambda part: None)
        for spp, seed in subject.units():
            key: dict[str, Any] = {"scene": subject.name, "spp": spp, "seed": seed, "model": model.name}
            key |= {"inputs": subject.fingerprint(), "identity": model.identity}
            findings.row(key, partial(compared, subject, reference, spp, seed))
        gc.collect()  # one scene at a time
    findings.finish()
    if (pictures / picture(findings.rows)).exists():
        (options.output / PAGE.name).mkdir(exist_ok=True)
        shutil.copy(pictures / picture(findings.rows), options.output / PAGE.name)


if __name__ == "__main__":
    main()
