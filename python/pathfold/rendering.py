"""Rendering Mitsuba scenes to what models read: per-pixel buffers, and samples with path descriptors."""

import re
from collections.abc import Callable, Collection, Mapping
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from pathfold._core import MAX_VERTICES
from pathfold.buffers import BUFFERS
from pathfold.channels import samples as sample_names
from pathfold.images import MAX_CHANNELS, NewPart, OutputError, write_parts
from pathfold.models import ALL_SAMPLES

BAND_SAMPLES = 1 << 22  # traced in one call: some 1.5 GB while Mitsuba is at it
_BEAUTY = ("color", "alpha")
_SUFFIXES = {"color": "RGB", "alpha": "A", "normal": "XYZ", "depth": "Z"}

Block = dict[str, NDArray[np.floating[Any]]]


class SceneError(RuntimeError):
    """A scene that cannot be rendered; the message says why."""


class Renderer:
    """Traces a scene through one of its cameras."""

    def __init__(self, path: Path, variant: str, sensor: int, size: tuple[int, int] | None) -> None:
        mi = load_mitsuba(variant)
        from pathfold.mitsuba import Frozen  # needs the variant

        if path.is_dir():
            raise SceneError(f"{path}: is a folder; name the scene in it, say {path / 'scene.xml'}")
        if not path.is_file():
            raise SceneError(f"{path}: no such file; a Mitsuba 3 scene (.xml) is wanted")
        try:
            # Merged meshes come in any order, and with them the lights: equal seeds would not give equal pictures.
            self._scene = mi.load_file(str(path), optimize=False)
        except Exception as error:  # Mitsuba raises whatever its parsers raise
            raise SceneError(f"{path}: not a scene that Mitsuba can load: {_last_words(error)}") from error
        if not self._scene.shapes():
            raise SceneError(f"{path}: has no shapes, so there is nothing to see; add one")
        self._path = path
        self._launch = Frozen()
        self.use(sensor, size)

    @property
    def scene(self) -> Any:
        """The loaded mitsuba.Scene."""
        return self._scene

    def use(self, sensor: int, size: tuple[int, int] | None) -> None:
        """See the scene through its camera number `sensor`, with a film of width x height (None: the film's own)."""
        import mitsuba as mi

        sensors = self._scene.sensors()
        if sensor >= len(sensors):
            raise SceneError(f"{self._path}: has no camera {sensor}; it has {len(sensors)}")
        self._sensor = sensor
        self._parameters = mi.traverse(sensors[sensor])
        if size:
            self._film(size=size)
        film = sensors[sensor].film()
        (x, y), (width, height) = film.crop_offset(), film.crop_size()
        self._origin, self.size = (int(x), int(y)), (int(width), int(height))

    def trace(
        self,
        spp: int,
        seed: int,
        max_depth: int,
        rr_depth: int | None,
        wanted: set[str],
        bar: Callable[[float], None],
        recorded: int = ALL_SAMPLES,
    ) -> tuple[Block, Block, int]:
        """Per-pixel buffers and the block of samples, those that are wanted, and the number of samples dropped.

        What is not wanted is not made, and the block holds the first `recorded` samples of a pixel alone. A path of
        `max_depth` scatters one time less, and so many vertices it gets.
        The picture is traced in bands of rows, so that memory goes with the block and not with what Mitsuba holds.
        """
        from pathfold.mitsuba import trace

        width, height = self.size
        rows = max(1, min(height, BAND_SAMPLES // (width * spp)))
        recorded = min(recorded, spp) if any(name.startswith("samples.") for name in wanted) else 0
        vertices = path_vertices(max_depth)
        means_of = {name for name in wanted if name in BUFFERS} | {*_BEAUTY}
        unneeded = unneeded_fields(wanted)
        buffers: Block = {}
        samples: Block = {}
        dropped = 0
        for index, first in enumerate(range(0, height, rows)):
            last = min(first + rows, height)
            self._film(crop_offset=(self._origin[0], self._origin[1] + first), crop_size=(width, last - first))
            band_seed = seed if rows == height else int(np.random.SeedSequence((seed, index)).generate_state(1)[0])
            try:
                band = trace(
                    self._scene,
                    spp,
                    band_seed,
                    max_depth,
                    self._sensor,
                    rr_depth,
                    vertices=vertices,
                    recorded=recorded,
                    leave_out=unneeded,
                    launch=self._launch,
                )
            except (ValueError, TypeError, NotImplementedError) as error:
                raise SceneError(_last_words(error)) from error
            means = band.reduce(means_of)
            dropped += means.pop("dropped")
            for name, pixels in means.items():
                if name in means_of:
                    whole = buffers.setdefault(name, np.empty((height, *pixels.shape[1:]), np.float32))
                    whole[first:last] = pixels
            pieces = {"descriptor": band.descriptor, "density": band.density}
            for name, block in pieces.items():
                if f"samples.{name}" in wanted and block is not None:
                    shape = (recorded, height, *block.shape[2:])
                    samples.setdefault(name, np.empty(shape, block.dtype))[:, first:last] = block
            if samples and not (valid := band.valid()[:recorded]).all():
                whole = samples.setdefault("valid", np.ones((recorded, height, width, 1), np.float16))
                whole[:, first:last] = valid[..., None]
            bar(last / height)
        self._film(crop_offset=self._origin, crop_size=self.size)
        return buffers, samples, dropped

    def _film(self, **values: tuple[int, int]) -> None:
        for name, value in values.items():
            self._parameters[f"film.{name}"] = list(value)
        self._parameters.update()


def path_vertices(max_depth: int) -> int:
    """How many vertices of a path are recorded: one for each time that it scatters, within what models read."""
    return MAX_VERTICES if max_depth < 0 else min(MAX_VERTICES, max(max_depth - 1, 1))


def check_samples(path: Path, recorded: int, max_depth: int) -> None:
    """Raise OutputError where the paths of so many samples have more channels than an EXR is written with."""
    # The density, and whether a sample is valid, which is known only after tracing.
    each = len(sample_names.descriptor(path_vertices(max_depth))) + 2
    if recorded * each > MAX_CHANNELS:
        raise OutputError(
            f"{path}: the paths of {recorded} samples need {recorded * each} channels, an EXR takes {MAX_CHANNELS}; "
            f"use --spp {MAX_CHANNELS // each} at most, --for pathfold-balanced, which reads two samples' paths, "
            "or --denoise MODEL, which writes none"
        )


def unneeded_fields(wanted: Collection[str]) -> set[str]:
    """The fields of `pathfold.mitsuba.Samples` that none of the wanted buffers is made from."""
    made_from = {
        "diffuse": {"diffuse", "specular", "diffuse.variance", "specular.variance"},
        "diffuse_albedo": {"diffuse.albedo"},
        "albedo": {"albedo"},
        "normal": {"normal"},
        "depth": {"depth"},
        "descriptor": {"samples.descriptor"},
        "density": {"samples.density"},
    }
    of_no_buffer = {"position", "overlong", "first_albedo", "first_normal", "first_depth", "visible"}
    return {*of_no_buffer, *(field for field, names in made_from.items() if not names & {*wanted})}


def write(path: Path, buffers: Block, samples: Block, metadata: Mapping[str, str | int | float]) -> None:
    """Write buffers (float) and, where there are any, samples as a second part."""
    names = [name for name in BUFFERS if name in buffers]
    channels = [channel for name in names for channel in channel_names(name)]
    stacked = [buffers[name] for name in names]
    height, width = buffers["color"].shape[:2]

    def rows(first: int, last: int) -> NDArray[np.floating[Any]]:
        return np.concatenate([pixels[first:last] for pixels in stacked], axis=-1)

    parts = [NewPart("buffers", channels, ["float"] * len(channels), (width, height), rows)]
    if samples:
        parts.append(sample_names.to_part(samples))
    write_parts(path, parts, metadata)


def channel_names(buffer: str) -> list[str]:
    """The channels of a buffer in our own files: R, G, B for the beauty, albedo.R, normal.X, depth.Z, ..."""
    letters = _SUFFIXES.get(buffer, "RGB")
    return [letter if buffer in _BEAUTY else f"{buffer}.{letter}" for letter in letters]


def load_mitsuba(variant: str) -> Any:
    """Mitsuba with this variant set.

    Raises ModuleNotFoundError where Mitsuba or the variant's driver is not there, SceneError for an unknown variant.
    """
    try:
        import mitsuba as mi
    except ModuleNotFoundError as error:
        raise ModuleNotFoundError("rendering needs Mitsuba: pip install 'pathfold[mitsuba]'") from error
    if variant not in mi.variants():
        raise SceneError(f"--variant {variant}: this Mitsuba has {', '.join(mi.variants())}")
    try:
        mi.set_variant(variant)
    except ImportError as error:  # the variant's driver is not there
        raise ModuleNotFoundError(
            f"--variant {variant}: cannot run here: {_last_words(error).rstrip('.')}; use llvm_ad_rgb"
        ) from error
    mi.set_log_level(mi.LogLevel.Error)
    import drjit as dr

    dr.set_thread_count(max(2, dr.thread_count()))  # with one, on one core, Mitsuba's loaders wait for each other
    return mi


def _last_words(error: Exception) -> str:
    """What a multi-line message of Mitsuba's comes down to."""
    lines = [line.strip() for line in str(error).splitlines() if line.strip()]
    return re.sub(r"^.*?\[\w+\.(cpp|h):\d+\]\s*", "", lines[-1]) if lines else type(error).__name__
