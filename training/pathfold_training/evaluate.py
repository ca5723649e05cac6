"""`pathfold-train evaluate`: models against the noisy input and OIDN on scenes with references, error and time."""

from __future__ import annotations

import gc
import json
import statistics
import time
from collections.abc import Callable, Iterator
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray
from pathfold import metrics
from pathfold.denoising import Denoiser
from pathfold.images import ImageFile
from pathfold.report.peers import oidn, oidn_prefiltered
from rich.console import Console
from rich.progress import Progress

Image = NDArray[np.float32]
Buffers = dict[str, Any]
REPEATS = 3  # runs timed after a warm-up, methods in turn
FLAG = 20.0  # a best method within this many times the reference's own error is flagged


@dataclass(frozen=True)
class Row:
    """One measurement: RelL2 is free of the reference's own noise where it came in halves."""

    scene: str
    spp: int
    seed: int
    method: str
    rell2: float
    smape: float
    ssim: float
    flip: float
    render_seconds: float
    milliseconds: float


@dataclass(frozen=True)
class Reference:
    """A reference picture, the mean of two independent halves."""

    mean: Image
    half_a: Image
    half_b: Image
    max_depth: int

    @staticmethod
    def read(path: Path) -> Reference:
        file = ImageFile(path)
        channels = {name: i for i, name in enumerate(file.parts[0].channelnames)}

        def image(prefix: str) -> Image:
            try:
                return file.read(0, [channels[prefix + c] for c in "RGB"])
            except KeyError as error:
                raise ValueError(f"{path} has no channel {error}; it has {', '.join(channels)}") from None

        depth = int(str(file.metadata().get("reference/max_depth", 6)))
        return Reference(image(""), image("half_a."), image("half_b."), depth)


def evaluate(scenes: Path, out: Path, models: list[str], spp: int = 8, seeds: int = 3) -> list[Row]:
    """Measure every method on every scene and write results.jsonl, table.md and a picture per scene into `out`.

    `scenes` holds folders with scene.xml and reference.exr. Every run measures anew and replaces what `out` held.
    Raises ValueError where no such folder is found.
    """
    folders = sorted(p.parent for p in scenes.glob("*/reference.exr") if (p.parent / "scene.xml").is_file())
    if not folders:
        raise ValueError(f"{scenes} has no folder with scene.xml and reference.exr")
    out.mkdir(parents=True, exist_ok=True)
    results = out / "results.jsonl"
    rows: list[Row] = []
    methods = peers(models)
    with Progress(console=Console(stderr=True)) as progress:
        bar = progress.add_task("scenes", total=len(folders))
        for folder in folders:
            rows += measure_scene(folder, out, methods, spp, seeds)
            results.write_text("".join(json.dumps(asdict(r)) + "\n" for r in rows))
            progress.advance(bar)
    (out / "table.md").write_text(table(rows, folders))
    return rows


def peers(models: list[str]) -> dict[str, Callable[[Buffers], Image]]:
    """Method name -> buffers to picture: OIDN twice, then the models through the SDK."""
    methods: dict[str, Callable[[Buffers], Image]] = {}
    for name, peer in (("oidn", oidn), ("oidn-prefiltered", oidn_prefiltered)):
        methods[name] = lambda b, run=peer: run(b["color"], b["albedo"], b["normal"])  # type: ignore[misc]
    for model in models:
        denoiser = Denoiser(model)
        methods[Path(model).name] = lambda b, run=denoiser: run.run_buffers(b).color  # type: ignore[misc]
    return methods


def measure_scene(
    folder: Path, out: Path, methods: dict[str, Callable[[Buffers], Image]], spp: int, seeds: int
) -> Iterator[Row]:
    reference = Reference.read(folder / "reference.exr")
    pictures: dict[str, Image] = {}
    for seed, (buffers, seconds) in enumerate(frames(folder, reference, spp, seeds)):
        images: dict[str, Image] = {"noisy": buffers["color"]}
        images |= {name: run(buffers) for name, run in methods.items()}
        times: dict[str, list[float]] = {name: [] for name in methods}
        for _ in range(REPEATS):
            for name, run in methods.items():
                start = time.perf_counter()
                run(buffers)
                times[name].append(1e3 * (time.perf_counter() - start))
        for name, image in images.items():
            rell2 = metrics.rell2_halves(image, reference.half_a, reference.half_b)
            scores = metrics.compare(image, reference.mean) | {"rell2": rell2}
            took = statistics.median(times[name]) if name in times else 0.0
            yield Row(folder.name, spp, seed, name, render_seconds=seconds, milliseconds=took, **scores)
        pictures = pictures or images | {"reference": reference.mean}
    write_picture(out / f"{folder.name}-{spp}spp.jpg", pictures, metrics.exposure(reference.mean))


def frames(folder: Path, reference: Reference, spp: int, seeds: int) -> Iterator[tuple[Buffers, float]]:
    """The noisy frame of each seed at the reference's size and depth, with its render seconds (kernels compiled)."""
    import mitsuba as mi

    if mi.variant() is None:
        mi.set_variant("llvm_ad_rgb")
    from pathfold.mitsuba import trace

    height, width = reference.mean.shape[:2]
    scene = mi.load_file(str(folder / "scene.xml"), resx=width, resy=height)
    trace(scene, spp=spp, seed=1000, max_depth=reference.max_depth)  # compiles the kernels
    for seed in range(seeds):
        start = time.perf_counter()
        samples = trace(scene, spp=spp, seed=seed, max_depth=reference.max_depth)
        seconds = time.perf_counter() - start
        buffers = samples.reduce()
        buffers.pop("dropped", None)
        buffers |= {"samples.descriptor": samples.descriptor, "samples.density": samples.density}
        yield buffers, seconds
    del scene
    gc.collect()  # a scene that lives on slows every later one: dispatch visits each live BSDF


def write_picture(path: Path, pictures: dict[str, Image], scale: float) -> None:
    """The methods' display pictures in one row per three, in the order of `pictures`."""
    import OpenImageIO as oiio  # noqa: N813

    tiles = [metrics.display(image, scale) for image in pictures.values()]
    tiles += [np.zeros_like(tiles[0])] * (-len(tiles) % 3)
    rows = [np.concatenate(tiles[i : i + 3], 1) for i in range(0, len(tiles), 3)]
    sheet = np.ascontiguousarray(np.concatenate(rows, 0), np.float32)
    file = oiio.ImageOutput.create(str(path))
    spec = oiio.ImageSpec(sheet.shape[1], sheet.shape[0], 3, "uint8")
    spec.attribute("Compression", "jpeg:90")
    if file is None or not file.open(str(path), spec):
        raise OSError(f"{path}: cannot be written: {oiio.geterror()}")
    file.write_image(sheet)
    file.close()


def table(rows: list[Row], folders: list[Path]) -> str:
    """Markdown: RelL2 per scene and method, then geometric means, ratios and times."""
    methods = list(dict.fromkeys(r.method for r in rows))
    spp, seeds = rows[0].spp, len({r.seed for r in rows})
    lines = [f"RelL2 at {spp} spp, geometric mean over {seeds} render seeds, noise of the reference removed.", ""]
    lines += ["| scene | " + " | ".join(methods) + " | |", "|---" * (len(methods) + 2) + "|"]
    errors = {}
    for folder in folders:
        own = [r for r in rows if r.scene == folder.name]
        errors[folder.name] = [mean_of([r.rell2 for r in own if r.method == m]) for m in methods]
        reference = Reference.read(folder / "reference.exr")
        limit = FLAG * metrics.reference_rell2(reference.half_a, reference.half_b)
        note = "within 20 times the reference's own error" if min(errors[folder.name]) < limit else ""
        lines.append(f"| {folder.name} | " + " | ".join(f"{e:.4f}" for e in errors[folder.name]) + f" | {note} |")
    means = np.exp(np.mean(np.log(list(errors.values())), 0))
    lines.append("| **geometric mean** | " + " | ".join(f"**{e:.4f}**" for e in means) + " | |")
    lines.append("| noisy / method | " + " | ".join(f"{means[0] / e:.1f}" for e in means) + " | |")
    for key in ("smape", "ssim", "flip", "milliseconds"):
        values = [np.mean([getattr(r, key) for r in rows if r.method == m]) for m in methods]
        lines.append(f"| mean {key} | " + " | ".join(f"{v:.4g}" for v in values) + " | |")
    return "\n".join(lines + paired(rows)) + "\n"


def paired(rows: list[Row]) -> list[str]:
    """Manifold against vanilla, scene by scene and seed by seed."""
    by = {(r.scene, r.seed, r.method): r.rell2 for r in rows}
    pairs: dict[str, list[float]] = {}
    for (scene, seed, method), error in by.items():
        if method == "kpcn-manifold" and (base := by.get((scene, seed, "kpcn-vanilla"))):
            pairs.setdefault(scene, []).append(error / base)
    if not pairs:
        return []
    lines = ["", "| kpcn-manifold / kpcn-vanilla | RelL2 ratio per seed | geometric mean |", "|---|---|---|"]
    for scene, ratios in pairs.items():
        lines.append(f"| {scene} | {', '.join(f'{r:.3f}' for r in ratios)} | {mean_of(ratios):.3f} |")
    return [*lines, f"| **all** | | **{mean_of([r for rs in pairs.values() for r in rs]):.3f}** |"]


def mean_of(values: list[float]) -> float:
    """Geometric mean; differences of halves that came out at or below zero count as 1e-6."""
    return float(np.exp(np.mean(np.log(np.maximum(values, 1e-6)))))
