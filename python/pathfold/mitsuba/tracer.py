"""`trace`: camera samples with radiance split, guides and path descriptors; `trace_mean`: their average."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import drjit as dr
import mitsuba as mi
import numpy as np

from . import materials
from .film import Film
from .walk import Guides, Path, Record, Settings, log, walk

DEAD = -100.0  # stands for the logarithm of 0 in a descriptor
MAX_LANES = 2**32 // 36
CHUNK_LANES = 1 << 22  # samples that trace_mean holds at once


@dataclass
class Samples:
    """Camera samples as NumPy arrays S x H x W x C, linear radiance, normals in camera space.

    `descriptor` (36 channels for 6 vertices, float16, logarithms where DESIGN calls for them), `density` (log q) and
    `overlong` (1 where the dominant path has more vertices than were recorded) are None unless they were asked for.
    `position` is the offset in pixels from the pixel centre.
    """

    radiance: np.ndarray
    diffuse: np.ndarray
    diffuse_albedo: np.ndarray
    albedo: np.ndarray
    normal: np.ndarray
    depth: np.ndarray
    alpha: np.ndarray
    position: np.ndarray
    descriptor: np.ndarray | None = None
    density: np.ndarray | None = None
    overlong: np.ndarray | None = None

    @property
    def specular(self) -> np.ndarray:
        """Radiance that the diffuse lobe did not carry, S x H x W x 3."""
        return self.radiance - self.diffuse

    def valid(self) -> np.ndarray:
        """Return S x H x W booleans: every radiance channel is finite."""
        return np.isfinite(self.radiance).all(-1) & np.isfinite(self.diffuse).all(-1)

    def reduce(self) -> dict[str, Any]:
        """Return per-pixel buffers H x W x C float32 and `dropped`, the number of non-finite samples left out.

        Buffers: color, diffuse, specular, their variances of the pixel mean (unbiased; 0 below two samples),
        diffuse.albedo, albedo, normal, depth, alpha.
        """
        valid = self.valid()[..., None]
        count = valid.sum(0)
        buffers: dict[str, Any] = {"dropped": int(valid.size - count.sum())}

        def mean(samples: np.ndarray) -> np.ndarray:
            return np.where(valid, samples, 0).sum(0, dtype=np.float32) / np.maximum(count, 1)

        radiance = {"color": self.radiance, "diffuse": self.diffuse, "specular": self.specular}
        for name, samples in radiance.items():
            buffers[name] = mean(samples).astype(np.float32)
            squares = np.where(valid, np.square(samples - buffers[name]), 0).sum(0, dtype=np.float32)
            variance = np.where(count > 1, squares / np.maximum(count - 1, 1) / np.maximum(count, 1), 0)
            buffers["variance" if name == "color" else f"{name}.variance"] = variance.astype(np.float32)
        guides = {"diffuse.albedo": self.diffuse_albedo, "albedo": self.albedo, "normal": self.normal,
                  "depth": self.depth, "alpha": self.alpha}  # fmt: skip
        return buffers | {name: mean(samples).astype(np.float32) for name, samples in guides.items()}


def trace(
    scene: Any,
    spp: int = 8,
    seed: int = 0,
    max_depth: int = 6,
    sensor: int = 0,
    descriptors: bool = True,
    rr_depth: int | None = None,
    emitter_sampling: bool = True,
    vertices: int = 6,
) -> Samples:
    """Path-trace `spp` samples for every pixel of a sensor of a loaded Mitsuba scene.

    `max_depth` counts as in Mitsuba: 1 shows emitters alone, 2 adds direct light, -1 has no limit and needs `rr_depth`,
    the depth from which Russian roulette may end a path (None: never; its probability joins the density).
    Without `emitter_sampling` light is only found by running into it. Equal arguments give equal arrays.
    Raises ValueError for arguments out of range and NotImplementedError for scene features that are not supported.
    """
    settings = Settings(max_depth, rr_depth, vertices, descriptors, emitter_sampling)
    camera = check(scene, spp, sensor, settings)
    film = Film(camera)
    lanes = film.pixels * spp
    if lanes > MAX_LANES:
        raise ValueError(
            f"{film.width}x{film.height} pixels at {spp} samples are {lanes} paths, more than {MAX_LANES} in one call; "
            "lower spp and call again with another seed, or set a crop window on the film"
        )
    ray_weight, position, (path, guides, record) = launch(scene, camera, film, spp, (seed, 0), settings)
    columns = pack(camera, ray_weight, path, guides)
    columns["position"] = position, "single"
    if record is not None:
        columns |= describe(record)
    flat = {name: interleave(values, precision) for name, (values, precision) in columns.items()}
    dr.eval(flat)
    shape = (spp, film.height, film.width, -1)
    return Samples(**{name: values.numpy().reshape(shape) for name, values in flat.items()})


def trace_mean(
    scene: Any,
    spp: int = 1024,
    seed: int = 0,
    max_depth: int = 6,
    sensor: int = 0,
    rr_depth: int | None = None,
    emitter_sampling: bool = True,
) -> dict[str, Any]:
    """Average `spp` samples per pixel on the device; return H x W x C float32 buffers and `dropped`.

    Buffers: color, diffuse, diffuse.albedo, albedo, normal, depth, alpha (specular = color - diffuse). Non-finite
    samples are left out and counted. Seeds are independent of `trace`'s, and unlike seeds of each other.
    """
    settings = Settings(max_depth, rr_depth, 1, False, emitter_sampling)
    camera = check(scene, spp, sensor, settings)
    film = Film(camera)
    step = max(1, min(spp, CHUNK_LANES // film.pixels))
    sums: dict[str, np.ndarray] = {}
    for index, first in enumerate(range(0, spp, step)):
        size = min(step, spp - first)
        ray_weight, _, (path, guides, _) = launch(scene, camera, film, size, (seed, 1, index), settings)
        columns = pack(camera, ray_weight, path, guides)
        finite = mi.Bool(True)
        for name in ("radiance", "diffuse"):
            finite &= dr.all(dr.isfinite(columns[name][0]))
        columns["count"] = dr.ones(mi.Float, film.pixels * size), "single"
        kept = {name: dr.select(finite, values, 0) for name, (values, _) in columns.items()}
        dr.eval(kept)  # one kernel: sums of unevaluated columns would each trace all paths again
        totals = {name: total(values, size) for name, values in kept.items()}
        for name, values in totals.items():
            sums[name] = sums.get(name, 0) + values.numpy().astype(np.float64)
    count = sums.pop("count")
    names = {"radiance": "color", "diffuse_albedo": "diffuse.albedo"}
    means: dict[str, Any] = {"dropped": int(film.pixels * spp - count.sum())}
    for name, values in sums.items():
        image = (values / np.maximum(count, 1)).T.reshape(film.height, film.width, -1)
        means[names.get(name, name)] = image.astype(np.float32)
    return means


def check(scene: Any, spp: int, sensor: int, settings: Settings) -> Any:
    """Return the sensor, or raise an error that names what is wrong and what would be right."""
    variant = mi.variant()
    if variant not in ("llvm_ad_rgb", "cuda_ad_rgb"):
        raise RuntimeError(
            f"Mitsuba variant {variant} cannot trace descriptors; call mitsuba.set_variant('llvm_ad_rgb') "
            "(or 'cuda_ad_rgb') before the scene is loaded"
        )
    if not isinstance(scene, mi.Scene):
        raise TypeError(
            f"scene is {type(scene).__name__}; pass the mitsuba.Scene that mitsuba.load_file returns"
        )
    if not 0 <= sensor < len(scene.sensors()):
        raise ValueError(
            f"sensor {sensor} does not exist; the scene has {len(scene.sensors())} (counted from 0)"
        )
    if spp < 1:
        raise ValueError(f"spp is {spp}; ask for at least 1 sample per pixel")
    if settings.vertices < 1:
        raise ValueError(f"vertices is {settings.vertices}; record at least 1")
    if settings.max_depth < 1 and (settings.max_depth != -1 or settings.rr_depth is None):
        raise ValueError(f"max_depth is {settings.max_depth}; give 1 or more, or -1 together with rr_depth")
    for shape in scene.shapes():
        if shape.bsdf() is not None:
            materials.check(shape.bsdf())
    return scene.sensors()[sensor]


def launch(
    scene: Any, camera: Any, film: Film, spp: int, entropy: tuple[int, ...], settings: Settings
) -> tuple[Any, Any, tuple[Path, Guides, Record | None]]:
    """Start one path per lane, sample-major: lane = sample * pixels + pixel, so that arrays come out S x H x W."""
    lanes = film.pixels * spp
    sampler = mi.load_dict({"type": "independent", "sample_count": spp})
    sampler.seed(int(np.random.SeedSequence(entropy).generate_state(1)[0]), lanes)
    pixel = dr.arange(mi.UInt32, lanes) % film.pixels
    offset = film.sample(sampler.next_2d())
    aperture = sampler.next_2d() if camera.needs_aperture_sample() else mi.Point2f(0.5)
    ray, ray_weight = camera.sample_ray(0, 0, film.place(pixel, offset), aperture)
    return ray_weight, offset, walk(scene, sampler, ray, settings)


def pack(camera: Any, ray_weight: Any, path: Path, guides: Guides) -> dict[str, tuple[Any, str]]:
    """Return the buffers of every sample as device arrays with the type they leave the device in."""
    to_camera = camera.world_transform().inverse()
    normal = to_camera @ guides.normal
    normal = dr.select(guides.found, normal * dr.rsqrt(dr.maximum(dr.squared_norm(normal), 1e-20)), 0)
    return {
        "radiance": (path.radiance * ray_weight, "single"),
        "diffuse": (path.diffuse * ray_weight, "single"),
        "diffuse_albedo": (guides.diffuse_albedo, "half"),
        "albedo": (guides.albedo, "half"),
        "normal": (normal, "half"),
        "depth": (guides.depth, "single"),
        "alpha": (dr.select(guides.covered, mi.Float(1), 0), "half"),
    }


def describe(record: Record) -> dict[str, tuple[Any, str]]:
    """Return descriptor, density and overlong flag of the dominant contribution, or of the whole walk without one."""
    lit = record.best > 0
    count = dr.select(lit, record.end_count, record.count)
    sampled = lit & record.end_sampled
    logs: list[Any] = []
    tags: list[Any] = []
    roughnesses: list[Any] = []
    product = mi.Color3f(0)
    for slot, vertex in enumerate(record.walk):
        vertex = dr.select(sampled & (count == slot), record.end, vertex)
        alive = (count > slot) | (sampled & (count == slot))
        logarithm = log(vertex.attenuation)
        dark = ~alive | (vertex.attenuation <= 0)
        product += dr.select(alive, dr.select(dark, -dr.inf, logarithm), 0)
        logs += list(dr.select(dark, DEAD, logarithm))
        tags.append(dr.select(alive, vertex.tag, 0))
        roughnesses.append(dr.select(alive, vertex.roughness, 0))
    photon = dr.select(lit, record.photon, 0)
    product += log(photon)
    floor = dr.log(mi.Float(1e-30))
    radiance = dr.select((photon > 0) & dr.isfinite(product), dr.maximum(product, floor), DEAD)
    logs = [*radiance, *dr.select(photon > 0, log(photon), DEAD), *logs]
    total = count + dr.select(sampled, mi.UInt32(1), 0)
    return {
        "descriptor": (logs + tags + roughnesses, "half"),
        "density": (dr.select(lit, record.end_density, record.log_density), "single"),
        "overlong": (dr.select(total > len(record.walk), mi.Float(1), 0), "half"),
    }


def interleave(values: Any, precision: str) -> Any:
    """Turn one device array per channel into one flat array, channels last, float32 or float16."""
    channels = [values] if isinstance(values, mi.Float) else list(values)
    flat = mi.ArrayXf(channels)
    return dr.ravel(dr.float16_array_t(flat)(flat) if precision == "half" else flat)


def total(values: Any, spp: int) -> Any:
    """Sum a device array over samples: C x P."""
    channels = [values] if isinstance(values, mi.Float) else list(values)
    return dr.sum(mi.TensorXf(dr.concat(channels), (len(channels), spp, dr.width(channels) // spp)), axis=1)
