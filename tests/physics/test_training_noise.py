"""Noise in units of the scene is that of counts, divided by the counts of one reflecting pixel."""

import math

import pytest
import torch

from conftest import assert_moments
from deepfsi.physics import detection, noise
from deepfsi.physics.detection import Rails
from deepfsi.physics.training_noise import TrainingNoise
from shared.noises import RAILS

DRAWS = 50_000
GAINS = [50.0, 200.0]
NUMBERS = {
    "poisson": [{}, {}],
    "ml_gauss": [{}, {}],
    "gaussian": [{"sigma": 2.0}, {"sigma": 5.0}],
    "camera": [{"sigma": 2.0, "dark": 30.0}, {"sigma": 5.0, "dark": 10.0}],
    "click": [{"gates": 20}, {"gates": 20}],
}
SCENE = torch.tensor([0.4, 0.9], dtype=torch.float64)
TRAINED = Rails.of(RAILS.unsqueeze(0))


def alone(kind: str) -> list[noise.Noise]:
    return [noise.make_noise(kind, **numbers) for numbers in NUMBERS[kind]]


def side_by_side(kind: str) -> TrainingNoise:
    return TrainingNoise.of(alone(kind), GAINS, [0, 1], torch.device("cpu"))


@pytest.mark.parametrize("kind", ["poisson", "camera", "click"])
def test_training_draws_what_the_scanner_does(kind):
    """Counted features of a step, against the law of each training, which is also claimed."""
    trained = side_by_side(kind)
    mean, light = (each @ SCENE for each in (TRAINED.difference, TRAINED.total))  # (1, 4)
    read = detection.Detection().readouts(TRAINED)
    features = trained.counted(mean.expand(DRAWS, 2, 4), light.expand(DRAWS, 2, 4), read)
    claimed = trained.variance(mean, light, read).double()
    of_one = detection.Detection().readouts(Rails.of(RAILS))
    for job, (one, gain) in enumerate(zip(alone(kind), GAINS, strict=True)):
        plus, minus = one.mean(RAILS @ SCENE * gain)
        power = one.variance(noise.Expectation(mean[0] * gain, light[0] * gain, of_one))
        drawn = features[:, job] * gain
        assert_moments(drawn, plus - minus, power, poisson=True, rounding=1e-4)
        assert torch.allclose(claimed[job], power / gain**2)


@pytest.mark.parametrize("kind", ["poisson", "camera"])
def test_training_follows_mean_light_and_time(kind):
    """E[y²] = μ² + (L + σ² / Φ + d / Φ) / Φ a feature: slopes 2 μ in μ, 1 / Φ in L and in d / Φ."""
    gain, dark = GAINS[0], NUMBERS["camera"][0]["dark"]
    noisy = TrainingNoise.of(alone(kind)[:1], [gain], [0], torch.device("cpu"))
    rails = Rails.of(RAILS[:, :2].unsqueeze(0))
    read = detection.Detection().readouts(rails)
    read = read._replace(time=read.time.clone().requires_grad_())
    mean, light = (
        (each @ SCENE).expand(DRAWS, 1, 2).clone().requires_grad_()
        for each in (rails.difference, rails.total)
    )
    noisy.counted(mean, light, read).square().sum().backward()
    by_mean, by_light = mean.grad[:, 0], light.grad[:, 0]
    for found, wanted in ((by_mean, 2 * mean[0, 0]), (by_light, 1 / gain)):
        assert ((found.mean(dim=0) - wanted).abs() <= 5 * found.std(dim=0) / DRAWS**0.5).all()
    if kind == "camera":
        error = 5 * by_light.std(dim=0) / math.sqrt(DRAWS)
        by_time = read.time.grad[0, 0] / DRAWS  # through d = D t
        assert ((by_time - dark / gain**2).abs() <= error * dark / gain).all()
