"""`pathfold render`: a Mitsuba scene to noisy buffers and samples with path descriptors, or straight to clean."""

import re
from collections.abc import Callable
from pathlib import Path
from time import perf_counter
from typing import TYPE_CHECKING, Annotated, Any

import typer

from pathfold.cli import console
from pathfold.cli.console import InputError
from pathfold.cli.denoise import result_lines

if TYPE_CHECKING:
    import numpy as np
    from numpy.typing import NDArray

    Block = dict[str, NDArray[np.floating[Any]]]

BAND_SAMPLES = 1 << 22  # traced in one call: some 1.5 GB while Mitsuba is at it
_BEAUTY = ("color", "alpha")
_SUFFIXES = {"color": "RGB", "alpha": "A", "normal": "XYZ", "depth": "Z"}


def render(
    scene: Annotated[Path, typer.Argument(metavar="SCENE.xml", help="A Mitsuba 3 scene.")],
    output: Annotated[Path, typer.Option("-o", "--output", metavar="OUT.exr", help="Where the result goes.")],
    spp: Annotated[int, typer.Option(min=1, help="Samples per pixel.")] = 8,
    seed: Annotated[int, typer.Option(min=0, help="Equal seeds give equal pictures.")] = 0,
    max_depth: Annotated[int, typer.Option(help="Longest path, in Mitsuba's meaning.")] = 8,
    rr_depth: Annotated[int | None, typer.Option(help="Russian roulette from here on; default: none.")] = None,
    size: Annotated[str | None, typer.Option(metavar="WxH", help="Instead of the film's own size.")] = None,
    sensor: Annotated[int, typer.Option(min=0, help="Which of the scene's cameras.")] = 0,
    for_model: Annotated[
        str | None, typer.Option("--for", metavar="MODEL", help="Write only what this model reads.")
    ] = None,
    model: Annotated[
        str | None,
        typer.Option("--denoise", metavar="MODEL", help="Denoise at once; no samples are written."),
    ] = None,
    exposure: Annotated[float | None, typer.Option(min=0, help="With --denoise: as in `denoise`.")] = None,
    variant: Annotated[str, typer.Option(help="Mitsuba's variant.")] = "llvm_ad_rgb",
    quiet: Annotated[bool, typer.Option("-q", "--quiet", help="Print errors only.")] = False,
) -> None:
    """Trace a scene through its own camera and film, and write the buffers and samples that models read.

    The first part of the file holds the buffers, the second one (`samples`) the path descriptor of every sample.
    Without --for it holds whatever any shipped model reads.
    """
    from pathfold import models, version
    from pathfold.denoising import Denoiser
    from pathfold.images import OutputError, check_output

    # What is not there or cannot be written is found out before rendering.
    if output.suffix.lower() != ".exr":
        raise OutputError(f"{output}: buffers and samples need an EXR; name it {output.with_suffix('.exr').name}")
    check_output(output)
    denoiser = Denoiser(model) if model else None
    reader = model or for_model
    wanted = models.inputs(reader) if reader else models.shipped_inputs()
    camera = Camera(scene, variant, sensor, parse_size(size))
    with console.progress(f"render {scene.name}", quiet) as bar:
        start = perf_counter()
        buffers, samples, dropped = camera.trace(spp, seed, max_depth, rr_depth, wanted, bar)
        seconds = perf_counter() - start
    if not quiet:
        width, height = camera.size
        console.say(f"{scene}: {width}x{height}, {spp} spp, {seconds:.2f} s")
        if dropped:
            console.say(f"  mended: {dropped} samples were not finite and are left out")
    if denoiser:
        with console.progress(denoiser.model.name, quiet) as bar:
            blocks = {f"samples.{name}": block for name, block in samples.items()}
            result = denoiser.run_buffers({**buffers, **blocks}, exposure=exposure, progress=bar)
        for line in () if quiet else result_lines(result.report):
            console.say(line)
        clean = {"color": result.color, "alpha": result.alpha, "diffuse": result.diffuse}
        clean["specular"] = result.specular
        buffers |= {name: pixels for name, pixels in clean.items() if pixels is not None}
        samples = {}
    metadata: dict[str, str | int | float] = {
        "pathfold:version": version(),
        "pathfold:spp": spp,
        "pathfold:seed": seed,
        "pathfold:max_depth": max_depth,
        **({"pathfold:model": denoiser.model.name} if denoiser else {}),
    }
    write(output, buffers, samples, metadata)
    if not quiet:
        console.say(str(output))


class Camera:
    """A scene and the camera it is seen through."""

    def __init__(self, path: Path, variant: str, sensor: int, size: tuple[int, int] | None) -> None:
        mi = load_mitsuba(variant)
        if not path.is_file():
            raise InputError(f"{path}: no such file; a Mitsuba 3 scene (.xml) is wanted")
        try:
            # Merged meshes come in any order, and with them the lights: equal seeds would not give equal pictures.
            self._scene = mi.load_file(str(path), optimize=False)
        except Exception as error:  # Mitsuba raises whatever its parsers raise
            raise InputError(f"{path}: not a scene that Mitsuba can load: {_last_words(error)}") from error
        if sensor >= len(self._scene.sensors()):
            raise InputError(f"{path}: has no camera {sensor}; it has {len(self._scene.sensors())}")
        self._sensor = sensor
        self._parameters = mi.traverse(self._scene.sensors()[sensor])
        if size:
            self._film(size=size)
        film = self._scene.sensors()[sensor].film()
        self._origin = tuple(int(n) for n in film.crop_offset())
        self.size = tuple(int(n) for n in film.crop_size())

    def trace(
        self,
        spp: int,
        seed: int,
        max_depth: int,
        rr_depth: int | None,
        wanted: set[str],
        bar: Callable[[float], None],
    ) -> "tuple[Block, Block, int]":
        """Per-pixel buffers and the block of samples, those that are wanted, and the number of samples dropped.

        The picture is traced in bands of rows, so that memory goes with the block and not with what Mitsuba holds.
        """
        import numpy as np

        from pathfold.mitsuba import trace

        width, height = self.size
        rows = max(1, min(height, BAND_SAMPLES // (width * spp)))
        described = any(name.startswith("samples.") for name in wanted)
        buffers: Block = {}
        samples: Block = {}
        dropped = 0
        for index, first in enumerate(range(0, height, rows)):
            last = min(first + rows, height)
            self._film(crop_offset=(self._origin[0], self._origin[1] + first), crop_size=(width, last - first))
            band_seed = seed if rows == height else int(np.random.SeedSequence((seed, index)).generate_state(1)[0])
            try:
                band = trace(self._scene, spp, band_seed, max_depth, self._sensor, described, rr_depth)
            except (ValueError, TypeError, NotImplementedError) as error:
                raise InputError(_last_words(error)) from error
            means = band.reduce()
            dropped += means.pop("dropped")
            for name, pixels in means.items():
                if name in wanted or name in _BEAUTY:
                    whole = buffers.setdefault(name, np.empty((height, *pixels.shape[1:]), np.float32))
                    whole[first:last] = pixels
            pieces = {"descriptor": band.descriptor, "density": band.density}
            for name, block in pieces.items():
                if f"samples.{name}" in wanted and block is not None:
                    shape = (spp, height, *block.shape[2:])
                    samples.setdefault(name, np.empty(shape, block.dtype))[:, first:last] = block
            bar(last / height)
        return buffers, samples, dropped

    def _film(self, **values: tuple[int, int]) -> None:
        for name, value in values.items():
            self._parameters[f"film.{name}"] = list(value)
        self._parameters.update()


def write(path: Path, buffers: "Block", samples: "Block", metadata: "dict[str, str | int | float]") -> None:
    """Write buffers (float) and, where there are any, samples as a second part."""
    import numpy as np

    from pathfold.channels import BUFFERS
    from pathfold.channels import samples as sample_names
    from pathfold.images import NewPart, write_parts

    names = [name for name in BUFFERS if name in buffers]
    channels = [channel for name in names for channel in channel_names(name)]
    stacked = [buffers[name] for name in names]
    height, width = buffers["color"].shape[:2]

    def rows(first: int, last: int) -> "NDArray[np.floating[Any]]":
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
    try:
        import mitsuba as mi
    except ModuleNotFoundError as error:
        raise ModuleNotFoundError("rendering needs Mitsuba: pip install 'pathfold[mitsuba]'") from error
    if variant not in mi.variants():
        raise InputError(f"--variant {variant}: this Mitsuba has {', '.join(mi.variants())}")
    mi.set_variant(variant)
    mi.set_log_level(mi.LogLevel.Error)
    return mi


def parse_size(text: str | None) -> tuple[int, int] | None:
    """ "640x360" as (640, 360)."""
    if text is None:
        return None
    found = re.fullmatch(r"(\d+)x(\d+)", text)
    if not found or not (int(found.group(1)) and int(found.group(2))):
        raise InputError(f"--size {text}: write WIDTHxHEIGHT, for example 640x360")
    return int(found.group(1)), int(found.group(2))


def _last_words(error: Exception) -> str:
    """What a multi-line message of Mitsuba's comes down to."""
    lines = [line.strip() for line in str(error).splitlines() if line.strip()]
    return re.sub(r"^.*?\[\w+\.(cpp|h):\d+\]\s*", "", lines[-1]) if lines else type(error).__name__
