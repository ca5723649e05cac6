"""Scenes from a folder: every Mitsuba scene in it, seen by its own camera and by others in the free space around it."""

from __future__ import annotations

import re
from collections.abc import Callable
from pathlib import Path
from typing import Any, NamedTuple

import mitsuba as mi
import numpy as np
from numpy.random import Generator
from numpy.typing import NDArray

from .cameras import Camera, RejectedError, cast, find, pose, resize, survey


class Entry(NamedTuple):
    """A scene file with its name, licence line and origin, and whether it may be changed."""

    path: Path
    name: str
    licence: str
    origin: str

    @property
    def may_vary(self) -> bool:
        """Whether its licence is known and does not forbid derivatives, by all that the LICENSE.txt beside it says."""
        note = self.path.parent / "LICENSE.txt"
        text = note.read_text(errors="replace") if note.exists() else ""
        return self.licence != "unknown" and not re.search(r"no[ -]?deriv|\bby([- ]nc)?[- ]nd\b", text, re.IGNORECASE)


def scan(folder: Path) -> list[Entry]:
    """Every `*.xml` directly in the folder and every `scene.xml` below it; LICENSE.txt beside it tells the licence."""
    if not folder.is_dir():
        raise FileNotFoundError(f"{folder} is no folder; give --library a folder of Mitsuba scenes")
    paths = sorted([*folder.glob("*.xml"), *folder.glob("**/scene.xml")])
    if not paths:
        raise FileNotFoundError(f"no Mitsuba scene in {folder}: expected NAME/scene.xml or *.xml")
    return [_entry(folder, path) for path in dict.fromkeys(paths)]


def _entry(folder: Path, path: Path) -> Entry:
    name = path.stem if path.parent == folder else str(path.parent.relative_to(folder)).replace("/", "-")
    note = path.parent / "LICENSE.txt"
    text = note.read_text(errors="replace") if note.exists() else ""
    licence = re.search(
        r"CC0(?: 1\.0)?|CC[ -]BY(?:-[A-Z]{2})* ?\d\.\d|public domain|free(?:ly)? for any purposes?|Apache-2\.0|MIT",
        text,
    )
    title = text.strip().splitlines()[0] if text.strip() else "unknown"
    source = re.search(r"https?://(?!creativecommons)\S+", text)
    origin = title if source is None or source.group() in title else f"{title}; {source.group()}"
    return Entry(path, name, licence.group() if licence else "unknown", origin)


def load(entry: Entry) -> mi.Scene:
    """The scene; errors name the file."""
    try:
        return mi.load_file(str(entry.path), optimize=False)  # merged meshes come in another order at every load
    except RuntimeError as error:
        raise RejectedError(f"{entry.path} does not load: {str(error).strip()[:500]}") from error


def choose(
    scene: mi.Scene,
    number: int,
    draft: Callable[[mi.Scene], NDArray[np.float32]],
    rng: Generator,
    size: tuple[int, int],
) -> Camera | None:
    """Aims the scene at its view `number`: 0 is its own camera (None), others are drawn, unlike those before."""
    resize(scene, size)
    if number == 0:
        return None
    origin, direction, up, fov = pose(scene)
    around = _Around(scene, origin, direction, up, fov)
    taken = [Camera(origin, origin + direction, up, fov)]
    for _ in range(number):
        taken.append(
            find(scene, around.propose, draft, rng, size, lambda c: all(_unlike(c, t, around.scale) for t in taken))
        )
    return taken[-1]


def _unlike(a: Camera, b: Camera, scale: float) -> bool:
    """Views differ when the camera moved by a fifth of the scene's extent or turned by 25 degrees."""
    turn = [(c.target - c.origin) / np.linalg.norm(c.target - c.origin) for c in (a, b)]
    moved = np.linalg.norm(a.origin - b.origin) > 0.2 * scale
    return bool(moved or turn[0] @ turn[1] < np.cos(np.radians(25)))


class _Around:
    """Free space and visible points about a scene's own camera."""

    def __init__(
        self, scene: mi.Scene, origin: NDArray[Any], direction: NDArray[Any], up: NDArray[Any], fov: float
    ) -> None:
        seen = survey(scene)
        hit = np.isfinite(seen.distance)
        if not hit.any():
            raise RejectedError("its own camera sees nothing")
        self.scene, self.origin, self.fov = scene, origin, fov
        self.points, self.scale = seen.points[hit], float(np.median(seen.distance[hit]))
        axis = np.argmax(np.abs(up))
        self.up = np.sign(up[axis]) * np.eye(3)[axis]  # scenes stand upright on an axis; their camera may lean

    def propose(self, rng: Generator) -> Camera | None:
        """From somewhere near the way to a visible point toward another visible point; None where it is too tight."""
        goal = self.points[rng.integers(len(self.points))]
        origin = self.origin + (goal - self.origin) * rng.uniform(0, 0.6) + rng.normal(size=3) * 0.15 * self.scale
        target = self.points[rng.integers(len(self.points))]
        if not self._free(origin) or np.linalg.norm(target - origin) < 0.25 * self.scale:
            return None
        return Camera(
            origin, target, self.up, float(np.clip(self.fov * rng.uniform(0.8, 1.3), 25, 80)), rng.uniform(0.003, 0.02)
        )

    def _free(self, origin: NDArray[Any]) -> bool:
        """In sight of the scene's own camera and away from every surface."""
        way = origin - self.origin
        length = float(np.linalg.norm(way))
        if cast(self.scene, self.origin, way[None] / length).distance[0] < 1.05 * length:
            return False
        index = np.arange(96) + 0.5
        polar, turn = np.arccos(1 - 2 * index / 96), np.pi * (1 + 5**0.5) * index
        ball = np.stack([np.cos(turn) * np.sin(polar), np.sin(turn) * np.sin(polar), np.cos(polar)], -1)
        return bool(cast(self.scene, origin, ball).distance.min() > 0.12 * self.scale)
