"""`trace`: camera samples with radiance split, guides and path descriptors; `trace_mean`: their average."""

from __future__ import annotations

from collections.abc import Callable, Collection
from dataclasses import dataclass
from itertools import chain
from typing import Any

import drjit as dr
import mitsuba as mi
import numpy as np
from numpy.typing import NDArray

from pathfold._core import Layout
from pathfold.models import ALL_SAMPLES

from . import descriptor, materials
from .film import Film, opaque
from .walk import Settings, Traced, walk

MEANS = (
    *("color", "diffuse", "specular", "diffuse.albedo", "albedo", "normal", "depth", "alpha"),
    *("variance", "diffuse.variance", "specular.variance"),
)
Columns = dict[str, list[Any]]  # of every field of Samples its channels, as device arrays
Launch = Callable[..., Columns]  # trace_lanes, or that made ready once
RECORDED = {"descriptor", "density", "overlong"}
FIRST_HIT = {"first_albedo", "first_normal", "first_depth", "visible"}
OPTIONAL = {"diffuse", "diffuse_albedo", "albedo", "normal", "depth", "alpha", "position", *FIRST_HIT, *RECORDED}
MAX_LANES = 2**32 // Layout().channels
FROZEN = 16  # launches that one Frozen keeps ready
CHUNK_LANES = 1 << 22  # samples that trace_mean holds at once


@dataclass
class Samples:
    """Camera samples as NumPy arrays S x H x W x C (memory S x C x H x W), linear radiance; fewer S of recorded paths.

    Radiance, depths, position and density are float32, the rest float16. Normals are in camera space and face the
    camera; `position` is the offset in pixels from the pixel centre; `alpha` is 1 where the sample met a surface.
    Albedo, normal and depth are those of the first hit that is not a delta event, `first_...` those of the first
    surface met; `visible` is 1 where that one's light sample is unoccluded, or the path then runs into an emitter.
    `descriptor` (6 + 5 * vertices channels, logarithms with DEAD_LOG for 0), `density` (log of the sampling density)
    and `overlong` (1 where a path has more vertices than were recorded) are None unless they were asked for, and
    whatever was left out is None.
    """

    radiance: NDArray[Any]
    diffuse: NDArray[Any] = None  # type: ignore[assignment]
    diffuse_albedo: NDArray[Any] = None  # type: ignore[assignment]
    albedo: NDArray[Any] = None  # type: ignore[assignment]
    normal: NDArray[Any] = None  # type: ignore[assignment]
    depth: NDArray[Any] = None  # type: ignore[assignment]
    alpha: NDArray[Any] = None  # type: ignore[assignment]
    position: NDArray[Any] = None  # type: ignore[assignment]
    first_albedo: NDArray[Any] = None  # type: ignore[assignment]
    first_normal: NDArray[Any] = None  # type: ignore[assignment]
    first_depth: NDArray[Any] = None  # type: ignore[assignment]
    visible: NDArray[Any] = None  # type: ignore[assignment]
    descriptor: NDArray[Any] | None = None
    density: NDArray[Any] | None = None
    overlong: NDArray[Any] | None = None

    @property
    def specular(self) -> NDArray[Any]:
        """Radiance that the diffuse lobe did not carry, S x H x W x 3."""
        return self.radiance - self.diffuse

    def valid(self) -> NDArray[Any]:
        """Return S x H x W booleans: radiance and guides, as far as they were made, are finite."""
        arrays = (self.radiance, self.diffuse, self.diffuse_albedo, self.albedo, self.normal, self.depth)
        return np.logical_and.reduce([np.isfinite(a).all(-1) for a in arrays if a is not None])

    def reduce(self, wanted: Collection[str] = MEANS) -> dict[str, Any]:
        """Return pixel means H x W x C float32, and `dropped`: how many samples were not finite and left out.

        Means: color, and as far as they are `wanted` and their samples were made diffuse, specular, diffuse.albedo,
        albedo, normal, depth, alpha; also variance, diffuse.variance and specular.variance, unbiased and of the
        pixel mean, 0 below two samples.
        """
        valid = self.valid()[..., None]
        count = valid.sum(0)
        buffers: dict[str, Any] = {"dropped": int(valid.size - count.sum())}

        def mean(samples: NDArray[Any]) -> NDArray[np.float32]:
            total = np.where(valid, samples, 0).sum(0, dtype=np.float32)
            return (total / np.maximum(count, 1)).astype(np.float32)

        for name in ("color", "diffuse", "specular"):
            spread = "variance" if name == "color" else f"{name}.variance"
            if name != "color" and (self.diffuse is None or not {name, spread} & {*wanted}):
                continue
            samples = self.radiance if name == "color" else getattr(self, name)
            buffers[name] = mean(samples)
            if spread in wanted:
                squares = np.where(valid, np.square(samples - buffers[name]), 0).sum(0)
                variance = np.where(count > 1, squares / np.maximum(count - 1, 1) / np.maximum(count, 1), 0)
                buffers[spread] = variance.astype(np.float32)
        guides = {
            "diffuse.albedo": self.diffuse_albedo,
            "albedo": self.albedo,
            "normal": self.normal,
            "depth": self.depth,
            "alpha": self.alpha,
        }
        made = {name: samples for name, samples in guides.items() if name in wanted and samples is not None}
        return buffers | {name: mean(samples) for name, samples in made.items()}


def trace(
    scene: Any,
    spp: int = 8,
    seed: int = 0,
    max_depth: int = 6,
    sensor: int = 0,
    rr_depth: int | None = None,
    emitter_sampling: bool = True,
    vertices: int = 6,
    *,
    recorded: int = ALL_SAMPLES,
    leave_out: Collection[str] = (),
    launch: Launch | None = None,
) -> Samples:
    """Path-trace `spp` samples for every pixel of a sensor of a loaded Mitsuba scene.

    `max_depth` counts as in Mitsuba: 1 shows emitters alone, 2 adds direct light, -1 has no limit and needs
    `rr_depth`, the depth from which Russian roulette may end a path (None: never; its odds join the density).
    Paths are recorded of the first `recorded` samples of every pixel, the same samples whatever their number:
    descriptor, density and overlong have no more.
    Without `emitter_sampling` light is only found by running into it. `leave_out` names fields of `Samples` that are
    not made, nor anything that only they need; the others stay what they are. Equal arguments give equal arrays.
    Many calls on one scene are faster with a `launch` that they share: see `Frozen`.
    Raises ValueError for arguments out of range, NotImplementedError naming what the scene has and we lack.
    """
    camera = check(scene, spp, seed, sensor, max_depth, rr_depth, vertices)
    if unknown := set(leave_out) - OPTIONAL:
        raise ValueError(f"leave_out names {', '.join(sorted(unknown))}; it may name {', '.join(sorted(OPTIONAL))}")
    if recorded < 0:
        raise ValueError(f"recorded is {recorded}; give 0 or more samples per pixel")
    film = Film.of(camera)
    if film.pixels * spp > MAX_LANES:
        raise ValueError(
            f"{film.width}x{film.height} pixels at {spp} samples are more than {MAX_LANES} paths in one call; "
            "lower spp and call again with another seed, or set a crop window on the film"
        )
    surveyed = materials.survey(scene)
    first = min(recorded, spp)
    first_hits = bool(FIRST_HIT.difference(leave_out))
    launched: list[tuple[int, int, Columns]] = []
    planes: dict[str, NDArray[Any]] = {}
    for begin, count, records in ((0, first, True), (first, spp - first, False)):
        if count == 0:
            continue
        settings = Settings(max_depth, rr_depth, vertices, records, first_hits, emitter_sampling, surveyed)
        lanes = dr.arange(mi.UInt32, film.pixels * count)
        dr.eval(lanes)  # their number is the size of the launch, whatever it was made ready with
        numbers = Stream.entropy(seed, 0), opaque(begin * film.pixels)
        columns = (launch or trace_lanes)(scene, camera, film, lanes, *numbers, settings, frozenset(leave_out))
        dr.eval(columns)  # returns at once: the second launch is made ready while the first one runs
        launched.append((begin, count, columns))
    while launched:
        begin, count, columns = launched.pop(0)
        for name, channels in columns.items():
            if name not in planes:
                samples = first if name in RECORDED else spp
                shape = samples, len(channels), film.height, film.width
                planes[name] = np.empty(shape, channels[0].numpy().dtype)
            to_host(channels, planes[name][begin : begin + count])
    return Samples(**{name: np.moveaxis(values, 1, -1) for name, values in planes.items()})


def trace_lanes(
    scene: Any, camera: Any, film: Film, lanes: Any, entropy: Any, first: Any, settings: Settings, leave_out: frozenset
) -> Columns:
    """Traced a path per lane; return the channels of all fields of `Samples` but those left out, one value per lane.

    `lanes` are UInt32 0 to S * H * W - 1 of `film`, sample-major: every channel is a plane S x H x W as it leaves the
    device. They take their random numbers from lane `first` of `entropy` on, UInt32 of width 1 each.
    """
    stream = Stream.seeded(entropy, lanes + first)
    position, traced = trace_paths(scene, camera, film, lanes % opaque(film.pixels), stream, settings)
    columns = pack(camera, traced, descriptor.half) | {"position": list(position)}
    columns |= {} if traced.record is None else descriptor.channels(traced.record)
    return {name: channels for name, channels in columns.items() if name not in leave_out}


class Frozen:
    """A `launch` for `trace`: made ready once for each of its settings and film sizes, and not in every call.

    Of the scene only what Dr.Jit holds in arrays may change between the calls that share it; take a new one after any
    other change, and for another scene. Where a plugin of the scene hides arrays from Dr.Jit it is `refused`, and every
    call does all the work.
    """

    def __init__(self) -> None:
        self._ready = dr.freeze(trace_lanes, limit=FROZEN, warn_after=ALL_SAMPLES)
        self.refused = False

    def __call__(self, *arguments: Any) -> Columns:
        if not self.refused:
            try:
                return self._ready(*arguments)
            except RuntimeError as error:
                if error.__cause__ and not isinstance(error.__cause__, Exception):
                    raise error.__cause__ from None  # Dr.Jit hides Ctrl-C, too
                self.refused = True  # an error of the tracing itself comes again below
        return trace_lanes(*arguments)


def trace_mean(
    scene: Any,
    spp: int = 1024,
    seed: int = 0,
    max_depth: int = 6,
    sensor: int = 0,
    rr_depth: int | None = None,
    emitter_sampling: bool = True,
) -> dict[str, Any]:
    """Average `spp` samples per pixel on the device; return H x W x C float32 means and `dropped`.

    Means: color, diffuse, diffuse.albedo, albedo, normal, depth, alpha (specular = color - diffuse). Samples that
    are not finite are left out and counted. Seeds are independent of each other and of `trace`'s.
    """
    camera = check(scene, spp, seed, sensor, max_depth, rr_depth, 1)
    film = Film.of(camera)
    settings = Settings(max_depth, rr_depth, 1, False, False, emitter_sampling, materials.survey(scene))
    chunk = max(1, CHUNK_LANES // film.pixels)
    sums: dict[str, NDArray[np.float64]] = {}
    for index, first in enumerate(range(0, spp, chunk)):
        size = min(chunk, spp - first)
        # Pixel-major lanes: the samples of a pixel lie side by side and are summed as a block.
        pixel = dr.arange(mi.UInt32, film.pixels * size) // opaque(size)
        stream = Stream.seeded(Stream.entropy(seed, 1, index), dr.arange(mi.UInt32, film.pixels * size))
        _, traced = trace_paths(scene, camera, film, pixel, stream, settings)
        columns = pack(camera, traced, list)
        finite = dr.full(mi.Bool, True, film.pixels * size)
        for channel in chain.from_iterable(columns.values()):
            finite &= dr.isfinite(channel)
        columns["count"] = [mi.Float(1)]
        columns = {name: [dr.select(finite, c, 0) for c in channels] for name, channels in columns.items()}
        dr.eval(columns)  # one kernel: sums of unevaluated columns would each trace all paths again
        for name, channels in columns.items():
            blocks = [dr.block_sum(channel, size) for channel in channels]
            dr.eval(blocks)
            sums[name] = sums.get(name, 0) + np.stack([block.numpy() for block in blocks], -1, dtype=np.float64)
    count = sums.pop("count")
    names = {"radiance": "color", "diffuse_albedo": "diffuse.albedo"}
    means: dict[str, Any] = {"dropped": int(film.pixels * spp - count.sum())}
    for name, values in sums.items():
        image = (values / np.maximum(count, 1)).reshape(film.height, film.width, -1)
        means[names.get(name, name)] = image.astype(np.float32)
    return means


def check(scene: Any, spp: int, seed: int, sensor: int, max_depth: int, rr_depth: int | None, vertices: int) -> Any:
    """Return the sensor, or raise an error that names what is wrong and what would be right."""
    if mi.variant() not in ("llvm_ad_rgb", "cuda_ad_rgb"):
        raise RuntimeError(
            f"Mitsuba's variant is {mi.variant()}; call mitsuba.set_variant('llvm_ad_rgb') or "
            "('cuda_ad_rgb') before the scene is loaded"
        )
    if not isinstance(scene, mi.Scene):
        raise TypeError(f"scene is a {type(scene).__name__}; pass the Scene that mitsuba.load_file returns")
    sensors = scene.sensors()
    if not 0 <= sensor < len(sensors):
        raise ValueError(f"sensor {sensor} does not exist; the scene has {len(sensors)}, counted from 0")
    if spp < 1:
        raise ValueError(f"spp is {spp}; ask for at least 1 sample per pixel")
    if seed < 0:
        raise ValueError(f"seed is {seed}; give 0 or more")
    if vertices < 1:
        raise ValueError(f"vertices is {vertices}; record at least 1")
    if max_depth < 1 and (max_depth != -1 or rr_depth is None):
        raise ValueError(f"max_depth is {max_depth}; give 1 or more, or -1 together with rr_depth")
    return sensors[sensor]


@dataclass
class Stream:
    """Uniform numbers in [0, 1), for each lane its own: what Mitsuba's independent sampler gives, from any lane on."""

    rng: Any

    @staticmethod
    def entropy(*numbers: int) -> Any:
        """The seed that these numbers stand for, on the device."""
        return opaque(int(np.random.SeedSequence(numbers).generate_state(1)[0]))

    @staticmethod
    def seeded(entropy: Any, lanes: Any) -> Stream:
        """For lanes of these numbers, of all that an entropy stands for."""
        state, sequence = mi.sample_tea_32(entropy, lanes)
        return Stream(mi.PCG32(initstate=mi.UInt64(state), initseq=mi.UInt64(sequence)))  # type: ignore[operator]

    def next_1d(self) -> Any:
        return self.rng.next_float32()

    def next_2d(self) -> Any:
        return mi.Point2f(self.rng.next_float32(), self.rng.next_float32())


def trace_paths(
    scene: Any, camera: Any, film: Film, pixel: Any, sampler: Stream, settings: Settings
) -> tuple[Any, Traced]:
    """Traced one path per lane through its pixel; return its film position first."""
    offset = film.sample(sampler.next_2d())
    aperture = sampler.next_2d() if camera.needs_aperture_sample() else mi.Point2f(0.5)
    ray, weight = camera.sample_ray(0, 0, film.place(pixel, offset), aperture)
    # Rays start at the near plane, distance at the camera.
    distance = dr.dot(ray.d, ray.o - camera.world_transform() @ mi.Point3f(0))
    traced = walk(scene, sampler, ray, distance, settings)
    traced.path.radiance *= weight
    traced.path.diffuse *= weight
    return offset, traced


def pack(camera: Any, traced: Traced, narrow: Callable[[Any], list[Any]]) -> dict[str, list[Any]]:
    """Return the channels of every buffer as device arrays; `narrow` makes lists of guides, which bear float16."""
    path, guides, first = traced.path, traced.guides, traced.first
    columns = {
        "radiance": list(path.radiance),
        "diffuse": list(path.diffuse),
        "depth": [guides.depth],
        "diffuse_albedo": narrow(guides.diffuse_albedo),
        "albedo": narrow(guides.albedo),
        "normal": narrow(seen_from(camera, guides.normal, guides.found)),
        "alpha": narrow([flag(guides.covered)]),
    }
    if first is not None:
        columns |= {
            "first_albedo": narrow(first.albedo),
            "first_normal": narrow(seen_from(camera, first.normal, first.met)),
            "first_depth": [first.depth],
            "visible": narrow([flag(first.visible)]),
        }
    return columns


def seen_from(camera: Any, normal: Any, found: Any) -> Any:
    """World-space normals as unit vectors in camera space, 0 where nothing was found."""
    normal = camera.world_transform().inverse() @ normal
    return dr.select(found, normal * dr.rsqrt(dr.maximum(dr.squared_norm(normal), 1e-20)), 0)


def flag(on: Any) -> Any:
    return dr.select(on, mi.Float(1), 0)


def to_host(channels: list[Any], planes: NDArray[Any]) -> None:
    """Write sample-major lanes into planes S x C x H x W."""
    samples, _, height, width = planes.shape
    for index, channel in enumerate(channels):
        values = channel.numpy()
        planes[:, index] = values.reshape(samples, height, width) if values.size > 1 else values
