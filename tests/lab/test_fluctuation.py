"""Light that fluctuates from picture to picture: its law, in events and in a file."""

import numpy as np
import pytest
from virtual_samples import patterns, record, scenes

from deepfsi.counting.recording import Recording
from deepfsi.lab.virtual_optics import VirtualCamera

PICTURES = 20_000


@pytest.mark.parametrize("relative", [0.02, 0.2])
def test_law_levels_have_the_mean_1_and_the_deviation_that_is_asked_for(relative):
    camera = VirtualCamera(fluctuation=relative)
    drawn = camera.fluctuate(np.ones((PICTURES, 1)), np.random.default_rng(1))[:, 0]
    assert (drawn > 0).all()
    assert abs(drawn.mean() - 1) <= 5 * relative / PICTURES**0.5
    # relative error of a variance: (kurtosis + 2) / n, and of this log-normal kurtosis < 16 f²
    error = relative**2 * np.sqrt((2 + 16 * relative**2) / PICTURES)
    assert abs(drawn.var() - relative**2) <= 5 * error
    assert abs(np.corrcoef(drawn[1:], drawn[:-1])[0, 1]) <= 5 / PICTURES**0.5


def test_law_counts_of_a_file_have_the_excess_of_the_light(tmp_path):
    patterns(tmp_path / "p")
    relative, x = 0.1, np.repeat(scenes(1), 300, axis=0)
    camera = VirtualCamera(fluctuation=relative)
    found = Recording.read(
        record(tmp_path, x, camera=camera, flux=2e6, exposure_s=1e-3, seed=7)
    ).count()
    # of complete scenes: all ON of a few is too dark beside their masks
    counts = found.counts[found.valid.all(axis=1)].sum(axis=1)
    lit = counts[:, counts.mean(axis=0) > 50]
    mean = lit.mean(axis=0)
    excess = (lit.var(axis=0, ddof=1) - mean) / mean**2
    # variance of a variance of n - 1 degrees of freedom, of about normal counts
    error = (relative**2 + 1 / mean) * np.sqrt(2 / (len(lit) - 1))
    assert np.all(np.abs(excess - relative**2) <= 5 * error)
    assert excess.mean() > 0.5 * relative**2
    # pictures have light of their own: rails of a mask do not share it
    correlation = np.corrcoef(lit.T)[np.triu_indices(lit.shape[1], 1)]
    assert np.abs(correlation).max() <= 5 / len(lit) ** 0.5


def test_dark_counts_do_not_fluctuate():
    camera = VirtualCamera(fluctuation=0.5, dark=100.0)
    rng = np.random.default_rng(2)
    rates = np.full((50, 2), 100.0)
    assert np.allclose(camera.fluctuate(rates, rng), 100.0)
    bright = camera.fluctuate(rates + 1000, rng)
    assert np.ptp(bright[:, 0]) > 100
    assert np.array_equal(bright[:, 0], bright[:, 1])  # one light for all detectors
