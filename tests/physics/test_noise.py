"""Each noise has the mean and variance it claims, and a gradient where masks train through it."""

import math

import pytest
import torch
from torch.nn.functional import softplus

from conftest import assert_moments, generator, quick
from deepfsi import Camera, InputError, Scanner
from deepfsi.physics import detection
from deepfsi.physics import noise as noise_module
from deepfsi.physics.noise import Poisson
from shared.noises import RAILS, exact, saturating

DRAWS = 100_000
ONE_RAIL = detection.Readouts(
    torch.tensor([[True], [False]]), torch.tensor([[1.0], [0.0]]), torch.zeros(2, 1).long()
)


@pytest.mark.parametrize("rate", [0.05, 0.5, 2.0])
def test_counts_of_one_rail_follow_their_rate_by_the_trapezoid_rule(rate):
    """∂ E f / ∂r is E ∫₀¹ f′(k + t) dt; counts summed over, as far as they are at all likely."""
    counts = torch.arange(60, dtype=torch.float64, requires_grad=True)
    law = torch.exp(counts * math.log(rate) - rate - torch.lgamma(counts + 1)).detach()
    losses = softplus(counts)
    (slope,) = torch.autograd.grad(losses.sum(), counts)
    rates = torch.full((DRAWS,), rate, dtype=torch.float64, requires_grad=True)
    light = noise_module.Expectation(rates, rates, ONE_RAIL)
    drawn = Poisson().draw(rates, generator())
    softplus(Poisson().gradient(drawn, light)).sum().backward()
    found, error = rates.grad.mean(), 5 * rates.grad.std() / math.sqrt(DRAWS)
    assert abs(found - law[:-1] @ (slope[:-1] + slope[1:]) / 2) <= error
    exact, straight = law[:-1] @ losses.detach().diff(), law @ slope
    assert abs(found - exact) < abs(straight - exact) / 4


ALL = [
    *(noise_module.make_noise(name) for name in ("none", "poisson", "ml_gauss", "click")),
    noise_module.make_noise("gaussian", sigma=3.0),
    noise_module.make_noise("camera", sigma=2.0, dark=40.0),
    noise_module.make_noise("click", gates=5),
]
FLUCTUATING = [
    noise_module.make_noise("none", fluctuation=0.3),
    noise_module.make_noise("camera", sigma=2.0, dark=40.0, fluctuation=0.3),
]
READ = detection.Readouts(
    torch.tensor([[True, True, False], [True, False, True]]),
    torch.tensor([[0.5, 0.3, 0.0], [0.1, 0.0, 0.1]], dtype=torch.float64),
    torch.tensor([[0, 2, 4], [1, 3, 5]]),
)
"""Both rails of a feature are read out, the positive one alone, and the negative one alone."""


@pytest.mark.parametrize("noise", [*ALL, *FLUCTUATING], ids=repr)
@pytest.mark.parametrize("gain", [1.0, 8.0])
def test_features_have_the_mean_and_the_variance_that_a_noise_claims(noise, gain):
    """Of two rails, to five standard errors; in units of the gain the variance is over it twice."""
    rates = torch.tensor([[0.7, 4.0, 0.0], [2.0, 0.0, 0.3]], dtype=torch.float64)
    every = rates.expand(DRAWS, 2, 3)
    dark = noise.dark_counts(READ.time)
    plus, minus = noise.sample(every, READ, dark, generator(2)).unbind(dim=1)
    mean = torch.where(READ.active, noise.mean(rates), 0.0)
    total, difference = (rates[0] + rates[1]) / gain, (rates[0] - rates[1]) / gain
    light = noise_module.Expectation(difference, total, READ, gain)
    variance = noise.variance(light) / gain
    drawn = (plus - minus) / gain
    fourth = (drawn - drawn.mean(dim=0)).pow(4).mean(dim=0) - drawn.var(dim=0).square()
    error = 5 * (fourth.clamp(min=0) / DRAWS).sqrt() + 1e-12
    assert ((drawn.var(dim=0) - variance).abs() <= error).all()
    centre = (mean[0] - mean[1]) / gain
    assert ((drawn.mean(dim=0) - centre).abs() <= 5 * (variance / DRAWS).sqrt() + 1e-12).all()
    if not noise.draws_rails:
        assert torch.allclose(noise.deviation(light).square(), variance)


@pytest.mark.parametrize("own", [saturating, "shared.noises:saturating"], ids=["function", "path"])
def test_a_noise_of_ones_own_is_drawn_for_each_rail(own):
    scene = torch.tensor([600.0, 900.0], dtype=torch.float64)
    scanner = Scanner.from_rails(RAILS, own)
    assert scanner.noise.name == "shared.noises:saturating"
    rates = RAILS @ scene
    seen = rates / (1 + rates / 1000)
    every = scene.expand(DRAWS, 2)
    counts, features = scanner.counts(every, generator()), scanner(every, generator())
    assert_moments(counts, seen, seen, poisson=False, rounding=1e-9)
    assert_moments(features, seen[0] - seen[1], seen.sum(dim=0), poisson=False, rounding=1e-9)


@pytest.mark.parametrize(
    ("own", "match"),
    [
        (exact, "no gradient in the rates"),
        (lambda rates, generator: rates[:, :1], "of the shape of the rates"),
        ("no_such_module:noise", "No module named"),
    ],
)
def test_what_is_no_noise_is_refused_in_one_line(digits, own, match):
    with pytest.raises(InputError, match=match) as error:
        quick(digits, noise=own)
    assert "\n" not in str(error.value)


@pytest.mark.parametrize("number", ["sigma", "dark"])
def test_noise_that_is_less_than_none_is_refused(number):
    for wrong in (-1e-3, math.nan, math.inf):
        with pytest.raises(InputError, match="give 0 or more"):
            noise_module.make_noise("camera", **{number: wrong})
    for right in (0.0, 1e-3):
        assert noise_module.make_noise("camera", **{number: right}).settings[number] == right


@pytest.mark.parametrize("rate", [0, 1e-3, 1, 1e3, noise_module.POISSON_LIMIT, 1e10])
@pytest.mark.parametrize("dtype", [torch.float32, torch.float64])
@pytest.mark.parametrize("name", ["poisson", "ml_gauss"])
def test_float32_keeps_mean_and_variance_up_to_1e10(name, rate, dtype):
    """Photon counts are whole and never negative."""
    rates = torch.full((DRAWS,), rate, dtype=dtype)
    counts = noise_module.make_noise(name).draw(rates, generator(4))
    assert counts.dtype == dtype
    spacing = 2.0 ** max(math.floor(math.log2(max(rate, 1e-9))) - 23, -23)
    assert_moments(counts, rate, rate, poisson=name == "poisson", rounding=max(spacing, 1.0) / 2)
    if name == "poisson":
        assert (counts == counts.round()).all()
        assert (counts >= 0).all()


def test_a_camera_has_its_noise_or_another_with_its_numbers():
    camera = Camera(noise="camera", sigma=2.0, dark=30.0)
    own, other = noise_module.noise_of(camera), noise_module.noise_of(camera, "gaussian")
    assert (own.name, own.sigma, own.dark) == ("camera", 2.0, 30.0)
    assert (other.name, other.sigma) == ("gaussian", 2.0)
    assert noise_module.noise_of(Camera(), "poisson") == Poisson()
