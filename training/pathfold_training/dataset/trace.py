"""One view: its scene built or loaded, the camera aimed, the reference and noisy samples of some crops rendered."""

from __future__ import annotations

import gc
import threading
import time
import zlib
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ..scenes import cameras, library, procedural, variation
from ..scenes.faults import RejectedError, picture_fault
from .store import KINDS, REFERENCES, SAMPLES, Arrays, Line
from .truth import depth_scale, exposure, importance, render_truth

LIBRARY_DEPTH = 6  # scenes of a library state depths up to 65; one value keeps the data alike, and cost grows with it
LANES = 1 << 22  # samples traced in one call
DESCRIBED = 16  # samples of a pixel of which all is kept: most of the bytes, and networks look at few of them
BUSY = threading.Lock()  # Mitsuba's variant and its threads belong to the process: one view at a time


@dataclass(frozen=True)
class Task:
    """One view to render: camera `number` of a generated scene or of a scene file.

    `known` is the view's index line where it exists and only its `kinds` of files are wanted.
    """

    id: str
    kind: str  # procedural | library
    scene: str
    split: str
    number: int
    seed: int
    size: int
    spp: int
    budget: float
    crop: int = 128  # side of the windows that samples are kept of
    crops: int = 1  # how many of them at most
    zoom: float = 1  # a new view is a window of a picture at most so many times as wide
    licence: str = "CC0-1.0"
    origin: str = "made in code"
    path: str = ""
    variant: str = "llvm_ad_rgb"
    known: Line | None = None
    kinds: tuple[str, ...] = KINDS


DESCRIPTION = ("id", "kind", "scene", "split", "number", "seed", "licence", "origin")  # of a task, kept in its line


def entropy(seed: int, *words: object) -> NDArray[np.uint32]:
    """Four 32-bit seeds that belong to these words."""
    words_hash = zlib.crc32("/".join(map(str, words)).encode())
    return np.random.SeedSequence([seed, words_hash]).generate_state(4).astype(np.uint32)


def render_view(task: Task) -> tuple[Line, Arrays]:
    """The view's index line and its tensors as the store names them: those of the task's kinds.

    Everything but the reference's sample count depends on the task alone. Raises RejectedError where no view is worth
    its cost, ImportError where the variant is not there.
    """
    with BUSY:
        import drjit as dr
        import mitsuba as mi

        if mi.variant() != task.variant:
            mi.set_variant(task.variant)
        begin = time.process_time()
        try:
            scene, line = _known_scene(task, task.known) if task.known else _new_scene(task)
            line, tensors = _render(task, scene, line)
        finally:
            scene = None
            gc.collect()
            dr.flush_malloc_cache()  # a worker goes on with other scenes
        seconds = round(line.get("cpu_seconds", 0) + time.process_time() - begin, 1)
        return line | {"cpu_seconds": seconds}, tensors


def _render(task: Task, scene: Any, line: Line) -> tuple[Line, Arrays]:
    tensors: Arrays = {}
    if REFERENCES in task.kinds:
        seeds = [int(s) for s in entropy(task.seed, task.id, "reference")[:2]]
        tensors, facts = render_truth(scene, task.budget, line["max_depth"], seeds)
        if fault := picture_fault(np.moveaxis(tensors["reference.color"], 0, -1), may_be_flat="window" in line):
            raise RejectedError(f"its picture is {fault}")
        if "window" in line:
            facts |= {name: line[name] for name in ("exposure", "depth_scale")}
        line = line | facts | {"budget": task.budget}
    if not task.known:
        crop = min(task.crop, task.size)
        corners = choose_crops(tensors["importance"], crop, task.crops, entropy(task.seed, task.id, "crops"))
        line = line | {"crop": crop, "crops": corners}
    if SAMPLES in task.kinds:
        tensors |= _samples(scene, task, line)
        line = line | {"spp": task.spp, "described": min(task.spp, DESCRIBED)}
    return line, tensors


def choose_crops(weight: NDArray[Any], side: int, count: int, seed: NDArray[np.uint32]) -> list[list[int]]:
    """Corners [y, x] of at most `count` of the tiles that cover the view, drawn by mean weight without repeats."""
    starts = [np.linspace(0, n - side, -(-n // side)).astype(int) for n in weight.shape]
    tiles = [[int(y), int(x)] for y in starts[0] for x in starts[1]]
    share = np.array([weight[y : y + side, x : x + side].mean() for y, x in tiles])
    chosen = np.random.default_rng(seed).choice(
        len(tiles), min(count, len(tiles)), replace=False, p=share / share.sum()
    )
    return [tiles[i] for i in sorted(chosen)]


def _samples(scene: Any, task: Task, line: Line) -> Arrays:
    """Noisy samples of the view's crops, [N, S, C, h, w]; equal tasks give equal samples.

    All paths are traced alike: a second kernel, for those that are not kept, takes longer to compile than it saves.
    """
    from pathfold.mitsuba import trace

    side = line["crop"]
    chunk = max(1, LANES // side**2)
    crops = []
    for number, (y, x) in enumerate(line["crops"]):
        _show(scene, line, (x, y), (side, side))
        parts = []
        for first in range(0, task.spp, chunk):
            seed = int(entropy(task.seed, task.id, "samples", number, first)[0])
            spp = min(chunk, task.spp - first)
            parts.append(trace(scene, spp, seed, line["max_depth"], leave_out={"overlong"}))
        crop = {name: np.concatenate([_plane(part, name) for part in parts]) for name in SAMPLE_TYPES}
        crops.append(crop | {name: crop[name][:DESCRIBED] for name in DESCRIBED_TYPES})
    return {f"samples.{name}": np.stack([crop[name] for crop in crops]) for name in SAMPLE_TYPES}


DESCRIBED_TYPES = {  # of at most DESCRIBED samples
    "density": np.float32,
    "descriptor": np.float16,
    "position": np.float16,
    "alpha": np.float16,
    "first.albedo": np.float16,
    "first.normal": np.float16,
    "first.depth": np.float32,
    "visible": np.float16,
}
SAMPLE_TYPES = {
    "radiance": np.float32,
    "diffuse": np.float32,
    "depth": np.float32,
    "diffuse.albedo": np.float16,
    "albedo": np.float16,
    "normal": np.float16,
    **DESCRIBED_TYPES,
}


def _plane(samples: Any, name: str) -> NDArray[Any]:
    """S x H x W x C of the tracer as [S, C, H, W]."""
    return np.moveaxis(getattr(samples, name.replace(".", "_")), -1, 1).astype(SAMPLE_TYPES[name])


def _draft(depth: int) -> Any:
    from pathfold.mitsuba import trace_mean

    return lambda scene: trace_mean(scene, spp=8, seed=1, max_depth=depth)["color"]


def _windowed(scene: Any, task: Task, line: Line) -> Line:
    """Makes a new view a window of the picture with 1 to `task.zoom` times the pixels across, and says so in its line.

    Log-uniform, about a pixel drawn by the picture's noise and detail. Exposure and depth scale are the picture's, as
    they are where a picture is denoised.
    """
    from pathfold.mitsuba import trace_mean

    if task.zoom == 1:
        return line
    depth = line["max_depth"]
    whole = [trace_mean(scene, spp=8, seed=seed, max_depth=depth) for seed in (1, 2)]
    a, b = (np.moveaxis(half["color"], -1, 0) for half in whole)
    line = line | {
        "exposure": exposure((a + b) / 2),
        "depth_scale": depth_scale((whole[0]["depth"] + whole[1]["depth"]) / 2),
    }
    weight = importance(a, b).ravel()
    rng = np.random.default_rng(entropy(task.seed, task.id, "window"))
    side = round(task.size * task.zoom ** rng.uniform())
    for _ in range(8):
        pixel = divmod(rng.choice(weight.size, p=weight / weight.sum()), task.size)
        middle = (np.array(pixel) + rng.uniform(size=2)) * side / task.size
        corner = np.clip(np.round(middle - task.size / 2), 0, side - task.size).astype(int)
        line = line | {"window": {"of": side, "corner": corner.tolist()}}
        _show(scene, line)
        if picture_fault(_draft(depth)(scene), may_be_flat=True) is None:
            return line
    raise RejectedError("8 x black or blown out in the window")


def _show(scene: Any, line: Line, corner: tuple[int, int] = (0, 0), size: tuple[int, int] | None = None) -> None:
    """Gives the film of an aimed scene the view's pixels, or those of its `size` (x, y) from `corner` on."""
    whole = line["width"], line["height"]
    y, x = line["window"]["corner"] if "window" in line else (0, 0)
    cameras.resize(scene, (line["window"]["of"],) * 2 if "window" in line else whole)
    cameras.window(scene, (x + corner[0], y + corner[1]), size or whole)


def _new_scene(task: Task) -> tuple[Any, Line]:
    """The scene with a camera found and aimed, and the line that describes both.

    A generated scene in which no camera is found gives way to another one, for this view alone.
    """
    size = task.size, task.size
    line: Line = {name: getattr(task, name) for name in DESCRIPTION}
    line |= {"width": task.size, "height": task.size, "path": task.path}
    if task.kind == "library":
        scene = _load_file(task)
        if task.number > 0 and _entry(task).may_vary:
            line |= {"variation": int(entropy(task.seed, task.scene, "variation", task.number)[0])}
            variation.vary(scene, np.random.default_rng(line["variation"]))
        rng = np.random.default_rng(entropy(task.seed, task.scene, "cameras"))
        camera = library.choose(scene, task.number, _draft(LIBRARY_DEPTH), rng, size)
        line |= {"content": "library", "max_depth": LIBRARY_DEPTH, "camera": _plain(camera)}
        return scene, _windowed(scene, task, line)
    reasons = []
    for attempt in range(4):
        state = entropy(task.seed, task.scene, attempt)  # all views of a scene share it, and each draws its own camera
        built, scene = _build(int(state[0]))
        try:
            rng = np.random.default_rng(entropy(task.seed, task.id, attempt)[1])
            camera = cameras.find(scene, built.propose, _draft(built.max_depth), rng, size)
            line |= {"content": built.kind, "max_depth": built.max_depth, "camera": _plain(camera)}
            line |= {"generator": procedural.GENERATOR, "scene_seed": int(state[0])}
            return scene, _windowed(scene, task, line)
        except RejectedError as error:
            reasons.append(f"{built.kind} ({error})")
    raise RejectedError("; ".join(reasons))


def _known_scene(task: Task, line: Line) -> tuple[Any, Line]:
    """The scene of an index line with its camera aimed again."""
    size = line["width"], line["height"]
    if line["kind"] == "procedural" and line["generator"] != procedural.GENERATOR:
        raise RejectedError(
            f"generator {line['generator']} made its scene and this is {procedural.GENERATOR}; "
            "render the data set anew, or what this view lacks with the version that made it"
        )
    scene = _load_file(task) if line["kind"] == "library" else _build(line["scene_seed"])[1]
    if "variation" in line:
        variation.vary(scene, np.random.default_rng(line["variation"]))
    if line["camera"]:
        pose = line["camera"]
        origin, target, up = (np.array(pose[name]) for name in ("origin", "target", "up"))
        cameras.aim(scene, cameras.Camera(origin, target, up, pose["fov"], pose["blur"]), size)
    _show(scene, line)
    return scene, {k: v for k, v in line.items() if k != "files"}


def _build(seed: int) -> tuple[Any, Any]:
    import drjit as dr

    dr.set_thread_count(2)  # with fewer, Mitsuba's loaders wait for each other
    built = procedural.build(seed)
    scene = built.stage.load()
    dr.set_thread_count(1)
    return built, scene


def _load_file(task: Task) -> Any:
    import drjit as dr

    dr.set_thread_count(2)
    scene = library.load(_entry(task))
    dr.set_thread_count(1)
    return scene


def _entry(task: Task) -> Any:
    return library.Entry(Path(task.path), task.scene, task.licence, task.origin)


def _plain(camera: Any) -> Line | None:
    """A camera for JSON; None stands for the scene's own."""
    if camera is None:
        return None
    return {k: v.tolist() if isinstance(v, np.ndarray) else float(v) for k, v in camera._asdict().items()}
