"""Surfaces made in code: vertices [V, 3], faces [F, 3], texture coordinates [V, 2]; lengths in metres, z up."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any, NamedTuple

import mitsuba as mi
import numpy as np
from numpy.random import Generator
from numpy.typing import NDArray

Array = NDArray[np.float64]


class Surface(NamedTuple):
    """A triangle mesh; `smooth` asks for interpolated normals."""

    vertices: Array
    faces: NDArray[np.int64]
    uv: Array
    smooth: bool = True


def frame(x: float = 0, y: float = 0, z: float = 0, yaw: float = 0, scale: float | Array = 1) -> Array:
    """4 x 4 matrix: scale, then turn about z by `yaw` radians, then move."""
    matrix = np.eye(4)
    c, s = np.cos(yaw), np.sin(yaw)
    matrix[:3, :3] = np.array([[c, -s, 0], [s, c, 0], [0, 0, 1]]) * np.broadcast_to(scale, 3)
    matrix[:3, 3] = x, y, z
    return matrix


def at(xy: Array, z: float = 0, yaw: float = 0) -> Array:
    """A frame at a point of the floor."""
    return frame(float(xy[0]), float(xy[1]), z, yaw)


def to_shape(surface: Surface, bsdf: mi.BSDF, placement: Array, light: dict[str, Any] | None = None) -> mi.Mesh:
    """The surface as a Mitsuba mesh, placed by a 4 x 4 matrix; `light` is its emitter, if any."""
    props = mi.Properties()
    props["bsdf"] = bsdf
    if light:
        props["emitter"] = mi.load_dict(light)
    count = len(surface.vertices), len(surface.faces)
    mesh = mi.Mesh("mesh", *count, has_vertex_normals=surface.smooth, has_vertex_texcoords=True, props=props)
    params = mi.traverse(mesh)
    world = (surface.vertices @ placement[:3, :3].T + placement[:3, 3]).astype(np.float32)
    params["vertex_positions"] = world.ravel()
    params["faces"] = surface.faces.astype(np.uint32).ravel()
    params["vertex_texcoords"] = surface.uv.astype(np.float32).ravel()
    params.update()
    if surface.smooth:  # Mitsuba adds its own up in the order in which threads come, so they differ by rounding
        params["vertex_normals"] = normals(world.astype(np.float64), surface.faces).astype(np.float32).ravel()
        params.update()
    return mesh


def normals(vertices: Array, faces: NDArray[np.int64]) -> Array:
    """Unit normals [V, 3]: the mean over a vertex's faces, each by its angle there; (1, 0, 0) where none has an area.

    The weights are Mitsuba's own (Thurmer and Wuthrich, Computing Vertex Normals from Polygonal Facets, 1998).
    """
    corners = vertices[faces]
    ahead, behind = np.roll(corners, -1, 1) - corners, np.roll(corners, 1, 1) - corners
    cross = np.cross(ahead[:, 0], behind[:, 0])
    angle = np.arctan2(np.linalg.norm(np.cross(ahead, behind), axis=-1), (ahead * behind).sum(-1))
    size = np.linalg.norm(cross, axis=-1, keepdims=True)
    facing = np.divide(cross, size, out=np.zeros_like(cross), where=size > 0)
    total = np.zeros_like(vertices)
    np.add.at(total, faces, angle[..., None] * facing[:, None])
    length = np.linalg.norm(total, axis=-1, keepdims=True)
    return np.divide(total, length, out=np.broadcast_to([1.0, 0, 0], total.shape).copy(), where=length > 0)


def grid(shape: Callable[[Array, Array], tuple[Array, Array, Array]], nu: int, nv: int, smooth: bool = True) -> Surface:
    """The surface (x, y, z) = shape(u, v) over the unit square, nu x nv quads."""
    u, v = np.meshgrid(np.linspace(0, 1, nu + 1), np.linspace(0, 1, nv + 1), indexing="ij")
    vertices = np.stack(np.broadcast_arrays(*shape(u, v)), -1).reshape(-1, 3)
    corner = (np.arange(nu)[:, None] * (nv + 1) + np.arange(nv)).ravel()
    a, b, c, d = corner, corner + nv + 1, corner + nv + 2, corner + 1
    faces = np.concatenate([np.stack([a, b, c], -1), np.stack([a, c, d], -1)])
    return Surface(vertices, faces, np.stack([u.ravel(), v.ravel()], -1), smooth)


def superquadric(round_z: float, round_xy: float, detail: int = 48) -> Surface:
    """Between a box (0.1), a ball (1) and a star (2.5); radius 1."""

    def power(x: Array, e: float) -> Array:
        return np.sign(x) * np.abs(x) ** e

    def shape(u: Array, v: Array) -> tuple[Array, Array, Array]:
        a, b = 2 * np.pi * u, np.pi * (v - 0.5)
        ring = power(np.cos(b), round_z)
        return ring * power(np.cos(a), round_xy), ring * power(np.sin(a), round_xy), power(np.sin(b), round_z)

    return grid(shape, detail, detail)


def blob(rng: Generator, roughness: float = 0.3, detail: int = 96) -> Surface:
    """A ball pushed in and out by a sum of waves: pebbles, fruit, clay."""
    waves = rng.normal(size=(12, 3)) * rng.uniform(1, 5, size=(12, 1))
    phase, size = rng.uniform(0, 2 * np.pi, 12), 1 / (1 + np.linalg.norm(waves, axis=1))

    def shape(u: Array, v: Array) -> tuple[Array, Array, Array]:
        a, b = 2 * np.pi * u, np.pi * (v - 0.5)
        p = np.stack([np.cos(a) * np.cos(b), np.sin(a) * np.cos(b), np.sin(b)], -1)
        radius = 1 + roughness * (np.sin(p @ waves.T + phase) * size).sum(-1)
        return tuple(np.moveaxis(p * radius[..., None], -1, 0))

    return grid(shape, detail, detail // 2)


def lathe(rng: Generator, kind: str = "vase", detail: int = 64) -> Surface:
    """A profile turned about z, from z = 0 to 1, radius at most about 0.5; `glass` has an inner wall too."""
    heights = np.linspace(0, 1, 6)
    radii = rng.uniform(0.15, 0.5, 6)
    if kind == "bowl":
        radii = 0.15 + 0.4 * heights ** rng.uniform(0.4, 1.0)
    elif kind == "glass":
        radii = 0.28 + 0.12 * heights ** rng.uniform(0.5, 2) + 0.02 * rng.normal(size=6)
    elif kind == "leg":
        radii = rng.uniform(0.03, 0.06, 6)
    t = np.linspace(0, 1, 40)
    outer = np.stack([np.interp(t, heights, np.convolve(np.pad(radii, 1, "edge"), [0.25, 0.5, 0.25], "valid")), t], -1)
    profile = np.concatenate([[[0, 0]], outer])
    if kind in ("bowl", "glass", "vase"):
        inner = outer[::-1] * [1, 0.96] + [-0.03, 0.04]
        profile = np.concatenate([profile, np.maximum(inner, [0.01, 0]), [[0, 0.04]]])
    else:
        profile = np.concatenate([profile, [[0, 1]]])

    def shape(u: Array, v: Array) -> tuple[Array, Array, Array]:
        at = v * (len(profile) - 1)
        r, z = (np.interp(at, np.arange(len(profile)), profile[:, i]) for i in (0, 1))
        return r * np.cos(2 * np.pi * u), r * np.sin(2 * np.pi * u), z

    return grid(shape, detail, len(profile) - 1)


def tube(path: Callable[[Array], Array], radius: float, nu: int = 256, nv: int = 20, lobes: int = 0) -> Surface:
    """A round (or lobed) profile swept along path(u) -> [..., 3], u in [0, 1]."""

    def shape(u: Array, v: Array) -> tuple[Array, Array, Array]:
        centre = path(u)
        along = path(u + 1e-3) - path(u - 1e-3)
        along /= np.linalg.norm(along, axis=-1, keepdims=True)
        side = np.cross(along, [0.31, 0.23, 0.92])
        side /= np.linalg.norm(side, axis=-1, keepdims=True)
        up, a = np.cross(along, side), 2 * np.pi * v
        r = radius * (1 + 0.25 * np.cos(lobes * a) * (lobes > 0))
        p = centre + (r * np.cos(a))[..., None] * side - (r * np.sin(a))[..., None] * up
        return tuple(np.moveaxis(p, -1, 0))

    return grid(shape, nu, nv)


def knot(rng: Generator) -> Surface:
    """A torus knot, or a ring, of radius about 1."""
    p, q = [(1, 0), (2, 3), (3, 2), (2, 5), (3, 4)][rng.integers(5)]

    def path(u: Array) -> Array:
        a = 2 * np.pi * u
        r = 0.75 + 0.25 * np.cos(q * a)
        return np.stack([r * np.cos(p * a), r * np.sin(p * a), 0.3 * np.sin(q * a)], -1)

    return tube(path, rng.uniform(0.08, 0.2), lobes=int(rng.integers(0, 6)))


def spring(rng: Generator) -> Surface:
    """A coil along z from 0 to 1."""
    turns, r = rng.uniform(3, 7), rng.uniform(0.2, 0.45)

    def path(u: Array) -> Array:
        return np.stack([r * np.cos(2 * np.pi * turns * u), r * np.sin(2 * np.pi * turns * u), 0.05 + 0.9 * u], -1)

    return tube(path, rng.uniform(0.02, 0.06), nu=400)


def cloth(rng: Generator, folds: float = 5, depth: float = 0.06) -> Surface:
    """A hanging sheet in the x-z unit square with folds along x."""
    phase, drift = rng.uniform(0, 6, 2)

    def shape(u: Array, v: Array) -> tuple[Array, Array, Array]:
        y = depth * np.sin(2 * np.pi * folds * u + phase + drift * v * 0.5) + 0.4 * depth * np.sin(17 * u + 3 * v)
        return u - 0.5, y, v

    return grid(shape, 160, 24)


def terrain(rng: Generator, height: float = 0.15) -> Surface:
    """Rolling ground over [-1, 1] x [-1, 1]."""
    waves, phase = rng.normal(size=(10, 2)) * 3, rng.uniform(0, 6, 10)

    def shape(u: Array, v: Array) -> tuple[Array, Array, Array]:
        x, y = 2 * u - 1, 2 * v - 1
        z = (np.sin(np.stack([x, y], -1) @ waves.T + phase) / (1 + np.linalg.norm(waves, axis=1))).sum(-1)
        return x, y, height * z

    return grid(shape, 96, 96)


def leaves(rng: Generator, count: int = 120) -> Surface:
    """Cards in a ball of radius 1 about (0, 0, 1): foliage once the material masks a leaf out of each card."""
    centre = rng.normal(size=(count, 3))
    centre *= (rng.uniform(0.2, 1, count) ** 0.5 / np.linalg.norm(centre, axis=1))[:, None]
    axes = rng.normal(size=(count, 2, 3))
    axes[:, 1] -= axes[:, 0] * ((axes[:, 0] * axes[:, 1]).sum(-1) / (axes[:, 0] ** 2).sum(-1))[:, None]
    axes *= rng.uniform(0.1, 0.22, (count, 1, 1)) / np.linalg.norm(axes, axis=-1, keepdims=True)
    corners = np.array([[-1.0, -1], [1, -1], [1, 1], [-1, 1]])
    vertices = centre[:, None] + [0, 0, 1] + np.einsum("ck,nkd->ncd", corners, axes)
    faces = (np.arange(count)[:, None, None] * 4 + [[0, 1, 2], [0, 2, 3]]).reshape(-1, 3)
    return Surface(vertices.reshape(-1, 3), faces.astype(np.int64), np.tile(corners * 0.5 + 0.5, (count, 1)), False)
