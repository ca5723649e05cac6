"""What a user gets who installs the wheel, and what set-up leaves behind."""

import os
import subprocess
import sys
import time
import venv
from pathlib import Path

import pytest

ROOT = Path(__file__).parent.parent

# Runs inside a virtual environment that holds the wheel and what the wheel asks for, nothing else.
USE = """
import importlib.util, sys
import numpy as np
import pathfold
import pathfold_training._taps
from importlib.resources import files

for absent in ("torch", "mitsuba", "lightning"):
    assert importlib.util.find_spec(absent) is None, absent
assert files("pathfold").joinpath("manifest.schema.json").is_file()
assert pathfold.__file__.startswith(sys.prefix), pathfold.__file__
assert "kpcn-vanilla" in pathfold.models.available(), pathfold.models.available()

rng = np.random.default_rng(0)
noisy = rng.exponential(1.0, (48, 64, 3)).astype(np.float32)
clean = pathfold.denoise(noisy)
assert clean.shape == noisy.shape and np.isfinite(clean).all()
assert clean.std() < 0.5 * noisy.std(), (clean.std(), noisy.std())
assert not {"torch", "mitsuba", "OpenImageIO"} & set(sys.modules)
"""


def run(*command: str | Path, cwd: Path = ROOT) -> str:
    """Run a command with nothing of this checkout in its environment; return what it prints."""
    clean = {name: value for name, value in os.environ.items() if not name.startswith(("PATHFOLD_", "PYTHON"))}
    done = subprocess.run(command, cwd=cwd, env=clean, text=True, capture_output=True)
    assert done.returncode == 0, f"{command}\n{done.stdout}{done.stderr}"
    return done.stdout


@pytest.mark.long
def test_wheel_denoises_without_torch(tmp_path: Path) -> None:
    pip = (sys.executable, "-m", "pip")
    run(*pip, "wheel", "--no-deps", "--no-build-isolation", "-w", tmp_path, ROOT)
    (wheel,) = tmp_path.glob("pathfold-*.whl")

    venv.create(tmp_path / "venv", with_pip=True)
    python = tmp_path / "venv" / "bin" / "python"
    run(python, "-m", "pip", "install", "-c", ROOT / "requirements" / "constraints.txt", wheel)

    run(python, "-c", USE, cwd=tmp_path)
    assert "kpcn-vanilla" in run(python, "-m", "pathfold", "info", cwd=tmp_path)


@pytest.mark.long
def test_second_setup_is_quick() -> None:
    run("tools/setup")
    start = time.monotonic()
    printed = run("tools/setup")
    assert time.monotonic() - start < 10
    assert len(printed.splitlines()) == 1, f"did more than look: {printed}"
