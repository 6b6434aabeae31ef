"""Noise in units of the scene is that of counts, divided by the counts of one reflecting pixel."""

import pytest
import torch

from deepfsi.optics.features import FeatureNoise, mean_over_exposures, standardise

DRAWS = 200_000
GAINS, SIGMAS = [4.0, 50.0], [3.0, 0.5]
MEAN = torch.tensor([[0.4, -0.2, 0.5], [0.4, -0.2, 0.5]])
TOTAL = torch.tensor([[0.9, 0.5, 0.5], [0.9, 0.5, 0.5]])
LIT = torch.tensor([[2, 2, 1], [2, 2, 1]])


def noise(kind: str) -> FeatureNoise:
    return FeatureNoise.of(kind, GAINS, SIGMAS, [0, 1], torch.device("cpu"))


def test_mlgauss_and_read_noise_deviate_as_counts_over_the_gain():
    gain, sigma = torch.tensor(GAINS)[:, None], torch.tensor(SIGMAS)[:, None]
    photons = noise("ml_gauss").deviation(TOTAL, LIT).square()
    assert torch.allclose(photons, TOTAL * gain / gain**2)
    read = noise("gaussian").deviation(TOTAL, LIT).square()
    assert torch.allclose(read, LIT * sigma**2 / gain**2)


def test_counted_features_have_the_moments_of_two_poisson_rails():
    """Within five standard errors; a variance of Poisson rails has the kurtosis of their sum."""
    every = noise("poisson")
    drawn = every.counted(MEAN.expand(DRAWS, 2, 3), TOTAL.expand(DRAWS, 2, 3), None)
    variance = TOTAL / every.gain
    error = (variance / DRAWS).sqrt()
    assert ((drawn.mean(dim=0) - MEAN).abs() < 5 * error).all()
    kurtosis = 2 + 1 / (TOTAL * every.gain)
    spread = variance * (kurtosis / DRAWS).sqrt()
    assert ((drawn.var(dim=0) - variance).abs() < 5 * spread).all()
    assert drawn.shape == (DRAWS, 2, 3)


@pytest.mark.parametrize("kind", ["ml_gauss", "poisson"])
def test_a_part_of_the_trainings_has_their_own_noise(kind):
    part = noise(kind).part(slice(1, 2))
    assert part.gain.tolist() == [[50.0]]
    assert part.unit.item() == pytest.approx(50**-0.5)


def test_noise_over_exposures_is_the_mean_over_those_that_show_a_mask():
    """Against the sum over numbers of masks shown and budgets, of two jobs that differ.

    With n masks shown, and used(n) of their light law, the noise of a budget Φ is that of
    Φ used(m) / used(n); budgets are drawn log-uniformly from a hundredth to all of the largest.
    """
    used = torch.tensor([[0.2, 0.5, 0.6, 1.0], [0.1, 0.3, 0.9, 1.5]], dtype=torch.float64)
    chances = torch.tensor([0.4, 0.0, 0.1, 0.5], dtype=torch.float64)
    places = (torch.arange(100_000, dtype=torch.float64) + 0.5) / 100_000
    dim = float((100.0**-places).mean())
    factor, often = mean_over_exposures(used, 100.0, chances)
    for mask in range(4):
        seen = chances[mask:]
        assert float(often[mask]) == pytest.approx(float(seen.sum()))
        for job in range(2):
            mean = float((seen * used[job, mask:] / used[job, -1]).sum() / seen.sum())
            assert float(factor[job, mask]) == pytest.approx(dim * mean, rel=1e-6)
    one, _ = mean_over_exposures(used, 1.0, chances)
    assert torch.allclose(one * dim, factor, rtol=1e-6)


@pytest.mark.parametrize("scale", ["each", "common"])
def test_features_of_each_job_are_brought_to_a_mean_square_of_one_in_their_batch(scale):
    """Each mask by itself, or all masks of a job by one factor; masks not shown count for none."""
    features = torch.randn(50, 2, 3, generator=torch.Generator().manual_seed(1))
    features *= torch.tensor([[1.0, 2.0, 4.0], [30.0, 20.0, 10.0]])
    features -= features.mean(dim=0)
    shown = torch.arange(3) < torch.arange(50).remainder(3).add(1)[:, None, None]
    for found, seen in (
        (standardise(features, scale), torch.ones(50, 1, 3)),
        (standardise(features, scale, shown), shown),
    ):
        over = 0 if scale == "each" else (0, 2)
        power = (features.square() * seen).sum(dim=over, keepdim=True)
        expected = features / (power / seen.sum(dim=over, keepdim=True)).sqrt()
        assert torch.allclose(found, expected, rtol=1e-5, atol=1e-6)


@pytest.mark.parametrize("scale", ["each", "common"])
@pytest.mark.parametrize("some", [False, True])
def test_features_that_do_not_vary_in_a_batch_are_0_and_have_finite_gradients(scale, some):
    """As of detectors whose gates all click."""
    features = torch.zeros(50, 1, 3, requires_grad=True)
    shown = torch.ones(50, 1, 3) if some else None
    scaled = standardise(features, scale, shown)
    scaled.sum().backward()
    assert (scaled == 0).all()
    assert features.grad.isfinite().all()
