"""The path tracing loop: one symbolic Dr.Jit kernel for radiance, its split, guides and the path descriptor."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import drjit as dr
import mitsuba as mi

from . import materials
from .descriptor import Record, light_vertex, sampled_vertex
from .film import opaque


@dataclass(frozen=True)
class Settings:
    """What the loop is asked for, `max_depth` as Mitsuba counts it, and what the scene needs of it."""

    max_depth: int
    rr_depth: int | None
    vertices: int
    descriptors: bool
    first_hits: bool
    emitter_sampling: bool
    lobes: materials.Lobes


@dataclass
class Path:
    """State of the random walk and the radiance it has gathered."""

    active: Any
    ray: Any
    depth: Any
    throughput: Any
    eta: Any
    last: Any  # previous interaction, the density it was left with, and whether by a delta event
    last_pdf: Any
    last_delta: Any
    radiance: Any
    diffuse: Any
    share: Any  # diffuse share, fixed where the path first scatters off a non-delta lobe
    split: Any

    @staticmethod
    def start(ray: Any) -> Path:
        # A fresh array for every field: += changes a Dr.Jit array itself, and with it every other name of it.
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

    def add(self, gathered: Any, share: Any) -> None:
        self.radiance += gathered
        self.diffuse += gathered * share


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
    def start(distance: Any) -> Guides:
        return Guides(
            albedo=mi.Color3f(1),
            diffuse_albedo=mi.Color3f(0),
            normal=mi.Normal3f(0),
            depth=mi.Float(0),
            covered=mi.Bool(False),
            found=mi.Bool(False),
            distance=mi.Float(distance),
        )


@dataclass
class FirstHit:
    """The first surface met, delta or not, and whether light reaches it; the defaults are those of a miss."""

    albedo: Any
    normal: Any
    depth: Any
    met: Any
    visible: Any  # its light sample is unoccluded, or the walk ran into an emitter right after it

    @staticmethod
    def start() -> FirstHit:
        return FirstHit(mi.Color3f(1), mi.Normal3f(0), mi.Float(0), mi.Bool(False), mi.Bool(False))


@dataclass
class Hit:
    """One interaction: where it is, what is there, and the direction in which the walk leaves it."""

    si: Any
    valid: Any
    emits: Any
    on: Any  # the walk goes on from here
    bsdf: Any
    sample: Any
    weight: Any
    delta: Any


@dataclass
class Light:
    """A connection from a hit to a sampled point on an emitter; `value` is f|cos| towards it."""

    sample: Any
    weight: Any
    on: Any
    wo: Any
    value: Any
    pdf: Any


@dataclass
class Traced:
    """What a path gathers."""

    path: Path
    guides: Guides
    first: FirstHit | None
    record: Record | None


def walk(scene: Any, sampler: Any, ray: Any, distance: Any, settings: Settings) -> Traced:
    """Traced one path per lane from `ray`, which starts `distance` from the camera; return what it gathered."""

    def body(sampler: Any, *state: Any) -> tuple[Any, ...]:
        step(scene, sampler, Traced(*state), settings)
        return sampler, *state

    first = FirstHit.start() if settings.first_hits else None
    record = Record.empty(settings.vertices) if settings.descriptors else None
    state = (sampler, Path.start(ray), Guides.start(distance), first, record)
    limit = settings.max_depth if settings.max_depth > 0 else None
    out = dr.while_loop(state, lambda sampler, path, *_: path.active, body, label="pathfold", max_iterations=limit)
    return Traced(*out[1:])


def step(scene: Any, sampler: Any, traced: Traced, settings: Settings) -> None:
    """Advance every path by one interaction."""
    path, record = traced.path, traced.record
    si = scene.ray_intersect(path.ray, mi.RayFlags.All, path.depth == 0)
    emits = find_light(scene, si, traced, settings)
    hit, light = interact(scene, sampler, si, emits, path, settings)

    first = hit.on & ~path.split
    leaves = first & ~hit.delta
    share = diffuse_share(hit, hit.sample.wo, hit.weight * hit.sample.pdf, leaves, settings)
    alpha = roughness(hit, settings) if record is not None else None
    if settings.emitter_sampling:
        connect(hit, light, first, alpha, traced, settings)
    gather_guides(traced, hit, settings)
    if record is not None:
        sampled = hit.sample.sampled_type
        vertex = sampled_vertex(hit.weight * hit.sample.pdf, sampled, alpha)
        null = mi.has_flag(sampled, mi.BSDFFlags.Null)
        record.scatter(hit.on & (hit.sample.pdf > 0), null, hit.sample.pdf, vertex)

    path.share = dr.select(leaves, share, path.share)
    path.split |= leaves
    path.ray = si.spawn_ray(si.to_world(hit.sample.wo))
    path.throughput *= hit.weight
    path.eta *= hit.sample.eta
    path.last, path.last_pdf, path.last_delta = mi.Interaction3f(si), hit.sample.pdf, hit.delta
    path.depth += 1
    path.active = hit.on & (dr.max(path.throughput) != 0)
    if settings.rr_depth is not None:
        roulette(sampler, path, record, settings.rr_depth)


def power_heuristic(a: Any, b: Any) -> Any:
    """Weight of the first of two sampling densities; 0 where it is undefined."""
    weight = dr.square(a) / (dr.square(a) + dr.square(b))
    return dr.select(dr.isfinite(weight), weight, 0)


def find_light(scene: Any, si: Any, traced: Traced, settings: Settings) -> Any:
    """Add the light that the walk ran into; return where a surface emits."""
    path = traced.path
    ds = mi.DirectionSample3f(scene, si, path.last)
    found = ds.emitter != None  # noqa: E711
    emitted = ds.emitter.eval(si, found & (path.last_pdf > 0))
    weight = mi.Float(1)
    if settings.emitter_sampling:
        density = scene.pdf_emitter_direction(path.last, ds, found & ~path.last_delta)
        weight = power_heuristic(path.last_pdf, density)
    gathered = path.throughput * emitted * weight
    path.add(gathered, path.share)
    if traced.record is not None:
        traced.record.find_light(gathered, emitted)
    if traced.first is not None:
        traced.first.visible |= (path.depth == 1) & (dr.max(emitted) > 0)
    return found & si.is_valid()


def interact(scene: Any, sampler: Any, si: Any, emits: Any, path: Path, settings: Settings) -> tuple[Hit, Light]:
    """Sample an emitter and the BSDF, and evaluate the BSDF towards the emitter, in one call."""
    valid = si.is_valid()
    on = valid & (path.depth + 1 < opaque(settings.max_depth)) if settings.max_depth > 0 else valid
    bsdf = si.bsdf(path.ray)
    lit, ds, weight = mi.Bool(False), dr.zeros(mi.DirectionSample3f), mi.Color3f(0)
    if settings.emitter_sampling:
        lit = on & mi.has_flag(bsdf.flags(), mi.BSDFFlags.Smooth)
        ds, weight = scene.sample_emitter_direction(si, sampler.next_2d(), True, lit)
        lit &= ds.pdf != 0
    wo = si.to_local(ds.d)
    uniform = sampler.next_1d(), sampler.next_2d()
    value, pdf, sample, throughput = bsdf.eval_pdf_sample(mi.BSDFContext(), si, wo, *uniform, on)
    delta = on & mi.has_flag(sample.sampled_type, mi.BSDFFlags.Delta)
    hit = Hit(si, valid, emits, on, bsdf, sample, throughput, delta)
    return hit, Light(ds, weight, lit, wo, value, pdf)


def connect(hit: Hit, light: Light, first: Any, alpha: Any, traced: Traced, settings: Settings) -> None:
    """Add the light that was sampled at a hit."""
    path, record = traced.path, traced.record
    # Past the split the share of the light's direction is needed for tags alone.
    wanted = light.on & first if record is None else light.on
    share = diffuse_share(hit, light.wo, light.value, wanted, settings)
    mis = dr.select(light.sample.delta, 1, power_heuristic(light.sample.pdf, light.pdf))
    gathered = dr.select(light.on, path.throughput * light.value * light.weight * mis, 0)
    path.add(gathered, dr.select(first, share, path.share))
    if record is not None:
        vertex = light_vertex(light.value, hit.si.wi.z * light.wo.z < 0, share, alpha)
        record.sample_light(gathered, light.weight * light.sample.pdf, light.sample.pdf, vertex)
    if traced.first is not None:
        traced.first.visible |= light.on & (path.depth == 0) & (dr.max(light.weight) > 0)


def diffuse_share(hit: Hit, wo: Any, value: Any, wanted: Any, settings: Settings) -> Any:
    """Return the part of `value` (f|cos| for `wo`) that the diffuse lobes make up, per channel in [0, 1]."""
    flags = hit.bsdf.flags()
    plain = dr.select(mi.has_flag(flags, mi.BSDFFlags.Diffuse), mi.Color3f(1), mi.Color3f(0))
    if not settings.lobes.mixed:
        return plain
    mixed = materials.is_mixed(flags)
    part = dr.dispatch(hit.bsdf, materials.diffuse_value, hit.si, wo, wanted & mixed)
    return dr.select(mixed, dr.clip(dr.select(value > 0, part / value, 0), 0, 1), plain)


def roughness(hit: Hit, settings: Settings) -> Any:
    """Return the roughness of the glossy lobes at a hit, 0 where there are none."""
    if not settings.lobes.glossy:
        return mi.Float(0)
    glossy = hit.on & mi.has_flag(hit.bsdf.flags(), mi.BSDFFlags.Glossy)
    return dr.dispatch(hit.bsdf, materials.roughness, hit.si, glossy)


def gather_guides(traced: Traced, hit: Hit, settings: Settings) -> None:
    """Fix the guides at the first hit that scatters off a non-delta lobe, or emits, or ends the path."""
    guides, first = traced.guides, traced.first
    guides.distance += dr.select(hit.valid, hit.si.t, 0)
    meets = hit.valid & ~mi.has_flag(hit.sample.sampled_type, mi.BSDFFlags.Null)
    guides.covered |= meets
    here = hit.valid & ~guides.found & (hit.emits | ~hit.delta)
    wanted = here if first is None else here | (meets & ~first.met)
    diffuse, albedo = dr.dispatch(hit.bsdf, materials.reflectance, hit.si, wanted)
    albedo = dr.select(hit.emits, mi.Color3f(1), dr.clip(albedo, 0, 1))
    normal = hit.si.sh_frame.n
    if settings.lobes.mapped:
        normal = dr.dispatch(hit.bsdf, materials.normal, hit.si, wanted)
    normal = dr.mulsign(normal, hit.si.wi.z)
    guides.diffuse_albedo = dr.select(here, dr.clip(diffuse, 0, 1), guides.diffuse_albedo)
    guides.albedo = dr.select(here, albedo, guides.albedo)
    guides.normal = dr.select(here, normal, guides.normal)
    guides.depth = dr.select(here, guides.distance, guides.depth)
    guides.found |= here
    if first is not None:
        begins = meets & ~first.met
        first.albedo = dr.select(begins, albedo, first.albedo)
        first.normal = dr.select(begins, normal, first.normal)
        first.depth = dr.select(begins, guides.distance, first.depth)
        first.met |= begins


def roulette(sampler: Any, path: Path, record: Record | None, depth: int) -> None:
    """Play Mitsuba's Russian roulette."""
    survival = dr.minimum(dr.max(path.throughput) * dr.square(path.eta), 0.95)
    play = path.depth >= opaque(depth)
    path.active &= ~play | (sampler.next_1d() < survival)
    path.throughput = dr.select(play, path.throughput / survival, path.throughput)
    if record is not None:
        record.survive(play, survival)
