"""Laws of adaptive masks under light that fluctuates from look to look."""

import numpy as np
import pytest
import torch
from scipy.stats import nbinom

from conftest import generator
from deepfsi.adaptive import posterior

PIXELS = 12
SIGMA = 0.2


@pytest.fixture(scope="module")
def prior() -> posterior.ScenePrior:
    rng = np.random.default_rng(0)
    return posterior.ScenePrior(
        rng.random((40, PIXELS)), np.arange(40) % 2, 2, components=PIXELS, spread=0.5
    )


def mask_of(look: int) -> torch.Tensor:
    """A random mask (1, N)."""
    return (torch.rand(1, PIXELS, generator=generator(look)) > 0.5).float()


def optics(**fields) -> posterior.LookOptics:
    return posterior.LookOptics(**{"photons": 3e3, "fluctuation": SIGMA, **fields})


def test_one_detector_counts_as_its_light_varies(prior):
    """The law is a negative binomial whose relative variance is σ² and what scenes have."""
    state = posterior.AdaptivePosterior(prior, 1, optics(dark=20.0))
    mask = mask_of(1)
    before = state.logs.clone()
    mean, parts = prior.light(mask)
    gain = state.gain / 4
    usual = float(mean + parts @ state.class_sums.sum(dim=1)[0])
    spread = float((parts**2).sum()) + (SIGMA * usual) ** 2  # e has the identity as covariance
    state.update(mask, torch.tensor([[260.0]]), share=0.25)
    light = (mean + parts @ prior.coefficients.T)[0].double().numpy() * gain + 5
    expected = usual * gain + 5
    size = expected**2 / (spread * gain**2)
    law = nbinom.logpmf(260, size, size / (size + light))
    # terms that are alike for all scenes are left out
    learned = (state.logs - before)[0].double().numpy()
    assert np.ptp(law - learned) < 1e-4 * np.ptp(law)


@pytest.mark.parametrize("fields", [{"arms": 2}, {"detectors": torch.arange(PIXELS) % 3}])
def test_readouts_of_a_look_have_one_light_and_looks_have_their_own(prior, fields):
    """With many photons e is known after two looks as of the normal law of all readouts."""
    state = posterior.AdaptivePosterior(prior, 1, optics(photons=1e9, **fields))
    gain = state.gain / 2
    known = []  # (through, mean, reading) of each look
    for look, mask in enumerate((mask_of(1), mask_of(2))):
        mean, parts = prior.light(state.optics.readouts(mask))
        here = state.class_sums.sum(dim=1)
        usual = mean + (parts @ state._shift[0]) + (state.unknown(parts) @ here[..., None])[..., 0]
        own = torch.zeros(usual.shape[1], 2)
        own[:, look] = SIGMA * usual[0]
        reading = usual * torch.linspace(0.9, 1.2, usual.shape[1])
        known.append((torch.cat([parts[0], own], dim=1), mean[0], reading[0]))
        state.update(mask, reading * gain, share=0.5)
    through, mean, reading = (torch.cat(each).double() for each in zip(*known, strict=True))
    weights = through.T @ torch.linalg.inv(through @ through.T)
    covariance = torch.eye(through.shape[1]) - weights @ through
    size = PIXELS
    shift, unknown = state._shift[0].double(), state.unknown(torch.eye(size)[None])[0].double()
    assert torch.allclose(shift, (weights @ (reading - mean))[:size], rtol=2e-3, atol=2e-3)
    assert torch.allclose(unknown, covariance[:size, :size], atol=2e-3)


def test_looks_vary_as_their_light_does(prior):
    """Counts of both arms have the variance r + (σ r)² and the covariance σ² r r'."""
    exposures = 20_000
    state = posterior.AdaptivePosterior(prior, exposures, optics(arms=2, dark=100.0))
    x = torch.full((1, PIXELS), 0.4).expand(exposures, -1)
    state.logs = state.logs[:1].expand(exposures, -1)
    look = state.look_at(x, 0.5, generator(3))
    light = look.light[0].double()
    of_mask = (look.masks == look.masks[0]).all(dim=1)
    counts = look.counts[of_mask].double()
    dark = 50.0
    covariance = SIGMA**2 * torch.outer(light, light) + torch.diag(light + dark)
    error = torch.sqrt(
        (covariance**2 + torch.outer(covariance.diag(), covariance.diag())) / len(counts)
    )
    # a log-normal light has somewhat heavier tails than a normal one
    assert ((torch.cov(counts.T) - covariance).abs() < 6 * error).all()
    mean_error = (covariance.diag() / len(counts)).sqrt()
    assert ((counts.mean(dim=0) - light - dark).abs() < 5 * mean_error).all()
