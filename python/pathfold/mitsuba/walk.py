"""The path tracing loop: one symbolic Dr.Jit kernel for radiance, its split, guides and the path descriptor."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import drjit as dr
import mitsuba as mi

from . import materials

GENERIC_TAG = 3
LOG_FLOOR = 1e-30


@dataclass(frozen=True)
class Settings:
    """What the loop is asked for: Mitsuba's `max_depth`, roulette depth or None, vertices to record, switches."""

    max_depth: int
    rr_depth: int | None
    vertices: int
    descriptors: bool
    emitter_sampling: bool
    lobes: materials.Lobes


@dataclass
class Vertex:
    """What one scattering event leaves in the descriptor: f|cos|, interaction tag, roughness of the lobe."""

    attenuation: Any
    tag: Any
    roughness: Any

    @staticmethod
    def empty() -> Vertex:
        return Vertex(mi.Color3f(0), mi.Float(0), mi.Float(0))


@dataclass
class Record:
    """The walk so far and the dominant contribution found on it."""

    walk: list[Vertex]
    count: Any  # vertices of the walk, recorded or not
    pending: Any  # weight of null events since the last vertex
    log_density: Any
    best: Any  # luminance of the dominant contribution
    photon: Any
    end: Vertex  # the vertex that a light sample ends on
    end_count: Any  # walk vertices before the end
    end_density: Any
    end_sampled: Any  # True where the end is a light sample

    @staticmethod
    def empty(vertices: int) -> Record:
        return Record(
            walk=[Vertex.empty() for _ in range(vertices)],
            count=mi.UInt32(0),
            pending=mi.Color3f(1),
            log_density=mi.Float(0),
            best=mi.Float(0),
            photon=mi.Color3f(0),
            end=Vertex.empty(),
            end_count=mi.UInt32(0),
            end_density=mi.Float(0),
            end_sampled=mi.Bool(False),
        )


@dataclass
class Guides:
    """Feature buffers at the first non-delta hit; the defaults are those of a miss."""

    albedo: Any
    diffuse_albedo: Any
    normal: Any
    depth: Any
    covered: Any
    found: Any
    distance: Any

    @staticmethod
    def empty() -> Guides:
        return Guides(
            albedo=mi.Color3f(1),
            diffuse_albedo=mi.Color3f(0),
            normal=mi.Normal3f(0),
            depth=mi.Float(0),
            covered=mi.Bool(False),
            found=mi.Bool(False),
            distance=mi.Float(0),
        )


@dataclass
class Path:
    """State of the random walk and what it has gathered."""

    active: Any
    ray: Any
    depth: Any
    throughput: Any
    eta: Any
    last: Any  # previous interaction, its sampling density and whether that was a delta event
    last_pdf: Any
    last_delta: Any
    radiance: Any
    diffuse: Any
    share: Any  # diffuse share, fixed where the path first scatters off a non-delta lobe
    split: Any

    @staticmethod
    def start(ray: Any) -> Path:
        # A fresh array for every field: Dr.Jit's += changes the array itself, and with it any other name for it.
        return Path(
            active=mi.Bool(True),
            ray=ray,
            depth=mi.UInt32(0),
            throughput=mi.Color3f(1),
            eta=mi.Float(1),
            last=dr.zeros(mi.Interaction3f),
            last_pdf=mi.Float(1),
            last_delta=mi.Bool(True),
            radiance=mi.Color3f(0),
            diffuse=mi.Color3f(0),
            share=mi.Color3f(0),
            split=mi.Bool(False),
        )


def walk(scene: Any, sampler: Any, ray: Any, settings: Settings) -> tuple[Path, Guides, Record | None]:
    """Trace one path per lane from `ray` and return what it gathered."""
    record = Record.empty(settings.vertices) if settings.descriptors else None

    def body(sampler: Any, path: Path, guides: Guides, record: Record | None) -> tuple[Any, ...]:
        step(scene, sampler, path, guides, record, settings)
        return sampler, path, guides, record

    limit = settings.max_depth if settings.max_depth > 0 else None
    state = (sampler, Path.start(ray), Guides.empty(), record)
    out = dr.while_loop(state, lambda sampler, path, *_: path.active, body, label="pathfold", max_iterations=limit)
    return out[1:]


def step(scene: Any, sampler: Any, path: Path, guides: Guides, record: Record | None, settings: Settings) -> None:
    """Advance every path by one interaction."""
    si = scene.ray_intersect(path.ray, mi.RayFlags.All, path.depth == 0)
    hit = si.is_valid()
    emitter_hit = add_emission(scene, si, path, record, settings)

    on = hit & (path.depth + 1 < mi.UInt32(settings.max_depth & 0xFFFFFFFF))
    bsdf = si.bsdf(path.ray)
    light, light_weight, lit = sample_light(scene, sampler, si, bsdf, on, settings)
    wo = si.to_local(light.d)
    uniform = sampler.next_1d(), sampler.next_2d()
    value, pdf, sample, weight = bsdf.eval_pdf_sample(mi.BSDFContext(), si, wo, *uniform, on)
    delta = on & mi.has_flag(sample.sampled_type, mi.BSDFFlags.Delta)

    first = on & ~path.split
    share = diffuse_share(bsdf, si, sample.wo, weight * sample.pdf, first & ~delta, settings)
    if settings.emitter_sampling:
        # Past the split the share of the light's direction is needed for tags alone.
        wanted = lit if settings.descriptors else lit & first
        light_share = diffuse_share(bsdf, si, wo, value, wanted, settings)
        mis = dr.select(light.delta, 1, balance(light.pdf, pdf))
        gathered = dr.select(lit, path.throughput * value * light_weight * mis, 0)
        path.radiance += gathered
        path.diffuse += gathered * dr.select(first, light_share, path.share)

    gather_guides(guides, si, bsdf, hit, delta, emitter_hit, sample, settings)
    if record is not None:
        alpha = lobe_roughness(bsdf, si, on, settings)
        if settings.emitter_sampling:
            end_on_light(record, gathered, light, light_weight, si, wo, value, light_share, alpha)
        scatter(record, on, sample, weight, alpha, settings)

    fixed = first & ~delta
    path.share = dr.select(fixed, share, path.share)
    path.split |= fixed
    path.ray = si.spawn_ray(si.to_world(sample.wo))
    path.throughput *= weight
    path.eta *= sample.eta
    path.last, path.last_pdf, path.last_delta = mi.Interaction3f(si), sample.pdf, delta
    path.depth += 1
    path.active = on & (dr.max(path.throughput) != 0)
    if settings.rr_depth is not None:
        roulette(sampler, path, record, settings.rr_depth)


def balance(a: Any, b: Any) -> Any:
    """Power heuristic with exponent two; 0 where it is undefined."""
    weight = dr.square(a) / (dr.square(a) + dr.square(b))
    return dr.select(dr.isfinite(weight), weight, 0)


def add_emission(scene: Any, si: Any, path: Path, record: Record | None, settings: Settings) -> Any:
    """Add light that the walk ran into; return where an emitter was hit."""
    ds = mi.DirectionSample3f(scene, si, path.last)
    found = ds.emitter != None  # noqa: E711
    emitted = ds.emitter.eval(si, found & (path.last_pdf > 0))
    mis = mi.Float(1)
    if settings.emitter_sampling:
        mis = balance(path.last_pdf, scene.pdf_emitter_direction(path.last, ds, found & ~path.last_delta))
    gathered = path.throughput * emitted * mis
    path.radiance += gathered
    path.diffuse += gathered * path.share
    if record is not None:
        better = improve(record, gathered)
        record.photon = dr.select(better, emitted * record.pending, record.photon)
        record.end_density = dr.select(better, record.log_density, record.end_density)
        record.end_sampled &= ~better
    return found & si.is_valid()


def sample_light(scene: Any, sampler: Any, si: Any, bsdf: Any, on: Any, settings: Settings) -> tuple[Any, Any, Any]:
    """Sample a direction towards an emitter where the BSDF has a smooth part."""
    if not settings.emitter_sampling:
        return dr.zeros(mi.DirectionSample3f), mi.Color3f(0), mi.Bool(False)
    lit = on & mi.has_flag(bsdf.flags(), mi.BSDFFlags.Smooth)
    light, weight = scene.sample_emitter_direction(si, sampler.next_2d(), True, lit)
    return light, weight, lit & (light.pdf != 0)


def diffuse_share(bsdf: Any, si: Any, wo: Any, value: Any, wanted: Any, settings: Settings) -> Any:
    """Return the part of `value` (f|cos| for `wo`) that the diffuse lobes make up, per channel in [0, 1]."""
    plain = dr.select(mi.has_flag(bsdf.flags(), mi.BSDFFlags.Diffuse), mi.Color3f(1), mi.Color3f(0))
    if not settings.lobes.mixed:
        return plain
    mixed = materials.is_mixed(bsdf.flags())
    part = dr.dispatch(bsdf, materials.diffuse_value, si, wo, wanted & mixed)
    return dr.select(mixed, dr.clip(dr.select(value > 0, part / value, 0), 0, 1), plain)


def gather_guides(
    guides: Guides,
    si: Any,
    bsdf: Any,
    hit: Any,
    delta: Any,
    emitter_hit: Any,
    sample: Any,
    settings: Settings,
) -> None:
    """Fix the guides at the first hit that scatters off a non-delta lobe, or emits, or ends the path."""
    guides.distance += dr.select(hit, si.t, 0)
    guides.covered |= hit & ~mi.has_flag(sample.sampled_type, mi.BSDFFlags.Null)
    here = hit & ~guides.found & (emitter_hit | ~delta)
    diffuse, albedo = dr.dispatch(bsdf, materials.reflectance, si, here)
    albedo = dr.select(emitter_hit, mi.Color3f(1), dr.clip(albedo, 0, 1))
    guides.diffuse_albedo = dr.select(here, dr.clip(diffuse, 0, 1), guides.diffuse_albedo)
    guides.albedo = dr.select(here, albedo, guides.albedo)
    normal = dr.dispatch(bsdf, materials.normal, si, here) if settings.lobes.mapped else si.sh_frame.n
    guides.normal = dr.select(here, dr.mulsign(normal, si.wi.z), guides.normal)
    guides.depth = dr.select(here, guides.distance, guides.depth)
    guides.found |= here


def lobe_roughness(bsdf: Any, si: Any, on: Any, settings: Settings) -> Any:
    """Roughness of the glossy lobes of the BSDF, 0 where it has none."""
    if not settings.lobes.glossy:
        return mi.Float(0)
    return dr.dispatch(bsdf, materials.roughness, si, on & mi.has_flag(bsdf.flags(), mi.BSDFFlags.Glossy))


def improve(record: Record, gathered: Any) -> Any:
    """Return where this contribution outshines all before it, and make it the dominant one."""
    brightness = mi.luminance(gathered)
    better = brightness > record.best
    record.best = dr.select(better, brightness, record.best)
    record.end_count = dr.select(better, record.count, record.end_count)
    return better


def end_on_light(
    record: Record,
    gathered: Any,
    light: Any,
    weight: Any,
    si: Any,
    wo: Any,
    value: Any,
    share: Any,
    alpha: Any,
) -> None:
    """Let a light sample end the recorded path: it counts as a vertex with its own attenuation and tag."""
    better = improve(record, gathered)
    diffuse = (dr.mean(share) > 0.5) | (alpha == 0)
    through = si.wi.z * wo.z < 0
    tag = dr.select(through, mi.Float(2), 1) + dr.select(diffuse, mi.Float(4), 8)
    tag = dr.select(diffuse | (alpha > 0), tag, GENERIC_TAG)
    vertex = Vertex(value * record.pending, tag, dr.select(diffuse, 1, dr.abs(alpha)))
    record.end = dr.select(better, vertex, record.end)
    record.photon = dr.select(better, weight * light.pdf, record.photon)
    density = record.log_density + dr.select(record.count < len(record.walk), log(light.pdf), 0)
    record.end_density = dr.select(better, density, record.end_density)
    record.end_sampled |= better


def scatter(record: Record, on: Any, sample: Any, weight: Any, alpha: Any, settings: Settings) -> None:
    """Append the sampled event to the walk; null events only leave their weight for the next vertex."""
    on = on & (sample.pdf > 0)
    null = mi.has_flag(sample.sampled_type, mi.BSDFFlags.Null)
    attenuation = weight * sample.pdf * record.pending
    vertex = Vertex(attenuation, tag_of(sample.sampled_type, alpha), roughness_of(sample.sampled_type, alpha))
    real = on & ~null
    kept = on & (record.count < settings.vertices)
    record.log_density += dr.select(kept, log(sample.pdf), 0)
    for slot in range(settings.vertices):
        record.walk[slot] = dr.select(real & (record.count == slot), vertex, record.walk[slot])
    record.pending = dr.select(on, dr.select(null, attenuation, 1), record.pending)
    record.count += dr.select(real, mi.UInt32(1), 0)


def tag_of(sampled: Any, alpha: Any) -> Any:
    """Reflection 1 or transmission 2, plus diffuse 4, glossy 8 or delta 16; generic for unnamed lobes."""
    flags = mi.BSDFFlags
    reflects, transmits = mi.has_flag(sampled, flags.Reflection), mi.has_flag(sampled, flags.Transmission)
    lobe = dr.select(mi.has_flag(sampled, flags.Diffuse), mi.Float(4),
                     dr.select(mi.has_flag(sampled, flags.Glossy), mi.Float(8), 16))  # fmt: skip
    generic = (reflects == transmits) | ((lobe == 8) & (alpha < 0))
    return dr.select(generic, GENERIC_TAG, lobe + dr.select(reflects, mi.Float(1), 2))


def roughness_of(sampled: Any, alpha: Any) -> Any:
    """Delta 0, diffuse 1, else the alpha of the glossy lobes."""
    glossy = dr.select(mi.has_flag(sampled, mi.BSDFFlags.Glossy), dr.abs(alpha), 0)
    return dr.select(mi.has_flag(sampled, mi.BSDFFlags.Diffuse), 1, glossy)


def roulette(sampler: Any, path: Path, record: Record | None, depth: int) -> None:
    """Mitsuba's Russian roulette, its survival probability folded into the density."""
    survival = dr.minimum(dr.max(path.throughput) * dr.square(path.eta), 0.95)
    play = path.depth >= depth
    path.active &= ~play | (sampler.next_1d() < survival)
    path.throughput = dr.select(play, path.throughput / survival, path.throughput)
    if record is not None:
        record.log_density += dr.select(play & (record.count <= len(record.walk)), log(survival), 0)


def log(x: Any) -> Any:
    return dr.log(dr.maximum(x, LOG_FLOOR))
