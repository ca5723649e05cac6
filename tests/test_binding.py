"""pathfold._core against a NumPy rendition of the same chain, and its manners as a Python module."""

import hashlib
import json
import subprocess
import sys
import threading
import time
from pathlib import Path
from typing import Any

import numpy as np
import onnxruntime
import pathfold
import pytest
from pathfold import _core

H, W, S = 34, 45, 3
MODELS = Path(__file__).parents[1] / "sdk" / "tests" / "make_test_models.py"


@pytest.fixture(scope="module")
def models(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("models")
    subprocess.run([sys.executable, MODELS, folder], check=True)
    libraries = sorted((Path(onnxruntime.__file__).parent / "capi").glob("libonnxruntime.so*"))
    _core.set_onnxruntime(str(libraries[0]))
    return folder


def make_buffers(seed: int = 0, samples: bool = False) -> dict[str, np.ndarray]:
    rng = np.random.default_rng(seed)

    def noise(channels: int) -> np.ndarray:
        return (rng.exponential(1, (H, W, channels)) ** 2).astype(np.float32)

    names = ["diffuse", "specular", "diffuse.albedo", "albedo", "variance", "diffuse.variance", "specular.variance"]
    buffers = {name: noise(3) for name in names}
    buffers |= {"normal": np.clip(noise(3) - 1, -1, 1), "depth": noise(1), "alpha": noise(1)}
    for name in ("diffuse.albedo", "albedo", "alpha"):
        buffers[name] = np.minimum(buffers[name], 1)
    buffers["diffuse"] *= buffers["diffuse.albedo"]  # which explains the light, so it is divided by as it stands
    buffers["color"] = buffers["diffuse"] + buffers["specular"]
    if samples:
        buffers["samples.descriptor"] = rng.normal(0, 2, (S, H, W, 36)).astype(np.float16)
        buffers["samples.density"] = rng.normal(-20, 5, (S, H, W, 1)).astype(np.float32)
        buffers["samples.valid"] = (rng.random((S, H, W, 1)) > 0.2).astype(np.float32)
    return buffers


def gather(image: np.ndarray, logits: np.ndarray) -> np.ndarray:
    """Softmax over the taps inside the image that are finite, in double. image [H,W,C], logits [K*K,H,W]."""
    size = round(logits.shape[0] ** 0.5)
    pad = ((size // 2, size // 2), (size // 2, size // 2))
    valid = np.pad(np.isfinite(image).all(-1), pad)
    values = np.pad(np.nan_to_num(image, posinf=0, neginf=0).astype(np.float64), (*pad, (0, 0)))
    height, width = image.shape[:2]
    shifts = [(slice(y, y + height), slice(x, x + width)) for y in range(size) for x in range(size)]
    scores = np.stack([np.where(valid[s], logits[t].astype(np.float64), -np.inf) for t, s in enumerate(shifts)])
    with np.errstate(invalid="ignore"):  # NaN where no tap is valid
        weights = np.exp(scores - scores.max(0))
        total = sum(weights[t][..., None] * values[s] for t, s in enumerate(shifts))
        return total / weights.sum(0)[..., None]


def log_average_exposure(color: np.ndarray) -> float:
    """The rule of sdk/src/prepare.h; color [H,W,3], finite."""
    height, width = color.shape[:2]
    rows, columns = -(-height // 16), -(-width // 16)
    luminance = color.astype(np.float64) @ [0.212671, 0.715160, 0.072169]
    bins = [
        np.sort(
            luminance[j * height // rows : (j + 1) * height // rows, i * width // columns : (i + 1) * width // columns],
            None,
        )
        for j in range(rows)
        for i in range(columns)
    ]
    means = np.array([pixels.mean() for pixels in bins])
    kept = (pixels[: pixels.size - -(-pixels.size // 64)] for pixels in bins)  # without the brightest 64th
    levels = sorted(pixels.mean() for pixels in kept if pixels.any())
    bright = levels[-1 - len(levels) // 64] if levels else means.max()
    counted = np.minimum(means[means > 1e-8 * bright], 16 * bright)
    return float(0.18 / np.exp(np.log(counted).mean())) if counted.size else 1.0


def denoise_in_numpy(folder: Path, buffers: dict[str, np.ndarray]) -> dict[str, np.ndarray]:
    """The whole chain for a split frame of sane values, straight from the contracts."""
    manifest = json.loads((folder / "manifest.json").read_text())
    depth = buffers["depth"]
    feeds: dict[str, np.ndarray] = {
        "exposure": np.array([log_average_exposure(buffers["diffuse"] + buffers["specular"])]),
        "depth_scale": np.array([np.exp(-np.log(depth[depth > 0].astype(np.float64)).mean())]),
        **{f"{name}.present": np.ones(1) for name in ("variance", "albedo", "normal", "depth", "split")},
    }
    for name in ("albedo", "normal", "depth", "diffuse.albedo"):
        feeds[name] = buffers[name].transpose(2, 0, 1)[None]
    if "samples.valid" in buffers:
        valid = buffers["samples.valid"] > 0
        dead = np.array([-100.0] * 24 + [0.0] * 12)
        feeds["samples.descriptor"] = np.where(valid, buffers["samples.descriptor"], dead).transpose(0, 3, 1, 2)
        feeds["samples.density"] = np.where(valid, buffers["samples.density"], 0).transpose(0, 3, 1, 2)
        feeds["samples.valid"] = valid.transpose(0, 3, 1, 2)
    results = {}
    for branch in manifest["reconstruction"]["branches"]:
        name = branch["radiance"]
        feeds["radiance"] = buffers[name].transpose(2, 0, 1)[None]
        feeds["variance"] = buffers[f"{name}.variance"].transpose(2, 0, 1)[None]
        session = onnxruntime.InferenceSession(folder / manifest["graphs"][branch["graph"]]["file"])
        inputs = {port.name: np.ascontiguousarray(feeds[port.name], np.float32) for port in session.get_inputs()}
        logits = session.run(["logits"], inputs)[0][0]
        factor: Any = 1.0
        if by := branch.get("demodulate"):
            factor = buffers[by["by"]].astype(np.float64) + by["epsilon"]
        results[name] = gather(buffers[name] / factor, logits) * factor
        if branch.get("unsplit"):
            results["alpha"] = gather(buffers["alpha"], logits)
    return results | {"color": results["diffuse"] + results["specular"]}


@pytest.mark.parametrize("model", ["split-5", "samples-5"])
@pytest.mark.parametrize("tile", [0, 16])
def test_whole_chain_equals_numpy(models: Path, model: str, tile: int) -> None:
    buffers = make_buffers(samples=model == "samples-5")
    results, report = _core.Denoiser(_core.Model(str(models / model)), tile=tile).run(buffers)
    expected = denoise_in_numpy(models / model, buffers)
    assert results.keys() == expected.keys()
    for name, values in expected.items():
        np.testing.assert_allclose(results[name], values, rtol=2e-5, atol=1e-5 * values.mean(), err_msg=name)
    assert report["split"] and report["branches"] == ["diffuse", "specular"]
    assert report["exposure"] == pytest.approx(log_average_exposure(buffers["color"]), rel=1e-5)


@pytest.mark.parametrize("size", [1, 3, 7, 21])
def test_gather_equals_numpy(size: int) -> None:
    rng = np.random.default_rng(size)
    image = rng.exponential(1, (19, 37, 5)).astype(np.float32)
    image[3, 4] = np.nan
    logits = rng.normal(0, 4, (size * size, 19, 37)).astype(np.float32)
    np.testing.assert_allclose(_core.gather(image, logits), np.nan_to_num(gather(image, logits)), rtol=1e-5, atol=1e-6)


@pytest.mark.parametrize("outlier", [1.0, 1e4, 1e12, 1e30])
def test_auto_exposure(outlier: float) -> None:
    color = make_buffers()["color"]
    color[7, 7] = outlier
    assert _core.auto_exposure(color) == pytest.approx(log_average_exposure(color), rel=1e-5)
    small = color[5:9, 5:9]
    assert _core.auto_exposure(small) == pytest.approx(log_average_exposure(small), rel=1e-5)


def test_any_strides_without_a_copy(models: Path) -> None:
    denoiser = _core.Denoiser(_core.Model(str(models / "single-3")))
    color = make_buffers()["color"]
    right = denoiser.run({"color": color})[0]["color"]
    wide = np.zeros((H, 2 * W, 7), np.float32)
    wide[:, ::2, 5:2:-1] = color
    planar = np.ascontiguousarray(color.transpose(2, 0, 1)).transpose(1, 2, 0)
    for view in (wide[:, ::2, 5:2:-1], planar, np.ascontiguousarray(color[::-1])[::-1]):
        before = view.copy()
        np.testing.assert_array_equal(denoiser.run({"color": view})[0]["color"], right)
        np.testing.assert_array_equal(view, before)
    half = color.astype(np.float16)
    expected = denoiser.run({"color": half.astype(np.float32)})[0]["color"]
    np.testing.assert_array_equal(denoiser.run({"color": half})[0]["color"], expected)
    np.testing.assert_array_equal(denoiser.run({"color": memoryview(color)})[0]["color"], right)
    alpha = np.ones((H, W), np.float32)  # one channel needs no axis of its own
    assert denoiser.run({"color": color, "alpha": alpha})[0]["alpha"].shape == (H, W, 1)


def test_layers_and_exposure(models: Path) -> None:
    denoiser = _core.Denoiser(_core.Model(str(models / "split-5")))
    buffers = make_buffers()
    key = {name: 0.25 * buffers[name] for name in ("diffuse", "specular")}
    results, report = denoiser.run(buffers, layers={"key": key}, exposure=2.0)
    np.testing.assert_allclose(results["key"], 0.25 * results["color"], rtol=1e-4)
    assert report["exposure"] == 2.0
    results, report = denoiser.run(buffers, layers={"key": {"color": buffers["color"]}})
    assert not report["split"] and "diffuse" not in results
    np.testing.assert_allclose(results["key"], results["color"], rtol=1e-5)


def test_progress_and_cancel(models: Path) -> None:
    denoiser = _core.Denoiser(_core.Model(str(models / "single-3")), tile=16)
    buffers = {"color": make_buffers()["color"]}
    seen: list[float] = []
    denoiser.run(buffers, progress=seen.append)  # returns None, which goes on
    assert seen == sorted(seen) and seen[0] == 0 and seen[-1] == 1
    with pytest.raises(_core.PathfoldError) as error:
        denoiser.run(buffers, progress=lambda done: done < 0.5)
    assert error.value.code == "cancelled"

    def stumble(done: float) -> bool:
        raise ValueError("mine")

    with pytest.raises(ValueError, match="mine"):
        denoiser.run(buffers, progress=stumble)
    denoiser.run(buffers)


def test_other_threads_run_meanwhile(models: Path) -> None:
    denoiser = _core.Denoiser(_core.Model(str(models / "single-21"), threads=1))
    color = np.ones((400, 400, 3), np.float32) + np.random.default_rng(0).random((400, 400, 3), np.float32)
    ticks, done = [], threading.Event()

    def tick() -> None:
        while not done.is_set():
            ticks.append(time.perf_counter())
            time.sleep(0.001)

    ticker = threading.Thread(target=tick)
    ticker.start()
    start = time.perf_counter()
    denoiser.run({"color": color})
    end = time.perf_counter()
    done.set()
    ticker.join()
    assert sum(start < t < end for t in ticks) >= 5  # none at all if the lock were held


def test_threads_share_a_denoiser(models: Path) -> None:
    denoiser = _core.Denoiser(_core.Model(str(models / "single-3"), threads=1))
    frames = [make_buffers(seed)["color"] for seed in range(4)]
    expected = [denoiser.run({"color": frame})[0]["color"] for frame in frames]
    equal = []

    def work(index: int) -> None:
        for _ in range(5):
            equal.append(np.array_equal(denoiser.run({"color": frames[index]})[0]["color"], expected[index]))

    threads = [threading.Thread(target=work, args=(index,)) for index in range(4)]
    for thread in threads:
        thread.start()
    for thread in threads:
        thread.join()
    assert len(equal) == 20 and all(equal)


COLOR = np.ones((4, 5, 3), np.float32)


@pytest.mark.parametrize(
    ("buffers", "words"),
    [
        ({}, ["color", "given: none"]),
        ({"colour": COLOR}, ["colour", "diffuse.albedo"]),
        ({"color": COLOR.astype(np.float64)}, ["color", "float64", "float32"]),
        ({"color": COLOR.astype(">f4")}, ["color", "byte order"]),
        ({"color": COLOR[0, 0]}, ["color", "1 axes", "height x width x channels"]),
        ({"color": COLOR[:0]}, ["color", "0 x 5 x 3"]),
        ({"color": COLOR[..., :2]}, ["color", "4 x 5 x 2", "3 channels"]),
        ({"color": [1, 2, 3]}, ["color", "list", "NumPy array"]),
        ({"color": COLOR, "albedo": COLOR[:3]}, ["albedo", "3 x 5 x 3", "4 x 5 x 3"]),
        ({"color": COLOR, "samples.density": np.ones((2, 4, 5, 1), np.float32)}, ["samples.descriptor"]),
    ],
)
def test_bad_buffers_are_explained(models: Path, buffers: dict[str, Any], words: list[str]) -> None:
    denoiser = _core.Denoiser(_core.Model(str(models / "samples-5")))
    with pytest.raises(_core.PathfoldError) as error:
        denoiser.run(buffers)
    assert error.value.code == "invalid-argument"
    assert all(word in str(error.value) for word in words), str(error.value)


def test_bad_models_are_explained(models: Path, tmp_path: Path) -> None:
    def complaint(*args: str, **options: Any) -> tuple[str, str]:
        with pytest.raises(_core.PathfoldError) as error:
            _core.Model(*args, **options)
        return error.value.code, str(error.value)

    code, message = complaint("no-such-model")
    assert code == "not-found" and "no-such-model" in message
    code, message = complaint(str(models / "single-3"), provider="quantum")
    assert code == "unsupported" and "cpu" in message
    code, message = complaint(str(models / "single-3"), threads=-1)
    assert code == "invalid-argument" and "threads is -1" in message

    graph = (models / "hostile" / "external.onnx").read_bytes()
    manifest = json.loads((models / "single-3" / "manifest.json").read_text())
    manifest["graphs"]["color"]["sha256"] = hashlib.sha256(graph).hexdigest()
    (tmp_path / "color.onnx").write_bytes(graph)
    (tmp_path / "manifest.json").write_text(json.dumps(manifest))
    code, message = complaint(str(tmp_path))
    assert code == "invalid-model" and "external data" in message


def test_model_properties(models: Path) -> None:
    model = _core.Model(str(models / "samples-5"))
    assert model.name == "samples-5"
    assert model.requires == ["color", "samples.descriptor", "samples.density"]
    assert "samples.valid" in model.uses
    assert model.manifest["reconstruction"]["size"] == 5
    assert model.folder == str(models / "samples-5")
    assert _core.find_model("samples-5", [str(models)]) == model.folder


def test_stub_names_what_there_is() -> None:
    stub = Path(pathfold.__file__).parent / "_core.pyi"
    text = stub.read_text()
    for name in (name for name in dir(_core) if not name.startswith("_")):
        assert any(f"\n{line}" in text for line in (f"class {name}", f"def {name}(", f"{name}: ")), name
