"""`pathfold denoise`: a picture file in, the same file with its noise removed out."""

from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import Annotated, Any

import typer

from pathfold import models
from pathfold.budget import Budget
from pathfold.channels import Frame
from pathfold.cli import console
from pathfold.cli.sequence import expand, similar
from pathfold.denoiser import Denoiser
from pathfold.files import Denoised, denoise_file
from pathfold.images import check_output


def denoise(
    source: Annotated[Path, typer.Argument(metavar="IN.exr", help="The noisy picture, or frames.####.exr.")],
    output: Annotated[Path, typer.Option("-o", "--output", metavar="OUT.exr", help="Where the result goes.")],
    model: Annotated[
        str | None,
        typer.Option(
            "-m",
            "--model",
            callback=console.check_model,
            help="A model's name or folder.",
            show_default=models.DEFAULT,
        ),
    ] = None,
    mapping: Annotated[
        list[str] | None,
        typer.Option("--map", metavar="BUFFER=LAYER", help="Name a buffer's layer, or none."),
    ] = None,
    layer: Annotated[
        list[str] | None,
        typer.Option("--layer", help="Filter these radiance layers alike, so that they add up."),
    ] = None,
    albedo: Annotated[Path | None, typer.Option("--alb", help="A file that holds the albedo.")] = None,
    normal: Annotated[Path | None, typer.Option("--nrm", help="A file that holds the normals.")] = None,
    depth: Annotated[Path | None, typer.Option("--depth", help="A file that holds the depth.")] = None,
    variance: Annotated[Path | None, typer.Option("--var", help="A file that holds the variance of the mean.")] = None,
    exposure: Annotated[
        float | None,
        typer.Option(callback=console.check_exposure, help="Factor for the network's input; default: automatic."),
    ] = None,
    provider: Annotated[str, typer.Option(help="The onnxruntime execution provider.")] = "cpu",
    threads: Annotated[int, typer.Option(min=0, help="Threads; 0: all cores.")] = 0,
    precision: Annotated[
        str, typer.Option(metavar="auto|fp32|int8", help="Of the model's networks; auto: the faster one here.")
    ] = "auto",
    seconds: Annotated[
        float | None, typer.Option("--seconds", metavar="T", help="Choose model, paths and tiles to be done in T.")
    ] = None,
    memory: Annotated[
        float | None, typer.Option("--memory", metavar="MB", help="Choose them to hold no more than this.")
    ] = None,
    leave_out: Annotated[
        str,
        typer.Option(
            help="What is not computed where the picture does not need it: all, none, or some of branches, tiles "
            "(exact), converged and paths (approximate), with commas between."
        ),
    ] = "all",
    keep_samples: Annotated[bool, typer.Option("--keep-samples", help="Copy the noisy samples as well.")] = False,
    quiet: Annotated[bool, typer.Option("-q", "--quiet", help="Print errors only.")] = False,
) -> None:
    """Denoise an EXR. Channels are found by the conventions of the common renderers; all others are kept.

    A sequence (frames.####.exr) is denoised frame by frame with the exposure of its first frame. --seconds and --memory
    choose among the shipped models, or how to run the one of --model, by a trial on a piece of the (first) picture.
    """
    buffers = parse_map(mapping or [])
    pairs = expand(source, output)
    for _, clean in pairs:
        check_output(clean)
    if not quiet and (skipped := similar(source, output)):
        console.say(f"not of the sequence {source.name}: {', '.join(skipped)}")
    options: dict[str, Any] = {"provider": provider, "threads": threads, "precision": precision, "leave_out": leave_out}
    denoiser: Denoiser | Budget
    with console.usage():
        if seconds is None and memory is None:
            denoiser = Denoiser(model or models.DEFAULT, **options)
        else:
            denoiser = Budget(seconds, memory, model, **options)
    guides = {"albedo": albedo, "normal": normal, "depth": depth, "variance": variance}
    exposures = [] if exposure is None else [exposure]
    for number, (noisy, clean) in enumerate(pairs):
        title = noisy.name if len(pairs) == 1 else f"{noisy.name} ({number + 1}/{len(pairs)})"
        with console.progress(title, quiet) as bar:
            done = denoise_file(
                noisy,
                clean,
                denoiser,
                mapping=buffers,
                layers=layer or [],
                guides={name: path for name, path in guides.items() if path},
                exposures=exposures,
                keep_samples=keep_samples,
                progress=bar,
            )
        exposures = exposures or [one.result.report["exposure"] for one in done]
        for one in done:
            if one.lost:
                console.complain(f"{noisy}: none of the {one.lost} pixels has finite color; {clean} is black there")
        if not quiet:
            for one in done:
                for line in frame_lines(noisy, one.frame) if number == 0 else ():
                    console.say(line)
                for line in (*one.converted, *one.budget) if number == 0 else ():
                    console.say(f"  {line}")
                if one.layers:
                    console.say(f"  filtered alike: {', '.join(one.layers)}")
                if one.left:
                    told = (f"{layer} ({what})" for layer, what in one.left.items())
                    console.say(f"  no radiance, left as they are: {', '.join(told)}")
                for line in result_lines(one.result.report):
                    console.say(line)
                if stay := noisy_layers(one):
                    console.say(f"  as noisy as before: {', '.join(stay)}; name radiance layers with --layer")
            console.say(f"{clean}")
            for line in done[-1].written:
                console.say(f"  {line}")


def parse_map(entries: Sequence[str]) -> dict[str, str]:
    """`--map` entries, "buffer=layer" each, as a dictionary."""
    parsed = {}
    for entry in entries:
        buffer, equals, layer = entry.partition("=")
        if not equals or not buffer or not layer:
            raise typer.BadParameter(f"--map {entry}: write BUFFER=LAYER, for example albedo=MyAlbedo or normal=none")
        parsed[buffer] = layer
    return parsed


def frame_lines(path: Path, frame: Frame) -> Iterator[str]:
    """What was mapped to what."""
    width, height = frame.size
    view = f"view {frame.color_layer.view}, " if frame.color_layer.view else ""
    yield f"{path}: {width}x{height}, {view}channel names of {frame.preset.title}"
    for line in (*frame.lines(), *frame.notes):
        yield f"  {line}"


def noisy_layers(one: Denoised) -> list[str]:
    """The parts of the beauty that the model did not filter and nobody asked for."""
    sources = one.frame.sources
    parts = {name: sources[name] for name in ("diffuse", "specular") if name in sources}
    # the beauty may be all diffuse, and what is only computed, beauty less diffuse, is in no layer
    stay = {name: str(source) for name, source in parts.items() if source != sources["color"] and not source.subtract}
    return [layer for name, layer in stay.items() if layer not in one.layers and getattr(one.result, name) is None]


def mended(buffer: str, faults: dict[str, int]) -> str:
    """What was wrong with a buffer: "albedo 5120 above 1 (clamped)"."""
    return f"{buffer} {', '.join(f'{count} {what}' for what, count in faults.items())}"


def result_lines(report: dict[str, Any]) -> Iterator[str]:
    """What a run used, mended, left out and took."""
    inputs = report["inputs"]
    yield f"  {report['model']}, precision {report['precision']}, read {', '.join(inputs['used'])}"
    if inputs["missing"]:
        yield f"  not there: {', '.join(inputs['missing'])}"
    if report["sanitised"]:
        yield f"  mended: {'; '.join(mended(*entry) for entry in report['sanitised'].items())}"
    if report["repaired"]:
        yield f"  left noisy: {report['repaired']} values, for which the network gave no finite kernel"
    for note in report["notes"]:
        yield f"  note: {note}"
    for entry in report["left_out"]:
        saved = f" (saved about {entry['saved_ms']:.3g} ms)" if "saved_ms" in entry else ""
        yield f"  left out {entry['what']}: {entry['why']}{saved}"
    spent = ", ".join(f"{stage} {took:.0f}" for stage, took in report["ms"].items() if stage != "total")
    yield f"  exposure {report['exposure']:.4g}, {report['ms']['total']:.0f} ms ({spent})"
