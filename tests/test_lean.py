"""`render --auto`: what a scene or a frame does not need is not there, and the denoised picture is the same."""

from pathlib import Path

import numpy as np
import pytest
from lean_scenes import BALL, PLASTIC, POINT, SCENES, TOUCHING, make_scene
from pathfold.channels import samples
from pathfold.cli import app, console
from pathfold.images import ImageFile, NewPart, write_parts

pytest.importorskip("mitsuba")


@pytest.fixture
def run(tiny: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]):
    """Run a command line in this process, which must succeed; what it says."""

    def call(*arguments: object) -> str:
        monkeypatch.setattr("sys.argv", ["pathfold", *map(str, arguments)])
        capsys.readouterr()
        code = console.run(app)
        captured = capsys.readouterr()
        assert code == 0, captured.err
        return captured.out

    return call


def buffers_of(file: ImageFile) -> set[str]:
    return {layer.name or "color" for layer in file.layers if layer.part == 0} | (
        {"alpha"} if "A" in file.parts[0].channelnames else set()
    )


@pytest.mark.parametrize("name", SCENES)
def test_what_is_left_out_changes_nothing(run, tmp_path: Path, name: str) -> None:
    things, spp, unneeded = SCENES[name]
    scene = make_scene(tmp_path / "scene.xml", things)
    arguments = ["render", scene, "--spp", spp, "--seed", 3, "--for", "samples-5"]
    run(*arguments, "-o", tmp_path / "full.exr")
    said = run(*arguments, "-o", tmp_path / "lean.exr", "--auto")
    full, lean = ImageFile(tmp_path / "full.exr"), ImageFile(tmp_path / "lean.exr")
    assert buffers_of(full) - buffers_of(lean) == unneeded
    for buffer in unneeded:
        assert any("left out" in line and buffer in line and ": " in line for line in said.splitlines())

    shown = {}
    for file in (full, lean):
        out = file.path.with_suffix(".clean.exr")
        run("denoise", file.path, "-o", out, "-m", "samples-5")
        shown[file.path.stem] = ImageFile(out).read(0, range(3))
    np.testing.assert_allclose(shown["lean"], shown["full"], rtol=1e-5, atol=1e-7)

    # Straight through memory: the same again.
    run(*arguments[:-2], "-o", tmp_path / "memory.exr", "--auto", "--denoise", "samples-5")
    np.testing.assert_allclose(
        ImageFile(tmp_path / "memory.exr").read(0, range(3)), shown["full"], rtol=1e-5, atol=1e-7
    )


def test_a_frame_that_needs_everything_gets_the_same_file(run, tmp_path: Path) -> None:
    scene = make_scene(tmp_path / "scene.xml", [BALL.format(PLASTIC), TOUCHING.format(PLASTIC), POINT])
    arguments = ["render", scene, "--spp", 2, "--max-depth", 3, "--for", "samples-5"]
    run(*arguments, "-o", tmp_path / "full.exr")
    said = run(*arguments, "-o", tmp_path / "lean.exr", "--auto")
    assert "left out nothing" in said
    full, lean = ImageFile(tmp_path / "full.exr"), ImageFile(tmp_path / "lean.exr")
    for part, (one, other) in enumerate(zip(full.parts, lean.parts, strict=True)):
        assert one.channelnames == other.channelnames
        numbers = range(one.nchannels)
        assert np.array_equal(full.read(part, numbers), lean.read(part, numbers))


def test_vertices_that_no_path_has_are_not_stored(run, tmp_path: Path) -> None:
    """A single ball under a light: what it scatters does not come back."""
    scene = make_scene(tmp_path / "scene.xml", [BALL.format(PLASTIC), POINT])
    said = run("render", scene, "--spp", 2, "-o", tmp_path / "lean.exr", "--for", "samples-5", "--auto")
    assert "left out path vertices from 2 on: no path of the frame has them" in said
    block = samples.load(ImageFile(tmp_path / "lean.exr"))["descriptor"]
    assert block.shape[-1] == 6 + 5


def test_a_file_that_says_nonsense_of_its_light_is_named(run, tmp_path: Path, capsys: pytest.CaptureFixture) -> None:
    path = tmp_path / "odd.exr"
    part = NewPart("", ["R", "G", "B"], ["float"] * 3, (4, 4), lambda first, last: np.ones((last - first, 4, 3), "f"))
    write_parts(path, [part], {"pathfold:all_light": "green"})
    with pytest.raises(AssertionError, match="pathfold:all_light is 'green'; it must be diffuse or specular"):
        run("denoise", path, "-o", tmp_path / "out.exr", "-m", "split-5")
