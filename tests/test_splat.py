"""The splat of samples and of layers in torch, against their definitions."""

import numpy as np
import pytest
import torch
from pathfold_training.networks.embedding import sample_sum
from pathfold_training.networks.splat import composite, splat, splat_sums, spread
from torch import Tensor

SIZE, HEIGHT, WIDTH = 5, 9, 11


def drawn(*shape: int, seed: int = 1, dtype: torch.dtype = torch.float32) -> Tensor:
    return torch.from_numpy(np.random.default_rng(seed).standard_normal(shape)).to(dtype)


def scattered(logits: Tensor, planes: Tensor) -> np.ndarray:
    """The definition: every source pixel adds to the pixels around it."""
    weights = np.exp(np.clip(logits.numpy().astype(np.float64), -10, 10))
    out = np.zeros(planes.shape)
    radius = SIZE // 2
    for n, y, x in np.ndindex(planes.shape[0], HEIGHT, WIDTH):
        for dy, dx in np.ndindex(SIZE, SIZE):
            to = y + dy - radius, x + dx - radius
            if 0 <= to[0] < HEIGHT and 0 <= to[1] < WIDTH:
                out[n, :, *to] += weights[n, dy * SIZE + dx, y, x] * planes[n, :, y, x].numpy()
    return out


@pytest.fixture
def logits() -> Tensor:
    return 4 * drawn(3, SIZE**2, HEIGHT, WIDTH)


def test_sums_are_those_of_the_definition(logits: Tensor) -> None:
    planes = drawn(3, 4, HEIGHT, WIDTH, seed=2).abs()
    expected = scattered(logits, planes) * np.exp(-5)
    np.testing.assert_allclose(splat_sums(logits, planes).numpy(), expected, rtol=2e-6)
    np.testing.assert_allclose(splat_sums(logits.double(), planes.double()).numpy(), expected, rtol=1e-12)


def test_compiled_gradients_are_those_of_torch(logits: Tensor) -> None:
    planes, onto = drawn(3, 4, HEIGHT, WIDTH, seed=2), drawn(3, 4, HEIGHT, WIDTH, seed=3)
    found = []
    for dtype in (torch.float32, torch.float64):  # float64 goes through torch's operations
        given = [x.to(dtype).clone().requires_grad_() for x in (logits, planes)]
        found.append(torch.autograd.grad((splat_sums(*given) * onto.to(dtype)).sum(), given))
    for compiled, exact in zip(*found, strict=True):
        np.testing.assert_allclose(compiled.numpy(), exact.numpy(), rtol=1e-4, atol=1e-5 * float(exact.abs().max()))


def test_gradients_of_the_definition_are_right() -> None:
    weights, planes = drawn(1, 9, 4, 4, dtype=torch.float64), drawn(1, 4, 4, 4, seed=2, dtype=torch.float64)
    assert torch.autograd.gradcheck(lambda w, p: spread(w, p, 3), (weights.requires_grad_(), planes.requires_grad_()))


@pytest.mark.parametrize("counts", [[1, 2], [3]])
def test_constants_stay_to_the_border(logits: Tensor, counts: list[int]) -> None:
    color = torch.tensor([0.25, 3.0, 1e4]).reshape(1, 3, 1, 1)
    radiance = color.expand(3, 3, HEIGHT, WIDTH)
    out = splat(logits, radiance, torch.ones(3, 1, HEIGHT, WIDTH), counts)
    np.testing.assert_allclose((out / color).numpy(), 1, rtol=3e-6)


def test_a_delta_kernel_moves_the_picture() -> None:
    logits = torch.full((1, SIZE**2, HEIGHT, WIDTH), -10.0)
    logits[:, 1 * SIZE + 4] = 10.0  # target one row up, two columns right
    radiance = drawn(1, 3, HEIGHT, WIDTH).abs() + 1
    out = splat(logits, radiance, torch.ones(1, 1, HEIGHT, WIDTH))
    np.testing.assert_allclose(out[..., :-1, 2:].numpy(), radiance[..., 1:, :-2].numpy(), rtol=1e-5)


def test_order_of_samples_does_not_matter_and_invalid_ones_take_no_part(logits: Tensor) -> None:
    radiance, valid = drawn(3, 3, HEIGHT, WIDTH, seed=2).abs(), torch.ones(3, 1, HEIGHT, WIDTH)
    valid[1, :, 2:5, 3:7] = 0
    out = splat(logits, radiance, valid)
    turned = splat(logits[[2, 0, 1]], radiance[[2, 0, 1]], valid[[2, 0, 1]])
    np.testing.assert_allclose(out.numpy(), turned.numpy(), rtol=1e-5)
    spoilt = torch.where(valid > 0, radiance, torch.nan)
    np.testing.assert_array_equal(splat(logits, spoilt, valid).numpy(), out.numpy())
    assert (out <= radiance.amax((0, 2, 3)).reshape(1, 3, 1, 1) * (1 + 1e-6)).all()
    assert not splat(logits, radiance, torch.zeros_like(valid)).any()


def test_even_kernels_and_other_planes_are_refused() -> None:
    with pytest.raises(ValueError, match="16 logits and 4 planes; give the square of an odd"):
        splat_sums(torch.zeros(1, 16, 4, 4), torch.zeros(1, 4, 4, 4))
    with pytest.raises(ValueError, match="9 logits and 3 planes"):
        splat_sums(torch.zeros(1, 9, 4, 4), torch.zeros(1, 3, 4, 4))


class TestLayers:
    """Samples shared out between a front and a back layer."""

    @staticmethod
    def layers(radiance: Tensor, share: Tensor, valid: Tensor) -> tuple[list[Tensor], list[Tensor], Tensor]:
        count = sample_sum(valid)
        shares = [s * valid / count.clamp(min=1) for s in (share, 1 - share)]
        summed = [sample_sum(s * torch.where(valid > 0, radiance, 0.0)) for s in shares]
        return summed, [sample_sum(s) for s in shares], (count > 0).float()

    def test_constants_stay_and_results_are_between_the_samples(self) -> None:
        logits = tuple(4 * drawn(1, SIZE**2, HEIGHT, WIDTH, seed=s) for s in (1, 2))
        share, valid = torch.sigmoid(drawn(4, 1, HEIGHT, WIDTH, seed=3)), torch.ones(4, 1, HEIGHT, WIDTH)
        valid[:, :, 3:5, 4] = 0
        for radiance in (torch.full((4, 3, HEIGHT, WIDTH), 7.0), drawn(4, 3, HEIGHT, WIDTH, seed=4).exp()):
            summed, weight, any_valid = self.layers(radiance, share, valid)
            out = composite(logits, tuple(summed), tuple(weight), any_valid)
            least, most = radiance.amin((0, 2, 3)), radiance.amax((0, 2, 3))
            assert (out >= least.reshape(1, 3, 1, 1) * (1 - 1e-5)).all()
            assert (out <= most.reshape(1, 3, 1, 1) * (1 + 1e-5)).all()

    @pytest.mark.parametrize("front", [0.0, 1.0])
    def test_all_in_one_layer_is_the_splat_of_the_means(self, front: float) -> None:
        logits = tuple(4 * drawn(1, SIZE**2, HEIGHT, WIDTH, seed=s) for s in (1, 2))
        radiance, valid = drawn(4, 3, HEIGHT, WIDTH, seed=4).abs(), torch.ones(4, 1, HEIGHT, WIDTH)
        summed, weight, any_valid = self.layers(radiance, torch.full_like(valid, front), valid)
        out = composite(logits, tuple(summed), tuple(weight), any_valid)
        alone = splat(logits[0 if front else 1], radiance.mean(0, keepdim=True), any_valid)
        np.testing.assert_allclose(out.numpy(), alone.numpy(), rtol=1e-5, atol=1e-6)

    def test_without_a_valid_sample_it_is_black(self) -> None:
        nothing = torch.zeros(1, 3, HEIGHT, WIDTH), torch.zeros(1, 3, HEIGHT, WIDTH)
        none = torch.zeros(1, 1, HEIGHT, WIDTH)
        logits = drawn(1, SIZE**2, HEIGHT, WIDTH)
        assert not composite((logits, logits), nothing, (none, none), none).any()
