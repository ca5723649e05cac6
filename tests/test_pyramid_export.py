"""A pathfold checkpoint becomes a model folder; torch and the SDK agree on it, tiles and layers included."""

import copy
import json
import shutil
from pathlib import Path

import numpy as np
import onnx
import onnxruntime
import pytest
import torch
from pathfold.check import check_model
from pathfold.check.demodulation import flatten
from pathfold.check.measure import relative_error, tolerance
from pathfold.denoiser import Denoiser
from pathfold_training.fit.task import Denoising
from pathfold_training.fit.train import fit
from pathfold_training.fit.warm_start import warm_start
from pathfold_training.networks.batch import Batch
from pathfold_training.networks.narrow import narrow, round_weights, widen
from pathfold_training.networks.pathfold.unet import ALBEDO_EPSILON, OPTIONAL
from pathfold_training.release.export import export
from pyramid_models import CONFIG, Buffers, export_tiny, frame
from training_data import write_data_set


@pytest.fixture(scope="module")
def exported(tmp_path_factory: pytest.TempPathFactory) -> tuple[Path, Denoising]:
    return export_tiny(tmp_path_factory.mktemp("export"))


def adversarial(buffers: Buffers, case: str) -> Buffers:
    buffers = {name: value.copy() for name, value in buffers.items()}
    if case == "firefly":
        buffers["color"][3, 4] += 1e7
        buffers["variance"][3, 4] = 1e13
    elif case == "dark":
        buffers["color"] *= 1e-6
        buffers["variance"] *= 1e-12
    elif case == "black albedo":
        buffers["albedo"][1:] = 0.0  # in every pixel it would count as absent
    elif case == "dead paths":
        buffers["samples.descriptor"][..., :24] = -100.0
    elif case == "color alone":
        buffers = {"color": buffers["color"]}
    elif case == "no albedo":
        del buffers["albedo"]
    elif case == "no paths":
        del buffers["samples.descriptor"]
    return buffers


def torch_frame(task: Denoising, buffers: Buffers, exposure: float) -> np.ndarray:
    """The chain in float64 torch: training's own denoise on the same buffers, absent ones as training has them."""
    height, width = buffers["color"].shape[:2]
    if "albedo" in buffers:
        light, albedo = (buffers[name].astype(np.float64) for name in ("color", "albedo"))
        buffers = buffers | {"albedo": flatten(albedo, light, np.isfinite(light).all(-1), ALBEDO_EPSILON)}
    channels = {"color": 3, "variance": 3, "albedo": 3, "normal": 3, "depth": 1}
    inputs = {
        n: torch.from_numpy(buffers[n]).permute(2, 0, 1)[None] if n in buffers else torch.zeros(1, c, height, width)
        for n, c in channels.items()
    }
    paths = "samples.descriptor" in buffers
    descriptor = torch.from_numpy(buffers["samples.descriptor"]) if paths else torch.zeros(1, height, width, 36)
    inputs["samples.descriptor"] = descriptor.permute(0, 3, 1, 2)
    inputs["samples.valid"] = torch.full((descriptor.shape[0], 1, height, width), float(paths))
    given = set(buffers) | ({"paths"} if paths else set())
    inputs |= {f"{name}.present": torch.tensor([float(name in given)]) for name in OPTIONAL}
    inputs["exposure"] = torch.tensor([exposure])
    scale = torch.exp(-torch.log(inputs["depth"].double()).mean()).float() if "depth" in buffers else torch.ones(())
    inputs["depth_scale"] = scale.reshape(1)
    exact, inputs = copy.deepcopy(task).double(), {name: value.double() for name, value in inputs.items()}
    with torch.no_grad():
        return exact.denoise(Batch(inputs, {}, [descriptor.shape[0]]))[0].permute(1, 2, 0).numpy()


CASES = ["plain", "firefly", "dark", "black albedo", "dead paths", "color alone", "no albedo", "no paths"]


@pytest.mark.parametrize("case", CASES)
def test_sdk_equals_torch(exported: tuple[Path, Denoising], case: str) -> None:
    folder, task = exported
    buffers = adversarial(frame(37, 50, 3, seed=1), case)
    result = Denoiser(folder).run_buffers(buffers, exposure=0.8)
    assert relative_error(result.color, torch_frame(task, buffers, 0.8))[0] < tolerance("chain.fp32")


@pytest.mark.parametrize(("height", "width", "samples"), [(1, 1, 2), (1, 33, 2), (49, 16, 4)])
def test_any_size(exported: tuple[Path, Denoising], height: int, width: int, samples: int) -> None:
    folder, task = exported
    buffers = frame(height, width, samples, seed=height)
    result = Denoiser(folder).run_buffers(buffers, exposure=1.3)
    assert relative_error(result.color, torch_frame(task, buffers, 1.3))[0] < tolerance("chain.fp32")


def test_samples_in_parts(exported: tuple[Path, Denoising]) -> None:
    """More samples than one run of the embedding takes: strips of the frame, and a part of its samples at a time."""
    folder, task = exported
    buffers = frame(20, 350, 9, seed=6)
    result = Denoiser(folder, threads=1).run_buffers(buffers, exposure=0.7)
    assert relative_error(result.color, torch_frame(task, buffers, 0.7))[0] < tolerance("chain.fp32")


def test_samples_are_embedded_once_and_only_where_there_are_paths(exported: tuple[Path, Denoising]) -> None:
    folder, _ = exported
    buffers = frame(64, 80, 2, seed=7)
    buffers["samples.descriptor"][1, 3:5, 7, 0] = np.nan  # seen by several windows, counted once each
    report = Denoiser(folder, tile=16).run_buffers(buffers).report
    assert report["ms"]["embedding"] > 0
    assert report["sanitised"]["samples"] == {"not finite (dropped)": 2}
    plain = {name: value for name, value in buffers.items() if not name.startswith("samples.")}
    valid_alone = plain | {"samples.valid": np.ones((2, 64, 80, 1), np.float32)}
    for given in (plain, valid_alone):
        report = Denoiser(folder).run_buffers(given).report
        assert "samples" not in report["sanitised"]
        assert report["ms"]["embedding"] == 0


def test_progress_never_goes_back(exported: tuple[Path, Denoising]) -> None:
    """Samples are embedded when the first tile needs them, here one in the middle."""
    folder, _ = exported
    buffers = frame(336, 48, 2, seed=9)
    buffers["color"][:192] = 0
    seen: list[float] = []
    report = Denoiser(folder, tile=16).run_buffers(buffers, progress=seen.append).report
    assert report["ms"]["embedding"] > 0
    assert any("tiles" in line["what"] for line in report["left_out"])
    assert seen == sorted(seen)
    assert seen[-1] == 1


def test_descriptors_need_not_fit_into_the_memory_of_a_tile(exported: tuple[Path, Denoising]) -> None:
    folder, _ = exported
    buffers = frame(256, 256, 16, seed=8)  # 151 MB of descriptors
    assert Denoiser(folder, memory_mb=40).run_buffers(buffers).report["tiles"] == 1


def test_tiles_make_no_difference(exported: tuple[Path, Denoising]) -> None:
    folder, _ = exported
    buffers = frame(330, 350, 1, seed=2)
    whole = Denoiser(folder).run_buffers(buffers)
    tiled = Denoiser(folder, tile=64).run_buffers(buffers)
    assert tiled.report["tiles"] > whole.report["tiles"] == 1
    assert relative_error(tiled.color, whole.color)[0] < tolerance("tiles")


@pytest.mark.parametrize("scale", [1e-6, 1e6])
def test_scaled_radiance_gives_the_scaled_picture(exported: tuple[Path, Denoising], scale: float) -> None:
    folder, _ = exported
    buffers = {n: v for n, v in frame(40, 40, 2, seed=3).items() if n != "samples.descriptor"}
    scaled = buffers | {"color": buffers["color"] * np.float32(scale)}
    scaled["variance"] = buffers["variance"] * np.float32(scale) ** 2
    denoiser = Denoiser(folder)
    expected = denoiser.run_buffers(buffers).color * scale
    assert relative_error(denoiser.run_buffers(scaled).color, expected)[0] < tolerance("scale")


@pytest.mark.parametrize("albedo", [True, False])
def test_layers_add_up_and_alpha_stays_in_range(exported: tuple[Path, Denoising], albedo: bool) -> None:
    folder, _ = exported
    rng = np.random.default_rng(4)
    buffers = adversarial(frame(40, 70, 2, seed=4), "plain" if albedo else "no albedo")
    key, fill = (buffers["color"] * f for f in (np.float32(0.75), np.float32(0.25)))
    buffers["alpha"] = (rng.random((40, 70, 1)) < 0.5).astype(np.float32)
    result = Denoiser(folder).run_buffers(buffers, layers={"key": {"color": key}, "fill": {"color": fill}})
    assert relative_error(result.layers["key"] + result.layers["fill"], result.color)[0] < 1e-5
    assert result.alpha.min() >= 0
    assert result.alpha.max() <= 1 + 1e-6


def test_bad_pixels_are_rebuilt_from_their_neighbours(exported: tuple[Path, Denoising]) -> None:
    folder, _ = exported
    buffers = {"color": np.full((48, 48, 3), 3.0, np.float32)}
    buffers["color"][10:16, 20:24] = np.nan
    np.testing.assert_allclose(Denoiser(folder).run_buffers(buffers).color, 3.0, rtol=1e-5)


def test_manifest_says_what_is_optional(exported: tuple[Path, Denoising]) -> None:
    folder, _ = exported
    manifest = json.loads((folder / "manifest.json").read_text())
    assert manifest["requires"] == ["color"]
    assert {"albedo", "samples.descriptor"} <= set(manifest["uses"])
    assert manifest["tile"]["alignment"] == 16
    assert "gather pyramid" in (folder / "README.md").read_text()


def test_weights_are_stored_as_halves_and_compute_the_same(exported: tuple[Path, Denoising]) -> None:
    stored = onnx.load(exported[0] / "network.onnx")
    halves = {t.name for t in stored.graph.initializer if t.data_type == onnx.TensorProto.FLOAT16}
    convolutions = sum(node.op_type == "Conv" for node in stored.graph.node)
    assert len(halves) == convolutions > 11
    wide = copy.deepcopy(stored)
    widen(wide)
    assert not any(node.op_type == "Cast" and node.input[0] in halves for node in wide.graph.node)
    sessions = [onnxruntime.InferenceSession(model.SerializeToString()) for model in (stored, wide)]
    rng = np.random.default_rng(9)
    feeds = {}
    for port in sessions[0].get_inputs():
        sizes = [size if isinstance(size, int) else {"H": 48, "W": 64}.get(size, 24) for size in port.shape]
        feeds[port.name] = rng.random(sizes, np.float32)
    feeds["embedding"] = rng.random((1, 9, 24, 32), np.float32)
    for one, other in zip(*(session.run(None, feeds) for session in sessions), strict=True):
        np.testing.assert_array_equal(one, other)
    narrow(wide)
    assert wide.graph == stored.graph


def test_a_graph_copies_no_prediction(exported: tuple[Path, Denoising]) -> None:
    graph = onnx.load(exported[0] / "network.onnx").graph
    convolved = {output for node in graph.node if node.op_type == "Conv" for output in node.output}
    assert not any(node.op_type == "Cast" and node.input[0] in convolved for node in graph.node)


def test_what_a_half_cannot_hold_is_kept(exported: tuple[Path, Denoising]) -> None:
    model = copy.deepcopy(exported[1].model)
    weights = dict(model.named_parameters())
    for name, value in (("down.0.0.weight", 7e4), ("up.0.0.weight", 1 / 3), ("up.0.0.bias", 1 / 3)):
        weights[name].data[:] = value
    round_weights(model, but="sample.")
    kept = {name: float(value.detach().flatten()[0]) for name, value in weights.items()}
    assert kept["down.0.0.weight"] == 7e4 and kept["up.0.0.bias"] == np.float32(1 / 3)
    assert kept["up.0.0.weight"] == np.float16(1 / 3)


def test_a_model_folder_starts_a_run_where_it_stood(exported: tuple[Path, Denoising]) -> None:
    folder, task = exported
    torch.manual_seed(7)
    begun = Denoising(CONFIG)
    warm_start(begun, folder)
    begun.eval()
    inputs = {name: torch.rand((1, 3, 32, 48)) for name in ("radiance", "variance", "albedo", "normal")}
    inputs |= {"depth": torch.rand((1, 1, 32, 48)), "samples.descriptor": torch.randn((2, 36, 32, 48))}
    inputs |= {"samples.valid": torch.ones((2, 1, 32, 48)), "exposure": torch.ones(1), "depth_scale": torch.ones(1)}
    inputs |= {f"{name}.present": torch.tensor([float(name != "depth")]) for name in OPTIONAL}
    with torch.no_grad():
        torch.testing.assert_close(begun.model.filter(inputs)[0], task.model.filter(inputs)[0], rtol=1e-4, atol=1e-5)


def test_layers_that_an_export_made_one_are_no_place_to_start_from(
    exported: tuple[Path, Denoising], tmp_path: Path
) -> None:
    folder = shutil.copytree(exported[0], tmp_path / "model")
    graph = onnx.load(folder / "network.onnx")
    convolutions = [node for node in graph.graph.node if node.op_type == "Conv"]
    convolutions[-1].input[2] = convolutions[-2].input[2]
    onnx.save(graph, folder / "network.onnx")
    with pytest.raises(ValueError, match=r"cannot be told apart; give the run's last\.ckpt"):
        warm_start(Denoising(CONFIG), folder)


def test_paths_are_left_out_by_name_where_the_manifest_says_so(
    exported: tuple[Path, Denoising], tmp_path: Path
) -> None:
    folder = tmp_path / "model"
    shutil.copytree(exported[0], folder)
    manifest = json.loads((folder / "manifest.json").read_text())
    manifest["samples_per_pixel"]["without_paths"] = 3
    (folder / "manifest.json").write_text(json.dumps(manifest))
    plain, bold = (Denoiser(folder, leave_out=names) for names in ("all", "all,paths"))
    for samples in (2, 3):
        buffers = frame(20, 24, samples, seed=samples)
        paths = {"descriptor": buffers.pop("samples.descriptor")}
        without = plain.run(**buffers).color
        with_paths, left_out = plain.run(**buffers, samples=paths), bold.run(**buffers, samples=paths)
        assert not np.array_equal(without, with_paths.color)
        np.testing.assert_array_equal(left_out.color, without if samples == 3 else with_paths.color)
        what = [line["what"] for line in left_out.report["left_out"]]
        assert ("paths" in what) == (samples == 3)
        assert left_out.report["samples_per_pixel"] == samples
        assert "samples.descriptor" not in left_out.report["inputs"]["missing"]
        assert ("samples.descriptor" in left_out.report["inputs"]["unused"]) == (samples == 3)


def test_no_more_samples_are_embedded_than_the_manifest_says(exported: tuple[Path, Denoising], tmp_path: Path) -> None:
    folder = shutil.copytree(exported[0], tmp_path / "model")
    manifest = json.loads((folder / "manifest.json").read_text())
    manifest["samples_per_pixel"]["embedded"] = 2
    (folder / "manifest.json").write_text(json.dumps(manifest))
    buffers = frame(20, 24, 3, seed=8)
    descriptor = buffers.pop("samples.descriptor")
    given = Denoiser(folder).run(**buffers, samples={"descriptor": descriptor})
    first = Denoiser(exported[0]).run(**buffers, samples={"descriptor": descriptor[:2]}, samples_per_pixel=3)
    np.testing.assert_array_equal(given.color, first.color)
    assert given.report["samples_per_pixel"] == 3
    assert "of 3 samples' paths the model looks at the first 2" in given.report["notes"]
    assert not [note for note in first.report["notes"] if "paths" in note]


def test_an_export_says_how_many_samples_were_embedded(tmp_path: Path) -> None:
    config = CONFIG.model_copy(update={"network": CONFIG.network.model_copy(update={"embedded": 1})})
    checkpoint = fit(config, write_data_set(tmp_path / "data"), tmp_path / "run", validate_every=1000, threads=1)
    folder = export(checkpoint, tmp_path / "model", json.loads((tmp_path / "run" / "record.json").read_text()))
    assert json.loads((folder / "manifest.json").read_text())["samples_per_pixel"]["embedded"] == 1
    assert check_model(folder).passed
