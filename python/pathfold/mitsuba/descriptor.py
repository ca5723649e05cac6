"""The path descriptor: what a walk records, and how the dominant contribution turns into channels."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import drjit as dr
import mitsuba as mi
import numpy as np

from pathfold._core import DEAD_LOG, KINDS, LEAST_VALUE

LOG_FLOOR = float(np.log(LEAST_VALUE))


@dataclass
class Vertex:
    """What one scattering event leaves in the descriptor: f|cos|, kind of interaction, roughness of the lobe."""

    attenuation: Any
    kind: Any
    roughness: Any

    @staticmethod
    def empty() -> Vertex:
        return Vertex(mi.Color3f(0), mi.Float(0), mi.Float(0))


@dataclass
class Record:
    """The BSDF-sampled walk so far and the dominant contribution found on it.

    The recorded path is the walk up to where the dominant light was found. Only its first `len(walk)` vertices
    count, in the densities too.
    """

    walk: list[Vertex]
    count: Any  # vertices of the walk, recorded or not
    pending: Any  # weight of null events since the last vertex
    log_density: Any
    best: Any  # luminance of the dominant contribution
    photon: Any  # its light, before anything scatters it
    end: Vertex  # the vertex that it ends on if it is a light sample
    end_count: Any  # vertices of the walk before that end
    end_density: Any
    end_sampled: Any  # whether it is a light sample

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

    def find_light(self, gathered: Any, emitted: Any) -> None:
        """The walk ran into an emitter; trailing null events join its light."""
        better = self._improve(gathered, emitted * self.pending)
        self.end_density = dr.select(better, self.log_density, self.end_density)
        self.end_sampled &= ~better

    def sample_light(self, gathered: Any, emitted: Any, density: Any, vertex: Vertex) -> None:
        """A light sample was connected; it ends the path with a vertex of its own."""
        better = self._improve(gathered, emitted)
        vertex = Vertex(vertex.attenuation * self.pending, vertex.kind, vertex.roughness)
        self.end = dr.select(better, vertex, self.end)
        total = self.log_density + dr.select(self.count < len(self.walk), log(density), 0)
        self.end_density = dr.select(better, total, self.end_density)
        self.end_sampled |= better

    def _improve(self, gathered: Any, photon: Any) -> Any:
        """Return where this contribution outshines all before it, and make it the dominant one."""
        brightness = mi.luminance(gathered)
        better = brightness > self.best
        self.best = dr.select(better, brightness, self.best)
        self.photon = dr.select(better, photon, self.photon)
        self.end_count = dr.select(better, self.count, self.end_count)
        return better

    def scatter(self, on: Any, null: Any, density: Any, vertex: Vertex) -> None:
        """Append a sampled event to the walk; a null event only leaves its weight for the next vertex."""
        joined = Vertex(vertex.attenuation * self.pending, vertex.kind, vertex.roughness)
        self.log_density += dr.select(on & (self.count < len(self.walk)), log(density), 0)
        for slot, old in enumerate(self.walk):
            self.walk[slot] = dr.select(on & ~null & (self.count == slot), joined, old)
        self.pending = dr.select(on, dr.select(null, joined.attenuation, 1), self.pending)
        self.count += dr.select(on & ~null, mi.UInt32(1), 0)

    def survive(self, on: Any, probability: Any) -> None:
        """Fold the odds of Russian roulette into the density of the vertex before it."""
        self.log_density += dr.select(on & (self.count <= len(self.walk)), log(probability), 0)


def sampled_vertex(attenuation: Any, sampled: Any, alpha: Any) -> Vertex:
    """Describe the lobe that was sampled; `alpha` is negative for lobes without a name."""
    flags = mi.BSDFFlags
    reflects, transmits = mi.has_flag(sampled, flags.Reflection), mi.has_flag(sampled, flags.Transmission)
    diffuse, glossy = mi.has_flag(sampled, flags.Diffuse), mi.has_flag(sampled, flags.Glossy)
    rough = dr.select(glossy, kind_of("glossy", reflects), kind_of("delta", reflects))
    generic = (reflects == transmits) | (glossy & (alpha < 0))
    kind = dr.select(generic, KINDS["generic"], dr.select(diffuse, kind_of("diffuse", reflects), rough))
    return Vertex(attenuation, kind, dr.select(diffuse, 1, dr.select(glossy, dr.abs(alpha), 0)))


def light_vertex(attenuation: Any, through: Any, share: Any, alpha: Any) -> Vertex:
    """Describe the lobe that carries most of a light sample: diffuse where its share is above one half."""
    diffuse = (dr.mean(share) > 0.5) | (alpha == 0)
    kind = dr.select(diffuse, kind_of("diffuse", ~through), kind_of("glossy", ~through))
    kind = dr.select(diffuse | (alpha > 0), kind, KINDS["generic"])
    return Vertex(attenuation, kind, dr.select(diffuse, 1, dr.abs(alpha)))


def kind_of(lobe: str, reflects: Any) -> Any:
    return dr.select(reflects, mi.Float(KINDS[f"{lobe}-reflection"]), KINDS[f"{lobe}-transmission"])


def channels(record: Record) -> dict[str, list[Any]]:
    """Return descriptor, density and overlong flag of the dominant contribution, or of a walk without one."""
    lit = record.best > 0
    sampled = lit & record.end_sampled
    count = dr.select(lit, record.end_count, record.count)
    attenuations, kinds, roughnesses = [], [], []
    product = mi.Color3f(0)
    for slot, vertex in enumerate(record.walk):
        ends = sampled & (count == slot)
        alive = ends | (count > slot)
        vertex = dr.select(alive, dr.select(ends, record.end, vertex), Vertex.empty())
        product += dr.select(alive, dr.log(vertex.attenuation), 0)
        attenuations.extend(logarithm(vertex.attenuation))
        kinds.append(vertex.kind)
        roughnesses.append(vertex.roughness)
    photon = dr.select(lit, record.photon, 0)
    product += dr.log(photon)
    undivided: Any = dr.select(dr.isfinite(product), dr.maximum(product, LOG_FLOOR), DEAD_LOG)
    total = count + dr.select(sampled, mi.UInt32(1), 0)
    return {
        "descriptor": half([*undivided, *logarithm(photon), *attenuations, *kinds, *roughnesses]),
        "density": [dr.select(lit, record.end_density, record.log_density)],
        "overlong": half([dr.select(total > len(record.walk), mi.Float(1), 0)]),
    }


def log(x: Any) -> Any:
    return dr.log(dr.maximum(x, LEAST_VALUE))


def logarithm(color: Any) -> Any:
    """ln(max(x, LEAST_VALUE)) per channel, DEAD_LOG for 0."""
    return dr.select(color > 0, dr.maximum(dr.log(color), LOG_FLOOR), DEAD_LOG)


def half(values: Any) -> list[Any]:
    """Convert device arrays to float16 where they are."""
    float16: Any = dr.float16_array_t(mi.Float)
    return [float16(value) for value in values]
