"""A run inside a budget of time or memory: which model, with or without paths, in tiles of what size.

Nothing is assumed of the machine: each way denoises a piece from the middle of the frame, and what that
takes is scaled to the frame's windows (tiles with their overlap).
"""

from collections.abc import Mapping
from dataclasses import dataclass, replace
from math import ceil, isqrt
from numbers import Real
from time import perf_counter
from typing import Any

from numpy.typing import NDArray

from pathfold import memory, models
from pathfold._core import PathfoldError, Plan
from pathfold.arguments import as_array, failure
from pathfold.denoiser import Denoiser, Result

# The best first, by the errors in docs/results/validation-8spp; another model takes part where it is named.
PREFERRED = ("pathfold-balanced", "pathfold-high", "pathfold-fast", "kpcn-manifold", "kpcn-vanilla", "kpcn-path")

ROUNDS = 2  # of a trial
IN_WINDOWS = ("pack", "network", "reconstruct")  # the stages of a run that see a tile's window
# On what a trial tells: other programs run, too, and what the heap had free hides some of what is needed.
TIME_MARGIN, MEMORY_MARGIN = 1.25, 1.4
TRIAL_EDGE = 64  # pixels of a trial's piece at least: on smaller ones a run's fixed cost hides what its pixels take

Buffers = Mapping[str, NDArray[Any]]


@dataclass(frozen=True)
class Cost:
    """What a trial tells of a way; milliseconds and bytes per pixel of a window, and of the frame."""

    window_ms: float
    frame_ms: float
    window_bytes: float


@dataclass(frozen=True)
class Outlook:
    """What a way would come to in the tiles of its denoiser."""

    denoiser: Denoiser
    plan: Plan
    seconds: float
    memory_mb: float  # of the process at its peak
    overlapping: float  # pixels of all windows over those of the frame

    @property
    def tile(self) -> str:
        return f"{self.plan.tile_width}x{self.plan.tile_height}"


@dataclass(frozen=True)
class Choice:
    """What a budget comes to: the denoiser, the buffers that it is to have, and what to tell the user."""

    denoiser: Denoiser
    buffers: Buffers
    seconds: float  # as expected
    memory_mb: float  # of the process at its peak, as feared
    lines: list[str]

    def run(self, **arguments: Any) -> Result:
        return self.denoiser.run_buffers(self.buffers, **arguments)


@dataclass(frozen=True)
class Way:
    """A model, with the paths of its samples or without."""

    name: str
    paths: bool | None  # whether samples are read; None: the model has no choice

    def __str__(self) -> str:
        return self.name + {None: "", True: " with paths", False: " without paths"}[self.paths]


class Budget:
    """Bounds on a run: `seconds` until its end, `memory_mb` of this process at its peak.

    `model` is the only model that may be chosen; None stands for all of PREFERRED that there are. `options` go to
    the Denoiser. Raises PathfoldError for bounds that are not > 0, and for a memory that cannot be watched.
    """

    def __init__(
        self, seconds: float | None = None, memory_mb: float | None = None, model: str | None = None, **options: Any
    ) -> None:
        for name, value in (("seconds", seconds), ("memory_mb", memory_mb)):
            a_number = isinstance(value, Real) and not isinstance(value, bool)
            if value is not None and not (a_number and 0 < value < float("inf")):
                raise failure("invalid-argument", f"{name} is {value!r}; it must be > 0 and finite")
        if memory_mb is not None and not memory.can_be_watched():
            raise failure("unsupported", "memory_mb: this system does not tell what a process holds; leave it away")
        self.seconds, self.memory_mb = seconds, memory_mb
        known = models.available()
        needed = {options.get("precision", "auto")} & {"int8"}
        fitting = [name for name in PREFERRED if name in known and needed <= {*models.precisions(name)}]
        self.models = fitting if model is None else [model]
        if not self.models:
            raise failure(
                "not-found",
                f"none of {', '.join(PREFERRED)} is there{' in int8' * len(needed)}; "
                f"name a model{', or give precision fp32 or auto' * len(needed)}",
            )
        self._options = options
        self._chosen: dict[tuple[Any, ...], Choice] = {}

    def __str__(self) -> str:
        given = ((self.seconds, "s"), (self.memory_mb, "MB"))
        return " and ".join(f"{value:g} {unit}" for value, unit in given if value is not None)

    @property
    def reads(self) -> set[str]:
        """What any of the models can use."""
        return set().union(*(models.inputs(name) for name in self.models))

    def choose(
        self,
        buffers: Buffers,
        *,
        start: float | None = None,
        samples_per_pixel: int = 0,
        later_mb: float = 0,
    ) -> Choice:
        """The first way, in the order of PREFERRED and with paths before without, that stays inside.

        `buffers` are those of the frame by name, height x width x channels, samples S x height x width x channels.
        `start` is when the clock began to run (perf_counter; None: now), `later_mb` what the caller will hold at a time
        beside the buffers and the denoiser, to write a file for example. Frames like one before get what that got.
        Raises PathfoldError ("unsupported") that names the nearest where none stays inside.
        """
        begin = perf_counter() if start is None else start
        buffers = {name: as_array(name, pixels) for name, pixels in buffers.items()}
        shapes = tuple(sorted((name, pixels.shape) for name, pixels in buffers.items()))
        if shapes not in self._chosen:
            self._chosen = {shapes: self._search(buffers, begin, samples_per_pixel, later_mb)}
        found = self._chosen[shapes]
        return replace(found, buffers={name: buffers[name] for name in found.buffers})

    def _search(self, buffers: Buffers, begin: float, samples_per_pixel: int, later_mb: float) -> Choice:
        _check_sizes(buffers)
        refused: list[tuple[float, str, str]] = []  # times the bound; what it would come to; what would be enough
        for way in self._ways(buffers):
            given = _without_paths(buffers) if way.paths is False else buffers
            denoiser = Denoiser(way.name, **self._options)
            trial = Denoiser(denoiser.model, **self._options | {"leave_out": "none"})  # the piece may need nothing
            cost = _try(trial, given, samples_per_pixel)
            del trial  # its tensors are no part of what is held
            found = self._look(denoiser, cost, given, samples_per_pixel, later_mb)
            spent = perf_counter() - begin
            until = spent + TIME_MARGIN * found.seconds
            if self.memory_mb is not None and found.memory_mb > self.memory_mb:
                needed = f"{ceil(found.memory_mb)} MB"
                refused.append((found.memory_mb / self.memory_mb, f"{way}: needs {needed}", needed))
            elif self.seconds is not None and until > self.seconds:
                words = f"{way}: would take {found.seconds:.2g} s, {spent:.2g} s are spent"
                refused.append((until / self.seconds, words, f"{ceil(100 * until) / 100:g} s"))
            else:
                expected = f"about {found.seconds:.2g} s, less than {found.memory_mb:.0f} MB"
                lines = [f"{way}, tiles of {found.tile}: {expected}"]
                lines += [f"gave up {words}" for _, words, _ in refused]
                if found.overlapping > 1.5:
                    lines.append(f"gave up larger tiles: with overlap these are {found.overlapping:.1f} pictures")
                return Choice(found.denoiser, given, found.seconds, found.memory_mb, lines)
            del denoiser, found  # before the next one is loaded
        _, words, enough = min(refused)
        raise failure(
            "unsupported",
            f"nothing stays inside {self}. Nearest is {words}; give {enough} or more",
        )

    def _ways(self, buffers: Buffers) -> list[Way]:
        found = []
        given = buffers.keys() | ({"color"} if {"diffuse", "specular"} <= buffers.keys() else set())
        for name in self.models:
            manifest = models.manifest(name)
            if not set(manifest["requires"]) <= given:
                continue
            optional = "samples.descriptor" in manifest["uses"] and "samples.descriptor" in buffers
            found += [Way(name, paths) for paths in ((True, False) if optional else (None,))]
        if not found:
            needed = f"{', '.join(self.models)} require buffers that are not there"
            raise failure("invalid-argument", f"{needed}; there are {', '.join(sorted(buffers)) or 'none'}")
        return found

    def _look(
        self, denoiser: Denoiser, cost: Cost, buffers: Buffers, samples_per_pixel: int, later_mb: float
    ) -> Outlook:
        """A run in the tiles that are fastest, else in the largest that the memory allows, else in the smallest."""
        held_mb = memory.in_use() + later_mb

        def look(**tiles: int) -> Outlook:
            tiled = Denoiser(denoiser.model, **self._options | tiles)
            plan = tiled.plan_buffers(buffers, samples_per_pixel=samples_per_pixel)
            pixels = _pixels(buffers)
            needed = plan.frame_bytes + plan.result_bytes + MEMORY_MARGIN * cost.window_bytes * plan.window_pixels
            seconds = (cost.window_ms * plan.pixels + cost.frame_ms * pixels) / 1000
            return Outlook(tiled, plan, seconds, held_mb + needed / memory.MEBIBYTE, plan.pixels / pixels)

        found = look()
        if self.memory_mb is None or found.memory_mb <= self.memory_mb:
            return found
        windows_mb = MEMORY_MARGIN * cost.window_bytes * found.plan.window_pixels / memory.MEBIBYTE
        left = self.memory_mb - (found.memory_mb - windows_mb)
        # As much of what the SDK counts for a window as is left of what the trial told.
        bound = int(left / windows_mb * found.plan.window_bytes / memory.MEBIBYTE) if windows_mb > 0 else 0
        try:
            return look(memory_mb=bound) if bound > 0 else look(tile=_alignment(denoiser))
        except PathfoldError:  # too little for any tile
            return look(tile=_alignment(denoiser))


def _check_sizes(buffers: Buffers) -> None:
    """Raise a PathfoldError where a trial's piece could not be cut out of all of them alike."""
    first = next(iter(buffers), "")
    for name, pixels in buffers.items():
        axes = "S x H x W x C" if name.startswith("samples.") else "H x W x C"
        if pixels.ndim != axes.count("x") + 1:
            raise failure("invalid-argument", f"{name} is of shape {pixels.shape}; give {axes}")
        (height, width), (right, across) = pixels.shape[-3:-1], buffers[first].shape[-3:-1]
        if (height, width) != (right, across):
            said = f"{name} is {width}x{height} pixels, but {first} is {across}x{right}"
            raise failure("invalid-argument", f"{said}; give buffers of one size")


def _try(denoiser: Denoiser, buffers: Buffers, samples_per_pixel: int) -> Cost:
    """Denoise the middle of the frame: a small piece to warm up, then the model's smallest window or a larger one."""
    # What loading the model left free in the heap would hide some of what the first run takes.
    in_small_tiles = Denoiser(denoiser.model, tile=_alignment(denoiser))
    least = in_small_tiles.plan_buffers(buffers, samples_per_pixel=samples_per_pixel).window_pixels
    edge = max(isqrt(least), TRIAL_EDGE)
    small, piece = (
        {name: _middle(pixels, size) for name, pixels in buffers.items()} for size in (edge // 4, edge)
    )  # the first's tensors stay
    denoiser.run_buffers(small, samples_per_pixel=samples_per_pixel)
    before = memory.forget_peak()
    reports = [denoiser.run_buffers(piece, samples_per_pixel=samples_per_pixel).report for _ in range(ROUNDS)]
    pixels = reports[0]["width"] * reports[0]["height"]
    inside = min(sum(report["ms"][stage] for stage in IN_WINDOWS) for report in reports)
    whole = min(report["ms"]["total"] for report in reports)
    held = (memory.peak() - before) * memory.MEBIBYTE
    return Cost(inside / pixels, max(0.0, whole - inside) / pixels, held / pixels)


def _alignment(denoiser: Denoiser) -> int:
    """The edge of the model's smallest tile."""
    return int(denoiser.model.manifest["tile"]["alignment"])


def _pixels(buffers: Buffers) -> int:
    height, width = buffers["color" if "color" in buffers else "diffuse"].shape[:2]
    return int(height * width)


def _without_paths(buffers: Buffers) -> dict[str, NDArray[Any]]:
    return {name: pixels for name, pixels in buffers.items() if not name.startswith("samples.")}


def _middle(pixels: NDArray[Any], edge: int) -> NDArray[Any]:
    """A piece of edge x edge from the middle, or as much of it as there is."""
    axis = pixels.ndim - 3
    height, width = pixels.shape[axis : axis + 2]
    y, x = max(0, height - edge) // 2, max(0, width - edge) // 2
    return pixels[..., y : y + edge, x : x + edge, :]
