"""The optical front end draws the right counts, on every path, and passes the right gradient."""

import math

import pytest
import torch
from torch import Tensor

from conftest import assert_moments, every_optics, generator
from deepfsi import InputError, Scanner
from deepfsi.physics import detection, noise
from deepfsi.physics.laws import LearnedMasks
from shared.noises import RAILS, TIMES

DRAWS = 50_000
RATES = [0.0, 1e-3, 1.0, 1e3, 1e6, 1.001e6, 1e8, 1e10]
SIGMA, DARK = 3.0, 40.0
NOISES = ["poisson", "ml_gauss", "gaussian", "none", "camera"]
LIT = RAILS.amax(dim=-1) > 0

every_noise = pytest.mark.parametrize("name", NOISES)


def scanner_of(name: str, rails: Tensor = RAILS) -> Scanner:
    return Scanner.from_rails(rails, name, SIGMA, DARK if name == "camera" else 0.0)


def variances(name: str, rates: Tensor) -> Tensor:
    light = {"none": 0 * rates, "gaussian": 0 * rates, "camera": rates + DARK * TIMES}
    read = SIGMA**2 if name in ("gaussian", "camera") else 0.0
    return light.get(name, rates) + read * LIT


@pytest.mark.parametrize("rate", RATES)
@every_noise
def test_counts_and_features_have_the_moments_of_the_noise(name, rate):
    """Those of each rail, and of the difference of both; rails that are never lit read 0."""
    photons = torch.tensor([rate, 2 * rate], dtype=torch.float64)
    scanner, every = scanner_of(name), photons.expand(DRAWS, 2)
    rates = RAILS @ photons
    power, poisson = variances(name, rates), name in ("poisson", "camera")
    counts = scanner.counts(every, generator())
    rounding = 0.5 * (rates > 0) if poisson else 1e-15 * rates
    assert_moments(counts, rates, power, poisson=poisson, rounding=rounding)
    assert (counts[:, ~LIT] == 0).all()
    features = scanner(every, generator())
    rounding = 1.0 * (power.sum(dim=0) > 0) if poisson else 1e-15 * rate
    assert_moments(
        features, rates[0] - rates[1], power.sum(dim=0), poisson=poisson, rounding=rounding
    )
    assert (features[:, 3] == 0).all()


def learned(light: str, rails: str, single_signed: bool = False) -> LearnedMasks:
    start = torch.randn(3, 4, generator=generator(2), dtype=torch.float64)
    if rails == "single" or single_signed:
        start = start.abs() + 0.1
    masks = LearnedMasks(start, light, rails)
    for parameter in masks.parameters():  # away from the kink where a column is just full
        parameter.data *= 1.3
    return masks


FLUCTUATING = noise.Poisson(fluctuation=0.2)


@pytest.mark.parametrize("light", ["column", "free-dwell", "two-arm"])
@pytest.mark.parametrize(
    "kind", ["ml_gauss", "poisson", "gaussian", "camera", FLUCTUATING], ids=str
)
def test_mask_gradients_follow_mean_and_variance(kind, light):
    """E[y²] = μ² + L with L of light, dark counts and read noise: its slope in every weight."""
    masks = LearnedMasks(torch.randn(3, 5, dtype=torch.float64, generator=generator(2)), light)
    scene = torch.linspace(1, 5, 5, dtype=torch.float64)
    numbers = () if kind is FLUCTUATING else (SIGMA, DARK if kind == "camera" else 0.0)
    scanner = Scanner(masks, kind, *numbers)

    shown = masks()
    read = detection.Detection().readouts(shown)
    mean, power = shown.difference @ scene, shown.total @ scene
    if kind == "gaussian":
        power = SIGMA**2 * read.lit
    if kind == "camera":
        power = power + DARK * read.time.sum(dim=0) + SIGMA**2 * read.lit
    if kind is FLUCTUATING:  # two arms see the same light, other rails each its own
        apart = (shown.stacked @ scene).square().sum(dim=0)
        power = power + 0.2**2 * (mean.square() if light == "two-arm" else apart)
    wanted = torch.autograd.grad((mean**2 + power).sum(), list(masks.parameters()))
    exact = torch.cat([each.flatten() for each in wanted])

    batches = []
    for seed in range(40):
        features = scanner(scene.expand(2000, 5), generator(seed))
        loss = features.square().sum(dim=1).mean()
        grads = torch.autograd.grad(loss, list(masks.parameters()))
        batches.append(torch.cat([each.flatten() for each in grads]))
    found = torch.stack(batches)
    error = found.std(dim=0) / math.sqrt(len(found))
    # of 40 batches the error itself is known to a ninth; five and a half of them
    assert ((found.mean(dim=0) - exact).abs() <= 5.5 * error + 1e-9).all()
    assert (exact.abs() > 1e-3).any()


@every_optics
@pytest.mark.parametrize("name", ["ml_gauss", "poisson", "gaussian"])
def test_dark_rails_and_dark_scenes_give_finite_gradients(light, rails, name):
    masks = learned(light, rails, single_signed=True)
    photons = torch.zeros(5, 4, dtype=torch.float64)
    photons[1:, 2] = 7.0
    Scanner(masks, name)(photons, generator()).square().sum().backward()
    for parameter in masks.parameters():
        assert torch.isfinite(parameter.grad).all()
        assert (parameter.grad != 0).any()


@pytest.mark.parametrize(
    ("photons", "match"),
    [
        (torch.ones(5, 3), r"shape \(5, 3\) do not fit masks of 2 pixels"),
        (torch.ones(5, 2, dtype=torch.int64), "torch.int64 photons"),
    ],
)
def test_photons_of_another_shape_or_kind_are_refused(photons, match):
    with pytest.raises(InputError, match=match):
        scanner_of("poisson")(photons)


def test_frames_that_start_below_0_are_refused():
    with pytest.raises(InputError, match="negative entries"):
        LearnedMasks(-torch.ones(3, 64), "column", "single")


def test_images_are_scenes_of_as_many_pixels():
    scanner = Scanner.from_rails(torch.rand(2, 3, 12, generator=generator()) / 12, noise="none")
    flat = torch.rand(5, 12, generator=generator(1))
    assert torch.equal(scanner(flat.view(5, 3, 4)), scanner(flat))
    assert torch.equal(scanner.counts(flat.view(5, 3, 4)), scanner.counts(flat))
