"""The SDK's call that fills in path descriptors, against what the tracer makes of the same walks."""

import mitsuba as mi
import numpy as np
import pytest

if mi.variant() != "llvm_ad_rgb":
    mi.set_variant("llvm_ad_rgb")

from pathfold import PathfoldError, _core
from pathfold.mitsuba.descriptor import Record, Vertex, channels

KINDS = list(_core.KINDS.values())[1:]
LANES = 64
Values = np.ndarray


def drawn(rng: np.random.Generator, shape: tuple[int, ...], low: float = -3, high: float = 2) -> Values:
    """Powers of ten, some 0."""
    values = 10 ** rng.uniform(low, high, shape)
    return np.where(rng.random(shape) < 0.15, 0, values).astype(np.float32)


def color(values: Values) -> mi.Color3f:
    return mi.Color3f(*(mi.Float(channel) for channel in values.T))


@pytest.mark.parametrize("sampled", [False, True])
@pytest.mark.parametrize("length", [0, 1, 3, 6, 8])
def test_a_path_is_described_as_the_tracer_does(length: int, sampled: bool) -> None:
    """Walks of so many vertices that find a light, by chance or as a light sample with a vertex of its own."""
    rng = np.random.default_rng(length)
    attenuations = [drawn(rng, (LANES, 3)) for _ in range(length + sampled)]
    kinds = [rng.choice(KINDS, LANES).astype(np.float32) for _ in attenuations]
    roughness = [rng.random(LANES).astype(np.float32) for _ in attenuations]
    densities = [10 ** rng.uniform(-3, 3, LANES).astype(np.float32) for _ in attenuations]
    light = drawn(rng, (LANES, 3), -30, 4)

    record = Record.empty(_core.MAX_VERTICES)
    on, gathered = mi.Bool(True), mi.Color3f(1)
    for number, attenuation in enumerate(attenuations):
        vertex = Vertex(color(attenuation), mi.Float(kinds[number]), mi.Float(roughness[number]))
        if sampled and number == length:
            record.sample_light(gathered, color(light), mi.Float(densities[number]), vertex)
        else:
            record.scatter(on, mi.Bool(False), mi.Float(densities[number]), vertex)
    if not sampled:
        record.find_light(gathered, color(light))
    made = channels(record)

    def lanes(values: list[object]) -> Values:
        return np.stack([np.broadcast_to(np.array(value, np.float32).ravel(), LANES) for value in values], -1)

    descriptor, density = lanes(made["descriptor"]), lanes(made["density"])
    for lane in range(LANES):
        path = [
            (attenuations[i][lane].tolist(), int(kinds[i][lane]), float(roughness[i][lane]), float(densities[i][lane]))
            for i in range(length + sampled)
        ]
        right, density_of = _core.describe_path(light[lane].tolist(), path)
        np.testing.assert_allclose(right, descriptor[lane], rtol=2**-10, atol=2e-4)
        assert density_of == pytest.approx(density[lane, 0], rel=1e-5, abs=1e-5)
    assert (descriptor == _core.DEAD_LOG).any()


def test_a_walk_without_a_light_has_no_radiance() -> None:
    record = Record.empty(2)
    record.scatter(mi.Bool(True), mi.Bool(False), mi.Float(0.5), Vertex(mi.Color3f(0.25), mi.Float(5), mi.Float(1)))
    made = [float(np.array(value, np.float32).ravel()[0]) for value in channels(record)["descriptor"]]
    right, _ = _core.describe_path((0, 0, 0), [((0.25, 0.25, 0.25), _core.KINDS["diffuse-reflection"], 1, 0.5)], 2)
    np.testing.assert_allclose(right, made, rtol=2**-10)


def test_the_layout_tells_the_vertices() -> None:
    for vertices in range(1, _core.MAX_VERTICES + 1):
        assert _core.descriptor_vertices(_core.Layout(vertices).channels) == vertices
    assert _core.descriptor_vertices(_core.Layout().channels + 1) == 0
    listed = {name: (channels, per_sample) for name, channels, per_sample in _core.buffers()}
    assert listed["samples.descriptor"] == (_core.Layout().channels, True) and listed["color"] == (3, False)
    with pytest.raises(PathfoldError, match="kind is 4; it must be a pathfold_kind"):
        _core.describe_path((1, 1, 1), [((1, 1, 1), 4, 0, 1)])
