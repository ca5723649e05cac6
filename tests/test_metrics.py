"""Metrics against values worked out by hand."""

import builtins

import numpy as np
import pytest
from pathfold import metrics


def flat(value: float, size: int = 8) -> np.ndarray:
    return np.full((size, size, 3), value, np.float32)


def test_rell2_by_hand() -> None:
    image, reference = flat(1.0), flat(2.0)
    image[0] = 2.0  # one row of eight is right
    assert metrics.rell2(image, reference) == pytest.approx(7 / 8 * 1 / 4.01)
    assert metrics.rell2(image, reference, epsilon=1.0) == pytest.approx(7 / 8 * 1 / 5)


def test_smape_by_hand() -> None:
    assert metrics.smape(flat(1.0), flat(3.0)) == pytest.approx(2 / 4.01)
    assert metrics.smape(flat(0.0), flat(0.0)) == 0


def test_halves_drop_the_noise_of_the_reference() -> None:
    truth, noise = np.random.default_rng(0), np.random.default_rng(1)
    r = truth.uniform(1, 2, (200, 200, 3))
    a, b = (r + noise.normal(0, 0.05, r.shape) for _ in range(2))
    image = r + 0.05 * truth.choice([-1, 1], r.shape)
    exact = metrics.rell2(image, r)
    assert metrics.rell2_halves(image, a, b) == pytest.approx(exact, rel=0.03)
    assert metrics.rell2(image, (a + b) / 2) > 1.3 * exact
    assert metrics.reference_rell2(a, b) == pytest.approx(metrics.rell2((a + b) / 2, r), rel=0.05)


def test_halves_by_hand() -> None:
    assert metrics.rell2_halves(flat(3.0), flat(1.0), flat(2.0)) == pytest.approx(2 * 1 / (1.5**2 + 0.01))


def test_display_puts_the_log_average_at_middle_grey() -> None:
    reference = flat(4.0)
    reference[:4] = 1.0
    reference[0, 0] = 0.0  # black does not count
    lit = np.log(np.r_[np.full(31, 1.0), np.full(32, 4.0)]).mean()
    scale = metrics.exposure(reference)
    assert scale == pytest.approx(0.18 / np.exp(lit))
    assert metrics.display(flat(1 / scale), scale) == pytest.approx(0.5 ** (1 / 2.2))
    assert metrics.exposure(flat(0.0)) == 1.0


def test_ssim_and_flip_are_the_packages_own() -> None:
    rng = np.random.default_rng(2)
    reference = rng.uniform(0, 3, (24, 32, 3))
    image = reference * rng.uniform(0.8, 1.2, reference.shape)
    scale = metrics.exposure(reference)
    x, r = metrics.display(image, scale), metrics.display(reference, scale)

    skimage = pytest.importorskip("skimage.metrics")
    expected = skimage.structural_similarity(x, r, data_range=1, channel_axis=2)
    assert metrics.ssim(image, reference) == pytest.approx(expected)
    assert metrics.ssim(reference, reference) == pytest.approx(1)

    flip_evaluator = pytest.importorskip("flip_evaluator")
    assert metrics.flip(image, reference) == pytest.approx(flip_evaluator.evaluate(r, x, "LDR")[1])
    assert metrics.flip(reference, reference) == pytest.approx(0, abs=1e-6)
    assert metrics.flip_map(image, reference).shape == reference.shape[:2]
    assert metrics.flip_map(image, reference).mean() == pytest.approx(metrics.flip(image, reference), rel=1e-4)
    assert list(metrics.compare(image, reference)) == ["rell2", "smape", "ssim", "flip"]


def test_shapes_that_differ_are_named() -> None:
    with pytest.raises(ValueError, match=r"\(8, 8, 3\) and \(4, 4, 3\)"):
        metrics.rell2(flat(1), flat(1, 4))
    with pytest.raises(ValueError, match="at least 7x7"):
        metrics.ssim(flat(1, 4), flat(1, 4))


@pytest.mark.parametrize(("metric", "package"), [("ssim", "scikit-image"), ("flip", "flip-evaluator")])
def test_a_missing_package_names_its_extra(monkeypatch: pytest.MonkeyPatch, metric: str, package: str) -> None:
    real = builtins.__import__

    def absent(name: str, *args: object, **kwargs: object) -> object:
        if name.split(".")[0] in ("skimage", "flip_evaluator"):
            raise ModuleNotFoundError(name)
        return real(name, *args, **kwargs)  # type: ignore[arg-type]

    monkeypatch.setattr(builtins, "__import__", absent)
    with pytest.raises(ModuleNotFoundError, match=rf"{package}.*pathfold\[bench\]"):
        getattr(metrics, metric)(flat(1), flat(1))


def test_a_shared_exposure_replaces_the_own_one() -> None:
    rng = np.random.default_rng(3)
    reference = rng.uniform(0.05, 3, (16, 16, 3))
    image = reference * rng.uniform(0.5, 1.5, reference.shape)
    own = metrics.exposure(reference)
    assert metrics.compare(image, reference, own) == metrics.compare(image, reference)
    other = metrics.compare(image, reference, 10 * own)
    assert other["ssim"] != metrics.ssim(image, reference) and other["flip"] != metrics.flip(image, reference)
    assert other["rell2"] == metrics.rell2(image, reference)


def test_flicker_by_hand() -> None:
    def sequence(*offsets: float) -> float | None:
        flicker = metrics.Flicker(1.0)
        for offset in offsets:
            shown = metrics.display(flat(1), 1.0) + offset
            linear = shown**2.2 / (1 - shown**2.2)  # the picture whose display values are off by `offset`
            flicker.add(linear, flat(1))
        return flicker.value

    assert sequence(0.1, 0.1) is None
    assert sequence(0.1, 0.1, 0.1) == pytest.approx(0, abs=1e-6)  # a steady error does not flicker
    assert sequence(0.0, 0.1, 0.2) == pytest.approx(0, abs=1e-6)  # nor does a drift
    assert sequence(0.1, -0.1, 0.1) == pytest.approx(0.4, rel=1e-4)
    assert sequence(0.1, -0.1, 0.1, 0.1) == pytest.approx((0.4 + 0.2) / 2, rel=1e-4)


def test_cropped() -> None:
    image = np.arange(60 * 70 * 3).reshape(60, 70, 3)
    np.testing.assert_array_equal(metrics.cropped(image), image[28:32, 28:42])
    assert metrics.cropped(image[:56]) is None
