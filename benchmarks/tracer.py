"""CPU time of pathfold's tracer, all outputs and host conversion included, over Mitsuba's own path integrator.

    python benchmarks/tracer.py [SCENE.xml ...] [--spp 8] [--size 256] [--rounds 9]

Of Mitsuba's Cornell box, of the furnished room that is built below, and of scenes that are named. Renders are
interleaved, so that a busy machine slows both alike; the medians of process time are compared.
"""

from __future__ import annotations

import argparse
import time
from collections.abc import Callable, Sequence
from functools import partial
from pathlib import Path
from typing import Any

import drjit as dr
import mitsuba as mi
import numpy as np
import pages
from pathfold.report.tables import markdown

MAX_DEPTH = 6
COLUMNS = {
    "trace": "paths of all samples",
    "plain": "of none",
    "two": "of two",
    "frozen": "of two, frozen",
    "mean": "means only",
}


def furnished_room(size: int) -> Any:
    """A room of plastic, metal, glass, cloth and wood under a window and a lamp."""
    place = mi.ScalarTransform4f
    rng = np.random.default_rng(3)
    wood = mi.Bitmap(rng.uniform(0.1, 0.6, (64, 64, 3)).astype(np.float32))

    def colour() -> dict[str, Any]:
        return {"type": "rgb", "value": rng.uniform(0.1, 0.8, 3).tolist()}

    def material(index: int) -> dict[str, Any]:
        kinds: list[dict[str, Any]] = [
            {"type": "twosided", "b": {"type": "diffuse", "reflectance": colour()}},
            {"type": "twosided", "b": {"type": "roughplastic", "diffuse_reflectance": colour(), "alpha": 0.1}},
            {"type": "twosided", "b": {"type": "roughconductor", "material": "Al", "alpha": 0.2}},
            {"type": "dielectric"},
            {"type": "twosided", "b": {"type": "plastic", "diffuse_reflectance": colour()}},
            {"type": "twosided", "b": {"type": "principled", "base_color": colour(), "roughness": 0.4}},
            {"type": "twosided", "b": {"type": "conductor", "material": "Cr"}},
        ]
        return kinds[index % len(kinds)]

    shapes: dict[str, Any] = {}
    for i in range(60):
        x, z = rng.uniform(-2.6, 2.6), rng.uniform(-1.5, 2.6)
        scale = rng.uniform(0.1, 0.35)
        pose = place().translate([x, scale - 1.5, z]).rotate([0, 1, 0], rng.uniform(0, 90)).scale(scale)
        kind = ("cube", "sphere", "cylinder")[i % 3]
        shapes[f"item{i}"] = {"type": kind, "to_world": pose, "bsdf": material(i)}
    floor = {"type": "roughplastic", "alpha": 0.15, "diffuse_reflectance": {"type": "bitmap", "bitmap": wood}}
    wall = {"type": "twosided", "b": {"type": "diffuse", "reflectance": {"type": "rgb", "value": [0.8, 0.75, 0.7]}}}
    flat = place().translate([0, -1.49, 0]).rotate([1, 0, 0], -90).scale(3)
    window = place().translate([-2.95, 0.2, 0.5]).rotate([0, 1, 0], 90).scale(0.8)
    lamp = place().translate([0.5, 1.45, 1]).rotate([1, 0, 0], 90).scale(0.2)
    view = place().look_at(origin=[0, 0.2, -2.8], target=[0, -0.7, 1], up=[0, 1, 0])
    return mi.load_dict(
        {
            "type": "scene",
            "walls": {"type": "cube", "to_world": place().scale([3, 1.5, 3]), "bsdf": wall},
            "floor": {"type": "rectangle", "to_world": flat, "bsdf": floor},
            "window": {"type": "rectangle", "to_world": window, "emitter": {"type": "area", "radiance": 6.0}},
            "lamp": {"type": "rectangle", "to_world": lamp, "emitter": {"type": "area", "radiance": 30.0}},
            "sensor": {"type": "perspective", "fov": 70, "to_world": view, "film": film(size)},
            **shapes,
        }
    )


def cornell_box(size: int) -> Any:
    box = mi.cornell_box()
    box["sensor"]["film"] = film(size)
    return mi.load_dict(box)


def film(size: int) -> dict[str, Any]:
    return {"type": "hdrfilm", "width": size, "height": size, "rfilter": {"type": "box"}}


def cpu_seconds(run: Callable[[], Any]) -> float:
    start = time.process_time()
    run()
    dr.sync_thread()
    return time.process_time() - start


def measure(build: Callable[[], Any], spp: int, rounds: int) -> dict[str, float]:
    """Return medians in CPU seconds: path; trace, with no sample's paths, with two samples', frozen too; trace_mean."""
    from pathfold.mitsuba import Frozen, trace, trace_mean

    scene, launch = build(), Frozen()
    path = mi.load_dict({"type": "path", "max_depth": MAX_DEPTH, "rr_depth": 1000})
    runs: dict[str, Callable[[int], Any]] = {
        "path": lambda seed: np.array(mi.render(scene, integrator=path, spp=spp, seed=seed)),
        "trace": lambda seed: trace(scene, spp=spp, seed=seed, max_depth=MAX_DEPTH),
        "plain": lambda seed: trace(scene, spp=spp, seed=seed, max_depth=MAX_DEPTH, recorded=0),
        "two": lambda seed: trace(scene, spp=spp, seed=seed, max_depth=MAX_DEPTH, recorded=2),
        "frozen": lambda seed: trace(scene, spp=spp, seed=seed, max_depth=MAX_DEPTH, recorded=2, launch=launch),
        "mean": lambda seed: trace_mean(scene, spp=spp, seed=seed, max_depth=MAX_DEPTH),
    }
    times: dict[str, list[float]] = {name: [] for name in runs}
    for seed in range(rounds + 1):
        for name, run in runs.items():
            seconds = cpu_seconds(lambda run=run, seed=seed: run(seed))  # type: ignore[misc]
            if seed > 0:  # the first round compiles
                times[name].append(seconds)
    return {name: float(np.median(values)) for name, values in times.items()}


def tables(rows: Sequence[pages.Row]) -> str:
    table = [["scene", "path, CPU s", *COLUMNS.values()]]
    for row in rows:
        table.append([row["scene"], f"{row['path']:.3f}", *(f"{row[name] / row['path']:.2f}" for name in COLUMNS)])
    settings = f"{rows[0]['spp']} spp, {rows[0]['size']}x{rows[0]['size']}, medians of {rows[0]['rounds']} rounds"
    return f"Times of `trace` over those of `path`; {settings}:\n\n{markdown(table)}"


PAGE = pages.Page(
    "tracer",
    "Path tracer against Mitsuba's `path`",
    "CPU time of pathfold's tracer over that of Mitsuba's own integrator, every output and its conversion to host "
    "arrays included; renders by turns. A frozen launch does not trace the Python code again.",
    tables,
)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("scenes", nargs="*", type=Path)
    parser.add_argument("--spp", type=int, default=8)
    parser.add_argument("--size", type=int, default=256)
    parser.add_argument("--rounds", type=int, default=9)
    parser.add_argument("-o", "--output", type=Path, default=pages.RESULTS, help="folder for the page and its data")
    options = parser.parse_args()
    mi.set_variant("llvm_ad_rgb")
    size = options.size
    builders: dict[str, Callable[[], Any]] = {
        "Cornell box": partial(cornell_box, size),
        "furnished room": partial(furnished_room, size),
    }
    for path in options.scenes:
        builders[path.absolute().parent.name] = partial(mi.load_file, str(path), resx=size, resy=size)
    findings = pages.Findings(PAGE, options.output, [])
    for name, build in builders.items():
        key = {"scene": name, "spp": options.spp, "size": size, "rounds": options.rounds}
        findings.row(key, partial(measure, build, options.spp, options.rounds))
    findings.finish()


if __name__ == "__main__":
    main()
