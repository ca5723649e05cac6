"""What a renderer's albedo is where a ray hits nothing becomes 1, by coverage."""

import numpy as np
import pytest
from pathfold.channels.convert import complete_albedo, encoded

SIZE = (24, 32)
Buffers = dict[str, np.ndarray]


def scene() -> tuple[Buffers, np.ndarray]:
    """A surface of albedo 0.3 that covers the left, a third and a half of two columns, and nothing of the right."""
    coverage = np.zeros((*SIZE, 1), np.float32)
    coverage[:, :16], coverage[:, 16], coverage[:, 17] = 1, 0.5, 0.33
    normal = coverage * np.float32([0, 0.6, -0.8])
    normal[:, 3] *= 0.4  # creased, not partly covered
    return {"albedo": 0.3 * coverage.repeat(3, -1), "normal": normal, "depth": 5 * coverage}, coverage


def completed(buffers: Buffers, on_miss: float | str | None = 0) -> np.ndarray:
    made = complete_albedo(buffers, on_miss)
    return buffers["albedo"] if made is None else made[0]


@pytest.mark.parametrize("told_by", ["alpha", "normals", "encoded", "depth"])
def test_what_is_not_covered_counts_as_1(told_by: str) -> None:
    buffers, coverage = scene()
    expected = (0.3 * coverage + 1 - coverage).repeat(3, -1)
    if told_by == "alpha":
        buffers["alpha"] = coverage
    else:
        buffers["alpha"] = np.ones_like(coverage)  # a film with a background
    if told_by == "encoded":
        buffers["normal"] = 0.5 * buffers["normal"] + 0.5
        del buffers["depth"]
    if told_by == "depth":
        del buffers["normal"]
        expected[:, 16:18] = buffers["albedo"][:, 16:18]  # how much of a pixel is covered it does not tell
    assert completed(buffers) == pytest.approx(expected, abs=1e-5)
    made = complete_albedo(buffers, 0)
    assert made is not None
    count = int((coverage < 1).sum()) - (2 * SIZE[0] if told_by == "depth" else 0)
    assert f"in {count} pixels, by coverage ({told_by.replace('encoded', 'normals')})" in made[1]


def test_thin_cover_is_followed_from_misses_and_creases_are_not() -> None:
    coverage = np.ones((*SIZE, 1), np.float32)
    coverage[:3], coverage[3:15] = 0, 0.25  # a fence out of focus, before a sky and then before a wall
    normal = coverage * np.float32([0, 0.6, -0.8])
    normal[18:22] *= 0.3  # creased
    buffers = {"albedo": 0.4 * coverage.repeat(3, -1), "normal": normal, "depth": 5 * coverage}
    assert completed(buffers) == pytest.approx((0.4 * coverage + 1 - coverage).repeat(3, -1), abs=1e-5)


def test_completing_a_large_picture_ends() -> None:
    rng = np.random.default_rng(4)
    normal = rng.uniform(0, 1, (700, 900, 1)).astype(np.float32) * np.float32([0, 0, -1])
    normal[rng.uniform(size=(700, 900)) < 0.3] = 0
    buffers = {"albedo": np.zeros_like(normal), "normal": normal}
    assert completed(buffers).min() >= 0 and completed(buffers).max() <= 1


@pytest.mark.parametrize("kept", ["covered", "one", "sky", "nothing tells", "another's alpha", "no hit", "bad"])
def test_what_needs_no_change_stays_to_the_bit(kept: str) -> None:
    buffers, coverage = scene()
    on_miss: float | str | None = 0
    if kept == "covered":
        buffers |= {"alpha": np.ones_like(coverage), "depth": np.ones_like(coverage)}
        buffers["normal"][:] = 1
    if kept == "one":
        on_miss = 1
    if kept == "sky":
        on_miss = "sky"
    if kept == "nothing tells":
        buffers = {"albedo": buffers["albedo"]}
    if kept == "another's alpha":  # 0 where this albedo has surfaces
        buffers = {"albedo": buffers["albedo"] + np.float32(0.3), "alpha": coverage}
        buffers["albedo"] += (buffers["albedo"] <= coverage) * (coverage + np.float32(0.1))
    if kept == "no hit":
        buffers |= {name: np.zeros_like(buffers[name]) for name in ("normal", "depth")}
    if kept == "bad":
        buffers |= {name: np.full_like(buffers[name], np.nan) for name in ("normal", "depth")}
    before = {name: pixels.copy() for name, pixels in buffers.items()}
    assert complete_albedo(buffers, on_miss) is None
    assert all(np.array_equal(before[name], buffers[name], equal_nan=True) for name in before)


@pytest.mark.parametrize("value", [0.0, 0.2, 1.0])
def test_where_nobody_says_the_pixels_tell(value: float) -> None:
    buffers, coverage = scene()
    buffers["albedo"] += np.float32(value) * (1 - coverage)
    changed = complete_albedo(buffers, None)
    assert (changed is not None) == (value == 0)


@pytest.mark.parametrize("far", [1e9, 1e10, 1e30, float(np.finfo(np.float32).max), np.inf, np.nan])
def test_far_depths_are_misses(far: float) -> None:
    buffers, coverage = scene()
    del buffers["normal"]
    buffers["depth"] = np.where(coverage > 0, buffers["depth"], np.float32(far))
    assert completed(buffers)[:, 20:] == pytest.approx(1)


@pytest.mark.filterwarnings("error")
@pytest.mark.parametrize("value", [np.nan, np.inf, -np.inf, 3e38, -3e38, 1e-40])
@pytest.mark.parametrize("name", ["albedo", "normal", "depth", "alpha"])
def test_any_value_anywhere_is_borne(name: str, value: float) -> None:
    buffers, coverage = scene()
    buffers["alpha"] = coverage.copy() if name == "alpha" else np.ones_like(coverage)
    buffers[name][::3] = value
    made = completed(buffers)
    assert made.shape == buffers["albedo"].shape and made[1, 25] == pytest.approx(1)
    encoded(buffers["normal"])


def test_values_that_are_not_finite_stay_theirs() -> None:
    buffers, coverage = scene()
    buffers["alpha"] = coverage
    buffers["albedo"][2, 2] = np.nan
    buffers["alpha"] = coverage.copy()
    buffers["alpha"][4, 4] = np.nan
    made = completed(buffers)
    assert np.isnan(made[2, 2]).all() and np.isfinite(made).sum() == made.size - 3
    assert made[4, 4] == pytest.approx(0.3)
