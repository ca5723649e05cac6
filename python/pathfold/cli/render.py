"""`pathfold render`: a Mitsuba scene to noisy buffers and samples with path descriptors, or straight to clean."""

import re
from pathlib import Path
from time import perf_counter
from typing import Annotated, Literal

import typer

from pathfold import lean, models
from pathfold._core import version
from pathfold.channels import ALL_LIGHT
from pathfold.cli import console
from pathfold.cli.denoise import result_lines
from pathfold.denoiser import Denoiser
from pathfold.images import OutputError, check_output
from pathfold.rendering import Renderer, check_samples, write

DEEPEST = 1 << 20  # scattering events, of either limit of a path's length: Dr.Jit's loops count in 32 bits


def render(
    scene: Annotated[Path, typer.Argument(metavar="SCENE.xml", help="A Mitsuba 3 scene.")],
    output: Annotated[Path, typer.Option("-o", "--output", metavar="OUT.exr", help="Where the result goes.")],
    spp: Annotated[int, typer.Option(min=1, help="Samples per pixel.")] = 8,
    # The header's whole numbers have 31 bits.
    seed: Annotated[int, typer.Option(min=0, max=2**31 - 1, help="Equal seeds give equal pictures.")] = 0,
    max_depth: Annotated[int, typer.Option(min=-1, max=DEEPEST, help="Longest path, in Mitsuba's meaning.")] = 8,
    rr_depth: Annotated[
        int | None, typer.Option(min=1, max=DEEPEST, help="Russian roulette from here on; default: none.")
    ] = None,
    size: Annotated[str | None, typer.Option(metavar="WxH", help="Instead of the film's own size.")] = None,
    sensor: Annotated[int, typer.Option(min=0, help="Which of the scene's cameras.")] = 0,
    for_model: Annotated[
        str | None,
        typer.Option("--for", metavar="MODEL", callback=console.check_model, help="Write only what this model reads."),
    ] = None,
    model: Annotated[
        str | None,
        typer.Option(
            "--denoise", metavar="MODEL", callback=console.check_model, help="Denoise at once; no samples are written."
        ),
    ] = None,
    auto: Annotated[
        bool, typer.Option("--auto", help="Leave out what this scene and frame do not need; the result stays the same.")
    ] = False,
    exposure: Annotated[
        float | None, typer.Option(callback=console.check_exposure, help="With --denoise: as in `denoise`.")
    ] = None,
    variant: Annotated[Literal["llvm_ad_rgb", "cuda_ad_rgb"], typer.Option(help="Mitsuba's variant.")] = "llvm_ad_rgb",
    quiet: Annotated[bool, typer.Option("-q", "--quiet", help="Print errors only.")] = False,
) -> None:
    """Trace a scene through its own camera and film, and write the buffers and samples that models read.

    The first part of the file holds the buffers, the second one (`samples`) the path descriptors of as many
    samples as the model looks at.
    Without --for it holds whatever any shipped model reads. --auto prints what it leaves out, and why.
    """
    if exposure is not None and not model:
        raise typer.BadParameter("goes with --denoise MODEL alone; leave it away", param_hint="'--exposure'")
    if model and for_model:
        raise typer.BadParameter(
            "does not go with --denoise, which names the model; leave it away", param_hint="'--for'"
        )
    # What is not there or cannot be written is found out before rendering.
    if output.suffix.lower() != ".exr":
        raise OutputError(f"{output}: buffers and samples need an EXR; name it {output.with_suffix('.exr').name}")
    check_output(output)
    denoiser = Denoiser(model) if model else None
    reader = model or for_model
    reads = models.inputs(reader) if reader else models.shipped_inputs()
    recorded = models.path_samples(reader) if reader else models.shipped_path_samples()
    if not model:
        check_samples(output, min(recorded, spp), max_depth)
    renderer = Renderer(scene, variant, sensor, parse_size(size))
    with console.progress(f"render {scene.name}", quiet) as bar:
        start = perf_counter()
        settings = (spp, seed, max_depth, rr_depth, reads, bar, recorded)
        frame = lean.trace(renderer, *settings) if auto else lean.LeanFrame(*renderer.trace(*settings), "", [])
        seconds = perf_counter() - start
    buffers, samples, all_light = frame.buffers, frame.samples, frame.all_light
    if not quiet:
        width, height = renderer.size
        console.say(f"{scene}: {width}x{height}, {spp} spp, {seconds:.2f} s")
        if frame.dropped:
            console.say(f"  mended: {frame.dropped} samples were not finite and are left out")
        for line in frame.lines or (["left out nothing: the model reads all, and the frame needs it"] if auto else []):
            console.say(f"  {line}")
    if denoiser:
        with console.progress(denoiser.model.name, quiet) as bar:
            blocks = {f"samples.{name}": block for name, block in samples.items()}
            whole = lean.restore_split(buffers, all_light, reads) if all_light else buffers
            result = denoiser.run_buffers({**whole, **blocks}, samples_per_pixel=spp, exposure=exposure, progress=bar)
        for line in () if quiet else result_lines(result.report):
            console.say(line)
        buffers |= {name: pixels for name, pixels in result.images().items() if name in buffers}
        samples = {}
    metadata: dict[str, str | int | float] = {
        "pathfold:version": version(),
        "pathfold:spp": spp,
        "pathfold:seed": seed,
        "pathfold:max_depth": max_depth,
        "pathfold:render_seconds": seconds,
        **({ALL_LIGHT: all_light} if all_light else {}),
        **({"pathfold:model": denoiser.model.name, "pathfold:precision": denoiser.model.precision} if denoiser else {}),
    }
    write(output, buffers, samples, metadata)
    if not quiet:
        console.say(str(output))


def parse_size(text: str | None) -> tuple[int, int] | None:
    """ "640x360" as (640, 360)."""
    if text is None:
        return None
    found = re.fullmatch(r"(\d+)x(\d+)", text)
    if not found or not (int(found.group(1)) and int(found.group(2))):
        raise typer.BadParameter(f"--size {text}: write WIDTHxHEIGHT, for example 640x360")
    return int(found.group(1)), int(found.group(2))
