"""`render` at the command line."""

import os
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest
from exr_files import RGB, noise, part, write
from pathfold.channels import samples
from pathfold.cli import console
from pathfold.images import ImageFile

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


@pytest.mark.parametrize(
    "options", [("--rr-depth", -3), ("--max-depth", 10**11), ("--variant", "scalar_rgb"), ("--size", "0x0")]
)
def test_render_refuses_what_cannot_be_traced(run, tmp_path: Path, options: tuple[object, ...]) -> None:
    (tmp_path / "scene.xml").write_text(SCENE)
    code, _, err = run("render", tmp_path / "scene.xml", "-o", tmp_path / "out.exr", *options)
    assert code == console.USAGE and str(options[0]) in err and err.count("\n") == 1


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


def test_a_variant_without_its_driver_is_named(run, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    mi = pytest.importorskip("mitsuba")

    def refuse(variant: str) -> None:
        raise ImportError("jit_init_thread_state(): the CUDA backend is inactive")

    monkeypatch.setattr(mi, "set_variant", refuse)
    code, _, err = run("render", tmp_path / "no.xml", "-o", tmp_path / "out.exr", "--variant", "llvm_ad_rgb")
    assert code == 4 and err.count("\n") == 1
    assert "--variant llvm_ad_rgb: cannot run here: " in err and "; use llvm_ad_rgb" in err
