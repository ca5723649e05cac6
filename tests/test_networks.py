"""Networks, operators and losses in torch."""

import itertools
import json
from pathlib import Path

import numpy as np
import pytest
import torch
from pathfold_training.fit.preset import load_preset, preset_names
from pathfold_training.networks.embedding import PathEmbedding, pixel_embedding
from pathfold_training.networks.families import FAMILIES, family
from pathfold_training.networks.features import DESCRIPTOR_CHANNELS, OPTIONAL
from pathfold_training.networks.kpcn.branch import Branch
from pathfold_training.networks.kpcn.network import Kpcn
from pathfold_training.networks.kpcn.sizes import KpcnSizes, overlap
from pathfold_training.networks.losses import (
    Draw,
    albedo_error,
    energy_error,
    error_scale,
    geometric,
    halves_error,
    manifold_loss,
    median3x3,
    robust_relative,
    tone_map,
)
from pathfold_training.networks.reconstruct import gather
from pathfold_training.release.quantise import trained_on

SMALL = KpcnSizes(width=8, layers=3, kernel_size=5, embedding=3, embedding_width=4)


def frame(height: int, width: int, samples: int, seed: int = 0) -> dict[str, torch.Tensor]:
    """Inputs of one branch graph, all present."""
    g = torch.Generator().manual_seed(seed)
    shape = (1, 3, height, width)
    inputs = {n: torch.rand(shape, generator=g) for n in ("radiance", "variance", "albedo", "normal", "diffuse.albedo")}
    inputs["depth"] = torch.rand((1, 1, height, width), generator=g)
    inputs["samples.descriptor"] = torch.randn((samples, 36, height, width), generator=g)
    inputs["samples.density"] = torch.randn((samples, 1, height, width), generator=g)
    inputs["samples.valid"] = torch.ones((samples, 1, height, width))
    inputs |= {f"{name}.present": torch.ones(1) for name in OPTIONAL}
    return inputs | {"exposure": torch.ones(1), "depth_scale": torch.ones(1)}


def naive_gather(logits: np.ndarray, radiance: np.ndarray, size: int, trust: np.ndarray) -> np.ndarray:
    """The operator as its definition reads, pixel by pixel in float64."""
    _, height, width = radiance.shape
    out = np.zeros_like(radiance, dtype=np.float64)
    for y, x in itertools.product(range(height), range(width)):
        taps = []
        for tap in range(size * size):
            v, u = y + tap // size - size // 2, x + tap % size - size // 2
            if 0 <= v < height and 0 <= u < width and np.isfinite(radiance[:, v, u]).all():
                taps.append((float(logits[tap, y, x] + trust[0, v, u]), radiance[:, v, u].astype(np.float64)))
        if taps:
            weights = np.exp(np.array([t[0] for t in taps]) - max(t[0] for t in taps))
            out[:, y, x] = (weights[:, None] * np.stack([t[1] for t in taps])).sum(0) / weights.sum()
    return out


@pytest.mark.parametrize(("height", "width", "size"), [(7, 9, 5), (1, 1, 3), (2, 11, 5), (6, 5, 21)])
def test_gather_is_its_definition(height: int, width: int, size: int) -> None:
    g = torch.Generator().manual_seed(height)
    logits = 4 * torch.randn((1, size * size, height, width), generator=g)
    radiance = torch.rand((1, 3, height, width), generator=g) * 100
    if height > 5:
        radiance[0, :, 2, 3] = float("nan")
        radiance[0, 1, 4, 4] = float("inf")
    trust = 6 * torch.randn((1, 1, height, width), generator=g)
    for given in (None, trust):
        added = torch.zeros_like(trust) if given is None else given
        expected = naive_gather(logits[0].numpy(), radiance[0].numpy(), size, added[0].numpy())
        out = gather(logits, radiance, size, trust=given)[0].numpy()
        np.testing.assert_allclose(out, expected, rtol=2e-5, atol=1e-6)


def test_gather_on_a_lattice_is_a_subset_of_the_whole() -> None:
    logits, radiance, trust = torch.randn(2, 25, 12, 15), torch.rand(2, 3, 12, 15), torch.randn(2, 1, 12, 15)
    whole = gather(logits, radiance, 5, trust=trust)
    part = gather(logits[:, :, 1::3, 2::3], radiance, 5, lattice=3, offset=(1, 2), trust=trust)
    torch.testing.assert_close(part, whole[:, :, 1::3, 2::3])


def test_gather_keeps_a_constant_and_stays_within_its_window() -> None:
    logits = 1e4 * torch.randn(1, 25, 8, 8)
    torch.testing.assert_close(gather(logits, torch.full((1, 3, 8, 8), 7.5), 5), torch.full((1, 3, 8, 8), 7.5))
    radiance = torch.rand(1, 3, 8, 8) ** 8 * 1e6
    high = torch.nn.functional.max_pool2d(radiance, 5, 1, 2)
    low = -torch.nn.functional.max_pool2d(-radiance, 5, 1, 2)
    out = gather(logits, radiance, 5)
    assert ((out <= high * (1 + 1e-6)) & (out >= low * (1 - 1e-6))).all()


def test_embedding_ignores_the_order_of_samples_and_invalid_ones() -> None:
    torch.manual_seed(0)
    network = PathEmbedding(3, 4)
    features, valid = torch.randn(4, 36, 9, 7), torch.ones(4, 1, 9, 7)
    p = pixel_embedding(network(features, valid), valid)
    order = torch.tensor([2, 0, 3, 1])
    torch.testing.assert_close(pixel_embedding(network(features[order], valid), valid), p, rtol=1e-4, atol=1e-5)
    more = torch.cat([features, torch.full((1, 36, 9, 7), 5.0)])
    marked = torch.cat([valid, torch.zeros(1, 1, 9, 7)])
    torch.testing.assert_close(pixel_embedding(network(more, marked), marked), p, rtol=1e-4, atol=1e-5)


def test_an_untrained_embedding_varies_and_its_deepest_layers_learn() -> None:
    torch.manual_seed(4)
    embedding = PathEmbedding(3, 16)
    features = torch.randn(4, DESCRIPTOR_CHANNELS, 32, 32) * embedding.deviation + embedding.mean
    paths = embedding(features, torch.ones(4, 1, 32, 32))
    assert paths.mean(0).std((1, 2)).max() > 0.05  # over pixels, as R sees it
    (paths * torch.randn(paths.shape) / paths.numel() ** 0.5).sum().backward()
    for parameter in embedding.context.bottom.parameters():
        assert parameter.grad is not None and parameter.grad.square().mean().sqrt() > 1e-4  # 1e-7 is lost in Adam


def test_images_of_unlike_sample_counts_in_a_batch_do_not_mix() -> None:
    torch.manual_seed(0)
    branch = Branch(SMALL, demodulate=True)
    frames = [frame(12, 8, samples, seed=samples) for samples in (2, 5)]
    batch = {n: torch.cat([f[n] for f in frames]) for n in frames[0]}
    together = branch(batch, counts=[2, 5]).logits
    alone = torch.cat([branch(f).logits for f in frames])
    torch.testing.assert_close(together, alone, rtol=1e-4, atol=1e-5)


def test_exposure_and_radiance_cancel() -> None:
    torch.manual_seed(0)
    branch, inputs = Branch(SMALL, demodulate=False), frame(8, 8, 3)
    scaled = inputs | {"radiance": inputs["radiance"] * 64, "variance": inputs["variance"] * 64**2}
    scaled["exposure"] = inputs["exposure"] / 64
    shifted = inputs["samples.descriptor"].clone()
    shifted[:, :6] += np.log(64.0)
    scaled["samples.descriptor"] = shifted
    torch.testing.assert_close(branch(scaled).logits, branch(inputs).logits, rtol=1e-4, atol=1e-5)


@pytest.mark.parametrize("embedding", [0, 3])
def test_nothing_beyond_the_stated_overlap_matters(embedding: int) -> None:
    torch.manual_seed(0)
    network = SMALL.model_copy(update={"embedding": embedding})
    branch = Branch(network, demodulate=False).double()
    reach = overlap(network) - network.kernel_size // 2  # the rest of the overlap is the gather's own
    column = (reach // 4 + 2) * 4
    inputs = {n: v.double() for n, v in frame(8, column + 8, 2).items()}
    changed = {n: v.clone() for n, v in inputs.items()}
    for name, value in changed.items():
        if value.dim() == 4 and name != "samples.valid":
            value[..., : column - reach] += 1.0
    difference = (branch(changed).logits - branch(inputs).logits).abs()
    assert difference[..., column:].max() == 0.0
    assert difference[..., : column - reach].max() > 0.0


@pytest.mark.parametrize("name", ["kpcn-vanilla", "kpcn-path", "kpcn-manifold"])
def test_compact_presets_keep_the_budget(name: str) -> None:
    assert Kpcn(load_preset(name).network).macs(spp=8) <= 0.8e6


def test_full_preset_has_the_papers_size() -> None:
    network = load_preset("kpcn-manifold-full").network
    parameters = sum(p.numel() for b in Kpcn(network).branches.values() for p in b.trunk.parameters())
    parameters += sum(p.numel() for b in Kpcn(network).branches.values() for p in b.kernels.parameters())
    assert 5.5e6 < parameters < 6.2e6  # the paper: 5.88 M for R


def test_presets_are_valid_and_unknown_keys_are_not(tmp_path) -> None:
    assert {"kpcn-vanilla", "kpcn-path", "kpcn-manifold", "kpcn-manifold-full"} <= set(preset_names())
    bad = tmp_path / "bad.yaml"
    bad.write_text("name: x\ndescription: y\nnetwork: {widht: 3}\n")
    with pytest.raises(ValueError, match="widht"):
        load_preset(str(bad))
    with pytest.raises(ValueError, match="kpcn-vanilla"):
        load_preset("kpcn-unknown")


@pytest.mark.parametrize(
    ("keys", "said"),
    [
        ("network: {widht: 3}", "network.widht: Extra inputs are not permitted"),
        ("data: {crop: -5, batch: 0}", "data.crop: Input should be greater than or equal to 16, not -5; data.batch: "),
        ("data: {magnified: 7}", "data.magnified: Input should be less than or equal to 1, not 7"),
        ("data: {fireflies: -1}", "data.fireflies: Input should be greater than or equal to 0, not -1"),
        ("data: {spp_min: 9}", "data: Value error, spp_min 9 is more than spp_max 8"),
        ("optimiser: {steps: 0}", "optimiser.steps: Input should be greater than or equal to 1, not 0"),
        ("optimiser: {learning_rate: .inf}", "optimiser.learning_rate: Input should be a finite number, not inf"),
        ("loss: {energy: -1}", "loss.energy: Input should be greater than or equal to 0, not -1"),
        ("network: {family: pathfold, widths: [0, 8, 8, 8]}", "network.widths.0: Input should be greater than"),
    ],
)
def test_what_does_not_fit_in_a_preset_is_one_line(tmp_path, keys: str, said: str) -> None:
    bad = tmp_path / "bad.yaml"
    bad.write_text(f"name: x\ndescription: y\n{keys}\n")
    with pytest.raises(ValueError) as left:
        load_preset(str(bad))
    assert str(left.value).startswith(f"preset {bad}: {said}") and "\n" not in str(left.value)


def test_presets_are_valid_and_shipped_models_say_how_they_were_trained() -> None:
    for name in preset_names():
        load_preset(name)
    manifests = sorted((Path(__file__).parent.parent / "models").glob("*/manifest.json"))
    assert manifests
    for file in manifests:
        manifest = json.loads(file.read_text())
        assert FAMILIES[family(manifest["training"]["config"]["network"])].network
        assert trained_on(manifest)[1] > 0


def test_a_preset_differs_from_its_family_in_what_it_says(tmp_path: Path) -> None:
    own = tmp_path / "own.yaml"
    own.write_text("name: own\ndescription: a\nnetwork: {family: pathfold, embedded: 0}\nloss: {energy: 0.25}\n")
    config, other = load_preset(str(own)), load_preset("pathfold-balanced")
    assert config.data == other.data and config.optimiser == other.optimiser
    assert config.loss == other.loss.model_copy(update={"energy": 0.25})
    assert config.network == other.network.model_copy(update={"embedded": 0})


def test_manifold_loss_is_zero_for_an_isometry_of_the_labels_and_not_otherwise() -> None:
    label = tone_map(torch.rand(2, 3, 6, 6))
    same = torch.cat([label[0].expand(3, 3, 6, 6), label[1].expand(2, 3, 6, 6)])
    turned = torch.einsum("ij,njhw->nihw", torch.linalg.qr(torch.randn(3, 3))[0], same) + 0.3
    g = torch.Generator().manual_seed(1)
    assert float(manifold_loss(turned, label, [3, 2], 500, Draw(g))) < 1e-9
    assert float(manifold_loss(2 * turned, label, [3, 2], 500, Draw(g))) > 1e-4


def test_manifold_loss_of_one_known_pair() -> None:
    # two pixels of one image, one sample each: D_f = 4, D_I = 0.25, or both 0 where a pixel meets itself
    embedding = torch.tensor([[[[0.0, 2.0]]]])
    label = torch.tensor([[[[0.0, 0.5]], [[0.0, 0.0]], [[0.0, 0.0]]]])
    term = (4 - 0.25) ** 2
    loss = manifold_loss(embedding, label, [1], 4000, Draw(torch.Generator().manual_seed(0)))
    assert float(loss) == pytest.approx(term, rel=0.05)  # local and non-local each hit unlike pixels half the time


def test_energy_error_sees_darkening_and_not_noise() -> None:
    g = torch.Generator().manual_seed(0)
    reference = 2.0 * torch.rand((1, 3, 50, 40), generator=g) + 1.0
    noisy = reference * (1 + 0.5 * torch.randn(reference.shape, generator=g))
    darker = float(energy_error(0.95 * reference, reference))
    assert darker == pytest.approx(0.05**2, rel=0.01)
    assert float(energy_error(noisy, reference)) < 1.5 * darker  # and by pixels a hundred times as large
    assert float(robust_relative(noisy, reference, reference)) > 50 * darker
    firefly = reference.clone()
    firefly[:, :, 3, 3] += 1e6
    assert float(energy_error(firefly, reference)) < 10  # the logarithm's tail
    assert float(energy_error(reference, reference)) == 0.0


def test_a_noisy_target_does_not_bias_the_cleaned_albedo() -> None:
    """Targets of 0 or 1: the loss is least at their mean. NaN targets and absent albedos say nothing."""
    target = (torch.arange(1000) % 4 == 0).float().expand(1, 3, 10, 1000)
    value = torch.tensor(0.25, requires_grad=True)
    albedo_error(value.expand_as(target), target, torch.ones(1)).backward()
    assert float(value.grad) == pytest.approx(0.0, abs=1e-5)
    both, nothing = torch.cat([target, torch.full_like(target, torch.nan)]), torch.zeros(2)
    cleaned = torch.full_like(both, 0.5)
    once = albedo_error(cleaned[:1], target, torch.ones(1))
    assert float(albedo_error(cleaned, both, torch.ones(2))) == pytest.approx(float(once) / 2)
    assert float(albedo_error(cleaned, both, nothing)) == 0.0


def test_error_by_halves_leaves_out_the_noise_of_the_reference() -> None:
    generator = torch.Generator().manual_seed(0)
    truth = torch.full((1, 3, 64, 64), 2.0)
    a, b = (truth + 0.1 * torch.randn(truth.shape, generator=generator) for _ in range(2))
    expected = 0.1**2 / (4 + 0.01)
    assert float(halves_error(truth + 0.1, a, b)) == pytest.approx(expected, rel=0.15)
    assert float(((truth + 0.1 - (a + b) / 2) ** 2 / 4.01).mean()) > 1.4 * expected
    assert float(halves_error((a + b) / 2 + 1e-3, a, b)) > 0.0


def test_robust_relative() -> None:
    scale = torch.full((1, 3, 1, 2), 2.0)
    reference = torch.zeros(1, 3, 1, 2)
    output = torch.tensor([1.0, 6.0]).expand(1, 3, 1, 2)
    assert float(robust_relative(output, reference, scale)) == pytest.approx((0.25 + 4 + 8 * np.log(1.5)) / 2)


def test_the_geometric_loss_counts_relative_changes_alike() -> None:
    errors = torch.tensor([0.02, 0.2, 2.0], requires_grad=True)
    geometric(errors).backward()
    assert np.allclose(errors.detach() * errors.grad, 0.01, rtol=0.06)  # a third of 0.03 each, less near the floor
    perfect = torch.zeros(3, requires_grad=True)
    geometric(perfect).backward()
    assert torch.isfinite(perfect.grad).all()


def test_errors_on_a_thin_dark_line_count_where_the_reference_is_clean() -> None:
    reference = torch.ones(1, 3, 9, 9)
    reference[:, :, 4] = 0.1
    assert float(error_scale(reference, noisy=False)[0, 0, 4, 4]) == pytest.approx(0.02**0.5)
    assert float(error_scale(reference)[0, 0, 4, 4]) == pytest.approx(1.01**0.5)


@pytest.mark.parametrize("size", [(1, 1), (1, 7), (9, 12)])
def test_median_of_3x3_is_the_middle_one(size: tuple[int, int]) -> None:
    image = torch.rand(2, 3, *size, generator=torch.Generator().manual_seed(1)).round(decimals=1)  # some are equal
    padded = torch.nn.functional.pad(image, (1, 1, 1, 1), mode="replicate")
    expected = padded.unfold(2, 3, 1).unfold(3, 3, 1).flatten(4).median(-1).values
    torch.testing.assert_close(median3x3(image), expected, rtol=0, atol=0)
