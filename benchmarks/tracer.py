"""CPU time of pathfold's tracer, all outputs and host conversion included, over Mitsuba's own path integrator.

    python benchmarks/tracer.py [SCENE.xml ...] [--spp 8] [--size 256] [--rounds 9] [--json]

Without a scene it takes Mitsuba's Cornell box and the furnished room that is built below. Renders are interleaved,
so that a busy machine slows both alike; the medians of process time are compared. Goal: a ratio of at most 1.3.
"""

from __future__ import annotations

import argparse
import json
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

import drjit as dr
import mitsuba as mi
import numpy as np

MAX_DEPTH = 6
GOAL = 1.3


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


def measure(scene: Any, spp: int, rounds: int) -> dict[str, float]:
    """Return medians in CPU seconds: path; trace, with no sample's paths, with two samples', frozen too; trace_mean."""
    from pathfold.mitsuba import Frozen, trace, trace_mean

    launch = Frozen()
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


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("scenes", nargs="*", type=Path)
    parser.add_argument("--spp", type=int, default=8)
    parser.add_argument("--size", type=int, default=256)
    parser.add_argument("--rounds", type=int, default=9)
    parser.add_argument("--json", action="store_true")
    options = parser.parse_args()
    mi.set_variant("llvm_ad_rgb")
    builders: dict[str, Callable[[], Any]] = {
        str(path): lambda path=path: mi.load_file(str(path), resx=options.size, resy=options.size)  # type: ignore[misc]
        for path in options.scenes
    }
    builders = builders or {
        "cornell box": lambda: cornell_box(options.size),
        "furnished room": lambda: furnished_room(options.size),
    }
    results = {}
    for name, build in builders.items():
        results[name] = seconds = measure(build(), options.spp, options.rounds)
        if not options.json:
            ratios = "  ".join(f"{key} {seconds[key] / seconds['path']:.2f}" for key in seconds if key != "path")
            verdict = "within" if seconds["trace"] <= GOAL * seconds["path"] else "over"
            print(f"{name}: path {seconds['path']:.3f} s, ratios: {ratios} ({verdict} the goal of {GOAL})")
    if options.json:
        print(json.dumps(results, indent=2))


if __name__ == "__main__":
    main()
