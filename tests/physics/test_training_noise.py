"""Noise in units of the scene is that of counts, divided by the counts of one reflecting pixel."""

import pytest
import torch

from deepfsi.physics import TrainingNoise, detection
from shared.noises import training_noise

READ = detection.Readouts(
    torch.tensor([[[True] * 3], [[True, True, False]]]),
    torch.ones(2, 1, 3),
    torch.arange(6).view(2, 1, 3),
)


LIT = READ.lit


DRAWS = 200_000
GAINS, SIGMAS = [4.0, 50.0], [3.0, 0.5]
MEAN = torch.tensor([[0.4, -0.2, 0.5], [0.4, -0.2, 0.5]])
TOTAL = torch.tensor([[0.9, 0.5, 0.5], [0.9, 0.5, 0.5]])
READ = detection.Readouts(
    torch.tensor([[[True] * 3], [[True, True, False]]]),
    torch.ones(2, 1, 3),
    torch.arange(6).view(2, 1, 3),
)


def noise(kind: str) -> TrainingNoise:
    return training_noise(kind, GAINS, SIGMAS, [0, 1], torch.device("cpu"))


def test_counted_features_have_the_moments_of_two_poisson_rails():
    """Within five standard errors; a variance of Poisson rails has the kurtosis of their sum."""
    every = noise("poisson")
    drawn = every.counted(MEAN.expand(DRAWS, 2, 3), TOTAL.expand(DRAWS, 2, 3), READ)
    variance = TOTAL / every.gain
    error = (variance / DRAWS).sqrt()
    assert ((drawn.mean(dim=0) - MEAN).abs() < 5 * error).all()
    kurtosis = 2 + 1 / (TOTAL * every.gain)
    spread = variance * (kurtosis / DRAWS).sqrt()
    assert ((drawn.var(dim=0) - variance).abs() < 5 * spread).all()
    assert drawn.shape == (DRAWS, 2, 3)


@pytest.mark.parametrize("kind", ["ml_gauss", "poisson"])
def test_a_part_of_the_trainings_has_their_own_noise(kind):
    part = noise(kind).of_jobs(slice(1, 2))
    assert part.gain.tolist() == [[50.0]]
    assert part.unit.item() == pytest.approx(50**-0.5)


def test_mlgauss_and_read_noise_deviate_as_counts_over_the_gain():
    gain, sigma = torch.tensor(GAINS)[:, None], torch.tensor(SIGMAS)[:, None]
    photons = noise("ml_gauss").deviation(MEAN, TOTAL, READ).square()
    assert torch.allclose(photons, TOTAL * gain / gain**2)
    read = noise("gaussian").deviation(MEAN, TOTAL, READ).square()
    assert torch.allclose(read, LIT * sigma**2 / gain**2)
