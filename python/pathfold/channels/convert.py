"""What a renderer writes where a ray hits nothing, made what models are trained on: albedo 1, depth 0.

Depths too far to be any are misses, and encoded normals are decoded, in the SDK for everybody; what a renderer's
albedo is on a miss only its preset can say.
"""

from collections.abc import Mapping

import numpy as np
from numpy.typing import NDArray

from pathfold.channels.presets import FARTHEST

# A normal that is shorter than one tells a pixel that is partly covered, or one in which normals differ. The former is
# near misses, at most so far away, or so are all pixels from there to a miss whose normals are as short as this.
_REACH = 2
_SHORT = 0.6
_NOTHING = 1e-3

Image = NDArray[np.float32]


def complete_albedo(buffers: Mapping[str, Image], on_miss: float | str | None) -> tuple[Image, str] | None:
    """The albedo with what is not covered counted as 1, and a line on it; None where it is so already.

    `buffers`: height x width x channels. `on_miss`: what the writer puts where nothing was hit, a number or "sky"
    (as it shines: the SDK's clamp makes 1 of most skies); None where it is not known: then the pixels tell.
    """
    albedo = buffers["albedo"]
    known = _coverage(buffers)
    if known is None or isinstance(on_miss, str):
        return None
    covered, told_by = known
    misses = covered[..., 0] < _NOTHING
    if on_miss is None:
        on_miss = 0.0 if misses.any() and np.nanmedian(albedo[misses]) < _NOTHING else 1.0
    # What is not covered gives on_miss, so more than the rest could give shows that this albedo is of something else.
    believed = albedo.max(-1, keepdims=True) <= covered + (1 - covered) * on_miss + 0.02
    lack = np.where(believed, (1 - covered) * (1 - on_miss), 0).astype(np.float32)
    count = int((lack > _NOTHING).sum())
    if not count:
        return None
    return albedo + lack, f"albedo is {on_miss:g} on misses: made 1 in {count} pixels, by coverage ({told_by})"


def encoded(normal: Image) -> bool:
    """Whether normals are stored as 0.5 n + 0.5, which the SDK decodes: by its rule (sdk/src/guides).

    None is negative, and as means of unit vectors they are hardly ever longer than one; few are unit as they stand.
    """
    normal = _bounded(normal)
    length, decoded = (np.linalg.norm(one, axis=-1) for one in (normal, 2 * normal - 1))
    hit = np.asarray((length > 0.1) & (decoded > 0.1))
    hits, pixels = int(hit.sum()), hit.size
    negative = int((normal.min(-1) < -0.01).sum())
    longer, near, plain = (int(one[hit].sum()) for one in (decoded > 1.05, decoded > 0.9, np.abs(length - 1) < 0.1))
    return hits > 0 and 1000 * negative <= pixels and 100 * longer <= hits <= 5 * near and 10 * plain < 9 * hits


def _coverage(buffers: Mapping[str, Image]) -> tuple[Image, str] | None:
    """How much of each pixel shows a surface, height x width x 1, and by what; None where nothing tells it.

    By alpha where it tells a background. Else by the normals' length near misses.
    """
    alpha, normal, depth = (buffers.get(name) for name in ("alpha", "normal", "depth"))
    if alpha is not None and (alpha < 1 - _NOTHING).any() and (alpha > _NOTHING).any():
        return np.clip(np.nan_to_num(alpha, nan=1.0), 0, 1), "alpha"
    if normal is None and depth is None:
        return None
    hit = np.ones((*next(iter(buffers.values())).shape[:2], 1), bool)
    covered = np.ones(hit.shape, np.float32)
    if depth is not None:
        hit = (depth > 0) & (depth < FARTHEST)
    if normal is not None:
        covered = _lengths(normal)
        hit = hit & (covered > _NOTHING) if depth is None else hit | (covered > _NOTHING)
    if hit.all() or not hit.any():
        return None
    thin = _near(_grown(~hit[..., 0], covered[..., 0] < _SHORT), _REACH)
    covered = np.where(thin[..., None], np.minimum(covered, 1), 1)
    return np.where(hit, covered, 0).astype(np.float32), "normals" if normal is not None else "depth"


def _lengths(normal: Image) -> Image:
    """The length of each normal, 0 where it is not finite; normals without a negative value are 0.5 n + 0.5."""
    normal = _bounded(normal)
    square = np.einsum("yxc,yxc->yx", normal, normal)[..., None]
    if normal.min() >= 0:  # |2 n - 1|^2
        square = np.where(square > 0, 4 * (square - normal.sum(-1, keepdims=True)) + 3, 0)
    return np.sqrt(np.maximum(square, 0))


def _bounded(normal: Image) -> Image:
    finite = normal if np.isfinite(normal).all() else np.nan_to_num(normal, nan=0.0, posinf=0.0, neginf=0.0)
    return np.clip(finite, -2, 2)


def _near(mask: NDArray[np.bool_], reach: int) -> NDArray[np.bool_]:
    """The pixels of a mask, height x width, and those within reach of one."""
    for axis in (0, 1):
        padding = [(0, 0), (0, 0)]
        padding[axis] = (reach, reach)
        padded, size = np.pad(mask, padding), mask.shape[axis]
        mask = np.any([padded.take(range(at, at + size), axis) for at in range(2 * reach + 1)], axis=0)
    return mask


def _grown(seed: NDArray[np.bool_], through: NDArray[np.bool_]) -> NDArray[np.bool_]:
    """The pixels of `seed` and those of `through` that are connected with them."""
    left = np.pad(through & ~seed, 1)
    grown = np.pad(seed, 1)
    row = left.shape[1]
    around = np.array([-row - 1, -row, -row + 1, -1, 1, row - 1, row, row + 1])
    front = np.flatnonzero(left & _near(grown, 1))
    while front.size:
        left.flat[front], grown.flat[front] = False, True
        met = (front[:, None] + around).ravel()
        front = np.unique(met[left.flat[met]])
    return grown[1:-1, 1:-1]
