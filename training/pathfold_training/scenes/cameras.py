"""Aiming cameras, and searching for one whose view has no fault."""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable
from typing import NamedTuple

import drjit as dr
import mitsuba as mi
import numpy as np
from numpy.random import Generator
from numpy.typing import NDArray

from .faults import RejectedError, Survey, geometry_fault, picture_fault

Vector = NDArray[np.float64]
RAYS = 48  # a view is surveyed by RAYS x RAYS camera rays


class Camera(NamedTuple):
    """Pose and lens; fov in degrees across the image, `blur` the aperture radius as a share of the focus distance."""

    origin: Vector
    target: Vector
    up: Vector
    fov: float
    blur: float = 0


Propose = Callable[[Generator], Camera | None]  # a pose to try, or None where there is no room for one


def orbit(
    rng: Generator,
    target: Vector,
    far: tuple[float, float],
    elevation: tuple[float, float],
    blur: float,
    fov: tuple[float, float] = (28, 70),
) -> Camera:
    """Somewhere around a target, `elevation` in degrees, seldom from straight above; one in five is tilted sideways."""
    turn, distance = rng.uniform(0, 2 * np.pi), rng.uniform(*far)
    rise = np.radians(elevation[0] + (elevation[1] - elevation[0]) * rng.uniform() ** 1.5)
    if rng.uniform() < 0.08:
        rise = np.radians(rng.uniform(65, 88))
    way = np.array([np.cos(turn) * np.cos(rise), np.sin(turn) * np.cos(rise), np.sin(rise)])
    up = np.array([0.0, 0, 1])
    if rng.uniform() < 0.2:
        up = up + rng.normal(size=3) * [0.25, 0.25, 0]
    return Camera(target + distance * way, target, up, rng.uniform(*fov), blur)


def aim(scene: mi.Scene, camera: Camera, size: tuple[int, int]) -> None:
    """Turns the scene's first sensor into this camera with a film of width x height pixels."""
    params = mi.traverse(scene.sensors()[0])
    look = mi.ScalarTransform4f().look_at(*(list(map(float, v)) for v in (camera.origin, camera.target, camera.up)))
    values = {"to_world": mi.AffineTransform4f(look.matrix), "x_fov": mi.Float(camera.fov)}
    if "aperture_radius" in params:
        focus = float(np.linalg.norm(camera.target - camera.origin))
        values |= {"focus_distance": mi.Float(focus), "aperture_radius": mi.Float(max(camera.blur, 1e-5) * focus)}
    for name, value in values.items():
        dr.make_opaque(value)  # as a literal it would be part of the kernels, and each view compile its own
        params[name] = value
    resize(scene, size)
    params.update()


def resize(scene: mi.Scene, size: tuple[int, int]) -> None:
    """Gives the first sensor a film of width x height pixels, without crop; the horizontal field of view stays."""
    params = mi.traverse(scene.sensors()[0])
    params["film.size"] = list(size)
    params["film.crop_size"] = list(size)
    params["film.crop_offset"] = [0, 0]
    params.update()


def pose(scene: mi.Scene) -> tuple[Vector, Vector, Vector, float]:
    """Origin, direction, up and fov of the first sensor."""
    params = mi.traverse(scene.sensors()[0])
    matrix = np.array(params["to_world"].matrix, dtype=np.float64).reshape(4, 4, -1)[:, :, 0]
    fov = np.array(params["x_fov"]).ravel()[0]
    return matrix[:3, 3], matrix[:3, 2], matrix[:3, 1], float(fov)


def cast(scene: mi.Scene, origin: Vector, direction: Vector) -> Survey:
    """Rays from one point (or N) along N directions."""
    count = len(direction)
    origin = np.broadcast_to(origin, (count, 3))
    start, way = mi.Point3f(*origin.T.astype(np.float32)), mi.Vector3f(*direction.T.astype(np.float32))
    hit = scene.ray_intersect_preliminary(mi.Ray3f(start, way))
    distance = np.where(np.array(hit.is_valid()), np.array(hit.t), np.inf)
    shape = np.array(dr.reinterpret_array(mi.UInt32, hit.shape))
    finite = np.where(np.isfinite(distance), distance, 0)
    return Survey(origin + direction * finite[:, None], distance, shape)


def survey(scene: mi.Scene) -> Survey:
    """What the first sensor sees."""
    y, x = np.meshgrid(*[(np.arange(RAYS) + 0.5) / RAYS] * 2, indexing="ij")
    film = mi.Point2f(x.ravel().astype(np.float32), y.ravel().astype(np.float32))
    ray, _ = scene.sensors()[0].sample_ray(0.0, 0.0, film, mi.Point2f(0.5, 0.5))
    return cast(scene, np.array(ray.o).T.astype(float).reshape(-1, 3), np.array(ray.d).T.astype(float))


def find(
    scene: mi.Scene,
    propose: Propose,
    draft: Callable[[mi.Scene], NDArray[np.float32]],
    rng: Generator,
    size: tuple[int, int],
    accept: Callable[[Camera], bool] = lambda _: True,
    tries: int = 60,
) -> Camera:
    """Aims the scene at the first proposal without fault; `draft` renders a quick picture [H, W, 3].

    Raises RejectedError with the reasons counted.
    """
    reasons: Counter[str] = Counter()
    drafts = 0
    for _ in range(tries):
        camera = propose(rng)
        if camera is None or not accept(camera):
            reasons["no free space" if camera is None else "too like another view"] += 1
            continue
        aim(scene, camera, size)
        fault = geometry_fault(survey(scene))
        if fault is None:
            drafts += 1
            fault = picture_fault(draft(scene))
        if fault is None:
            return camera
        reasons[fault] += 1
        if drafts == 8:
            break
    raise RejectedError(", ".join(f"{n} x {reason}" for reason, n in reasons.most_common()))


def window(scene: mi.Scene, corner: tuple[int, int], size: tuple[int, int]) -> None:
    """Restricts the first sensor's film to width x height pixels from (x, y) on; the picture stays where it was."""
    params = mi.traverse(scene.sensors()[0])
    params["film.crop_size"] = list(size)
    params["film.crop_offset"] = list(corner)
    params.update()
