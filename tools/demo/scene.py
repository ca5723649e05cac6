"""The demo's still life, made of formulas: no file is read, nothing is downloaded. It is CC0 1.0.

Vessels of glass, gold, steel, copper and glazed clay on a wooden table, before a tiled wall. Daylight comes through
a window at the left, warm light from a strip hidden under a shelf; the rest of the room is lit indirectly.
Lengths are in decimetres, z is up, the camera looks along +y.
"""

from typing import Any

import mitsuba as mi
import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float32]
Node = dict[str, Any]

MAX_DEPTH = 8  # two walls of glass take four vertices


def still_life(width: int = 384, height: int = 256) -> Any:
    """The scene as a loaded mitsuba.Scene; a variant (llvm_ad_rgb) must be set before."""
    camera = mi.ScalarTransform4f().look_at(origin=[0.5, -19, 6.4], target=[0.1, 0, 3.7], up=[0, 0, 1])
    film = {"type": "hdrfilm", "width": width, "height": height, "rfilter": {"type": "box"}}
    sensor = {"type": "perspective", "fov": 46, "fov_axis": "x", "to_world": camera, "film": film}
    objects = {**room(), **lights(), **vessels(), **small_things()}
    integrator = {"type": "path", "max_depth": MAX_DEPTH, "rr_depth": 5}
    return mi.load_dict({"type": "scene", "integrator": integrator, "sensor": sensor, **objects})


def room() -> dict[str, Node]:
    """Table, tiled wall, shelf, side walls and ceiling."""
    plaster = diffuse([0.72, 0.66, 0.58])
    terracotta = diffuse([0.58, 0.25, 0.15])
    wood = glossy(bitmap(planks()), alpha=0.16)
    dark_wood = glossy([0.16, 0.075, 0.035], alpha=0.2)
    tiles = glossy(bitmap(zellige()), alpha=0.08)
    return {
        "table": box([0, 0, -0.4], [13, 9, 0.4], wood),
        "wall": quad([0, 9, 7], [13, 7], tiles, facing="-y"),
        "shelf": box([1.5, 8.2, 7.6], [6.4, 0.8, 0.16], dark_wood),
        "right": quad([13, 0, 7], [9, 7], terracotta, facing="-x"),
        "left_low": box([-13.2, 0, 1.0], [0.2, 9, 1.4], plaster),
        "left_high": box([-13.2, 0, 12.5], [0.2, 9, 1.7], plaster),
        "left_back": box([-13.2, 7.2, 6.5], [0.2, 1.8, 4.4], plaster),
        "left_front": box([-13.2, -7.2, 6.5], [0.2, 1.8, 4.4], plaster),
        "mullion": box([-13.2, 0, 6.5], [0.2, 0.22, 4.4], dark_wood),
        "transom": box([-13.2, 0, 7.6], [0.2, 5.4, 0.2], dark_wood),
        "ceiling": quad([0, 0, 14], [13, 9], plaster, facing="-z"),
        "behind": quad([0, -24, 7], [13, 8], diffuse([0.3, 0.32, 0.36]), facing="+y"),
    }


def lights() -> dict[str, Node]:
    """Sky behind the window, and a warm strip under the shelf that shines on the wall."""
    sky = {"type": "area", "radiance": {"type": "rgb", "value": [11.0, 13.0, 16.5]}}
    strip = {"type": "area", "radiance": {"type": "rgb", "value": [10.5, 5.6, 2.2]}}
    return {
        "sky": {**quad([-13.6, 0, 6.5], [5.4, 4.4], diffuse([0, 0, 0]), facing="+x"), "emitter": sky},
        "strip": {**quad([1.5, 8.0, 7.4], [5.8, 0.45], diffuse([0, 0, 0]), facing="-z"), "emitter": strip},
        "lip": box([1.5, 7.5, 7.3], [6.4, 0.06, 0.28], glossy([0.16, 0.075, 0.035], alpha=0.2)),
    }


def vessels() -> dict[str, Any]:
    """What is turned on a wheel: profiles of (radius, height)."""
    glass = {"type": "dielectric", "int_ior": 1.5, "ext_ior": 1.0}
    gold = {"type": "roughconductor", "material": "Au", "alpha": 0.12}
    vase = [(0, 0), (0.9, 0), (1.1, 0.1), (1.75, 1.3), (1.95, 2.5), (1.6, 3.7), (0.85, 4.6), (0.62, 5.2)]
    vase += [(0.72, 5.7), (1.0, 5.95), (0.9, 5.9), (0.6, 5.6), (0.5, 5.2)]
    carafe = [(0, 0.02), (1.2, 0.02), (1.4, 0.2), (1.5, 1.0), (1.25, 2.1), (0.6, 3.0), (0.45, 3.9), (0.7, 4.6)]
    carafe += [(0.6, 4.6), (0.36, 3.9), (0.5, 3.0), (1.13, 2.05), (1.37, 1.0), (1.27, 0.3), (1.1, 0.2), (0, 0.2)]
    bowl = [(0, 0.25), (0.8, 0.25), (0.9, 0), (1.0, 0.05), (0.9, 0.3), (1.7, 0.7), (2.4, 1.5), (2.65, 2.2)]
    bowl += [(2.55, 2.2), (2.25, 1.5), (1.55, 0.8), (0.8, 0.42), (0, 0.4)]
    jar = [(0, 0), (0.8, 0), (1.0, 0.2), (1.05, 1.3), (0.8, 1.6), (0.85, 1.75), (0.7, 1.9), (0.2, 2.1), (0, 2.1)]
    return {
        "vase": lathe("vase", vase, [-4.6, 2.6, 0], glossy(bitmap(glaze()), alpha=0.05)),
        "carafe": lathe("carafe", carafe, [2.0, 0.3, 0], glass),
        "bowl": lathe("bowl", bowl, [5.4, 2.6, 0], gold),
        "jar": lathe("jar", jar, [-2.3, 7.9, 7.76], glossy([0.05, 0.22, 0.21], alpha=0.06)),
        "jug": lathe("jug", [(r * 0.42, h * 0.42) for r, h in vase], [4.2, 7.9, 7.76], diffuse([0.75, 0.71, 0.62])),
    }


def small_things() -> dict[str, Any]:
    """Fruit, balls, books and a knot of copper."""
    copper = {"type": "roughconductor", "material": "Cu", "alpha": 0.22}
    steel = {"type": "conductor", "material": "Cr"}
    orange, lemon = [0.82, 0.28, 0.03], [0.85, 0.62, 0.06]
    fruit = [([4.7, 2.3, 1.5], 0.85, orange), ([6.2, 2.9, 1.5], 0.82, orange), ([5.4, 1.7, 1.75], 0.7, lemon)]
    fruit += [([5.5, 3.3, 2.2], 0.8, orange), ([8.3, -1.4, 0.72], 0.72, lemon)]
    books = [([0.55, 0.12, 0.1], 0.3, 0), ([0.1, 0.19, 0.33], 0.22, 9), ([0.62, 0.54, 0.36], 0.26, -6)]
    things: dict[str, Any] = {
        f"fruit{i}": ball(center, radius, glossy(color, alpha=0.18)) for i, (center, radius, color) in enumerate(fruit)
    }
    floor = 0.0
    for i, (color, thickness, turn) in enumerate(books):
        top = floor + 2 * thickness
        place = [-8.3, 4.2, (floor + top) / 2]
        things[f"book{i}"] = box(place, [2.0 - 0.15 * i, 1.4, thickness], glossy(color, alpha=0.3), turn)
        floor = top
    return things | {
        "knot": knot("knot", [-1.2, -2.2, 0.92], 0.62, copper),
        "steel": ball([-6.9, -0.8, 1.0], 1.0, steel),
        "marble": ball([4.6, -3.0, 0.62], 0.62, {"type": "dielectric", "int_ior": 1.5}),
        "plaster": ball([-8.3, 4.2, floor + 0.9], 0.9, diffuse([0.8, 0.77, 0.7])),
        "globe": ball([6.9, 7.9, 8.46], 0.7, glossy([0.75, 0.55, 0.2], alpha=0.1)),
    }


def diffuse(color: Any) -> Node:
    return {"type": "diffuse", "reflectance": _color(color)}


def glossy(color: Any, alpha: float) -> Node:
    """A diffuse base under a rough dielectric coat."""
    return {"type": "roughplastic", "diffuse_reflectance": _color(color), "alpha": alpha, "nonlinear": True}


def bitmap(pixels: Array) -> Node:
    return {"type": "bitmap", "bitmap": mi.Bitmap(pixels), "raw": True, "wrap_mode": "repeat"}


def box(center: list[float], half: list[float], bsdf: Node, turn: float = 0) -> Node:
    place = mi.ScalarTransform4f().translate(center).rotate([0, 0, 1], turn).scale(half)
    return {"type": "cube", "to_world": place, "bsdf": bsdf}


def quad(center: list[float], half: list[float], bsdf: Node, facing: str) -> Node:
    axis = {"x": [1, 0, 0], "y": [0, 1, 0], "z": [0, 0, 1]}[facing[1]]
    normal = [component * (-1 if facing[0] == "-" else 1) for component in axis]
    up = [0, 1, 0] if facing[1] == "z" else [0, 0, 1]
    target = [c + n for c, n in zip(center, normal, strict=True)]
    place = mi.ScalarTransform4f().look_at(origin=center, target=target, up=up).scale([*half, 1])
    return {"type": "rectangle", "to_world": place, "bsdf": bsdf}


def ball(center: list[float], radius: float, bsdf: Node) -> Node:
    return {"type": "sphere", "center": center, "radius": radius, "bsdf": bsdf}


def lathe(name: str, profile: list[tuple[float, float]], place: list[float], bsdf: Node, steps: int = 64) -> Any:
    """A surface of revolution round z; the profile is rounded by cutting its corners (Chaikin)."""
    line = np.array(profile, np.float64)
    for _ in range(2):
        cut = np.stack([0.75 * line[:-1] + 0.25 * line[1:], 0.25 * line[:-1] + 0.75 * line[1:]], 1).reshape(-1, 2)
        line = np.concatenate([line[:1], cut, line[-1:]])
    angle = np.linspace(0, 2 * np.pi, steps + 1)
    radius, level = line[:, 0, None], line[:, 1, None]
    grid = np.stack(np.broadcast_arrays(radius * np.cos(angle), radius * np.sin(angle), level), -1)
    return surface(name, grid + np.array(place), bsdf)


def knot(name: str, place: list[float], size: float, bsdf: Node) -> Any:
    """A trefoil tube."""
    t = np.linspace(0, 2 * np.pi, 361)
    line = np.stack([np.sin(t) + 2 * np.sin(2 * t), np.cos(t) - 2 * np.cos(2 * t), -np.sin(3 * t)], -1)
    tangent = np.gradient(line, axis=0)
    tangent[[0, -1]] = line[1] - line[-2]
    tangent /= np.linalg.norm(tangent, axis=-1, keepdims=True)
    side = np.cross(tangent, [0, 0, 1])
    side /= np.linalg.norm(side, axis=-1, keepdims=True)
    angle = np.linspace(0, 2 * np.pi, 33)[None, :, None]
    ring = np.cos(angle) * side[:, None] + np.sin(angle) * np.cross(tangent, side)[:, None]
    return surface(name, size * (line[:, None] * 0.72 + 0.42 * ring) + np.array(place), bsdf)


def surface(name: str, grid: NDArray[np.float64], bsdf: Node) -> Any:
    """A mesh over a grid of points (U x V x 3) with smooth normals and the grid as texture coordinates."""
    rows, columns = grid.shape[:2]
    corner = np.arange((rows - 1) * columns).reshape(rows - 1, columns)[:, :-1].ravel()
    faces = [[corner, corner + 1, corner + columns], [corner + 1, corner + columns + 1, corner + columns]]
    properties = mi.Properties()
    properties["bsdf"] = mi.load_dict(bsdf)
    triangles = np.concatenate([np.stack(face, -1) for face in faces])
    mesh = mi.Mesh(name, rows * columns, len(triangles), properties, True, True)
    u, v = np.meshgrid(np.linspace(0, 1, rows), np.linspace(0, 1, columns), indexing="ij")
    parameters = mi.traverse(mesh)
    parameters["vertex_positions"] = grid.ravel().astype(np.float32)
    parameters["vertex_normals"] = _normals(grid).ravel().astype(np.float32)
    parameters["vertex_texcoords"] = np.stack([v, u], -1).ravel().astype(np.float32)
    parameters["faces"] = triangles.ravel().astype(np.uint32)
    parameters.update()
    return mesh


def _normals(grid: NDArray[np.float64]) -> NDArray[np.float64]:
    along, around = np.gradient(grid, axis=0), np.gradient(grid, axis=1)
    seam = grid[:, 1] - grid[:, -2]  # the first and the last column are one
    around[:, 0], around[:, -1] = seam, seam
    normal = np.cross(around, along)
    length = np.linalg.norm(normal, axis=-1, keepdims=True)
    pole = np.where(np.arange(len(grid))[:, None, None] == 0, [0.0, 0.0, -1.0], [0.0, 0.0, 1.0])
    return np.where(length > 1e-9, normal / np.maximum(length, 1e-9), pole)


def planks(size: int = 512) -> Array:
    """Boards with grain: stretched noise, darker joints."""
    rng = np.random.default_rng(1)
    v, u = np.mgrid[0:size, 0:size] / size
    board = np.floor(v * 7)
    tone = rng.uniform(0.75, 1.15, 8)[board.astype(int)]
    grain = sum(
        np.sin(2 * np.pi * (f * v * 7 + rng.uniform() + 0.6 * np.sin(2 * np.pi * (u * g + board * 0.37)))) / f
        for f, g in ((3, 1), (7, 2), (17, 1), (31, 3))
    )
    joint = np.clip(np.abs(v * 7 - np.round(v * 7)) * 28, 0.25, 1)
    shade = (tone * (1 + 0.22 * grain) * joint)[..., None]
    return (shade * np.array([0.36, 0.19, 0.085])).clip(0.01, 0.9).astype(np.float32)


def zellige(size: int = 768) -> Array:
    """Small glazed tiles, no two of one colour, with pale joints."""
    rng = np.random.default_rng(2)
    columns, rows = 26, 14
    v, u = np.mgrid[0:size, 0:size] / size
    column, row = np.floor(u * columns).astype(int), np.floor(v * rows).astype(int)
    palette = np.array([[0.04, 0.17, 0.22], [0.06, 0.25, 0.27], [0.13, 0.36, 0.34], [0.55, 0.56, 0.48]])
    pick = rng.choice(4, (rows, columns), p=[0.38, 0.34, 0.18, 0.1])
    color = palette[pick] * rng.uniform(0.75, 1.25, (rows, columns, 1))
    edge = np.minimum(np.abs(u * columns % 1 - 0.5), 2) < 0.46
    edge &= np.abs(v * rows % 1 - 0.5) < 0.46
    return np.where(edge[..., None], color[row, column], [0.5, 0.47, 0.42]).astype(np.float32)


def glaze(size: int = 512) -> Array:
    """Cobalt on white: bands, waves and leaves round a vase."""
    v, u = np.mgrid[0:size, 0:size] / size
    wave = np.abs((v - 0.48) * 30 - 2 * np.sin(2 * np.pi * 8 * u)) < 0.5
    leaf = np.abs(np.sin(2 * np.pi * 8 * u)) * np.sin(np.pi * np.clip((v - 0.26) / 0.18, 0, 1)) > 0.72
    petal = np.abs(np.sin(2 * np.pi * 12 * u)) * np.sin(np.pi * np.clip((v - 0.56) / 0.1, 0, 1)) > 0.6
    bands = np.abs(v[..., None] - np.array([0.16, 0.24, 0.55, 0.68, 0.8])).min(-1) < 0.008
    painted = (wave | leaf | petal | bands)[..., None]
    return np.where(painted, [0.03, 0.07, 0.3], [0.78, 0.77, 0.72]).astype(np.float32)


def _color(value: Any) -> Any:
    return value if isinstance(value, dict) else {"type": "rgb", "value": value}
