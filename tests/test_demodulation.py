"""Where an albedo does not explain the light, radiance is filtered undivided; where it does, nothing is changed."""

import numpy as np
import pathfold
import pytest
from pathfold.check import demodulation
from pathfold.check.spoilt import room

SHAPE = (64, 80, 3)
NOTE = "does not explain the light in"


def texture(seed: int = 0) -> np.ndarray:
    return np.random.default_rng(seed).random(SHAPE).astype(np.float32)


def noisy(light: np.ndarray, seed: int = 1) -> np.ndarray:
    return (light * np.random.default_rng(seed).gamma(0.5, 2.0, (*SHAPE[:2], 1))).astype(np.float32)


@pytest.mark.parametrize("model", ["pathfold-fast", "kpcn-vanilla"])
def test_even_light_stays_even_whatever_the_albedo(model: str) -> None:
    light = np.ones(SHAPE, np.float32)
    frame = {"color": light, "albedo": texture()}
    by = "albedo"
    if model.startswith("kpcn"):
        frame = {"diffuse": light, "specular": 0 * light, "diffuse.albedo": texture()}
        by = "diffuse.albedo"
    result = pathfold.Denoiser(model).run_buffers(frame)
    assert np.abs(result.color - 1).mean() < 0.1
    assert [note for note in result.report["notes"] if note.startswith(f"{by} {NOTE} 5120 pixels")]


@pytest.mark.parametrize("share", [1.0, 0.3, 0.05])
def test_an_albedo_that_explains_the_light_is_left_alone(share: float) -> None:
    """Whatever the noise: here `share` of the pixels are lit at all."""
    albedo = texture()
    lit = np.random.default_rng(2).random((*SHAPE[:2], 1)) < share
    frame = {"color": noisy(3 * albedo * lit / share), "albedo": albedo}
    assert not [n for n in pathfold.Denoiser("pathfold-fast").run_buffers(frame).report["notes"] if NOTE in n]
    flat = demodulation.flatten(albedo.astype(float), frame["color"].astype(float), np.ones(SHAPE[:2], bool), 0.01)
    assert np.abs(flat - albedo).mean() < 0.01


def test_a_flat_albedo_is_left_alone_to_the_bit() -> None:
    for value in (0.0, 0.4, 1.0):
        albedo = np.full(SHAPE, value)
        flat = demodulation.flatten(albedo, noisy(np.ones(SHAPE)).astype(float), np.ones(SHAPE[:2], bool), 0.01)
        np.testing.assert_array_equal(flat, albedo)


def test_layers_still_add_up_where_the_albedo_is_flattened() -> None:
    frame = {"color": noisy(np.ones(SHAPE)), "albedo": texture()}
    key = frame["color"] * texture(3)
    layers = {"key": {"color": key}, "fill": {"color": frame["color"] - key}}
    result = pathfold.Denoiser("pathfold-fast").run_buffers(frame, layers=layers)
    assert [n for n in result.report["notes"] if NOTE in n]
    np.testing.assert_allclose(result.layers["key"] + result.layers["fill"], result.color, rtol=1e-4, atol=1e-6)


def test_what_is_seen_through_is_better_than_before() -> None:
    """A fence of albedo 0.5 that covers a part of each pixel before a sky of 1, which has albedo 0."""
    covered = np.random.default_rng(4).binomial(8, 0.4, (96, 96, 1)) / 8
    truth = np.full((96, 96, 3), 0.4 * 0.2 + 0.6)
    frame = {"color": (0.2 * covered + (1 - covered)) * np.ones(3), "albedo": 0.5 * covered * np.ones(3)}
    frame = {name: values.astype(np.float32) for name, values in frame.items()}
    for model in ("pathfold-fast", "pathfold-balanced"):
        image = pathfold.Denoiser(model).run_buffers(frame).color
        assert float(np.mean((image - truth) ** 2)) < float(np.mean((frame["color"] - truth) ** 2)) / 5


def test_the_room_of_check_is_explained_by_its_albedo() -> None:
    frame, _ = room({"requires": []})
    albedo, light = (frame[name].astype(float) for name in ("albedo", "color"))
    np.testing.assert_allclose(
        demodulation.flatten(albedo, light, np.ones(light.shape[:2], bool), 0.01), albedo, atol=0.02
    )
