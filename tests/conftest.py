"""Fixtures that several tests share."""

import os
import subprocess
import sys
from pathlib import Path

import pytest
from pathfold.cli import app, console

# before torch is imported: several test processes whose threads wait for each other crawl
os.environ.setdefault("OMP_NUM_THREADS", "1")
ROOT = Path(__file__).parent.parent


@pytest.fixture(scope="session")
def tiny_models(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A folder of models with random weights: single-3, split-5, samples-5, ..."""
    folder = tmp_path_factory.mktemp("models")
    script = ROOT / "sdk" / "tests" / "make_test_models.py"
    subprocess.run([sys.executable, str(script), str(folder)], check=True)
    return folder


@pytest.fixture
def tiny(tiny_models: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """The tiny models can be named."""
    monkeypatch.setenv("PATHFOLD_MODEL_PATH", os.fspath(tiny_models))
    return tiny_models


@pytest.fixture
def run(tiny: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]):
    """Run a command line in this process: (exit code, stdout, stderr)."""

    def call(*arguments: object) -> tuple[int, str, str]:
        monkeypatch.setattr(sys, "argv", ["pathfold", *map(str, arguments)])
        capsys.readouterr()
        code = console.run(app)
        captured = capsys.readouterr()
        return code, captured.out, captured.err

    return call
