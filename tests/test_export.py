"""A checkpoint becomes a model folder, and torch, onnxruntime and the SDK agree on it."""

import json
import shutil
from dataclasses import asdict, replace
from pathlib import Path
from typing import Any

import numpy as np
import onnxruntime
import pytest
import torch
from pathfold.bench.measurement import Measurement
from pathfold.check import check_model, references
from pathfold.check.cases import CASES
from pathfold.check.demodulation import flatten
from pathfold.check.measure import relative_error, tolerance
from pathfold.check.properties import Subject
from pathfold.check.references import References
from pathfold.check.run import case_row
from pathfold.denoiser import Denoiser
from pathfold_training.fit.preset import Config, Data, Optimiser
from pathfold_training.fit.task import Denoising
from pathfold_training.fit.train import fit
from pathfold_training.networks.batch import Batch
from pathfold_training.networks.family import input_shape
from pathfold_training.networks.features import DEMODULATION_EPSILON, OPTIONAL
from pathfold_training.networks.kpcn.branch import BRANCHES
from pathfold_training.networks.kpcn.sizes import KpcnSizes
from pathfold_training.networks.reconstruct import gather
from pathfold_training.release.card import write_card
from pathfold_training.release.export import export, load_task
from training_data import write_data_set

NAMES = ("color", "diffuse", "specular", "diffuse.albedo", "albedo", "normal", "depth")
VARIANCES = ("variance", "diffuse.variance", "specular.variance")


def config(embedding: int) -> Config:
    return Config(
        name=f"tiny-{embedding}",
        description="a network for tests",
        network=KpcnSizes(width=8, layers=4, kernel_size=7, embedding=embedding, embedding_width=4),
        data=Data(crop=24, batch=2, spp_max=4),
        optimiser=Optimiser(steps=2, precision="fp32"),
    )


@pytest.fixture(scope="module", params=[0, 3], ids=["pixels", "paths"])
def exported(request: pytest.FixtureRequest, tmp_path_factory: pytest.TempPathFactory) -> tuple[Path, Denoising]:
    folder = tmp_path_factory.mktemp("export")
    run = folder / "run"
    checkpoint = fit(config(request.param), write_data_set(folder / "data"), run, validate_every=1000, threads=1)
    spread_trust(checkpoint)
    record = json.loads((run / "record.json").read_text())
    return export(checkpoint, folder / "model", record, standalone=True), load_task(checkpoint)[0]


def spread_trust(checkpoint: Path) -> None:
    """Two steps leave trust near its start at 0, where a fault in it would not show."""
    state = torch.load(checkpoint, weights_only=True)
    for name, value in state["state_dict"].items():
        if ".trust." in name:
            value.copy_(0.1 * torch.randn(value.shape, generator=torch.Generator().manual_seed(0)))
    torch.save(state, checkpoint)


def frame(height: int, width: int, samples: int, seed: int) -> dict[str, np.ndarray]:
    """A frame's buffers in host layout: heavy-tailed radiance over a smooth scene."""
    rng = np.random.default_rng(seed)
    shape = (height, width, 3)
    diffuse = rng.exponential(0.5, shape) ** 2
    specular = rng.exponential(0.2, shape) ** 3
    buffers = {"color": diffuse + specular, "diffuse": diffuse, "specular": specular}
    buffers |= {"diffuse.albedo": rng.uniform(0, 1, shape), "albedo": rng.uniform(0, 1, shape)}
    buffers |= {"normal": rng.uniform(-1, 1, shape), "depth": rng.uniform(0.5, 50, (height, width, 1))}
    buffers |= {name: rng.exponential(0.1, shape) for name in VARIANCES}
    logs = rng.normal(-2, 6, (samples, height, width, 24))
    logs[rng.random(logs.shape) < 0.3] = -100
    tags = rng.choice([0, 5, 9, 17, 6, 10, 18, 3], (samples, height, width, 6))
    roughness = rng.uniform(0, 1, (samples, height, width, 6))
    buffers["samples.descriptor"] = np.concatenate([logs, tags, roughness], -1)
    buffers["samples.density"] = rng.normal(0, 20, (samples, height, width, 1))
    return {name: value.astype(np.float32) for name, value in buffers.items()}


def adversarial(buffers: dict[str, np.ndarray], case: str) -> dict[str, np.ndarray]:
    buffers = {name: value.copy() for name, value in buffers.items()}
    if case == "firefly":
        for name in ("color", "diffuse"):
            buffers[name][3, 4] += 1e7
        buffers["diffuse.variance"][3, 4] = buffers["variance"][3, 4] = 1e13
    elif case == "dark":
        for name in ("color", "diffuse", "specular"):
            buffers[name] *= 1e-6
        for name in VARIANCES:
            buffers[name] *= 1e-12
    elif case == "black albedo":
        buffers["diffuse.albedo"][1:] = 0.0  # in every pixel it would count as absent
    elif case == "densities":
        buffers["samples.density"] *= 30.0
    elif case == "dead paths":
        buffers["samples.descriptor"][..., :24] = -100.0
    return buffers


def torch_frame(task: Denoising, buffers: dict[str, np.ndarray], exposure: float) -> np.ndarray:
    """The chain in torch: the training code's own denoise on the same buffers."""
    images = [n for n in buffers if not n.startswith("samples.")]
    light, albedo = (buffers[name].astype(np.float64) for name in ("diffuse", "diffuse.albedo"))
    flat = flatten(albedo, light, np.isfinite(light).all(-1), DEMODULATION_EPSILON)
    buffers = buffers | {"diffuse.albedo": flat.astype(np.float32)}
    inputs = {n: torch.from_numpy(buffers[n]).permute(2, 0, 1)[None] for n in images}
    for name in ("samples.descriptor", "samples.density"):
        inputs[name] = torch.from_numpy(buffers[name]).permute(0, 3, 1, 2)
    inputs["samples.valid"] = torch.ones_like(inputs["samples.density"])
    inputs |= {f"{name}.present": torch.ones(1) for name in OPTIONAL}
    inputs["exposure"] = torch.tensor([exposure])
    inputs["depth_scale"] = torch.exp(-torch.log(inputs["depth"].double()).mean()).float().reshape(1)
    empty = torch.zeros_like(inputs["color"])
    reference = {"color": empty, "diffuse": empty, "diffuse.albedo": empty}
    with torch.no_grad():
        counts = [inputs["samples.valid"].shape[0]]
        return task.denoise(Batch(inputs, reference, counts))[0].permute(1, 2, 0).numpy()


@pytest.mark.parametrize("case", ["plain", "firefly", "dark", "black albedo", "densities", "dead paths"])
def test_sdk_equals_torch(exported: tuple[Path, Denoising], case: str) -> None:
    folder, task = exported
    buffers = adversarial(frame(37, 50, 3, seed=1), case)
    result = Denoiser(folder).run_buffers(buffers, exposure=0.8)
    assert relative_error(result.color, torch_frame(task, buffers, 0.8))[0] < tolerance("chain.fp32")


@pytest.mark.parametrize(("height", "width", "samples"), [(1, 1, 1), (1, 9, 2), (5, 3, 4), (40, 33, 7)])
def test_any_size_and_sample_count(exported: tuple[Path, Denoising], height: int, width: int, samples: int) -> None:
    folder, task = exported
    buffers = frame(height, width, samples, seed=height)
    result = Denoiser(folder).run_buffers(buffers, exposure=1.3)
    assert relative_error(result.color, torch_frame(task, buffers, 1.3))[0] < tolerance("chain.fp32")


def test_check_measures_against_the_exported_references(exported: tuple[Path, Denoising]) -> None:
    folder, task = exported
    report = check_model(folder)
    assert report.passed, [(row.name, row.reason) for row in report.rows if row.reason]
    assert not report.note
    measured = [row for row in report.rows if row.name in {case.name for case in CASES}]
    assert len(measured) == len(CASES) - (0 if task.config.network.embedding else 7)
    assert all(row.error is not None and row.allowed is not None for row in measured)
    assert max(row.error or 0.0 for row in measured) > 0  # float32 is not float64
    assert (folder / references.FILE).stat().st_size < 300_000


def test_check_finds_what_does_not_agree(exported: tuple[Path, Denoising], tmp_path: Path) -> None:
    folder = shutil.copytree(exported[0], tmp_path / "model")
    manifest = json.loads((folder / "manifest.json").read_text())
    kept = references.read(folder, manifest)
    assert kept is not None
    off, lacking = dict(kept.images), dict(kept.images)
    off["plain"] = off["plain"].copy()
    off["plain"][3, 4] *= 1.001
    del lacking["plain"]
    for images, reason, worst in ((off, "error above", (3, 4)), (lacking, "has no reference", None)):
        references.write(folder, manifest, References(images, kept.frames, kept.logits))
        row = case_row(Subject(folder, "cpu"), CASES[0], references.read(folder, manifest))
        assert row.name == "plain" and reason in row.reason and row.worst == worst
    manifest["graphs"]["diffuse"] = manifest["graphs"]["specular"]
    with pytest.raises(references.ReferencesError, match="other weights"):
        references.read(folder, manifest)


def test_tiles_make_no_difference(exported: tuple[Path, Denoising]) -> None:
    folder, _ = exported
    buffers = frame(150, 171, 2, seed=2)
    whole = Denoiser(folder).run_buffers(buffers)
    tiled = Denoiser(folder, tile=64).run_buffers(buffers)
    assert tiled.report["tiles"] > whole.report["tiles"]
    assert relative_error(tiled.color, whole.color)[0] < tolerance("tiles")


@pytest.mark.parametrize("scale", [1e-6, 1e-2, 1e3, 1e6])
def test_scaled_radiance_gives_the_scaled_picture(exported: tuple[Path, Denoising], scale: float) -> None:
    folder, _ = exported
    buffers = frame(40, 40, 2, seed=3)
    scaled = {n: v.copy() for n, v in buffers.items()}
    for name in ("color", "diffuse", "specular"):
        scaled[name] *= np.float32(scale)
    for name in VARIANCES:
        scaled[name] *= np.float32(scale) ** 2
    light = scaled["samples.descriptor"][..., :6]
    scaled["samples.descriptor"][..., :6] = np.where(light > -99, light + np.log(np.float32(scale)), light)
    denoiser = Denoiser(folder)
    expected = denoiser.run_buffers(buffers).color * scale
    assert relative_error(denoiser.run_buffers(scaled).color, expected)[0] < tolerance("scale")


def test_only_beauty_is_a_case(exported: tuple[Path, Denoising]) -> None:
    folder, _ = exported
    buffers = frame(24, 24, 2, seed=4)
    given = {n: v for n, v in buffers.items() if n == "color" or n.startswith("samples.")}
    result = Denoiser(folder).run_buffers(given)
    assert np.isfinite(result.color).all()
    assert result.color.min() >= 0
    assert result.color.mean() == pytest.approx(buffers["color"].mean(), rel=0.5)


def test_standalone_graph_holds_the_reconstruction(exported: tuple[Path, Denoising]) -> None:
    folder, task = exported
    for name in BRANCHES:
        branch = task.model.branch(name)
        sizes = {"S": 2, "H": 13, "W": 18}
        g = torch.Generator().manual_seed(0)
        shapes = {n: [k if isinstance(k, int) else sizes[k] for k in input_shape(n)] for n in branch.input_names()}
        inputs: dict[str, Any] = {n: torch.rand(shape, generator=g) for n, shape in shapes.items()}
        with torch.no_grad():
            factor = inputs["diffuse.albedo"] + DEMODULATION_EPSILON if branch.demodulate else torch.ones(1)
            predicted, size = branch(inputs), task.config.network.kernel_size
            filtered = gather(predicted.logits, inputs["radiance"] / factor, size, trust=predicted.trust)
            expected = (filtered * factor).numpy()
        session = onnxruntime.InferenceSession(folder / f"{name}-standalone.onnx")
        (out,) = session.run(None, {n: v.numpy() for n, v in inputs.items()})
        assert relative_error(out, expected)[0] < tolerance("standalone")


def test_manifest_and_card_say_how_it_was_made(exported: tuple[Path, Denoising]) -> None:
    folder, task = exported
    manifest = json.loads((folder / "manifest.json").read_text())
    assert manifest["training"]["config"] == task.config.model_dump()
    assert manifest["training"]["steps"] == 2
    assert manifest["training"]["data"]["views"] == 2
    assert set(manifest["graphs"]) == set(BRANCHES)
    assert manifest["tile"]["overlap"] % manifest["tile"]["alignment"] == 0
    card = (folder / "README.md").read_text()
    assert manifest["name"] in card
    assert manifest["training"]["hardware"] in card


def test_a_card_holds_the_errors_that_were_measured(exported: tuple[Path, Denoising], tmp_path: Path) -> None:
    folder = shutil.copytree(exported[0], tmp_path / "models" / "tiny")
    name = json.loads((folder / "manifest.json").read_text())["name"]
    errors = {"noisy": (1.0, 1.0), "oidn": (0.01, 0.02), "oidn-prefiltered": (0.01, 0.02), name: (0.02, 0.06)}
    lines = [
        Measurement(scene, 8, seed, method, error[scene == "b"] * (2 - seed * 1.5), 0.1, 0.9, 0.1, [1.0], [1.0])
        for scene in "ab"
        for seed in (0, 1)
        for method, error in errors.items()
    ]
    results = tmp_path / "results"
    results.mkdir()
    with pytest.raises(ValueError, match=f"no measurement of {name}"):
        write_card(folder, results)
    (results / "results.jsonl").write_text("".join(json.dumps(asdict(line)) + "\n" for line in lines))
    whole = (results / "results.jsonl").read_text()
    (results / "results.jsonl").write_text(
        "".join(json.dumps(asdict(one)) + "\n" for one in lines if one.method == name)
    )
    with pytest.raises(ValueError, match="no measurement of oidn-prefiltered"):
        write_card(folder, results)
    (results / "results.jsonl").write_text(whole)
    write_card(folder, results)
    rows = [line for line in (folder / "README.md").read_text().splitlines() if line.startswith(("| [", "| all"))]
    assert rows[0] == "| [b](../../results/b-8spp.jpg) | 1.0000 | 0.0200 | 0.0200 | 0.0600 | 3.00 |"
    assert rows[1].startswith("| [a]") and rows[1].endswith("| 2.00 |")
    assert rows[2].endswith("| 0.0346 | 2.45 |")
    with (results / "results.jsonl").open("a") as file:
        file.write(json.dumps(asdict(replace(lines[0], spp=2))) + "\n")
    with pytest.raises(ValueError, match="several spp"):
        write_card(folder, results)
