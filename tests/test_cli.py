"""The command line: what it says, and how it fails."""

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
from exr_files import RGB, beauty, noise, part, with_samples, write
from pathfold import metrics
from pathfold.cli import console

Captured = pytest.CaptureFixture[str]


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
    assert "2 samples per pixel" in out and "not found: alpha" in out


def test_version_and_help(run) -> None:
    import pathfold

    assert run("--version") == (0, f"pathfold {pathfold.version()}\n", "")
    code, out, err = run()
    assert code == 2 and "Usage: " in out + err and "pathfold: " not in err
    assert all(command in run("--help")[1] for command in ("denoise", "render", "info", "compare", "Exit codes"))


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
        "guide size": (["denoise", good, *out, "--alb", small], 3, "small.exr: 8x8 at 0,0 in a frame of 8x8"),
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
