"""Rendering and training in one process, without a data set on disk."""

import json
from pathlib import Path

import pytest

pytest.importorskip("mitsuba")

from pathfold_training.cli import app
from pathfold_training.fit import live
from pathfold_training.fit.live import Live, LiveViews
from pathfold_training.fit.preset import Config, Data, Optimiser
from pathfold_training.fit.train import fit
from pathfold_training.networks.kpcn.sizes import KpcnSizes
from typer.testing import CliRunner

SMALL = Live(budget=0.0, size=24, spp=4, every=2)


@pytest.fixture
def few(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(live, "FIRST", 1)
    monkeypatch.setattr(live, "POOL", 2)
    monkeypatch.setattr(live, "HELD_OUT", 1)


@pytest.mark.long
@pytest.mark.usefixtures("few")
def test_training_renders_what_it_learns_from(tmp_path: Path) -> None:
    config = Config(
        name="tiny",
        description="a network for tests",
        network=KpcnSizes(width=8, layers=3, kernel_size=5, embedding=3, embedding_width=4),
        data=Data(crop=16, batch=2, spp_max=4),
        optimiser=Optimiser(steps=5, precision="fp32", warmup=1),
    )
    fit(config, SMALL, tmp_path / "run", seed=2, threads=1, validate_every=1000)
    record = json.loads((tmp_path / "run" / "record.json").read_text())
    assert record["data"]["views"] == record["data"]["procedural"] == 3  # at steps 0, 2 and 4
    assert record["data"]["validation_views"] == 1
    assert not list(tmp_path.glob("**/*.safetensors"))


@pytest.mark.long
@pytest.mark.usefixtures("few")
def test_the_pool_moves_on_and_depends_on_seed_process_and_step_alone() -> None:
    views = LiveViews(SMALL, seed=2)
    first = views(0)
    assert views(1) == first
    second = views(2)
    assert second[0] is first[0]
    assert len(second) == 2
    third = views(4)
    assert third[0] is second[1]
    again = LiveViews(SMALL, seed=2)(4)
    for one, two in zip(third, again, strict=True):
        assert (one.tensor("samples.radiance") == two.tensor("samples.radiance")).all()
    names = [line["id"] for line in views.lines]
    shares = [LiveViews(SMALL, seed=2, process=n, processes=2) for n in range(2)]
    for share in shares:
        share(0)
    assert names[0] == shares[0].lines[0]["id"] != shares[1].lines[0]["id"]


def test_data_and_rendering_exclude_each_other(tmp_path: Path) -> None:
    arguments = ["fit", "kpcn-vanilla", "--out", str(tmp_path / "run")]
    for wrong in ([], ["--render-on-the-fly", "--data", str(tmp_path)]):
        result = CliRunner().invoke(app, arguments + wrong)
        assert "give --data DIR, or --render-on-the-fly" in str(result.exception)
