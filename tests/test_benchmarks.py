"""The logic of measuring scripts under benchmarks/: weights, subsets, classes; not what they measure."""

import json
import math
import sys
from pathlib import Path

import numpy as np
import pytest
import torch
from pathfold.bench.reference import Reference
from pathfold.models import ALL_SAMPLES
from pathfold_training.dataset.store import Store
from pathfold_training.fit.preset import Data, Optimiser, load_preset
from pathfold_training.fit.views import ValidationViews, Window
from pathfold_training.networks.losses import robust_relative
from pathfold_training.release.score import scene_mean
from training_data import write_data_set

sys.path.insert(0, str(Path(__file__).parent.parent / "benchmarks"))

import ablation
import energy
import loader
import pages
import paths_gain
import resolution
import variants

TINY = {
    "network": {"widths": [16, 16, 16, 16], "convolutions": [1, 1, 1, 1], "embedding": 2},
    "data": Data(crop=24, batch=2, spp_max=4).model_dump(),
    "optimiser": Optimiser(steps=2, warmup=1).model_dump(),
}


def test_every_scene_counts_alike() -> None:
    assert scene_mean(["fur", "room", "fur", "fur"], [1.0, 5.0, 2.0, 3.0]) == pytest.approx(3.5)


def test_a_smaller_share_of_scenes_is_part_of_a_larger_one() -> None:
    scenes = [f"scene-{number % 20}" for number in range(50)]
    quarter, half = (ablation.chosen_scenes(scenes, share) for share in (0.25, 0.5))
    assert (len(quarter), len(half)) == (5, 10) and quarter < half
    assert ablation.chosen_scenes(scenes, 1.0) == set(scenes)


def test_a_subset_keeps_what_is_held_out_and_stays_as_it_was(tmp_path: Path) -> None:
    data = write_data_set(tmp_path / "data", views=4)
    index = data / "index.jsonl"
    lines = [json.loads(line) for line in index.read_text().splitlines()]
    index.write_text("".join(json.dumps(line | {"scene": line["id"]}) + "\n" for line in lines))
    kept = Store(ablation.subset(data, tmp_path / "third", 1 / 3)).lines
    assert [line["split"] for line in kept] == ["train", "val"]
    index.write_text(index.read_text().splitlines(keepends=True)[-1])
    assert Store(ablation.subset(data, tmp_path / "third", 1 / 3)).lines == kept


def test_the_loader_is_timed_on_noise_with_cleaned_references(tmp_path: Path) -> None:
    config = ablation.changed(load_preset("pathfold-fast"), TINY)
    config = config.model_copy(update={"data": config.data.model_copy(update={"cleaned": True})})
    found = loader.measure(config, loader.write_noise(tmp_path, 2), 1)
    assert all(math.isfinite(value) and value > 0 for value in found.values())


@pytest.mark.parametrize("run", ["baseline", "kernel-11", "split", "unscaled", "uncleaned", "modulated", "unbiased"])
def test_every_network_trains_and_keeps_a_constant(run: str, tmp_path: Path) -> None:
    variant = next(v for v in ablation.VARIANTS if v.run == run)
    config = ablation.changed(load_preset("pathfold-fast"), TINY)
    data = write_data_set(tmp_path / "data")
    views = ablation.Stored(data).held_out()
    found = ablation.measure(variant, config, 0, data, tmp_path / "run", views)
    assert found["logs"].keys() == {"2", "8"} and all(map(math.isfinite, found["logs"].values()))
    network = variant.network(config.network)
    for head in network.heads:
        torch.nn.init.normal_(head.weight)
    inputs = views_inputs(views[0])
    constant = {name: torch.full_like(inputs[name], 2.5) for name in ("radiance", "diffuse")}
    flat = {name: torch.full_like(inputs[name], 0.4) for name in ("albedo", "diffuse.albedo")}
    image, *_ = network.filter(inputs | constant | flat)
    torch.testing.assert_close(image, constant["radiance"])


def views_inputs(view: Window) -> dict[str, torch.Tensor]:
    inputs = ValidationViews([view], ALL_SAMPLES, 2)[0].inputs
    return inputs | {"radiance": inputs["color"]}


def test_a_misspelt_field_of_a_variant_is_an_error() -> None:
    with pytest.raises(ValueError, match="manifold_weight"):
        ablation.changed(load_preset("pathfold-fast"), {"loss": {"manifold_weight": 1.0}})


def test_rows_are_compared_seed_by_seed() -> None:
    def result(title: str, seed: int, log: float) -> dict:
        return {"title": title, "seed": seed, "logs": {"2": log, "8": log}, "cpu_seconds": 1.0} | about

    robust = next(v.title for v in ablation.VARIANTS if v.run == "robust")
    about = {"config": {"name": "tiny", "optimiser": {"steps": 2}}, "views": 1}
    rows = [result("baseline", 0, -1.0), result("baseline", 1, -3.0), result(robust, 0, -1.5)]
    last = ablation.tables(rows).splitlines()[-1]
    assert f" {math.exp(-0.5):.3f} |" in last


def test_bias_is_told_from_variance_and_from_the_noise_of_the_reference() -> None:
    rng = np.random.default_rng(0)
    shape = (60, 80, 3)
    halves = tuple(rng.normal(2.0, 0.5, shape).astype(np.float32) for _ in range(2))
    reference = Reference(np.full(shape, 2.0, np.float32), halves)
    spread = energy.Spread()
    for _ in range(8):
        spread.add(rng.normal(1.8, 0.4, shape).astype(np.float32), reference)
    found = spread.summary(reference)
    assert found["energies"] == pytest.approx([0.9] * 8, abs=0.005)
    assert found["bias"] == pytest.approx(0.2**2 / 4.01, rel=0.1)
    assert found["variance"] == pytest.approx(0.4**2 / 4.01, rel=0.02)


def test_pixels_are_classed_by_what_most_samples_do() -> None:
    tags = np.zeros((3, 1, 5, 6))
    tags[:, 0, 0, 0] = 5  # diffuse, then the light
    tags[:, 0, 1, :2] = [17, 5]  # a mirror shows a diffuse surface
    tags[:, 0, 2, :3] = [5, 18, 18]  # light through glass falls onto a diffuse surface
    tags[:2, 0, 3, :2] = [9, 5]  # two of three samples are glossy
    descriptor = np.zeros((3, 1, 5, 36), np.float16)
    descriptor[..., 24:30] = tags
    image = np.ones((1, 5, 3), np.float32)
    found = paths_gain.classes({"samples.descriptor": descriptor, "color": image, "variance": image, "diffuse": image})
    where = {name: np.flatnonzero(mask).tolist() for name, mask in found.items()}
    assert where["first event diffuse"] == [0, 2]
    assert where["first event delta"] == [1]
    assert where["first event glossy"] == [3]
    assert where["first event none"] == [4]
    assert where["light: direct"] == [0, 4]
    assert where["light: several events"] == [1, 3]
    assert where["light: caustic"] == [2]
    assert sum(mask.sum() for mask in found.values()) == 4 * 5  # four ways to class, each whole


def test_gain_is_of_errors_summed_over_seeds() -> None:
    def row(scene: str, seed: int, with_paths: float, without: float) -> dict:
        return {
            "scene": scene,
            "spp": 8,
            "seed": seed,
            "with": {"rell2": with_paths, "flip": 0.1},
            "without": {"rell2": without, "flip": 0.2},
            "classes": {name: [100, 100 * with_paths, 100 * without] for name in "abcd"},
        }

    rows = [row("x", 0, 1.0, 2.0), row("x", 1, 3.0, 6.0), row("y", 0, 8.0, 4.0)]
    for metric, mean, wins in (("rell2", "1.000", "1 of 2"), ("flip", "0.500", "2 of 2")):
        *_, means, won = paths_gain.scene_table(rows, metric, metric).splitlines()
        assert means == f"| geometric mean |  | {mean} |" and won == f"| smaller with paths |  | {wins} |"
    assert paths_gain.class_table(rows).splitlines()[-1] == "| d | 100.0% | 100.0% | 2 | 1.000 |"


def test_findings_go_on_where_they_were_stopped(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(sys, "argv", ["benchmarks/toy.py", str(tmp_path / "scenes"), "-o", str(tmp_path)])
    page = pages.Page(
        "toy", "Toys", "Of toys.", lambda rows: " ".join(f"{row['scene']} {row['error']}" for row in rows)
    )

    def run(scenes: str) -> None:
        findings = pages.Findings(page, tmp_path, [])
        for scene in scenes:
            findings.row({"scene": scene, "seeds": (0, 1)}, lambda: {"error": counter.pop() / 3})
        findings.finish()

    counter = [1, 2]
    run("ab")
    run("ba")
    assert not counter and (tmp_path / "toy.md").read_text().endswith("\nb 0.333333 a 0.666667\n")
    run("b")
    data = json.loads((tmp_path / "toy.json").read_text())
    assert data["rows"] == [{"scene": "b", "seeds": [0, 1], "error": 0.333333}]
    assert page.text(data) == (tmp_path / "toy.md").read_text()
    assert data["command"] == f"python benchmarks/toy.py {tmp_path.name.upper()}/scenes"
    (tmp_path / "toy.json").write_text(json.dumps(data | {"machine": "another"}))
    counter = [3]
    run("b")  # what another machine measured stands on a page of its own
    assert not counter and "b 1.0" in (tmp_path / "toy.md").read_text()


def test_data_that_are_no_page_s_are_named(tmp_path: Path) -> None:
    with pytest.raises(ValueError, match="no folder"):
        pages.every(tmp_path / "nowhere")
    for name, text, said in (("energy", "{", "damaged"), ("energy", "[]", "damaged"), ("stray", "{}", "no benchmark")):
        path = tmp_path / f"{name}.json"
        path.write_text(text)
        with pytest.raises(ValueError, match=f"{name}.json.*{said}"):
            pages.every(tmp_path)
        path.unlink()


def test_windows_are_compared_one_by_one_over_seeds() -> None:
    def row(seed: int, *ours: float) -> dict:
        windows = {"noisy": [9.0, 9.0, 9.0], "oidn": [1.0, 1.0, 1.0], "pathfold-balanced": list(ours)}
        return {"scene": "room", "spp": 8, "seed": seed, "windows": windows}

    errors = resolution.over_seeds([row(0, 1.0, 4.0, -0.5), row(1, 0.6, 2.0, 0.1)])
    assert resolution.ratios(errors, 8, "pathfold-balanced", "oidn") == pytest.approx([0.8, 3.0, resolution.FLOOR])
    assert resolution.worst(errors)[:2] == [("room", 1, 3.0), ("room", 0, 0.8)]
    assert "| pathfold-balanced | 8 | 0.800 | 2 of 3 |" in resolution.tables(
        [row(0, 1.0, 4.0, -0.5), row(1, 0.6, 2.0, 0.1)]
    )


def test_the_unbiased_loss_pulls_towards_the_mean_of_noisy_references() -> None:
    reference = torch.full((400, 1, 1, 1), 0.1)
    reference[:20] = 18.1  # one hit in twenty: mean 1, median 0.1
    slope = {}
    for mean in (0.9, 1.0, 1.1):
        output = torch.full_like(reference, mean, requires_grad=True)
        variants.unbiased_relative(output, reference).mean().backward()
        slope[mean] = float(output.grad.sum())
    assert slope[0.9] < -1e-3
    assert slope[1.0] == pytest.approx(0, abs=1e-5)
    assert slope[1.1] > 1e-3
    output = torch.full_like(reference, 1.0, requires_grad=True)
    robust_relative(output, reference, torch.ones_like(reference)).mean().backward()
    assert float(output.grad.sum()) > 0.1  # the robust one would darken it
