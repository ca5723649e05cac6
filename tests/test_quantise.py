"""int8 and what a model can do without: measured on held-out views when it is exported."""

import copy
import hashlib
import json
import shutil
from pathlib import Path

import numpy as np
import onnx
import pytest
from pathfold.check.measure import drift
from pathfold.denoiser import Denoiser
from pathfold_training.fit.task import Denoising
from pathfold_training.fit.views import Stored, ValidationViews
from pathfold_training.networks.pathfold.unet import PIXEL_CHANNELS
from pathfold_training.release import quantise, without_paths
from pyramid_models import Buffers, export_tiny, frame
from training_data import write_data_set


@pytest.fixture(scope="module")
def exported(tmp_path_factory: pytest.TempPathFactory) -> tuple[Path, Denoising]:
    return export_tiny(tmp_path_factory.mktemp("export"))


@pytest.fixture(scope="module")
def data(tmp_path_factory: pytest.TempPathFactory) -> Stored:
    return Stored(write_data_set(tmp_path_factory.mktemp("calibration") / "data"))


def test_int8_is_written_with_its_measured_error(
    exported: tuple[Path, Denoising], data: Stored, tmp_path: Path
) -> None:
    folder = shutil.copytree(exported[0], tmp_path / "model")
    said = quantise.add_int8(folder, data)
    assert said.startswith("int8: RelL2 ")
    manifest = json.loads((folder / "manifest.json").read_text())
    (block,) = manifest["variants"].values()
    assert 0.9 < block["rell2_over_fp32"] <= 1.02 and block["rell2_over_fp32"] != 1
    graph = block["graphs"]["network"]
    assert hashlib.sha256((folder / graph["file"]).read_bytes()).hexdigest() == graph["sha256"]
    assert "int8 with" in (folder / "README.md").read_text()
    quantised = onnx.load(folder / graph["file"]).graph
    kinds = [t.data_type for t in quantised.initializer if len(t.dims) == 4]
    convolutions = sum(node.op_type == "Conv" for node in quantised.node)
    assert kinds.count(onnx.TensorProto.INT8) == 11  # the U-Net
    assert kinds.count(onnx.TensorProto.FLOAT16) == convolutions - 11
    buffers = frame(50, 70, 2, seed=5)
    exact, rounded = (Denoiser(folder, precision=p).run_buffers(buffers) for p in ("fp32", "int8"))
    assert rounded.report["precision"] == "int8" and exact.report["precision"] == "fp32"
    assert 0 < drift(rounded.color, exact.color) < 0.4  # its logits are random
    np.testing.assert_array_equal(exact.color, Denoiser(exported[0]).run_buffers(buffers).color)


def test_an_error_is_of_a_frame_of_all_its_samples(
    exported: tuple[Path, Denoising], data: Stored, monkeypatch: pytest.MonkeyPatch
) -> None:
    said = []
    run = Denoiser.run_buffers

    def spied(self: Denoiser, buffers: Buffers, **options: float) -> object:
        said.append((len(buffers["samples.descriptor"]), options["samples_per_pixel"], "variance" in buffers))
        return run(self, buffers, **options)

    monkeypatch.setattr(Denoiser, "run_buffers", spied)
    one, most = ValidationViews(data.held_out(), 1, 4), ValidationViews(data.held_out(), 1, 99)
    quantise.error(Denoiser(exported[0]), one[0], 4)  # whatever the paths are of
    assert said == [(1, 4, True)]
    monkeypatch.setattr(quantise, "Denoiser", lambda folder, precision: Denoiser(folder))
    assert quantise.ratios(exported[0], most) == [1.0]
    assert said[1:] == [(1, 8, True)] * 2


def test_int8_is_calibrated_on_fireflies_too(
    exported: tuple[Path, Denoising], data: Stored, monkeypatch: pytest.MonkeyPatch
) -> None:
    manifest = json.loads((exported[0] / "manifest.json").read_text())
    brightest = []
    for share in (0.0, 1.0):
        monkeypatch.setattr(quantise, "FIREFLIES", share)
        feeds = list(quantise.calibration_feeds(exported[0], manifest, data, 6))
        brightest.append([float((f["radiance"] * f["exposure"][:, None, None, None]).max()) for f in feeds])
    assert max(brightest[0]) < 10 < sorted(brightest[1])[1]


@pytest.mark.parametrize(("bound", "value", "said"), [("BOUND", 0.5, "more than 0.5"), ("MOST_BYTES", 1, "MB")])
def test_an_int8_variant_that_is_no_good_is_refused(
    exported: tuple[Path, Denoising],
    data: Stored,
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    bound: str,
    value: float,
    said: str,
) -> None:
    monkeypatch.setattr(quantise, bound, value)
    folder = shutil.copytree(exported[0], tmp_path / "model")
    line = quantise.add_int8(folder, data)
    assert line.startswith("no int8: ") and said in line
    for path in folder.iterdir():
        assert path.read_bytes() == (exported[0] / path.name).read_bytes()


def test_from_which_spp_on_paths_can_go_is_measured(exported: tuple[Path, Denoising], tmp_path: Path) -> None:
    assert without_paths.least([2, 4, 8], [1.5, 1.01, 1.02]) == 4
    assert without_paths.least([2, 4, 8], [1.0, 1.5, 1.0]) == 8
    assert without_paths.least([2, 4, 8], [1.0, 1.0, 1.1]) is None
    views = Stored(write_data_set(tmp_path / "data")).held_out()
    blind = copy.deepcopy(exported[1]).eval()
    blind.model.first.weight.data[:, 4 * PIXEL_CHANNELS :] = 0  # sees nothing of the embedding
    blind.model.presence.weight.data.zero_()
    assert without_paths.samples_without_paths(blind, views) == 2
    assert without_paths.ratio(exported[1], views, 2) != 1
