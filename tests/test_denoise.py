"""Denoising from Python: what is taken, what comes back, and what is refused."""

import subprocess
import sys
import time
from contextlib import nullcontext
from fractions import Fraction
from pathlib import Path
from typing import Any

import numpy as np
import pathfold
import pytest
from pathfold.arguments import as_array

H, W, S = 20, 28, 3


def picture(seed: int = 0, channels: int = 3) -> np.ndarray:
    return np.random.default_rng(seed).exponential(1.0, (H, W, channels)).astype(np.float32)


def split_frame() -> dict[str, np.ndarray]:
    diffuse, specular, albedo = picture(1), picture(2), np.clip(picture(3), 0, 1)
    return {"color": diffuse + specular, "diffuse": diffuse, "specular": specular, "diffuse_albedo": albedo}


def block() -> dict[str, np.ndarray]:
    rng = np.random.default_rng(4)
    descriptor = rng.normal(0, 1, (S, H, W, 36)).astype(np.float16)
    return {"descriptor": descriptor, "density": rng.normal(0, 1, (S, H, W, 1)).astype(np.float32)}


def test_import_is_quick_and_brings_nothing_heavy() -> None:
    code = """
import sys, time
start = time.process_time()
import pathfold
took = time.process_time() - start
heavy = {"numpy", "OpenImageIO", "mitsuba", "torch", "rich", "typer"} & set(sys.modules)
assert not heavy, heavy
assert took < 0.2, took
"""
    subprocess.run([sys.executable, "-c", code], check=True)


def test_denoise_is_the_color_of_a_run(tiny: Path) -> None:
    color = picture()
    image = pathfold.denoise(color, albedo=np.clip(picture(5), 0, 1), model="split-5")
    result = pathfold.Denoiser("split-5").run(color, albedo=np.clip(picture(5), 0, 1))
    assert image.dtype == np.float32 and image.shape == (H, W, 3)
    assert (image == result.color).all()
    assert result.alpha is None and result.diffuse is None and result.layers == {}
    assert result.report["model"] == "split-5" and "albedo" in result.report["inputs"]["used"]
    assert (pathfold.denoise(color, model=pathfold.Denoiser(tiny / "single-3")) != image).any()


def test_denoise_takes_what_a_denoiser_takes(tiny: Path) -> None:
    options = {"provider": "cpu", "threads": 1, "leave_out": "none"}
    expected = pathfold.Denoiser("split-5", **options).run(picture()).color
    assert (pathfold.denoise(picture(), model="split-5", **options) == expected).all()
    with pytest.raises(pathfold.PathfoldError, match="warp"):
        pathfold.denoise(picture(), model="split-5", provider="warp")
    with pytest.raises(pathfold.PathfoldError, match="model is a Denoiser; give provider, threads, leave_out where"):
        pathfold.denoise(picture(), model=pathfold.Denoiser("split-5"), leave_out="none")


def test_the_split_adds_up_and_alpha_comes_along(tiny: Path) -> None:
    alpha = np.ones((H, W), np.float32)
    result = pathfold.Denoiser("split-5").run(**split_frame(), alpha=alpha, depth=picture(6, 1)[..., 0])
    assert result.diffuse is not None and result.specular is not None and result.alpha is not None
    assert result.color == pytest.approx(result.diffuse + result.specular, rel=1e-5)
    assert result.alpha.reshape(H, W) == pytest.approx(1, abs=1e-6)


def test_layers_are_filtered_alike(tiny: Path) -> None:
    color = picture()
    layers = {"key": {"color": 0.25 * color}, "fill": {"color": 0.75 * color}}
    result = pathfold.Denoiser("split-5").run(color, layers=layers)
    assert sorted(result.layers) == ["fill", "key"]
    assert result.layers["key"] + result.layers["fill"] == pytest.approx(result.color, rel=1e-5)


def test_samples_are_read(tiny: Path) -> None:
    denoiser = pathfold.Denoiser("samples-5")
    samples = block()
    first = denoiser.run(**split_frame(), samples=samples).color
    turned = {name: values[:, ::-1] for name, values in samples.items()}
    assert (denoiser.run(**split_frame(), samples=turned).color != first).any()
    with pytest.raises(pathfold.PathfoldError, match=r"samples\.descriptor"):
        denoiser.run(**split_frame())


def layouts() -> dict[str, Any]:
    color = picture()
    padded = np.zeros((H, W, 7), np.float32)
    padded[..., 2:5] = color
    return {
        "fortran": np.asfortranarray(color),
        "padded": padded[..., 2:5],
        "flipped": color[::-1, ::-1].copy()[::-1, ::-1],
        "readonly": np.frombuffer(color.tobytes(), np.float32).reshape(color.shape),
        "float64": color.astype(np.float64),
        "big endian": color.astype(">f4"),
        "list": color.tolist(),
    }


@pytest.mark.parametrize("layout", layouts())
def test_any_layout_gives_the_same(tiny: Path, layout: str) -> None:
    image = pathfold.denoise(layouts()[layout], model="single-3")
    assert (image == pathfold.denoise(picture(), model="single-3")).all()


def test_half_floats(tiny: Path) -> None:
    half = picture().astype(np.float16)
    image = pathfold.denoise(half, model="single-3")
    assert image == pytest.approx(pathfold.denoise(half.astype(np.float32), model="single-3"), rel=1e-5)


def test_torch_tensors_are_not_copied(tiny: Path) -> None:
    torch = pytest.importorskip("torch")
    tensor = torch.from_numpy(picture()).permute(2, 0, 1).contiguous().permute(1, 2, 0)  # planar memory
    assert np.shares_memory(as_array("color", tensor), tensor.numpy())
    assert (pathfold.denoise(tensor, model="single-3") == pathfold.denoise(picture(), model="single-3")).all()
    with pytest.raises(pathfold.PathfoldError, match=r"color: a torch.Tensor cannot be read.*detach\(\)\.cpu\(\)"):
        pathfold.denoise(tensor.to(torch.bfloat16), model="single-3")


def test_mitsuba_tensors(tiny: Path) -> None:
    mi = pytest.importorskip("mitsuba")
    mi.set_variant("llvm_ad_rgb")
    tensor = mi.TensorXf(picture())
    assert (pathfold.denoise(tensor, model="single-3") == pathfold.denoise(picture(), model="single-3")).all()


def test_dlpack_alone_is_enough(tiny: Path) -> None:
    class Opaque:
        def __init__(self, array: np.ndarray) -> None:
            self._array = array

        def __dlpack__(self, **options: Any) -> object:
            return self._array.__dlpack__(**options)

        def __dlpack_device__(self) -> tuple[int, int]:
            return self._array.__dlpack_device__()

    color = picture()
    assert np.shares_memory(as_array("color", Opaque(color)), color)


def test_inputs_are_never_changed(tiny: Path) -> None:
    color = picture()
    color[3, 4] = np.nan
    before = color.copy()
    pathfold.denoise(color, model="single-3")
    assert color.tobytes() == before.tobytes()


def test_bad_pixels_are_mended_and_counted(tiny: Path) -> None:
    color = picture()
    color[3, 4], color[10, 11, 1], color[0, 0] = np.nan, np.inf, -1
    result = pathfold.Denoiser("single-3").run(color)
    assert np.isfinite(result.color).all() and result.color.min() >= 0
    faults = {"not finite (rebuilt from neighbours)": 2, "negative (set to 0)": 1}
    assert result.report["sanitised"] == {"color": faults}


def test_exposure_is_reported_and_can_be_given(tiny: Path) -> None:
    denoiser = pathfold.Denoiser("single-3")
    automatic = denoiser.run(picture())
    fixed = denoiser.run(picture(), exposure=automatic.report["exposure"])
    assert (fixed.color == automatic.color).all()
    assert (denoiser.run(picture(), exposure=7.0).color != automatic.color).any()


def test_what_is_left_out_can_be_chosen(tiny: Path) -> None:
    frame = split_frame() | {"specular": np.zeros((H, W, 3), np.float32)}
    frame["color"] = frame["diffuse"]
    results = {names: pathfold.Denoiser("split-5", leave_out=names).run(**frame) for names in ("all", "none", "tiles")}
    for result in results.values():
        assert result.color == pytest.approx(results["none"].color, rel=1e-5)
    said = {names: [line["what"] for line in result.report["left_out"]] for names, result in results.items()}
    assert said == {"all": ["branch specular"], "none": [], "tiles": []}
    assert "color" in results["all"].report["inputs"]["used"]  # its parts are compared with it
    with pytest.raises(
        pathfold.PathfoldError, match='leave_out is "pixels"; it must be all, none, or some of branches'
    ):
        pathfold.Denoiser("split-5", leave_out="pixels")


def test_converged_tiles_are_copied_where_asked(tiny: Path) -> None:
    color, variance = 1 + picture(), np.full((H, W, 3), 1e-6, np.float32)
    variance[0, 0] = 2e-6  # the same everywhere it would say nothing
    denoiser = pathfold.Denoiser("split-5", leave_out="all,converged")
    copied = denoiser.run(color, variance=variance, samples_per_pixel=16)
    assert (copied.color == color).all() and copied.report["left_out"][0]["what"] == "all tiles"
    assert (denoiser.run(color, variance=variance).color != color).any()  # nobody says how many samples


def test_progress_grows_and_cancels(tiny: Path) -> None:
    denoiser = pathfold.Denoiser("single-3", tile=8)
    seen: list[float] = []
    denoiser.run(picture(), progress=seen.append)
    assert seen == sorted(seen) and seen[-1] == 1 and len(seen) > 2
    with pytest.raises(pathfold.PathfoldError) as caught:
        denoiser.run(picture(), progress=lambda done: done < 0.3)
    assert caught.value.code == "cancelled"
    assert denoiser.run(picture()).color.shape == (H, W, 3)


@pytest.mark.parametrize("handled", [True, False])
def test_a_run_within_its_own_run_is_refused(tiny: Path, handled: bool) -> None:
    denoiser = pathfold.Denoiser("single-3")

    def again(_: float) -> None:
        with pytest.raises(pathfold.PathfoldError, match="another Denoiser") if handled else nullcontext():
            denoiser.run(picture())

    outcome: Any = (
        nullcontext() if handled else pytest.raises(pathfold.PathfoldError, match="progress callback asks it")
    )
    with outcome:
        denoiser.run(picture(), progress=again)
    assert denoiser.run(picture()).color.shape == (H, W, 3)  # usable afterwards


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        ({"color": picture().astype(np.uint8)}, r"color: given uint8 values; .*float32"),
        ({"color": picture(channels=4)}, r"color.*4"),
        ({"color": picture(), "albedo": picture()[:-1]}, r"albedo.*28x19|albedo.*19"),
        ({"color": np.zeros((0, 4, 3), np.float32)}, r"color"),
        ({"albedo": picture()}, r"color"),
        ({"color": picture(), "exposure": -1.0}, r"exposure is -1"),
        ({"color": "picture.exr"}, r"color: given <U11 values"),
        ({"color": picture(), "exposure": "bright"}, r"exposure is a str; give a number > 0"),
        ({"color": picture(), "samples_per_pixel": "a"}, r"samples_per_pixel is a str; give a whole number"),
        ({"color": picture(), "samples_per_pixel": 10**12}, r"samples_per_pixel is 1000000000000; .* of 31 bits"),
        ({"color": picture(), "threads": "a"}, r"threads is a str; give a whole number"),
        ({"color": picture(), "leave_out": ["tiles"]}, r"leave_out is a list; give its name as a str"),
        ({"color": picture(), "progress": 5}, r"progress is a int; give a function"),
        ({"color": picture(), "seconds": "x"}, r"seconds is 'x'; it must be > 0"),
        ({"color": picture(), "albedo": picture()[:-1], "seconds": 9}, r"albedo is 28x19 pixels, but color is 28x20"),
        ({"color": np.zeros(3, np.float32), "seconds": 9}, r"color is of shape \(3,\); give H x W x C"),
        ({"color": picture(), "samples_per_pixel": 2.5}, r"samples_per_pixel is a float; give a whole number"),
        ({"color": picture(), "samples": picture()}, r'samples is a numpy.ndarray; give {"descriptor": S x H x W'),
        ({"color": picture(), "samples": {1: picture()}}, r"samples has the key 1, a int; give {"),
        ({"color": picture(), "layers": ["key"]}, r"layers is a list; give {NAME: "),
        ({"color": picture(), "layers": {"key": picture()}}, r"layers\['key'\] is a numpy.ndarray; give {\"color\""),
        ({"color": picture(), "layers": {"key": {"color": None}}}, r"layer 'key', color: given object values"),
    ],
)
def test_what_is_wrong_is_named(tiny: Path, arguments: dict[str, Any], message: str) -> None:
    with pytest.raises(pathfold.PathfoldError, match=message) as caught:
        pathfold.denoise(model="split-5", **arguments)
    assert caught.value.code == "invalid-argument"


@pytest.mark.parametrize("model", [None, 5])
def test_what_is_no_model_is_named(model: Any) -> None:
    with pytest.raises(pathfold.PathfoldError, match=r"model is a \w+; give a name, a folder") as caught:
        pathfold.Denoiser(model)
    assert caught.value.code == "invalid-argument"


def test_any_real_number_is_an_exposure(tiny: Path) -> None:
    expected = pathfold.denoise(picture(), model="single-3", exposure=2.0)
    for exposure in (2, np.float32(2), Fraction(2)):
        assert (pathfold.denoise(picture(), model="single-3", exposure=exposure) == expected).all()


def test_unknown_buffers_and_models_are_named(tiny: Path) -> None:
    for budget in ({}, {"seconds": 60.0}):
        with pytest.raises(TypeError, match=r"^denoise\(\) got an unexpected keyword argument 'albedoo'"):
            pathfold.denoise(picture(), albedoo=picture(), model="single-3", **budget)
    with pytest.raises(pathfold.PathfoldError, match=r"samples\.nonsense"):
        pathfold.denoise(picture(), samples={"nonsense": picture()[None]}, model="single-3")
    with pytest.raises(pathfold.PathfoldError, match=r'"nope".*single-3') as caught:
        pathfold.denoise(picture(), model="nope")
    assert caught.value.code == "not-found"


def test_models_are_listed_in_order_of_search(tiny: Path) -> None:
    assert {"single-3", "split-5", "samples-5"} <= set(pathfold.models.available())
    assert pathfold.models.find("split-5") == tiny / "split-5"
    assert pathfold.models.inputs("single-3") >= {"color"}


def test_precision_is_chosen_and_reported(tiny: Path) -> None:
    exact, rounded = (pathfold.Denoiser("quantised-3", precision=precision) for precision in ("fp32", "int8"))
    color = picture()
    images = {}
    for precision, denoiser in (("fp32", exact), ("int8", rounded)):
        result = denoiser.run(color)
        assert result.report["precision"] == denoiser.model.precision == precision
        images[precision] = result.color
        assert (pathfold.denoise(color, model="quantised-3", precision=precision) == result.color).all()
        assert (pathfold.denoise(color, model=denoiser) == result.color).all()
    assert (images["fp32"] != images["int8"]).any()
    automatic = pathfold.Denoiser("quantised-3").model.precision
    assert (pathfold.denoise(color, model="quantised-3") == images[automatic]).all()
    assert pathfold.Denoiser("single-3").model.precision == "fp32"
    assert pathfold.models.precisions("quantised-3") == ["fp32", "int8"]
    with pytest.raises(pathfold.PathfoldError, match="model is a Denoiser in fp32; make one in int8"):
        pathfold.denoise(color, model=exact, precision="int8")
    with pytest.raises(pathfold.PathfoldError, match='precision is "half"; it must be auto, fp32 or int8'):
        pathfold.denoise(color, model="quantised-3", precision="half")
    with pytest.raises(pathfold.PathfoldError, match="single-3 has no int8 variant; give precision fp32") as caught:
        pathfold.denoise(color, model="single-3", precision="int8")
    assert caught.value.code == "unsupported"


def test_a_repeated_call_loads_nothing(tiny: Path) -> None:
    pathfold.denoise(picture(), model="single-3")
    start = time.process_time()
    pathfold.denoise(picture(), model="single-3")
    assert time.process_time() - start < 0.1


def test_denoise_loads_no_more_than_it_needs() -> None:
    """What a renderer's plug-in pays for: no image files, no tracer, no training."""
    script = """
import sys
import numpy as np
import pathfold
pathfold.denoise(np.ones((16, 16, 3), np.float32), model="kpcn-vanilla")
print(sorted({"torch", "mitsuba", "lightning", "OpenImageIO"} & set(sys.modules)))
"""
    done = subprocess.run([sys.executable, "-c", script], capture_output=True, text=True, check=True)
    assert done.stdout == "[]\n"
