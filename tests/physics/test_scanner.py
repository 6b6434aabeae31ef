"""The optical front end draws the right counts, on every path, and passes the right gradient."""

import math

import pytest
import torch
from torch import Tensor, nn

from conftest import assert_moments, every_optics, generator
from deepfsi import Scanner
from deepfsi.base import InputError
from deepfsi.physics import (
    LearnedMasks,
    Rails,
    ml_gauss_features,
    project,
    project_rails,
    root,
)

DRAWS = 50_000
RATES = [1e-3, 1.0, 1e3, 1e6, 1.001e6, 1e8, 1e10]
NOISES = ["poisson", "ml_gauss", "gaussian", "none"]

# masks with both rails lit, one alone, the other alone, and none
PLUS = torch.tensor([[0.5, 0.0], [0.25, 0.25], [0.0, 0.0], [0.0, 0.0]], dtype=torch.float64)
MINUS = torch.tensor([[0.0, 0.25], [0.0, 0.0], [0.25, 0.5], [0.0, 0.0]], dtype=torch.float64)
RAILS = torch.stack([PLUS, MINUS])


def expected(noise: str, rates: Tensor, sigma: float) -> Tensor:
    """Variance of each rail, (2, 4)."""
    if noise == "none":
        return torch.zeros_like(rates)
    return sigma**2 * (RAILS.amax(dim=-1) > 0) if noise == "gaussian" else rates


@pytest.mark.parametrize("rate", RATES)
@pytest.mark.parametrize("noise", NOISES)
def test_counts_of_each_rail_have_the_moments_of_the_noise(noise, rate):
    photons = torch.tensor([rate, 2 * rate], dtype=torch.float64)
    counts = Scanner.from_rails(RAILS, noise, 3.0).counts(photons.expand(DRAWS, 2), generator())
    rates = RAILS @ photons
    power = expected(noise, rates, 3.0)
    for rail in range(2):
        for mask in range(4):
            mean, variance = float(rates[rail, mask]), float(power[rail, mask])
            rounding = 0.5 if noise == "poisson" and mean else 1e-15 * mean
            assert_moments(
                counts[:, rail, mask], mean, variance, poisson=noise == "poisson", rounding=rounding
            )


@pytest.mark.parametrize("rate", RATES)
@pytest.mark.parametrize("noise", NOISES)
def test_features_have_the_moments_of_the_rails_difference(noise, rate):
    photons = torch.tensor([rate, 2 * rate], dtype=torch.float64)
    features = Scanner.from_rails(RAILS, noise, 3.0)(photons.expand(DRAWS, 2), generator())
    rates = RAILS @ photons
    power = expected(noise, rates, 3.0).sum(dim=0)
    for mask, mean in enumerate((rates[0] - rates[1]).tolist()):
        rounding = 1.0 if noise == "poisson" and power[mask] else 1e-15 * rate
        assert_moments(
            features[:, mask],
            mean,
            float(power[mask]),
            poisson=noise == "poisson",
            rounding=rounding,
        )


@pytest.mark.parametrize("noise", NOISES)
def test_rails_dark_by_construction_read_exactly_zero(noise):
    scanner = Scanner.from_rails(RAILS, noise, 3.0)
    photons = torch.full((100, 2), 50.0)
    counts = scanner.counts(photons, generator())
    assert (counts[:, RAILS.amax(dim=-1) == 0] == 0).all()
    assert (scanner(photons, generator())[:, 3] == 0).all()


def test_rails_lit_by_construction_add_read_noise_in_the_dark():
    scanner = Scanner.from_rails(RAILS, "gaussian", 3.0)
    dark = torch.zeros(DRAWS, 2, dtype=torch.float64)
    for mask, rails in enumerate((2, 1, 1, 0)):
        assert_moments(scanner(dark, generator())[:, mask], 0, 9 * rails, poisson=False)


@pytest.mark.parametrize("noise", NOISES)
def test_float64_light_gives_float64_counts_whatever_the_masks(noise):
    """So that single photons can be told apart above 2²⁴ counts."""
    scanner = Scanner.from_rails(RAILS.float(), noise)
    photons = torch.tensor([[1e10 + 4, 0.0]], dtype=torch.float64)
    assert scanner(photons, generator()).dtype == torch.float64
    assert scanner.counts(photons, generator()).dtype == torch.float64
    assert scanner.rates(photons)[0, 0, 0] == 5e9 + 2


@pytest.mark.parametrize("noise", NOISES)
@every_optics
def test_replicas_give_an_axis_before_the_masks(noise, light, rails):
    start = torch.rand(3, 4, 6, generator=generator()) + 0.1
    scanner = Scanner(LearnedMasks(start, light, rails), noise)
    photons = torch.full((7, 6), 30.0)
    assert scanner(photons, generator()).shape == (7, 3, 4)
    count = 2 if rails == "dual" else 1
    assert scanner.counts(photons, generator()).shape == (7, 3, count, 4)
    each = [Scanner(LearnedMasks(one, light, rails), "none")(photons) for one in start]
    assert torch.allclose(Scanner(scanner.masks, "none")(photons), torch.stack(each, dim=1))


def learned(light: str, rails: str, single_signed: bool = False) -> LearnedMasks:
    start = torch.randn(3, 4, generator=generator(2), dtype=torch.float64)
    if rails == "single" or single_signed:
        start = start.abs() + 0.1
    masks = LearnedMasks(start, light, rails)
    for parameter in masks.parameters():  # away from the kink where a column is just full
        parameter.data *= 1.3
    return masks


@every_optics
@pytest.mark.parametrize("noise", ["ml_gauss", "gaussian", "none"])
def test_mask_gradients_equal_finite_differences(light, rails, noise):
    """Sample mean and mean square of features, with common random numbers."""
    masks = learned(light, rails)
    photons = torch.tensor([[50.0, 80.0, 20.0, 0.0], [3.0, 0.0, 9.0, 30.0]], dtype=torch.float64)
    scanner = Scanner(masks, noise, 2.0)

    def moments(*_: Tensor) -> tuple[Tensor, Tensor]:
        features = scanner(photons.repeat(20, 1), generator())
        return features.mean(dim=0), features.square().mean(dim=0)

    assert torch.autograd.gradcheck(moments, tuple(masks.parameters()), atol=1e-4)


@pytest.mark.parametrize(
    ("noise", "sigma"), [("ml_gauss", 1.0), ("poisson", 1.0), ("gaussian", 5.0)]
)
def test_mask_gradients_follow_mean_and_variance(noise, sigma):
    """E[y²] = (Mλ)² + |M|λ, or + 2σ², whose slope in M_ij is known."""
    photons = torch.tensor([50.0, 80.0, 20.0, 5.0], dtype=torch.float64)
    matrix = torch.tensor([[0.3, -0.2, 0.1, -0.05]], dtype=torch.float64, requires_grad=True)

    class Matrix(nn.Module):
        def forward(self) -> Rails:
            return Rails(matrix, matrix.abs())

    batches = []
    for seed in range(60):
        features = Scanner(Matrix(), noise, sigma)(photons.expand(2000, 4), generator(seed))
        (slope,) = torch.autograd.grad(features.square().mean(), matrix)
        batches.append(slope[0])
    slopes = torch.stack(batches)
    worth = 2 * float((matrix @ photons).detach()) * photons
    if noise != "gaussian":
        worth = worth + photons * matrix.detach()[0].sign()
    assert (abs(slopes.mean(dim=0) - worth) <= 5 * slopes.std(dim=0) / math.sqrt(60)).all()


@every_optics
@pytest.mark.parametrize("noise", ["ml_gauss", "poisson", "gaussian"])
def test_dark_rails_and_dark_scenes_give_finite_gradients(light, rails, noise):
    masks = learned(light, rails, single_signed=True)
    photons = torch.zeros(5, 4, dtype=torch.float64)
    photons[1:, 2] = 7.0
    Scanner(masks, noise)(photons, generator()).square().sum().backward()
    for parameter in masks.parameters():
        assert torch.isfinite(parameter.grad).all()
        assert (parameter.grad != 0).any()


def test_masks_learn_in_front_of_a_network_of_your_own():
    rng = generator()
    labels = torch.arange(200) % 2
    photons = 50 * torch.rand(200, 6, generator=rng) + 100 * labels[:, None] * torch.eye(6)[1]
    net = nn.Sequential(
        Scanner(LearnedMasks(torch.randn(2, 6, generator=rng), "free-dwell"), "ml_gauss"),
        nn.BatchNorm1d(2),
        nn.Linear(2, 2),
    )
    optimiser = torch.optim.Adam(net.parameters(), lr=0.05)
    losses = []
    for _ in range(60):
        loss = nn.functional.cross_entropy(net(photons), labels)
        optimiser.zero_grad()
        loss.backward()
        optimiser.step()
        losses.append(loss.item())
    assert sum(losses[-5:]) < 0.6 * sum(losses[:5])


@pytest.mark.parametrize(
    ("light", "rails"),
    [("column", "dual"), ("column", "single"), ("free-dwell", "dual"), ("two-arm", "dual")],
)
@pytest.mark.parametrize("replicas", [(), (3,)])
@pytest.mark.parametrize("levels", [0, 2])
def test_the_step_of_training_is_the_scanners_forward_and_its_gradient(
    light, rails, replicas, levels
):
    draw = generator(3)
    scenes = torch.rand(7, 12, generator=draw, dtype=torch.float64)
    mean_scene = scenes.mean(dim=0)
    centred = torch.cat([scenes - mean_scene, mean_scene[None]])
    epsilon = torch.randn(7, *replicas, 5, generator=draw, dtype=torch.float64)
    start = torch.randn(*replicas, 5, 12, generator=draw, dtype=torch.float64)
    start[..., 2, :] = 0
    masks = LearnedMasks(start.abs() if rails == "single" else start, light, rails, levels)
    weight = torch.randn(epsilon.shape, generator=draw, dtype=torch.float64)

    def expected() -> torch.Tensor:
        shown = masks()
        mean, light_ = project_rails(scenes, shown)
        return mean - project(mean_scene, shown.difference) + root(light_) * epsilon

    given = masks().difference if masks.disjoint else masks().combined
    found = []
    for features in (
        ml_gauss_features(centred, given, epsilon, masks.disjoint),
        expected(),
    ):
        masks.zero_grad()
        (features * weight).sum().backward()
        found.append((features.detach(), [p.grad.clone() for p in masks.parameters()]))
    assert torch.allclose(found[0][0], found[1][0], rtol=0, atol=1e-12)
    for ours, autograd in zip(found[0][1], found[1][1], strict=True):
        assert torch.isfinite(ours).all()
        assert torch.allclose(ours, autograd, rtol=0, atol=1e-11)


@pytest.mark.parametrize(
    ("photons", "match"),
    [
        (torch.ones(5, 3), r"shape \(5, 3\) do not fit masks of 2 pixels: give \(..., 2\)"),
        (torch.tensor(1.0), "do not fit masks of 2 pixels"),
        (torch.ones(5, 2).numpy(), r"ndarray: give a tensor"),
        ([[1.0, 2.0]], "list: give a tensor"),
        (torch.ones(5, 2, dtype=torch.int64), r"give photons.float\(\)"),
    ],
)
@pytest.mark.parametrize("noise", NOISES)
def test_photons_of_another_shape_or_kind_are_one_line(photons, match, noise):
    scanner = Scanner.from_rails(RAILS, noise)
    for see in (scanner, scanner.counts, scanner.rates):
        with pytest.raises(InputError, match=match) as error:
            see(photons)
        assert "\n" not in str(error.value)


@pytest.mark.parametrize(
    ("make", "match"),
    [
        (lambda: Scanner.from_rails(torch.ones(3, 64)), r"rails of shape \(3, 64\) and type"),
        (lambda: Scanner.from_rails(torch.ones(2, 3, 64).numpy()), "rails of ndarray cannot"),
        (lambda: Scanner.from_rails(torch.ones(3, 3, 64)), "3 rails were given"),
        (lambda: Scanner.from_rails(torch.ones(2, 3, 64).int()), "torch.int32"),
        (lambda: Scanner(torch.ones(2, 3, 64)), "give Scanner.from_rails"),
        (lambda: LearnedMasks(torch.ones(64), "column"), r"a start of shape \(64,\)"),
        (lambda: LearnedMasks([[1.0]], "column"), "a start of list"),
        (lambda: LearnedMasks(-torch.ones(3, 64), "column", "single"), "negative entries"),
    ],
)
def test_masks_of_another_shape_or_kind_are_one_line(make, match):
    with pytest.raises(InputError, match=match) as error:
        make()
    assert "\n" not in str(error.value)


def test_images_are_scenes_of_as_many_pixels():
    rails = torch.rand(2, 3, 12, generator=generator()) / 12
    scanner = Scanner.from_rails(rails, noise="none")
    flat = torch.rand(5, 12, generator=generator(1))
    assert torch.equal(scanner(flat.view(5, 3, 4)), scanner(flat))
    assert torch.equal(scanner.counts(flat.view(5, 3, 4)), scanner.counts(flat))
    with pytest.raises(InputError, match="or images of so many"):
        scanner(flat.view(5, 2, 6)[..., :5])
