"""The pathfold family in torch: the trusted gather pyramid's promises, the network's shapes and receptive field."""

import numpy as np
import pytest
import torch
from pathfold.models import ALL_SAMPLES
from pathfold_training import _taps
from pathfold_training.fit.crops import Crops
from pathfold_training.fit.preset import Config, Data, Optimiser, load_preset
from pathfold_training.fit.task import Denoising
from pathfold_training.fit.train import fit
from pathfold_training.fit.views import Stored
from pathfold_training.fit.warm_start import warm_start
from pathfold_training.networks.embedding import Standardised
from pathfold_training.networks.losses import Loss
from pathfold_training.networks.pathfold.network import Pathfold
from pathfold_training.networks.pathfold.sizes import PathfoldSizes, overlap
from pathfold_training.networks.pathfold.unet import (
    Prediction,
    embedding_moments,
    embedding_sums,
    pixel_features,
    reconstruct,
)
from pathfold_training.networks.reconstruct import KERNEL_TAPS, _WeighTaps, gather_factor, gather_pyramid, level_sums
from pathfold_training.release.score import load
from training_data import write_data_set

SMALL = PathfoldSizes(widths=(16, 16, 16, 16), convolutions=(2, 1, 1, 1), embedding=4)
TINY = Config(
    name="tiny",
    description="a network for tests",
    network=SMALL,
    loss=Loss(albedo=0.5, manifold=0.0125, manifold_pairs=256),
    data=Data(crop=32, batch=2, spp_max=4, drop_paths=0.5),
    optimiser=Optimiser(steps=4, precision="fp32", warmup=1, average=0.9),
)


def random_logits(
    height: int, width: int, seed: int = 0, spread: float = 3.0, count: int = 5
) -> tuple[torch.Tensor, list[torch.Tensor]]:
    """Trust and `count` levels for a frame of height x width, float64."""
    g = torch.Generator().manual_seed(seed)
    h, w = -(-height // 16) * 16, -(-width // 16) * 16
    levels = [
        spread * torch.randn((1, 30 if i < count - 1 else 25, h >> i, w >> i), generator=g, dtype=torch.float64)
        for i in range(count)
    ]
    return -9 * torch.rand((1, 1, h, w), generator=g, dtype=torch.float64), levels


def noise(height: int, width: int, seed: int = 1) -> torch.Tensor:
    g = torch.Generator().manual_seed(seed)
    return torch.rand((1, 3, height, width), generator=g, dtype=torch.float64) ** 4 * 100


SIZES = [(48, 64), (37, 50), (1, 1), (1, 33)]


@pytest.mark.parametrize(("height", "width"), SIZES)
def test_constants_stay(height: int, width: int) -> None:
    trust, levels = random_logits(height, width)
    constant = torch.full((1, 3, height, width), 7.5, dtype=torch.float64)
    torch.testing.assert_close(gather_pyramid(trust, levels, constant), constant, rtol=1e-13, atol=0)


@pytest.mark.parametrize(("height", "width"), SIZES)
@pytest.mark.parametrize("spread", [1.0, 1e4])
def test_bounded_by_the_input(height: int, width: int, spread: float) -> None:
    trust, levels = random_logits(height, width, spread=spread)
    source = noise(height, width)
    out = gather_pyramid(trust, levels, source)
    assert (out >= source.amin((2, 3), keepdim=True) - 1e-12).all()
    assert (out <= source.amax((2, 3), keepdim=True) + 1e-12).all()


def test_layers_add_up() -> None:
    trust, levels = random_logits(40, 40)
    a, b = noise(40, 40, 1), noise(40, 40, 2)
    parts = gather_pyramid(trust, levels, a) + gather_pyramid(trust, levels, b)
    torch.testing.assert_close(gather_pyramid(trust, levels, a + b), parts, rtol=1e-12, atol=1e-12)


def test_bad_pixels_take_no_part() -> None:
    trust, levels = random_logits(48, 48)
    source = noise(48, 48)
    source[:, :, 10:14, 20:25] = torch.nan
    source[:, 1, 30, 30] = torch.inf
    out = gather_pyramid(trust, levels, source)
    finite = torch.isfinite(source).all(1)[0]
    assert torch.isfinite(out).all()
    assert out.max() <= source[0][:, finite].max()
    constant = torch.where(finite, 2.0, torch.nan).expand(1, 3, 48, 48).double()
    torch.testing.assert_close(gather_pyramid(trust, levels, constant), torch.full_like(constant, 2.0))
    nothing = torch.full_like(constant, torch.nan)
    assert gather_pyramid(trust, levels, nothing).abs().max() == 0.0


def test_trust_alone_removes_a_firefly() -> None:
    trust, levels = (
        torch.zeros((1, 1, 32, 32)),
        [torch.zeros((1, 30 if i < 4 else 25, 32 >> i, 32 >> i)) for i in range(5)],
    )
    source = torch.ones((1, 3, 32, 32))
    source[:, :, 9, 12] = 1e4
    assert gather_pyramid(trust, levels, source).max() > 100
    trust[:, :, 9, 12] = -50.0  # clamped to -9
    assert gather_pyramid(trust, levels, source).max() < 1.1


@pytest.mark.parametrize(("height", "width"), [(48, 64), (21, 35), (3, 2), (1, 1)])
@pytest.mark.parametrize("coarsest", [False, True])
def test_the_fast_sums_of_a_level_and_their_gradients_are_the_others(height: int, width: int, coarsest: bool) -> None:
    g = torch.Generator().manual_seed(3)
    random = [
        torch.randn((2, channels, height, width), generator=g, dtype=torch.float64)
        for channels in ((25, 4) if coarsest else (30, 4, 4))
    ]
    random[0] *= 6.0  # some beyond the limit of 10
    results = []
    for dtype in (torch.float64, torch.float32):
        given = [x.to(dtype).requires_grad_() for x in random]
        logits = given[0].contiguous(memory_format=torch.channels_last)  # as a head gives them
        sums = level_sums(logits, *given[1:])
        assert ("LevelSums" in sums[0].grad_fn.name()) == (dtype == torch.float32)
        weighted = sum(
            (part * torch.arange(1.0, part.shape[1] + 1).reshape(1, -1, 1, 1)).square().sum() for part in sums
        )
        results.append([*sums, *torch.autograd.grad(weighted, given)])
    assert len(results[0]) == (3 if coarsest else 6)
    for slow, fast in zip(*results, strict=True):
        assert fast.dtype == torch.float32
        torch.testing.assert_close(fast.double(), slow, rtol=1e-5, atol=1e-6 * float(slow.abs().max()))


def test_taps_outside_of_what_is_given_are_refused() -> None:
    logits, source = np.zeros((1, 25, 4, 4), np.float32), np.zeros((1, 4, 8, 7), np.float32)
    with pytest.raises(ValueError, match=r"the tap at \(0, 4\) reaches beyond source, \(1, 4, 8, 7\)"):
        _taps.sum_taps(logits, 0, source, KERNEL_TAPS, 1)
    with pytest.raises(ValueError, match="25 channels from 1 on"):
        _taps.sum_taps(logits, 1, source, KERNEL_TAPS, 1)
    wide, sums = np.zeros((1, 4, 8, 8), np.float32), np.zeros((1, 4, 4, 4), np.float32)
    with pytest.raises(ValueError, match="gradient is"):
        _taps.spread_taps(logits, 0, wide, sums.reshape(1, 4, 8, 2), np.empty_like(logits), KERNEL_TAPS, 1)
    with pytest.raises(ValueError, match="of_logits is"):
        _taps.spread_taps(logits, 0, wide, sums, np.empty((1, 25, 2, 8), np.float32), KERNEL_TAPS, 1)
    with pytest.raises(TypeError):  # a copy would be written to
        _taps.spread_taps(logits, 0, wide, sums, np.empty((1, 25, 4, 8), np.float32)[..., ::2], KERNEL_TAPS, 1)


def naive(trust: np.ndarray, levels: list[np.ndarray], source: np.ndarray) -> np.ndarray:
    """The formulas of gather_pyramid, pixel by pixel; source H x W without bad pixels, a multiple of 16 each way."""
    weight = np.exp(np.clip(trust, -9, 0))
    numbers, weights = [source * weight], [weight]
    for _ in range(4):
        for maps in (numbers, weights):
            x = maps[-1]
            maps.append((x[::2, ::2] + x[1::2, ::2] + x[::2, 1::2] + x[1::2, 1::2]) / 4)
    coarser = None
    for level in reversed(range(5)):
        height, width = numbers[level].shape
        out = np.zeros((height, width))
        for y in range(height):
            for x in range(width):
                logits = np.clip(levels[level][:, y, x], -10, 10)
                top = bottom = 0.0
                for tap in range(25):
                    v, u = y + tap // 5 - 2, x + tap % 5 - 2
                    if 0 <= v < height and 0 <= u < width:
                        top += np.exp(logits[tap]) * numbers[level][v, u]
                        bottom += np.exp(logits[tap]) * weights[level][v, u]
                out[y, x] = top / bottom
                if coarser is None:
                    continue
                top = bottom = 0.0
                for j in range(4):
                    v, u = (y - 1) // 2 + j // 2, (x - 1) // 2 + j % 2  # of the four nearest cells
                    if 0 <= v < coarser.shape[0] and 0 <= u < coarser.shape[1]:
                        top += np.exp(logits[25 + j]) * coarser[v, u]
                        bottom += np.exp(logits[25 + j])
                share = 1 / (1 + np.exp(-logits[29]))
                out[y, x] = (1 - share) * out[y, x] + share * top / bottom
        coarser = out
    return out


def test_pyramid_equals_its_formulas() -> None:
    trust, levels = random_logits(32, 48)
    source = noise(32, 48)
    expected = naive(trust[0, 0].numpy(), [level[0].numpy() for level in levels], source[0, 1].numpy())
    out = gather_pyramid(trust, levels, source)[0, 1].numpy()
    np.testing.assert_allclose(out, expected, rtol=1e-12)


def test_a_factor_is_filtered_without_trust_and_stays_where_nothing_is_valid() -> None:
    _, levels = random_logits(37, 50, count=3)
    source, valid = noise(37, 50), torch.ones((1, 1, 37, 50), dtype=torch.bool)
    even = torch.zeros((1, 1, 48, 64), dtype=torch.float64)
    torch.testing.assert_close(gather_factor(levels, source, valid), gather_pyramid(even, levels, source))
    constant = torch.full_like(source, 0.3)
    torch.testing.assert_close(gather_factor(levels, constant, valid), constant)
    torch.testing.assert_close(gather_factor(levels, source, ~valid), source, rtol=0, atol=0)
    valid[:, :, 8:30, 8:40] = False
    holed = source.masked_fill(~valid, torch.nan)
    torch.testing.assert_close(gather_factor(levels, source, valid), gather_pyramid(even, levels, holed))


def packed(levels: list[torch.Tensor]) -> list[torch.Tensor]:
    """Levels as a network predicts them."""
    return [torch.cat([torch.nn.functional.pixel_unshuffle(levels[0], 2), levels[1]], 1), *levels[2:]]


def test_the_albedo_is_cleaned_by_a_pyramid_of_its_own() -> None:
    trust, levels = random_logits(32, 32)
    own = random_logits(32, 32, seed=1, count=3)[1]
    predicted = Prediction(torch.nn.functional.pixel_unshuffle(trust, 2), packed(levels), packed(own))
    factor = 0.1 + noise(32, 32) / 100
    radiance = noise(32, 32, seed=2)
    out, cleaned = reconstruct(predicted, radiance, factor)
    assert cleaned is not None
    torch.testing.assert_close(cleaned, gather_factor(own, factor, torch.ones((1, 1, 32, 32), dtype=torch.bool)))
    assert (cleaned - factor).abs().max() > 0.1 * factor.mean()
    torch.testing.assert_close(out, cleaned * gather_pyramid(trust, levels, radiance / cleaned))  # in and out alike
    out, _ = reconstruct(predicted, 5.0 * cleaned, factor)  # one irradiance everywhere
    torch.testing.assert_close(out, 5.0 * cleaned)


def test_gradient_by_hand() -> None:
    g = torch.Generator().manual_seed(0)
    weights = torch.rand((2, 4, 3, 5), generator=g, dtype=torch.float64, requires_grad=True)
    source = torch.rand((2, 2, 5, 7), generator=g, dtype=torch.float64, requires_grad=True)
    taps = [(0, 0), (0, 2), (2, 0), (2, 2)]
    assert torch.autograd.gradcheck(lambda w, s: _WeighTaps.apply(w, s, taps), (weights, source))


def frame(height: int, width: int, samples: int, seed: int = 0) -> dict[str, torch.Tensor]:
    g = torch.Generator().manual_seed(seed)
    inputs = {n: torch.rand((1, 3, height, width), generator=g) for n in ("radiance", "variance", "albedo", "normal")}
    inputs["depth"] = torch.rand((1, 1, height, width), generator=g)
    inputs["samples.descriptor"] = torch.randn((samples, 36, height, width), generator=g)
    inputs["samples.valid"] = torch.ones((samples, 1, height, width))
    inputs |= {f"{n}.present": torch.ones(1) for n in ("variance", "albedo", "normal", "depth", "paths")}
    return inputs | {"exposure": torch.ones(1), "depth_scale": torch.ones(1)}


def awake(network: PathfoldSizes, seed: int = 0) -> Pathfold:
    """A network whose heads, which start at zero, are random too."""
    torch.manual_seed(seed)
    model = Pathfold(network)
    for head in (model.trust, *model.heads, model.presence, *model.albedo_heads):
        torch.nn.init.normal_(head.weight, std=0.1)  # type: ignore[arg-type]
    return model.eval()


def test_untrained_network_is_a_plain_blur() -> None:
    model = Pathfold(SMALL).eval()
    with torch.no_grad():
        predicted, _ = model(frame(32, 32, 2))
    assert max(float(level.abs().max()) for level in predicted.logits) == 0.0
    finest = predicted.cleaning[0][0, :120:4, 0, 0]
    assert float(torch.softmax(finest[:25], 0)[12]) == pytest.approx(0.944, abs=1e-3)  # the albedo nearly as it is
    assert float(torch.sigmoid(finest[29])) == pytest.approx(0.018, abs=1e-3)
    assert float(predicted.cleaning[0][0, 120:].abs().max()) == float(predicted.cleaning[1].abs().max()) == 0.0


@pytest.mark.parametrize(("height", "width", "samples"), [(1, 1, 1), (17, 40, 3)])
def test_any_size(height: int, width: int, samples: int) -> None:
    with torch.no_grad():
        out, _, paths, _ = awake(SMALL).filter(frame(height, width, samples))
    assert out.shape == (1, 3, height, width)
    assert paths.shape == (samples, SMALL.embedding, height, width)
    assert torch.isfinite(out).all()


@pytest.mark.parametrize("light", [1e4, 1e8, 1e30])
def test_a_firefly_is_seen_no_brighter_than_the_ceiling(light: float) -> None:
    inputs = frame(16, 16, 0)
    inputs["albedo"], inputs["albedo.present"] = torch.zeros(1, 3, 16, 16), torch.ones(1)
    inputs["radiance"][:, :, 5, 5] = light  # over a black albedo, which makes it a hundred times as bright
    inputs["variance"][:, :, 5, 5] = light
    seen = pixel_features(inputs)
    assert seen.isfinite().all() and float(seen.max()) < 7
    assert float(seen[0, 0, 5, 5]) == pytest.approx(np.log(1001))


def test_overlap_covers_the_receptive_field() -> None:
    model = awake(SMALL).double()
    side, reach = 320, overlap(SMALL)
    assert reach % 16 == 0
    inputs = {n: v.double() for n, v in frame(side, side, 1).items()}
    inputs["samples.descriptor"].requires_grad_()
    inputs["radiance"].requires_grad_()
    inputs["albedo"].requires_grad_()
    centre = slice(160, 176)
    model.filter(inputs)[0][:, :, centre, centre].sum().backward()
    reached = []
    for name in ("radiance", "albedo", "samples.descriptor"):
        touched = inputs[name].grad.abs().sum((0, 1)) > 0  # type: ignore[union-attr]
        for index in (touched.any(1).nonzero(), touched.any(0).nonzero()):
            reached += [160 - int(index.min()), int(index.max()) - 175]
    assert reach - 16 <= max(reached) <= reach  # enough, and not a whole block too much


def test_scaled_descriptors_are_folded_into_the_weights() -> None:
    layer = Standardised(5)
    x = frame(6, 7, 3)["samples.descriptor"]
    wanted = torch.nn.functional.conv2d((x - layer.mean) / layer.deviation, layer.weight, layer.bias)
    torch.testing.assert_close(layer(x), wanted, rtol=1e-4, atol=1e-4)
    other = Standardised(5)
    other.unfold(*layer.folded())
    torch.testing.assert_close(other.weight, layer.weight)
    torch.testing.assert_close(other.bias, layer.bias, rtol=1e-4, atol=1e-5)


def test_embedding_moments_of_known_values() -> None:
    paths = torch.arange(8.0).reshape(2, 1, 2, 2)  # samples of one 2x2 block: 0..7
    valid = torch.ones((2, 1, 2, 2))
    valid[1, 0, 1, 1] = 0.0  # without the 7
    mean, deviation = embedding_moments(embedding_sums(paths, valid))[0, :, 0, 0].tolist()
    assert mean == pytest.approx(3.0)
    assert deviation == pytest.approx(2.0, abs=0.011)
    parts = embedding_sums(paths[:1], valid[:1]) + embedding_sums(paths[1:], valid[1:])
    torch.testing.assert_close(parts, embedding_sums(paths, valid))
    assert embedding_moments(embedding_sums(paths, valid * 0))[0, :, 0, 0].tolist() == pytest.approx([0.0, 0.0])


@pytest.mark.parametrize(("name", "low", "high"), [("fast", 30, 40), ("balanced", 80, 100), ("high", 150, 330)])
def test_presets_keep_their_budget(name: str, low: float, high: float) -> None:
    network = load_preset(f"pathfold-{name}").network
    assert isinstance(network, PathfoldSizes)
    assert low < Pathfold(network).macs(spp=0) / 1e3 <= high
    assert overlap(network) == 112


def test_absent_paths_are_one_invalid_sample(tmp_path) -> None:  # type: ignore[no-untyped-def]
    data = write_data_set(tmp_path / "data")
    batch = next(iter(Crops(Stored(data), TINY.data.model_copy(update={"drop_paths": 1.0}), seed=0, paths=ALL_SAMPLES)))
    assert batch.counts == [1, 1]
    assert batch.inputs["paths.present"].tolist() == [0.0, 0.0]
    assert batch.inputs["samples.valid"].abs().max() == 0.0
    assert batch.inputs["samples.descriptor"].abs().max() == 0.0


def test_training_moves_everything_and_resumes_exactly(tmp_path, monkeypatch) -> None:  # type: ignore[no-untyped-def]
    data = write_data_set(tmp_path / "data")
    whole = torch.load(fit(TINY, data, tmp_path / "whole", seed=3, validate_every=2, threads=1), weights_only=True)
    start = Pathfold(SMALL).state_dict()
    assert {n.removeprefix("model.") for n in whole["state_dict"]} == set(start)
    heads = [v for n, v in whole["state_dict"].items() if "heads" in n or "trust.weight" in n]
    assert all(float(v.abs().max()) > 0 for v in heads)

    class InterruptError(Exception):
        pass

    original, calls = Crops.draw, [0]

    def stops(self: Crops, *arguments: object) -> object:
        calls[0] += 1
        if calls[0] > 2 * TINY.data.batch + 1:
            raise InterruptError
        return original(self, *arguments)  # type: ignore[arg-type]

    monkeypatch.setattr(Crops, "draw", stops)
    with pytest.raises(InterruptError):
        fit(TINY, data, tmp_path / "parts", seed=3, validate_every=2, threads=1, save_every=2)
    monkeypatch.setattr(Crops, "draw", original)
    resumed = torch.load(fit(TINY, data, tmp_path / "parts", seed=3, validate_every=2, threads=1), weights_only=True)
    for name, value in whole["state_dict"].items():
        torch.testing.assert_close(resumed["state_dict"][name], value, rtol=0, atol=0, msg=name)


def test_a_wider_network_begins_as_the_narrow_one(tmp_path) -> None:  # type: ignore[no-untyped-def]
    narrow = fit(TINY, write_data_set(tmp_path / "data"), tmp_path / "narrow", validate_every=1000, threads=1)
    wider = SMALL.model_copy(update={"widths": (24, 16, 32, 40)})
    wide = TINY.model_copy(update={"network": wider})
    torch.manual_seed(1)
    task = Denoising(wide)
    warm_start(task, narrow)
    inputs = frame(32, 48, 2)
    with torch.no_grad():
        torch.testing.assert_close(
            task.model.filter(inputs)[0], load(narrow).model.filter(inputs)[0], rtol=1e-5, atol=1e-6
        )
    with pytest.raises(ValueError, match=r"does not fit preset 'tiny'"):
        shrunk = SMALL.model_copy(update={"widths": (8, 16, 16, 16)})
        warm_start(Denoising(TINY.model_copy(update={"network": shrunk})), narrow)
