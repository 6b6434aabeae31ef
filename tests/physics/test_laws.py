"""The paper's claims as laws, over all designs and all light laws at once."""

import numpy as np
import pytest
import torch
from torch import Tensor

from conftest import (
    FLOAT32,
    OPTICS,
    PHOTONS,
    every_design,
    every_passive_design,
    generator,
    light_on,
    quick,
    synthetic,
)
from deepfsi import Scanner
from deepfsi.jobs.designs import sensing_matrix
from deepfsi.physics import detection
from deepfsi.physics import noise as noise_module
from deepfsi.physics.detection import Rails
from deepfsi.physics.laws import frames, light_law

N = 64
DRAWS = 20_000
SCENES = {
    "digit": None,
    "uniform": np.ones(N),
    "point": np.eye(N)[27],
    "ramp": np.linspace(0, 1, N),
}


def separation(masks: Tensor, power: Tensor, difference: Tensor) -> Tensor:
    """Squared distance of two scenes in the best linear feature, in its standard deviations."""
    return ((difference @ masks.T).square() / power).sum(dim=-1)


@every_design
def test_no_design_counts_more_than_its_light(made, digits, design, light, rails):
    """A scene its own light, the training mean the budget; a projector's white scene its dose."""
    made_design = made(design, light, rails)
    scanner, photons = made_design.scanner("none"), light_on(made_design, digits.x_train)
    rates = scanner.rates(photons).double()
    counted = made_design.exposure.detection.totals(rates).mean(dim=0)
    if light != "dose":
        assert (rates.sum(dim=(-2, -1)) <= photons.sum(dim=-1) * (1 + FLOAT32)).all()
        assert light_law("column").excess(made_design.rails.stacked) <= FLOAT32
        assert counted.sum() <= PHOTONS * (1 + FLOAT32)
    shares = made_design.exposure.shares.double()
    assert torch.allclose(counted, shares * PHOTONS, rtol=1e-5, atol=1e-3)
    white = torch.ones(1, N) * PHOTONS / made_design.summed_reflectance
    assert scanner.rates(white).sum() <= white.sum() * (1 + FLOAT32)


def scan(design: str, digits) -> Tensor:
    matrix = torch.from_numpy(sensing_matrix(design, N, digits))
    if design == "raster":
        return matrix.unsqueeze(0)
    return light_law("column").fit(matrix)


def scene(name: str, digits) -> Tensor:
    x = digits.x_test[0] if SCENES[name] is None else SCENES[name]
    return torch.as_tensor(x).double() * (1e6 / x.sum())


def analytic_error(rails: Tensor, photons: Tensor, noise: str, sigma: float) -> float:
    """Pixel mean of the variance of the reconstruction M⁻¹ y."""
    both = Rails.of(rails)
    light = noise_module.Expectation(
        photons @ both.difference.T, photons @ both.total.T, detection.Detection().readouts(both)
    )
    power = noise_module.make_noise(noise, sigma=sigma).variance(light)
    return float((torch.linalg.inv(both.difference).square() @ power).mean())


def simulated_error(rails: Tensor, photons: Tensor, noise: str, sigma: float) -> float:
    scanner = Scanner.from_rails(rails, noise, sigma)
    features = scanner(photons.expand(DRAWS, N), generator(1))
    reconstruction = features @ torch.linalg.inv(Rails.of(rails).difference).T
    error = 5 * reconstruction.std(dim=0).max() / DRAWS**0.5
    assert ((reconstruction.mean(dim=0) - photons).abs() <= error).all()  # unbiased
    return float(reconstruction.var(dim=0).mean())


@pytest.mark.parametrize("name", SCENES)
def test_gaussian_noise_hadamard_gains_over_raster(digits, name):
    hadamard, raster = scan("hadamard", digits), scan("raster", digits)
    photons, sigma = scene(name, digits), 3.0
    gain = N**2 / (2 * N - 1)
    worth = [analytic_error(rails, photons, "gaussian", sigma) for rails in (raster, hadamard)]
    assert worth[0] / worth[1] == pytest.approx(gain, rel=1e-9)
    drawn = [simulated_error(rails, photons, "gaussian", sigma) for rails in (raster, hadamard)]
    five_sigma = 5 * (2 / DRAWS) ** 0.5  # of a variance, were all pixels' errors the same
    assert drawn == pytest.approx(worth, rel=five_sigma)


@pytest.mark.parametrize("noise", ["poisson", "ml_gauss"])
@pytest.mark.parametrize("name", SCENES)
def test_photon_noise_hadamard_equals_raster(digits, name, noise):
    hadamard, raster = scan("hadamard", digits), scan("raster", digits)
    photons = scene(name, digits)
    worth = [analytic_error(rails, photons, noise, 1.0) for rails in (raster, hadamard)]
    assert worth == pytest.approx([N * float(photons.mean())] * 2, rel=1e-9)
    drawn = [simulated_error(rails, photons, noise, 1.0) for rails in (raster, hadamard)]
    assert drawn == pytest.approx(worth, rel=5 * (2.1 / DRAWS) ** 0.5)


@pytest.mark.parametrize("name", SCENES)
def test_hadamard_on_one_device(digits, name):
    """Its 2N − 1 frames share the time of one detector; two arms show two of them at once."""
    matrix = torch.from_numpy(sensing_matrix("hadamard", N, digits))
    raster, photons, shown = scan("raster", digits), scene(name, digits), 2 * N - 1
    for light, photon_noise, read_noise in (
        ("free-dwell", shown / N, shown**3 / N**4),
        ("two-arm", 1.0, shown / N**2),
    ):
        hadamard = light_law(light).fit(matrix)
        for noise, ratio in (("poisson", photon_noise), ("gaussian", read_noise)):
            errors = [analytic_error(rails, photons, noise, 3.0) for rails in (hadamard, raster)]
            assert errors[0] / errors[1] == pytest.approx(ratio, rel=1e-6)


@every_passive_design
def test_photon_noise_nothing_separates_two_scenes_better_than_impulse(
    made, digits, design, light, rails
):
    masks = frames(made(design, light, rails).rails.stacked).double()
    first = light_on(made(design, light, rails), digits.x_test[:100])
    second = first.roll(1, dims=0)
    mean, difference = (first + second) / 2, first - second
    impulse = separation(torch.eye(N).double(), mean, difference)
    coded = separation(masks, (mean @ masks.T).clamp(min=1e-12), difference)
    assert (coded <= impulse * (1 + FLOAT32)).all()


@every_design
def test_subtracting_rails_adds_no_information(made, digits, design, light, rails):
    rails_made = made(design, light, rails).rails
    signed, total = rails_made.difference.double(), rails_made.total.double()
    masks = frames(rails_made.stacked).double()
    first = light_on(made(design, light, rails), digits.x_test[:100])
    mean, difference = (first + first.roll(1, dims=0)) / 2, first - first.roll(1, dims=0)
    apart = separation(masks, (mean @ masks.T).clamp(min=1e-12), difference)
    feature = separation(signed, (mean @ total.T).clamp(min=1e-12), difference)
    assert (feature <= apart * (1 + 1e-9)).all()


@pytest.mark.parametrize(("light", "rails"), [each for each in OPTICS if each[0] != "dose"])
def test_coded_counts_are_impulse_counts_routed_at_random(made, digits, light, rails):
    """Draw the impulse camera's photons, send each to a readout or away, compare with Scanner."""
    made_design = made("deepfsi", light, rails)
    masks = frames(made_design.rails.stacked).double()
    photons = light_on(made_design, digits.x_test[0], 1e3)
    rng, draws = np.random.default_rng(0), 10_000
    routed = np.zeros((draws, len(masks) + 1))
    for rate, shares in zip(photons.numpy(), masks.numpy().T, strict=True):
        ways = np.append(shares, max(0.0, 1 - shares.sum()))
        routed += rng.multinomial(rng.poisson(rate, draws), ways / ways.sum())
    counts = made_design.scanner().counts(photons.expand(draws, N), generator())
    every = counts.transpose(-1, -2).flatten(1)
    shown = made_design.rails.stacked.transpose(0, 1).flatten(0, 1).amax(dim=-1) > 0
    rates = (masks @ photons).numpy()
    power = np.sqrt(np.outer(rates, rates) + np.diag(rates + rates**2)) / draws**0.5
    for drawn in (routed[:, :-1], every[:, : len(shown)][:, shown].numpy()):
        assert np.all(abs(drawn.mean(axis=0) - rates) <= 5 * np.sqrt(rates / draws))
        assert np.all(abs(np.cov(drawn.T) - np.diag(rates)) <= 5 * power)


@pytest.mark.usefixtures("uncharacterised", "trained_once")
@pytest.mark.parametrize("design", ["hadamard", "truncated-hadamard", "s-matrix"])
def test_padding_takes_no_light_from_the_laws(design):
    data = synthetic((12, 10))
    made_design = quick(data, design)
    photons = light_on(made_design, data.x_test)
    counted = made_design.scanner("none").rates(photons).sum(dim=(-2, -1))
    assert (counted <= photons.sum(dim=-1) * (1 + FLOAT32)).all()
