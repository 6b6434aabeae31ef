"""Counts of looks under photon noise, dark counts and read noise: their mean and their variance.

Given the counts before it, a look with the dwells d counts y of mean r d and variance
(r + D) d + σ², D the dark counts of a detector in the whole exposure, which are subtracted in the
mean. The dwells depend on earlier counts alone, so that the sums over K looks have E[y − r d] = 0
and E[(y − r d)²] = E[(r + D) d] + K σ², with d the dwells of all looks together.
"""

import numpy as np
import pytest
import torch
from torch import Tensor

from conftest import generator, once
from deepfsi import Scanner
from deepfsi.datasets.arrays import from_arrays
from deepfsi.exposure.training import JobGroup, build_training
from deepfsi.exposure.training_set import TrainingSet
from deepfsi.physics.training_noise import Draws
from shared.jobs import job

LOOKS, DARK, SIGMA, PHOTONS = 3, 400.0, 4.0, 2e3

OPTICS = [
    {"light": "free-dwell", "rails": "single"},
    {"light": "free-dwell", "rails": "dual", "readout": "both"},
    {"light": "two-arm", "rails": "dual", "readout": "both"},
    {"light": "two-arm", "rails": "dual", "readout": "difference"},
    {"light": "free-dwell", "rails": "single", "detectors": "2x2"},
    {"light": "two-arm", "rails": "dual", "detectors": "2x2"},
]
every_optics = pytest.mark.parametrize("optics", OPTICS, ids=str)
every_noise = pytest.mark.parametrize(("dark", "sigma"), [(DARK, 0.0), (0.0, SIGMA), (DARK, SIGMA)])


def added_to(dwell: Tensor, optics: dict[str, str], dark: float, sigma: float) -> Tensor:
    """Variance of dark counts and read noise, of one or two readouts a feature."""
    readouts = 2 if optics.get("readout") == "difference" else 1
    return readouts * (dark * dwell + LOOKS * sigma**2)


def assert_law(off: Tensor, variance: Tensor) -> None:
    """Deviations (n, k) from what is expected have mean 0 and the variances (n, k)."""
    n = len(off)
    assert (off.mean(dim=0).abs() <= 5 * off.std(dim=0) / n**0.5).all()
    more = off.square() - variance
    assert (more.mean(dim=0).abs() <= 5 * more.std(dim=0) / n**0.5).all()


@every_optics
@every_noise
def test_sums_of_looks_have_the_mean_and_variance_of_light_dark_counts_and_read_noise(
    digits, optics, dark, sigma
):
    design = once(digits, masks=5, looks=LOOKS, **optics)
    scanner, few = design.scanner("camera", sigma, dark), torch.from_numpy(digits.x_test[:4])
    with torch.no_grad():
        rates = design.rates(scanner, few.repeat_interleave(5000, dim=0))
        *_, seen = design.observe(scanner, rates, generator(3), PHOTONS)
        expected = PHOTONS * design.exposure.expected(rates, seen)
    off = seen.features * PHOTONS - design.detection.features(expected)
    dwell = seen.dwell.repeat_interleave(design.features // seen.dwell.shape[-1], dim=-1)
    added = added_to(dwell, optics, dark, sigma)
    variance = (design.detection.totals(expected) + added).double()
    assert_law(off.double(), variance)
    with pytest.raises(AssertionError):  # each part is seen
        assert_law(off.double(), variance - added * (0.5 if dark else 1.0))


@every_optics
@every_noise
def test_looks_of_a_training_have_the_same_law(optics, dark, sigma):
    """Scenes that are all alike: features, in units of their photon noise at equal dwells."""
    count, rng = 6000, np.random.default_rng(1)
    x = np.broadcast_to(rng.uniform(0.2, 1, (8, 8)), (count, 8, 8)).astype(np.float32)
    data = from_arrays(x, np.arange(count) % 2, name="alike")
    scenes = TrainingSet(data, "cpu")
    count = len(scenes.labels)
    one = job(
        design="random", masks=5, photons=PHOTONS, looks=LOOKS, noise="camera", dark=dark,
        sigma=sigma, scale="each", hidden=(8,), batch=count, **optics,
    )  # fmt: skip
    one.check(data)
    group, gain = JobGroup.of(scenes, [one]), PHOTONS / scenes.summed_reflectance
    training = build_training(group)
    draws = Draws([one.seed], group.noise, scenes.labels, count)
    draws.shuffle()
    draws.gather(0)
    with torch.no_grad():
        training.prepare()
        last = training.inputs(draws)[-count:, 0].double()
        scanner = Scanner(training.masks, "none", detection=training.detection)
        rates = training.detection.totals(scanner.rates(gain * scenes.full[0])[0]).double()
    k, q = rates.shape[-1], training.dwells.count
    off, dwell = last[:, :k], 3 * last[:, k:] / q
    assert dwell.sum(dim=-1).numpy() == pytest.approx(1, abs=1e-5)
    dwell = dwell.repeat_interleave(k // q, dim=-1)
    added = added_to(dwell, optics, dark, sigma) / rates
    assert_law(off, q * dwell + added)
    with pytest.raises(AssertionError):
        assert_law(off, q * dwell + added * (0.5 if dark else 0.0))
