"""`denoise` at the command line: what it writes and what it says."""

import os
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest
from exr_files import RGB, SIZE, beauty, noise, part, with_samples, write
from pathfold.channels import ALL_LIGHT, samples
from pathfold.cli import console
from pathfold.images import ImageFile, NewPart, write_parts


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
    arguments = ["-m", "split-5", "--map", "albedo=none", "--layer", "fi*", "--exposure", "2"]
    code, out, _ = run("denoise", source, "-o", tmp_path / "out.exr", *arguments)
    assert code == 0 and "albedo <-" not in out and "exposure 2," in out
    before, after = ImageFile(source), ImageFile(tmp_path / "out.exr")
    assert (before.read(0, range(7, 10)) != after.read(0, range(7, 10))).all((0, 1)).any()


def test_denoise_says_what_it_made_of_an_albedo(run, tmp_path: Path) -> None:
    names = [*RGB, "A", *(f"albedo.{c}" for c in RGB)]
    values = noise(7) / 4
    values[:4, :, 3:] = 0
    source = write(tmp_path / "in.exr", [part("", names, ["float"] * 7, values, Software="appleseed 2.1")])
    code, out, _ = run("denoise", source, "-o", tmp_path / "out.exr", "-m", "single-3")
    assert code == 0 and "made 1 in" not in out  # this model reads no albedo
    code, out, _ = run("denoise", source, "-o", tmp_path / "out.exr", "-m", "split-5")
    assert code == 0 and "  albedo is 0 on misses: made 1 in" in out and "by coverage (alpha)" in out


def test_denoise_says_what_it_left_out(run, tmp_path: Path) -> None:
    source = with_samples(tmp_path / "in.exr", specular=0)
    arguments = ["denoise", source, "-o", tmp_path / "out.exr", "-m", "split-5"]
    assert "left out branch specular: specular is constant there" in run(*arguments)[1]
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


@pytest.mark.skipif(not hasattr(os, "sched_setaffinity"), reason="needs processes that can be held to one core")
def test_denoise_on_one_core_takes_one_thread(tiny: Path, tmp_path: Path) -> None:
    beauty(tmp_path / "in.exr")
    code = (
        "import os, sys; os.sched_setaffinity(0, {min(os.sched_getaffinity(0))}); from pathfold.cli import app;"
        "sys.argv = ['pathfold', 'denoise', 'in.exr', '-o', 'out.exr', '-m', 'single-3', '--quiet']; app()"
    )
    run = subprocess.run([sys.executable, "-c", code], cwd=tmp_path, capture_output=True, text=True)
    assert (run.returncode, run.stderr) == (0, "")
