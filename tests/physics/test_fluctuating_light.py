"""Light that fluctuates from frame to frame: moments, what is alike in a frame, and training."""

from dataclasses import replace

import pytest
import torch
from torch import Tensor

from conftest import generator
from deepfsi import Scanner
from deepfsi.physics import noise as noise_module
from deepfsi.physics.detection import Detection, Rails
from deepfsi.physics.noise import Poisson
from deepfsi.physics.training_noise import TrainingNoise

DRAWS = 100_000
SIGMA = 0.2
LIGHT = torch.tensor([40.0, 90.0, 60.0, 20.0], dtype=torch.float64)
TILES = Detection(count=2, labels=torch.tensor([0, 1, 0, 1]))
SIGNED = torch.tensor([[0.4, -0.2, 0.1, -0.3], [-0.1, 0.3, -0.4, 0.2]], dtype=torch.float64)
APART = torch.stack([SIGNED.clamp(min=0), (-SIGNED).clamp(min=0)])
AT_ONCE = torch.stack([0.5 + SIGNED, 0.5 - SIGNED]) / 2
"""Rails (2, m, N) that one arm shows one after the other, and that two arms see at once."""

FLUCTUATION = Poisson(fluctuation=SIGMA)
OPTICS = {
    "one rail": (APART[:1] + 0.1, [[0], [1]]),
    "one after the other": (APART, [[0, 2], [1, 3]]),
    "two arms": (AT_ONCE, [[0, 0], [1, 1]]),
}
"""Rails, and number of the frame (m, rails) of each."""


def covariance(rates: Tensor, frames: Tensor) -> Tensor:
    """By the definition: δ r of photons, and σ² r r′ of readouts of one frame, of rates (k,)."""
    alike = frames[:, None] == frames
    return torch.diag(rates) + SIGMA**2 * alike * rates[:, None] * rates


def frames_of(optics: str, detectors: int) -> Tensor:
    rails, frames = OPTICS[optics]
    return torch.tensor(frames).T[: len(rails)].repeat_interleave(detectors, dim=1).flatten()


def assert_covariance(counts: Tensor, mean: Tensor, expected: Tensor) -> None:
    """Of draws (n, k), to five standard errors by the draws themselves."""
    off = counts.double() - mean
    products = off[:, :, None] * off[:, None]
    error = 5 * products.std(dim=0) / len(counts) ** 0.5 + 1e-9
    assert (off.mean(dim=0).abs() <= 5 * off.std(dim=0) / len(counts) ** 0.5 + 1e-9).all()
    assert ((products.mean(dim=0) - expected).abs() <= error).all()


@pytest.mark.parametrize("optics", OPTICS)
@pytest.mark.parametrize("detection", [Detection(), TILES], ids=["one detector", "two"])
def test_counts_of_one_frame_share_its_light(optics, detection):
    scanner = Scanner.from_rails(OPTICS[optics][0], FLUCTUATION, detection=detection)
    rates = scanner.rates(LIGHT).flatten()
    counts = scanner.counts(LIGHT.expand(DRAWS, 4), generator()).flatten(1)
    assert_covariance(counts, rates, covariance(rates, frames_of(optics, detection.count)))


@pytest.mark.parametrize("optics", OPTICS)
@pytest.mark.parametrize("readout", ["difference", "both"])
@pytest.mark.parametrize("inner", [Poisson(), noise_module.make_noise("ml_gauss")], ids=repr)
def test_features_of_a_training_have_the_same_law(optics, readout, inner):
    """And the variance that is claimed of them: that of the photons, and of the light."""
    (rails, _), gain = OPTICS[optics], 3.0
    detection = Detection(readout, 2, TILES.labels)
    read = detection.readouts(Rails.of(rails).map(detection.arrange))
    scanner = Scanner.from_rails(rails, "none", detection=detection)
    rates = scanner.rates(LIGHT)
    mean, total = detection.features(rates), detection.totals(rates)
    read = type(read)(*(each.unsqueeze(1) for each in read))
    noise = TrainingNoise.of([replace(inner, fluctuation=SIGMA)], [gain], [1], torch.device("cpu"))
    pair = (each.expand(DRAWS, 1, len(mean)) / gain for each in (mean, total))
    drawn = noise.features(*pair, read, lambda count: torch.zeros(0))[:, 0] * gain
    every = covariance(rates.flatten(), frames_of(optics, 2))
    # features are sums of counts of rails: by the same map as of the rates
    signs = torch.stack(
        [detection.features(unit.view_as(rates)) for unit in torch.eye(rates.numel()).double()], -1
    )
    expected = signs @ every @ signs.T
    assert_covariance(drawn, mean, expected)
    claimed = noise.variance(mean[None] / gain, total[None] / gain, read)[0] * gain**2
    assert torch.allclose(claimed, expected.diagonal(), rtol=1e-5)


def test_dark_counts_and_read_noise_do_not_fluctuate():
    noise = noise_module.make_noise("camera", sigma=2.0, dark=50.0, fluctuation=SIGMA)
    counts = Scanner.from_rails(APART[:1] * 0 + 0.25, noise).counts(
        LIGHT.expand(DRAWS, 4), generator()
    )
    rates = torch.full((2,), float(LIGHT.sum()) / 4).double()
    expected = covariance(rates, torch.arange(2)) + torch.eye(2) * (50.0 * 0.25 + 4.0)
    assert_covariance(counts.flatten(1), rates, expected)
