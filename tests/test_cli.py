"""The command line: what it writes, what it says, and how it fails."""

import contextlib
import json
import os
import shutil
import signal
import subprocess
import sys
import time
from pathlib import Path

import numpy as np
import pytest
from exr_files import SIZE, noise, part, write
from pathfold import metrics
from pathfold.channels import ALL_LIGHT, samples
from pathfold.cli import app, console
from pathfold.images import ImageFile, NewPart, write_parts

RGB = ["R", "G", "B"]
SCENE = """<scene version="3.0.0">
    <sensor type="perspective">
        <transform name="to_world"><lookat origin="0, 0, 4" target="0, 0, 0" up="0, 1, 0"/></transform>
        <film type="hdrfilm"><integer name="width" value="24"/><integer name="height" value="16"/>
            <rfilter type="box"/></film>
    </sensor>
    <shape type="sphere"><bsdf type="roughplastic"><float name="alpha" value="0.2"/></bsdf></shape>
    <shape type="rectangle">
        <transform name="to_world"><scale value="4"/><translate z="-1"/></transform>
    </shape>
    <emitter type="point"><point name="position" x="2" y="3" z="3"/>
        <rgb name="intensity" value="20, 18, 15"/></emitter>
</scene>
"""

Captured = pytest.CaptureFixture[str]


@pytest.fixture
def run(tiny: Path, monkeypatch: pytest.MonkeyPatch, capsys: Captured):
    """Run a command line in this process: (exit code, stdout, stderr)."""

    def call(*arguments: object) -> tuple[int, str, str]:
        monkeypatch.setattr(sys, "argv", ["pathfold", *map(str, arguments)])
        capsys.readouterr()
        code = console.run(app)
        captured = capsys.readouterr()
        return code, captured.out, captured.err

    return call


def beauty(path: Path, seed: int = 0, extra: int = 3) -> Path:
    """A half-float picture with alpha, albedo and a layer that nobody knows."""
    names = [*RGB, "A", *(f"albedo.{c}" for c in RGB), *(f"matte.{c}" for c in RGB[:extra])]
    values = noise(len(names), seed)
    values[..., 3:7] = np.clip(values[..., 3:7], 0, 1)
    return write(path, [part("", names, ["half"] * len(names), values, artist="nobody")])


def with_samples(path: Path, count: int = 2) -> Path:
    """A picture of our own with split buffers and path descriptors."""
    rng = np.random.default_rng(7)
    block = {
        "descriptor": rng.normal(0, 1, (count, SIZE[1], SIZE[0], 36)).astype(np.float16),
        "density": rng.normal(0, 1, (count, SIZE[1], SIZE[0], 1)).astype(np.float32),
    }
    names = [*RGB, *(f"{layer}.{c}" for layer in ("diffuse", "specular", "diffuse.albedo") for c in RGB)]
    values = noise(12)
    values[..., :3] = values[..., 3:6] + values[..., 6:9]
    buffers = NewPart("buffers", names, ["float"] * 12, SIZE, lambda first, last: values[first:last])
    write_parts(path, [buffers, samples.to_part(block)], {"pathfold:version": "0", "pathfold:spp": count})
    return path


def test_denoise_changes_the_beauty_and_keeps_the_rest(run, tmp_path: Path) -> None:
    source, target = beauty(tmp_path / "in.exr"), tmp_path / "out.exr"
    code, out, err = run("denoise", source, "-o", target, "--model", "split-5")
    assert (code, err) == (0, "")
    assert "color <- R,G,B" in out and "albedo <- albedo" in out and "exposure" in out
    before, after = ImageFile(source), ImageFile(target)
    assert after.parts[0].channelnames == before.parts[0].channelnames
    assert str(after.parts[0].format) == "half" and after.metadata()["artist"] == "nobody"
    changed = (before.read(0, range(10)) != after.read(0, range(10))).any((0, 1))
    assert changed.tolist() == [True] * 4 + [False] * 6
    assert not [path for path in tmp_path.iterdir() if path not in (source, target)]


def test_denoise_map_layer_and_exposure(run, tmp_path: Path) -> None:
    source = beauty(tmp_path / "in.exr")
    arguments = ["-m", "split-5", "--map", "albedo=none", "--layer", "mat*", "--exposure", "2"]
    code, out, _ = run("denoise", source, "-o", tmp_path / "out.exr", *arguments)
    assert code == 0 and "albedo <-" not in out and "exposure 2," in out
    before, after = ImageFile(source), ImageFile(tmp_path / "out.exr")
    assert (before.read(0, range(7, 10)) != after.read(0, range(7, 10))).all((0, 1)).any()


def test_denoise_says_what_it_left_out(run, tmp_path: Path) -> None:
    source = with_samples(tmp_path / "in.exr")
    arguments = ["denoise", source, "-o", tmp_path / "out.exr", "-m", "split-5"]
    assert "left out input color: not read by the model for this frame (saved about" in run(*arguments)[1]
    code, out, _ = run(*arguments, "--leave-out", "none")
    assert code == 0 and "left out" not in out
    code, _, err = run(*arguments, "--leave-out", "pixels")
    assert code == console.USAGE and 'leave_out is "pixels"; it must be all, none' in err


def test_denoise_says_which_parts_of_the_beauty_stay_noisy(run, tmp_path: Path) -> None:
    arguments = ["denoise", with_samples(tmp_path / "in.exr"), "-o", tmp_path / "out.exr", "-m"]
    assert "as noisy as before: diffuse, specular; name radiance layers with --layer" in run(*arguments, "single-3")[1]
    assert "as noisy as before: specular;" in run(*arguments, "single-3", "--layer", "diffuse")[1]
    assert "as noisy" not in run(*arguments, "split-5")[1]
    whole = tmp_path / "whole.exr"  # its beauty is all diffuse light, which is denoised
    names = [*RGB, *(f"diffuse.albedo.{c}" for c in RGB)]
    buffers = NewPart("buffers", names, ["float"] * 6, SIZE, lambda first, last: noise(6)[first:last])
    write_parts(whole, [buffers], {"pathfold:version": "0", ALL_LIGHT: "diffuse"})
    said = run(*arguments[:1], whole, *arguments[2:], "single-3")[1]
    assert "diffuse <- R,G,B" in said and "as noisy" not in said


def test_denoise_in_a_precision(run, tmp_path: Path) -> None:
    source, target = beauty(tmp_path / "in.exr"), tmp_path / "out.exr"
    for precision in ("fp32", "int8"):
        code, out, _ = run("denoise", source, "-o", target, "-m", "quantised-3", "--precision", precision)
        assert code == 0 and f"quantised-3, precision {precision}, read " in out
        assert ImageFile(target).metadata()["pathfold:precision"] == precision
    assert "fp32, int8 (RelL2 1.005 of fp32's); runs in " in run("info", "quantised-3")[1]
    code, _, err = run("denoise", source, "-o", target, "-m", "single-3", "--precision", "int8")
    assert code == 4 and "single-3 has no int8 variant" in err


def test_denoise_quietly(run, tmp_path: Path) -> None:
    source = beauty(tmp_path / "in.exr")
    assert run("denoise", source, "-o", tmp_path / "out.exr", "-q", "-m", "single-3") == (0, "", "")


def test_a_picture_without_a_finite_pixel_is_told_of(run, tmp_path: Path) -> None:
    source = write(tmp_path / "nan.exr", [part("", RGB, ["float"] * 3, np.full((9, 12, 3), np.nan))])
    code, out, err = run("denoise", source, "-o", tmp_path / "out.exr", "-m", "single-3", "-q")
    assert (code, out) == (0, "")
    assert "nan.exr: none of the 108 pixels has finite color" in err and err.count("\n") == 1


def test_samples_are_used_and_not_copied_unless_asked(run, tmp_path: Path) -> None:
    source = with_samples(tmp_path / "in.exr")
    code, out, _ = run("denoise", source, "-o", tmp_path / "out.exr", "-m", "samples-5")
    assert code == 0 and "samples.descriptor" in out
    assert len(ImageFile(tmp_path / "out.exr").parts) == 1
    assert run("denoise", source, "-o", tmp_path / "all.exr", "-m", "samples-5", "--keep-samples")[0] == 0
    kept = samples.load(ImageFile(tmp_path / "all.exr"))
    assert kept["descriptor"].tobytes() == samples.load(ImageFile(source))["descriptor"].tobytes()
    clean = ImageFile(tmp_path / "out.exr")
    color, diffuse, specular = (clean.read(0, at) for at in (range(3), range(3, 6), range(9, 12)))
    names = clean.parts[0].channelnames
    assert [names[3], names[9]] == ["diffuse.R", "specular.R"]
    assert color == pytest.approx(diffuse + specular, rel=1e-5)


def test_file_and_memory_agree(run, tmp_path: Path) -> None:
    import pathfold

    source = with_samples(tmp_path / "in.exr")
    run("denoise", source, "-o", tmp_path / "out.exr", "-m", "samples-5")
    file = ImageFile(source)

    def layer(name: str) -> np.ndarray:
        return file.read(0, file.layer(name).pick(3))

    result = pathfold.Denoiser("samples-5").run(
        layer(""),
        diffuse=layer("diffuse"),
        specular=layer("specular"),
        diffuse_albedo=layer("diffuse.albedo"),
        samples=samples.load(file),
    )
    assert (ImageFile(tmp_path / "out.exr").read(0, range(3)) == result.color).all()


def test_sequences_share_the_exposure_of_the_first_frame(run, tmp_path: Path) -> None:
    for number in (8, 9, 10):
        beauty(tmp_path / f"f.{number:04d}.exr", number)
    code, out, _ = run("denoise", tmp_path / "f.####.exr", "-o", tmp_path / "clean.##.exr", "-m", "single-3")
    assert code == 0
    clean = [ImageFile(tmp_path / f"clean.{number:02d}.exr") for number in (8, 9, 10)]
    assert len({file.metadata()["pathfold:exposure"] for file in clean}) == 1
    assert out.count("color <-") == 1


def test_guides_in_files_of_their_own(run, tmp_path: Path) -> None:
    for tag, seed in (("hdr", 0), ("alb", 1), ("nrm", 2)):
        write(tmp_path / f"shot.{tag}.exr", [part("", RGB, ["float"] * 3, np.clip(noise(3, seed), 0, 1))])
    _, out, _ = run("denoise", tmp_path / "shot.hdr.exr", "-o", tmp_path / "a.exr", "-m", "split-5")
    assert "read albedo, color, normal" in out
    bare = write(tmp_path / "bare.exr", [part("", RGB, ["float"] * 3, noise(3))])
    _, out, _ = run("denoise", bare, "-o", tmp_path / "b.exr", "-m", "split-5", "--alb", tmp_path / "shot.alb.exr")
    assert "read albedo, color\n" in out


def test_compare(run, tmp_path: Path) -> None:
    a, b = noise(3, 1), noise(3, 2)
    for name, values in (("a", a), ("b", b)):
        write(tmp_path / f"{name}.exr", [part("", RGB, ["float"] * 3, values)])
    code, out, _ = run("compare", tmp_path / "a.exr", tmp_path / "b.exr", "--json")
    assert code == 0 and json.loads(out) == pytest.approx(metrics.compare(a, b))
    assert run("compare", tmp_path / "a.exr", tmp_path / "b.exr")[1].startswith("rell2 ")


def test_compare_with_halves(run, tmp_path: Path) -> None:
    x, a, b = noise(3, 1), noise(3, 2), noise(3, 3)
    write(tmp_path / "x.exr", [part("", RGB, ["float"] * 3, x)])
    names = [*RGB, *(f"half_a.{c}" for c in RGB), *(f"half_b.{c}" for c in RGB)]
    write(tmp_path / "r.exr", [part("", names, ["float"] * 9, np.concatenate([(a + b) / 2, a, b], -1))])
    values = json.loads(run("compare", tmp_path / "x.exr", tmp_path / "r.exr", "--json")[1])
    assert values["rell2"] == pytest.approx(metrics.rell2_halves(x, a, b), rel=1e-5)


def test_info(run, tmp_path: Path) -> None:
    assert "split-5" in run("info")[1]
    out = run("info", "samples-5")[1]
    assert "requires      color, samples.descriptor, samples.density" in out
    out = run("info", with_samples(tmp_path / "in.exr"))[1]
    assert "2 samples per pixel" in out and "diffuse.albedo <- diffuse.albedo" in out
    assert "not found: alpha" in out


def test_version_and_help(run) -> None:
    import pathfold

    assert run("--version") == (0, f"pathfold {pathfold.version()}\n", "")
    code, out, err = run()
    assert code == 2 and "Usage: " in out + err and "pathfold: " not in err
    assert all(command in run("--help")[1] for command in ("denoise", "render", "info", "compare", "Exit codes"))


@pytest.mark.parametrize(
    "options", [("--rr-depth", -3), ("--max-depth", 10**11), ("--variant", "scalar_rgb"), ("--size", "0x0")]
)
def test_render_refuses_what_cannot_be_traced(run, tmp_path: Path, options: tuple[object, ...]) -> None:
    (tmp_path / "scene.xml").write_text(SCENE)
    code, _, err = run("render", tmp_path / "scene.xml", "-o", tmp_path / "out.exr", *options)
    assert code == console.USAGE and str(options[0]) in err and err.count("\n") == 1


def test_an_interrupt_is_noticed_even_where_a_library_drops_it(run, monkeypatch: pytest.MonkeyPatch) -> None:
    def dropped(*_arguments: object, **_options: object) -> None:
        with console.progress("work", quiet=True) as tell:
            with contextlib.suppress(KeyboardInterrupt):
                os.kill(os.getpid(), signal.SIGINT)
                time.sleep(5)
            tell(0.5)
            pytest.fail("went on")

    before = signal.signal(signal.SIGINT, signal.default_int_handler)  # pytest's workers ignore it
    monkeypatch.setattr(sys.modules["pathfold.cli.info"], "installation", dropped)
    try:
        code, _, err = run("info")
        assert signal.getsignal(signal.SIGINT) is signal.default_int_handler
    finally:
        signal.signal(signal.SIGINT, before)
    assert (code, err) == (console.INTERRUPTED, "pathfold: interrupted; no file was left half written\n")


def test_render(run, tmp_path: Path) -> None:
    pytest.importorskip("mitsuba")
    (tmp_path / "scene.xml").write_text(SCENE)
    arguments = ["render", tmp_path / "scene.xml", "--spp", 3, "--seed", 5, "--max-depth", 4, "--size", "20x12"]
    code, _, err = run(*arguments, "-o", tmp_path / "noisy.exr", "--for", "samples-5")
    assert (code, err) == (0, "")
    file = ImageFile(tmp_path / "noisy.exr")
    assert (file.parts[0].width, file.parts[0].height) == (20, 12)
    assert samples.count(file) == 3
    kinds = dict(zip(file.parts[1].channelnames, map(str, file.parts[1].channelformats), strict=True))
    assert kinds["samples.000.path.density"] == "float" and kinds["samples.000.path.tag.0"] == "half"

    # A path of depth 4 has at most 3 vertices; the others are not written.
    assert "samples.000.path.tag.2" in kinds and "samples.000.path.tag.3" not in kinds

    # Through the file or straight through memory: the same pixels.
    assert run("denoise", tmp_path / "noisy.exr", "-o", tmp_path / "a.exr", "-m", "samples-5")[0] == 0
    assert run(*arguments, "-o", tmp_path / "b.exr", "--denoise", "samples-5")[0] == 0
    a, b = ImageFile(tmp_path / "a.exr"), ImageFile(tmp_path / "b.exr")
    assert len(b.parts) == 1
    assert (a.read(0, range(4)) == b.read(0, range(4))).all()

    # A model that reads no samples gets none.
    assert run(*arguments, "-o", tmp_path / "plain.exr", "--for", "single-3")[0] == 0
    assert len(ImageFile(tmp_path / "plain.exr").parts) == 1


def test_render_in_bands_shows_the_same_picture(run, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    pytest.importorskip("mitsuba")
    (tmp_path / "scene.xml").write_text(SCENE)
    arguments = ["render", tmp_path / "scene.xml", "--spp", 64, "--max-depth", 3, "--for", "split-5"]
    assert run(*arguments, "-o", tmp_path / "whole.exr")[0] == 0
    monkeypatch.setattr("pathfold.rendering.BAND_SAMPLES", 24 * 64 * 5)  # bands of 5 rows
    assert run(*arguments, "-o", tmp_path / "bands.exr")[0] == 0
    whole, bands = (ImageFile(tmp_path / name) for name in ("whole.exr", "bands.exr"))
    for name in ("depth", "normal"):
        at = whole.layer(name).channels.values()
        assert np.abs(whole.read(0, [*at]) - bands.read(0, [*at])).mean() < 0.02


@pytest.mark.skipif(not hasattr(os, "sched_setaffinity"), reason="needs processes that can be held to one core")
def test_render_on_one_core(tmp_path: Path) -> None:
    pytest.importorskip("mitsuba")
    write(tmp_path / "sky.exr", [part("", RGB, ["float"] * 3, noise(3))])  # a reader that shares its work out
    sky = '<emitter type="envmap"><string name="filename" value="sky.exr"/></emitter></scene>'
    (tmp_path / "scene.xml").write_text(SCENE.replace("</scene>", sky))
    code = (
        "import os, sys; os.sched_setaffinity(0, {min(os.sched_getaffinity(0))}); from pathfold.cli import app;"
        "sys.argv = ['pathfold', 'render', 'scene.xml', '-o', 'out.exr', '--spp', '1', '--quiet']; app()"
    )
    run = subprocess.run([sys.executable, "-c", code], cwd=tmp_path, capture_output=True, text=True, timeout=300)
    assert run.returncode == 0, run.stderr
    assert (tmp_path / "out.exr").is_file()


@pytest.mark.skipif(not hasattr(os, "sched_setaffinity"), reason="needs processes that can be held to one core")
def test_denoise_on_one_core_takes_one_thread(tiny: Path, tmp_path: Path) -> None:
    beauty(tmp_path / "in.exr")
    code = (
        "import os, sys; os.sched_setaffinity(0, {min(os.sched_getaffinity(0))}); from pathfold.cli import app;"
        "sys.argv = ['pathfold', 'denoise', 'in.exr', '-o', 'out.exr', '-m', 'single-3', '--quiet']; app()"
    )
    run = subprocess.run([sys.executable, "-c", code], cwd=tmp_path, capture_output=True, text=True)
    assert (run.returncode, run.stderr) == (0, "")


def test_a_variant_without_its_driver_is_named(run, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    mi = pytest.importorskip("mitsuba")

    def refuse(variant: str) -> None:
        raise ImportError("jit_init_thread_state(): the CUDA backend is inactive")

    monkeypatch.setattr(mi, "set_variant", refuse)
    code, _, err = run("render", tmp_path / "no.xml", "-o", tmp_path / "out.exr", "--variant", "llvm_ad_rgb")
    assert code == 4 and err.count("\n") == 1
    assert "--variant llvm_ad_rgb: cannot run here: " in err and "; use llvm_ad_rgb" in err


def failing(tmp_path: Path) -> dict[str, tuple[list[object], int, str]]:
    """Command lines that must fail: arguments, exit code, what the one line says."""
    good = beauty(tmp_path / "good.exr")
    text = tmp_path / "text.exr"
    text.write_text("not a picture")
    (tmp_path / "empty.xml").write_text('<scene version="3.0.0"><sensor type="perspective"/></scene>')
    (tmp_path / "broken.xml").write_text("<scene")
    no_color = write(tmp_path / "no.exr", [part("", ["N.X", "N.Y", "N.Z"], ["float"] * 3, noise(3))])
    rg = write(tmp_path / "rg.exr", [part("", ["R", "G"], ["float"] * 2, noise(2))])
    small = write(tmp_path / "small.exr", [part("", RGB, ["float"] * 3, noise(3, size=(8, 8)))])
    nan = write(tmp_path / "nan.exr", [part("", RGB, ["float"] * 3, np.full((9, 12, 3), np.nan))])
    png = write(tmp_path / "display.png", [part("", RGB, ["uint8"] * 3, noise(3) / 4)])
    out = ["-o", tmp_path / "out.exr", "-m", "split-5"]
    scene = ["-o", tmp_path / "out.exr", "--for", "split-5"]
    lost, bare = tmp_path / "no" / "out.exr", tmp_path / "out"
    spoiled = tmp_path / "spoiled"
    spoiled.mkdir()
    (spoiled / "manifest.json").write_text('{"format": 1, "requires": ["color"]}')
    return {
        "missing file": (["denoise", tmp_path / "none.exr", *out], 3, "none.exr: no such file"),
        "not an EXR": (["denoise", text, *out], 3, "text.exr: not a picture that can be read"),
        "display values": (["denoise", png, *out], 3, "display.png: holds uint8 display values"),
        "no color": (["denoise", no_color, *out], 3, "no color found; it has N; name it with --map"),
        "no samples": (["denoise", good, *out[:2], "-m", "samples-5"], 3, "samples.density, samples.descriptor"),
        "no such layer": (["denoise", good, *out, "--map", "normal=N"], 3, "no such layer; it has R,G,B, albedo"),
        "bad map": (["denoise", good, *out, "--map", "normal"], 2, "--map normal: write BUFFER=LAYER"),
        "guide size": (["denoise", good, *out, "--alb", small], 3, "small.exr: 8x8, the picture is 12x9"),
        "no model": (["denoise", good, *out[:2], "-m", "nope"], 4, 'no model "nope"; models found: '),
        "no provider": (["denoise", good, *out, "--provider", "warp"], 4, "provider warp"),
        "no output": (["denoise", good], 2, "Missing option '-o'"),
        "output folder": (["denoise", good, "-o", lost, "-m", "split-5"], 5, "cannot be written"),
        "output type": (["denoise", good, "-o", bare, "-m", "split-5"], 5, "out: "),
        "unknown output type": (["denoise", good, "-o", tmp_path / "out.xyz", "-m", "nope"], 5, "name it .exr"),
        "no exposure": (["denoise", tmp_path / "none.exr", *out, "--exposure", 0], 2, "'--exposure': 0 is not > 0"),
        "exposure of NaN": (["render", good, *scene, "--exposure", "nan"], 2, "'--exposure': nan is not > 0"),
        "color none": (["denoise", good, *out, "--map", "color=none"], 3, "color is what is denoised; name its layer"),
        "no frames": (["denoise", tmp_path / "f.####.exr", "-o", tmp_path / "c.####.exr"], 3, "no file of that name"),
        "one output": (["denoise", tmp_path / "f.####.exr", *out], 3, "needs #### in the name of its output"),
        "no scene": (["render", tmp_path / "no.xml", *scene], 3, "no such file"),
        "bad scene": (["render", tmp_path / "broken.xml", *scene], 3, "broken.xml: not a scene"),
        "not to EXR": (["render", good, "-o", tmp_path / "out.png"], 5, "need an EXR; name it out.exr"),
        "bad size": (["render", tmp_path / "broken.xml", *scene, "--size", "9"], 2, "--size 9"),
        "sizes differ": (["compare", good, small], 3, "good.exr is 12x9"),
        "not finite": (["compare", nan, good], 3, "nan.exr: 108 pixels are not finite"),
        "unknown command": (["denoize"], 2, "No such command 'denoize'"),
        "info on nothing": (["info", "nope"], 4, 'no model "nope"'),
        "info on a folder": (["info", tmp_path], 4, "manifest.json"),
        "info on a spoiled model": (["info", spoiled], 4, "manifest.json"),
        "for a folder": (["render", tmp_path / "no.xml", "-o", out[1], "--for", tmp_path], 4, "with a model in it"),
        "too many samples": (["render", text, *scene[:3], "samples-5", "--spp", 108], 5, "use --spp 107 at most"),
        "scene folder": (["render", tmp_path, *scene], 3, "is a folder; name the scene in it"),
        "no shapes": (["render", tmp_path / "empty.xml", *scene], 3, "empty.xml: has no shapes"),
        "seed out of range": (["render", text, *scene, "--seed", 2**31], 2, "2147483647"),
        "display output": (["denoise", good, "-o", tmp_path / "out.png"], 5, "needs an EXR; name it out.exr"),
        "one input": (["denoise", good, "-o", tmp_path / "c.####.exr"], 3, "which good.exr has not; name one file"),
        "empty model": (["denoise", good, *out[:2], "-m", ""], 2, "is empty; name a model"),
        "exposure alone": (["render", text, *scene, "--exposure", 2], 2, "goes with --denoise MODEL alone"),
        "two models": (["render", text, *scene, "--denoise", "split-5"], 2, "does not go with --denoise"),
        "no blue": (["denoise", rg, *out], 3, "rg.exr: no color found; it has R,G and lacks B; name it"),
    }  # fmt: skip


CASES = (
    "missing file", "not an EXR", "display values", "no color", "no samples", "no such layer", "bad map", "guide size",
    "no model", "no provider", "no output", "output folder", "output type", "no frames", "one output", "no scene",
    "bad scene", "bad size", "not to EXR", "sizes differ", "not finite", "unknown command", "info on nothing",
    "info on a folder", "info on a spoiled model", "for a folder", "unknown output type", "no exposure",
    "exposure of NaN", "color none", "too many samples", "scene folder", "no shapes", "seed out of range",
    "display output", "one input", "empty model", "exposure alone", "two models", "no blue",
)  # fmt: skip


@pytest.mark.parametrize("case", CASES)
def test_failures_are_one_line_and_leave_nothing(run, tmp_path: Path, case: str) -> None:
    arguments, expected, message = failing(tmp_path)[case]
    before = sorted(tmp_path.rglob("*"))
    code, _, err = run(*arguments)
    assert code == expected
    assert message in err and err.startswith("pathfold: ") and err.count("\n") == 1
    assert sorted(tmp_path.rglob("*")) == before


def shell(*arguments: object, **environment: str) -> subprocess.CompletedProcess[str]:
    """The command as a process of its own."""
    command = [sys.executable, "-m", "pathfold", *map(str, arguments)]
    return subprocess.run(command, capture_output=True, text=True, env={**os.environ, **environment}, check=False)


def test_names_cannot_steer_the_terminal(run, tiny: Path, tmp_path: Path) -> None:
    evil = "\x1b]0;owned\x07\x9b2J\u202e"
    source = write(tmp_path / "in.exr", [part("", [*RGB, f"{evil}.Y"], ["float"] * 4, noise(4), artist=evil)])
    out = tmp_path / "out.exr"
    for arguments in (
        ["info", source],
        ["denoise", source, "-o", out, "-m", "single-3", "--layer", "*owned*"],
        ["denoise", source, "-o", out, "-m", "single-3", "--map", "normal=nowhere"],
        ["denoise", source, "-o", out, "-m", evil],
        ["denoise", tmp_path / evil, "-o", out],
    ):
        code, said, complained = run(*arguments)
        shown = said + complained
        assert r"\x1b]0;owned\x07\x9b2J\u202e" in shown, (code, shown)
        assert not any(ord(c) < 32 or 127 <= ord(c) < 160 or c == "\u202e" for c in shown.replace("\n", ""))


def test_a_manifest_cannot_steer_the_terminal(run, tiny: Path, tmp_path: Path) -> None:
    shutil.copytree(tiny / "single-3", tmp_path / "model")
    path = tmp_path / "model" / "manifest.json"
    entry = json.loads(path.read_text())
    for place in (entry, entry["training"]):
        place["name"] = "\x1b[2J"
        path.write_text(json.dumps(entry))
        code, out, err = run("info", tmp_path / "model")
        assert code == 4 and "control character with the code 27" in err and "\x1b" not in out + err
        place["name"] = "fine"


def test_an_absent_onnxruntime_is_named(tiny: Path, tmp_path: Path) -> None:
    source = beauty(tmp_path / "in.exr")
    done = shell(
        "denoise",
        source,
        "-o",
        tmp_path / "out.exr",
        "-m",
        "single-3",
        PATHFOLD_ONNXRUNTIME="/nowhere/libonnxruntime.so",
    )
    assert done.returncode == 4 and done.stdout == ""
    assert "/nowhere/libonnxruntime.so" in done.stderr and done.stderr.count("\n") == 1
    assert [path.name for path in tmp_path.iterdir()] == ["in.exr"]


def test_a_full_disk_leaves_nothing(tiny: Path, tmp_path: Path) -> None:
    source = write(tmp_path / "in.exr", [part("", RGB, ["float"] * 3, noise(3, size=(128, 128)))])
    script = (
        "import resource, sys; resource.setrlimit(resource.RLIMIT_FSIZE, (20000, 20000));"
        "from pathfold.cli import main; sys.argv[0] = 'pathfold'; main()"
    )
    command = [sys.executable, "-c", script, "denoise", source, "-o", tmp_path / "out.exr", "-m", "single-3"]
    done = subprocess.run(list(map(str, command)), capture_output=True, text=True, check=False)
    assert done.returncode == 5, done.stderr
    assert "out.exr: cannot be written" in done.stderr and done.stderr.count("\n") == 1
    assert [path.name for path in tmp_path.iterdir()] == ["in.exr"]


def test_nothing_but_errors_on_stderr_without_a_terminal(tiny: Path, tmp_path: Path) -> None:
    source = beauty(tmp_path / "in.exr")
    done = shell("denoise", source, "-o", tmp_path / "out.exr", "-m", "single-3")
    assert (done.returncode, done.stderr) == (0, "")
