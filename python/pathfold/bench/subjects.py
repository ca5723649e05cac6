"""What a bench looks at: Mitsuba scenes that it renders, or folders of rendered pictures with a reference.

Both give noisy frames at some spp and seed, and a reference for every frame. More than one frame is a sequence.
"""

import re
from collections.abc import Callable, Collection, Sequence
from dataclasses import dataclass
from functools import cached_property
from hashlib import sha256
from pathlib import Path
from typing import Any

from pathfold import channels
from pathfold.bench.reference import Reference, header, render
from pathfold.bench.shot import Buffers, Shot
from pathfold.bench.timing import SLOW_MS, in_turns
from pathfold.buffers import BUFFERS
from pathfold.channels import samples
from pathfold.images import ImageError, ImageFile
from pathfold.rendering import Renderer

VARIANT = "llvm_ad_rgb"
DEEPEST, DEPTH = 64, 16  # a scene whose paths may be longer than DEEPEST is traced to DEPTH
_NUMBERED = re.compile(r"(.+)\.(\d+)$")

Bar = Callable[[float], None]


@dataclass(frozen=True)
class Options:
    """What all scenes of a bench share."""

    spps: tuple[int, ...] = (1, 2, 4, 8, 16, 32, 64)
    seeds: int = 3
    reference_spp: int = 4096  # of references that have to be rendered, at most
    reference_seconds: float = 600
    rounds: int = 3  # timed runs of each frame at the first seed; later ones add one each: with three seeds five
    references: Path = Path()  # folder for rendered references


class SubjectError(RuntimeError):
    """A scene or folder that cannot be measured; the message says why."""


@dataclass
class MitsubaSubject:
    """A scene file. Cameras beyond the first make it a sequence, a frame each: a camera path."""

    path: Path
    name: str
    options: Options

    def units(self) -> list[tuple[int, int]]:
        """All (spp, seed) to measure, cheap ones first."""
        return [(spp, seed) for spp in sorted(self.options.spps) for seed in range(self.options.seeds)]

    def fingerprint(self) -> str:
        options = self.options
        files = [self.path, *sorted(self.path.parent.glob("reference*.exr"))]
        asked = "" if len(files) > 1 else f"{options.reference_spp} {options.reference_seconds}"
        return _fingerprint(files, asked)

    @cached_property
    def _renderer(self) -> Renderer:
        return Renderer(self.path, VARIANT, 0, None)

    @cached_property
    def frames(self) -> int:
        return len(self._renderer.scene.sensors())

    @property
    def size(self) -> tuple[int, int]:
        """Width and height of the picture that is rendered: the film's, until `shoot` is told another."""
        return self._renderer.size

    @cached_property
    def _max_depth(self) -> int:
        """The reference's, else that of the scene's integrator."""
        given = self._given_reference(0)
        if given and given.max_depth:
            return given.max_depth
        found = re.search(r"max_depth = (\d+)", str(self._renderer.scene.integrator()))
        return int(found.group(1)) if found and 1 <= int(found.group(1)) <= DEEPEST else DEPTH

    def reference(self, frame: int, bar: Bar) -> Reference:
        """The file beside the scene; where there is none, one is rendered and kept in the output folder."""
        if given := self._given_reference(frame):
            return given
        options, depth = self.options, self._max_depth
        path = options.references / f"{self.name}.{self.fingerprint()}.{frame:04d}.exr"
        if not path.is_file():
            self._renderer.use(frame, None)
            path.parent.mkdir(parents=True, exist_ok=True)
            render(
                self._renderer.scene,
                options.reference_spp,
                options.reference_seconds / self.frames,
                bar,
                sensor=frame,
                max_depth=depth,
            ).save(path)
        return Reference.read(path)

    def _given_reference(self, frame: int) -> Reference | None:
        numbered = self.path.with_name(f"reference.{frame + 1:04d}.exr")
        path = numbered if self.frames > 1 else self.path.with_name("reference.exr")
        return Reference.read(path) if path.is_file() else None

    def shoot(
        self, frame: int, spp: int, seed: int, recorded: Collection[int], size: tuple[int, int], first_seed: bool
    ) -> Shot:
        """Render a frame with the paths of as many samples of a pixel as the most of `recorded`.

        At the first seed with as many as each of the others and with none too, in turn: for the time that it takes.
        Equal arguments, equal frames.
        """
        self._renderer.use(frame, size)
        if self._warm != (frame, size):
            for kind in (0, 1) if max(recorded, default=0) else (0,):
                self._trace(1, 0, kind)  # compiles the kernels and makes them ready
            self._warm = frame, size
        pictures: dict[int, Buffers] = {}

        def call(kind: int) -> None:
            pictures.clear()  # one block of samples at a time
            pictures[kind] = self._trace(spp, seed, kind)

        kinds = sorted({0, *(min(count, spp) for count in recorded)})
        most = kinds[-1]
        if not first_seed:
            kinds = [most]
        calls: dict[int, Callable[[], None]] = {kind: lambda kind=kind: call(kind) for kind in kinds}  # type: ignore[misc]
        took = in_turns(calls, 1)
        if first_seed and max(took[most]) < SLOW_MS:
            for kind, more in in_turns(calls, self.options.rounds - 1).items():
                took[kind] += more
        return Shot(pictures[most], spp, took)

    _warm: tuple[int, tuple[int, int]] | None = None  # frame and size

    def _trace(self, spp: int, seed: int, recorded: int) -> Buffers:
        wanted = {*BUFFERS, *({"samples.descriptor", "samples.density"} if recorded else ())}
        buffers, block, _ = self._renderer.trace(spp, seed, self._max_depth, None, wanted, lambda done: None, recorded)
        return {**buffers, **{f"samples.{name}": pixels for name, pixels in block.items()}}


@dataclass
class PictureSubject:
    """A folder of noisy pictures: NAME.exr each an spp and seed, or NAME.0001.exr ... each a sequence of them.

    The reference is reference.exr, or reference.0001.exr ... for the frame of that number. The spp comes from the
    header or the name ("8spp"), and so does the seed ("seed1"); the time of rendering from the header.
    """

    folder: Path
    name: str
    options: Options
    pattern: str = ""  # the one sequence that is meant, "frames" of frames.####.exr

    def units(self) -> list[tuple[int, int]]:
        return sorted(self._sequences)

    def fingerprint(self) -> str:
        paths = sorted(self.folder.glob("reference*.exr"))
        return _fingerprint([*paths, *(path for unit in self.units() for path in self._sequences[unit])], "")

    @cached_property
    def frames(self) -> int:
        counts = {len(paths) for paths in self._sequences.values()}
        if len(counts) > 1:
            raise SubjectError(f"{self.folder}: its sequences have unlike lengths ({', '.join(map(str, counts))})")
        return counts.pop()

    @cached_property
    def _sequences(self) -> dict[tuple[int, int], list[Path]]:
        """(spp, seed) -> the frames."""
        stems: dict[str, list[Path]] = {}
        for path in sorted(self.folder.glob("*.exr")):
            stem, _ = _frame_number(path)
            if stem != "reference" and self.pattern in ("", stem):
                stems.setdefault(stem, []).append(path)
        found: dict[tuple[int, int], list[Path]] = {}
        for stem, paths in stems.items():
            file = ImageFile(paths[0])
            spp = _spp(file, stem)
            named = re.search(r"seed(\d+)", stem)
            seed = header(file, "pathfold:seed")
            seed = seed if seed is not None else int(named.group(1)) if named else 0
            while (spp, seed) in found:
                seed += 1
            found[spp, seed] = paths
        if not found:
            raise SubjectError(f"{self.folder}: no noisy picture (*.exr) beside the reference")
        return found

    def reference(self, frame: int, bar: Bar) -> Reference:
        return Reference.read(self._reference_path(frame))

    def _reference_path(self, frame: int) -> Path:
        first = next(iter(self._sequences.values()))
        _, number = _frame_number(first[frame])
        names = [*([f"reference.{number}.exr"] if number else []), "reference.exr"]
        for name in names:
            if (self.folder / name).is_file():
                return self.folder / name
        raise SubjectError(f"{self.folder}: has no {' nor '.join(names)}")

    def shoot(
        self, frame: int, spp: int, seed: int, recorded: Collection[int], size: tuple[int, int], first_seed: bool
    ) -> Shot:
        """Read a frame; its time is what the header tells, the same with paths and without."""
        file = ImageFile(self._sequences[spp, seed][frame])
        found = channels.match(file)[0]
        if found.size != size:
            unlike = " and ".join(f"{width}x{height}" for width, height in (found.size, size))
            raise SubjectError(f"{file.path} and its reference are of unlike sizes, {unlike}")
        truth = channels.match(ImageFile(self._reference_path(frame)))[0].window
        if found.window != truth:
            raise SubjectError(f"{file.path} and its reference lie at unlike places, {found.window} and {truth}")
        buffers: Buffers = {name: channels.load(file, found, name) for name in found.sources}
        if "albedo" in buffers and (made := channels.complete_albedo(buffers, found.writer("albedo").miss_albedo)):
            buffers["albedo"], _ = made
        if max(recorded, default=0) and samples.find(file) is not None:
            buffers |= {f"samples.{name}": pixels for name, pixels in samples.load(file, found.window).items()}
        took = _render_ms(file.metadata())
        return Shot(buffers, spp, {min(count, spp): took for count in (0, *recorded)})


Subject = MitsubaSubject | PictureSubject


def find(path: Path, options: Options) -> list[Subject]:
    """The subjects that a name stands for: a scene file, a folder of either kind, a folder of such, or
    frames.####.exr. Raises SubjectError that says what is wanted."""
    if "#" in path.name:
        stem = re.sub(r"\.#+$", "", path.stem)
        if path.suffix.lower() != ".exr" or "#" in stem:
            raise SubjectError(f"{path}: write the frame number as ####, between two dots: frames.####.exr")
        if not path.parent.is_dir():
            raise SubjectError(f"{path.parent}: no such folder")
        return [PictureSubject(path.parent, f"{path.absolute().parent.name}-{stem}", options, stem)]
    if path.is_file() and path.suffix.lower() == ".xml":
        absolute = path.absolute()
        return [MitsubaSubject(path, absolute.parent.name if path.stem == "scene" else path.stem, options)]
    if path.is_dir():
        if (path / "scene.xml").is_file():
            return [MitsubaSubject(path / "scene.xml", path.absolute().name, options)]
        if any(path.glob("reference*.exr")):
            return [PictureSubject(path, path.absolute().name, options)]
        if inner := sorted(path.glob("*/scene.xml")) + sorted(path.glob("*/reference*.exr")):
            folders = dict.fromkeys(found.parent for found in inner)
            return [subject for folder in folders for subject in find(folder, options)]
    wanted = "a Mitsuba scene (.xml), a folder with scene.xml, or one of EXRs with reference.exr"
    raise SubjectError(f"{path}: {'holds no such thing' if path.exists() else 'is not there'}; {wanted} is wanted")


def find_all(paths: Sequence[Path], options: Options) -> list[Subject]:
    """All of them; raises SubjectError as `find`, or where two would go by one name."""
    found: dict[str, Subject] = {}
    for subject in (subject for path in paths for subject in find(path, options)):
        if subject.name in found:
            raise SubjectError(f"two scenes are called {subject.name}; rename a folder")
        found[subject.name] = subject
    return list(found.values())


def _frame_number(path: Path) -> tuple[str, str]:
    """ "a.0001.exr" as ("a", "0001"); without a number ("a", "")."""
    found = _NUMBERED.fullmatch(path.stem)
    return (found.group(1), found.group(2)) if found else (path.stem, "")


def _spp(file: ImageFile, stem: str) -> int:
    """Samples per pixel: from the header, the name, or the block of samples."""
    entries = file.metadata()
    keys = ["pathfold:spp", *(key for key in entries if re.fullmatch(r"cycles\..+\.samples", key))]
    numbers = [number for key in keys if (number := header(file, key))]
    named = re.search(r"(\d+)\s*spp", stem)
    spp = numbers[0] if numbers else int(named.group(1)) if named else samples.count(file)
    if spp < 1:
        raise ImageError(f"{file.path}: how many samples a pixel has is not known; name it {stem}-8spp.exr or the like")
    return spp


def _render_ms(entries: dict[str, Any]) -> list[float]:
    """What the header tells of the time of rendering: ours, Cycles' "01:02.5" or Blender's stamp."""
    if (seconds := entries.get("pathfold:render_seconds")) is not None:
        return [1000 * float(seconds)]
    keys = [key for key in entries if re.fullmatch(r"cycles\..+\.render_time", key)] + ["RenderTime"]
    for key in keys:
        if re.fullmatch(r"(\d+:)+[\d.]+", str(entries.get(key, ""))):
            total = 0.0
            for part in str(entries[key]).split(":"):
                total = 60 * total + float(part)
            return [1000 * total]
    return []


def _fingerprint(paths: Sequence[Path], text: str) -> str:
    """Of files that are small by their content, of others by size and time."""
    digest = sha256(text.encode())
    for path in paths:
        status = path.stat()
        digest.update(path.name.encode())
        digest.update(
            path.read_bytes() if status.st_size < 1 << 24 else f"{status.st_size} {status.st_mtime_ns}".encode()
        )
    return digest.hexdigest()[:12]
