"""From a simulated photon file of passing scenes to their classes."""

import numpy as np
import pytest

import deepfsi
from conftest import synthetic
from deepfsi.counting.reader import read_photons
from deepfsi_flow import transits
from deepfsi_flow.settings import Passing
from deepfsi_flow.transits import classify_transits
from shared.benchmarks import benchmark

BIN_S, PHOTONS, BACKGROUND = 1e-3, 1e4, 200.0


@pytest.fixture(scope="module")
def data():
    return synthetic((6, 8), scenes=240)


@pytest.fixture(scope="module")
def design(data, all_trained_once):
    """A pattern that scenes enter and leave within the bins."""
    return deepfsi.learn(
        data,
        photons=PHOTONS,
        exposure=Passing(bins=12, speed=2.0, jitter=0.7, pattern_width=16),
        training={"epochs": 30, "hidden": (48,), "mask_lr": 0.2},
    )


@pytest.fixture(scope="module")
def recorded(data, design, tmp_path_factory):
    path = tmp_path_factory.mktemp("photons") / "photons.ptu"
    starts = benchmark("passing").simulate_transits(
        design, data.x_test, path, BIN_S, photons=PHOTONS, background=BACKGROUND, seed=1
    )
    return path, starts


def test_every_scene_is_found_and_classified_as_in_an_evaluation(data, design, recorded):
    path, starts = recorded
    found = classify_transits(design, path, BIN_S)
    assert len(found.transits) == len(data.x_test)
    assert found.threshold.false_alarms <= 0.01
    assert found.background == pytest.approx(BACKGROUND, rel=0.3)
    off = np.array([each.start_s for each in found.transits]) - starts
    assert abs(off).max() < 1.5 * BIN_S
    truth = [data.classes[label] for label in data.y_test]
    right = np.mean(
        [each.predicted == one for each, one in zip(found.transits, truth, strict=True)]
    )
    [result] = deepfsi.evaluate(design, data, PHOTONS)
    assert right >= result.low - 0.05
    counts = np.array([each.counts for each in found.transits]).sum(axis=1)
    wanted = PHOTONS * data.x_test.sum(axis=1) / design.summed_reflectance
    assert (counts <= wanted + 12 * BIN_S * BACKGROUND + 5 * wanted**0.5).all()


def test_a_scene_of_the_simulation_counts_in_its_bins_what_the_design_expects(
    data, design, recorded
):
    path, starts = recorded

    times, _ = read_photons(path)
    counts = transits.count_bins(times, starts, BIN_S, 12) - BACKGROUND * BIN_S
    wanted = PHOTONS * data.x_test @ design.matrix.T / design.summed_reflectance
    error = 5 * (wanted + BACKGROUND * BIN_S) ** 0.5
    assert (abs(counts - wanted) < error + 1).all()
