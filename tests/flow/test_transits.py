"""Transits in photon files: false alarms as derived, and starts as simulated."""

import numpy as np
import pytest

from deepfsi.counting.events import PtuWriter
from deepfsi.counting.reader import read_photons, summarise
from deepfsi_flow import transits
from shared.benchmarks import benchmark

BACKGROUND, WINDOW, DURATION = 40.0, 0.1, 20.0
"""Counts/s, seconds, seconds: a mean of four photons in a window."""


def dark(rng: np.random.Generator) -> np.ndarray:
    return np.sort(DURATION * rng.random(rng.poisson(BACKGROUND * DURATION)))


def rises(times: np.ndarray, level: int) -> int:
    low, found = 0, 0
    for place, time in enumerate(times):
        while times[low] <= time - WINDOW:
            low += 1
        found += place - low + 1 == level
    return found


@pytest.mark.parametrize("level", [8, 10, 12])
def test_background_rises_to_a_level_as_often_as_derived(level):
    """A rise to k is an arrival that finds k − 1: also where the record begins empty."""
    rng = np.random.default_rng(level)
    found = np.array([rises(dark(rng), level) for _ in range(400)])
    wanted = transits.false_alarms(level, BACKGROUND, WINDOW, DURATION)
    error = 5 * found.std() / 20
    # of a record that begins empty the first window holds less, and the last term is left out
    assert abs(found.mean() - wanted) < error + 2 * WINDOW / DURATION * wanted + 0.03


def test_records_of_background_have_no_more_false_alarms_than_are_allowed():
    rng, allowed, records = np.random.default_rng(0), 0.2, 1000
    threshold = transits.find_threshold(BACKGROUND, WINDOW, DURATION, allowed)
    alarms = np.array(
        [len(transits.find_transits(dark(rng), WINDOW, threshold.photons)) for _ in range(records)]
    )
    share = (alarms > 0).mean()
    error = 5 * (allowed * (1 - allowed) / records) ** 0.5
    assert threshold.false_alarms <= allowed
    assert alarms.mean() <= threshold.false_alarms + 5 * alarms.std() / records**0.5
    assert share <= threshold.false_alarms + error
    # rises of one cluster are one alarm, so that there are fewer of them, but not by far
    assert alarms.mean() > threshold.false_alarms / 4


@pytest.mark.parametrize("background", [0.0, 0.5, 40.0, 3e4])
@pytest.mark.parametrize("allowed", [1e-6, 0.01, 0.5])
def test_a_threshold_is_the_least_that_keeps_what_is_allowed(background, allowed):
    found = transits.find_threshold(background, WINDOW, DURATION, allowed)
    assert found.false_alarms <= allowed
    assert found.photons >= 2
    below = found.photons - 1
    if below > background * WINDOW + 1 and below >= 2:
        assert transits.false_alarms(below, background, WINDOW, DURATION) > allowed


@pytest.fixture
def recorded(tmp_path):
    """Photon file of 40 transits of one trace, and their starts."""
    rng = np.random.default_rng(2)
    trace = np.repeat([2.0, 9, 4, 12, 1, 8], 8)
    starts = 0.3 + 0.35 * np.arange(40) + 0.1 * rng.random(40)
    path = tmp_path / "photons.ptu"
    traces = np.tile(trace / 8, (40, 1))
    step_s = WINDOW / 48
    benchmark("passing").write_transits(
        path, traces, starts, step_s=step_s, background=BACKGROUND, seconds=15.0, rng=rng
    )
    return path, trace[::8], starts


def test_simulated_transits_are_found_where_they_are(recorded):
    path, trace, starts = recorded
    times, end = read_photons(path)
    assert len(times) == summarise(path).photons[1]
    assert (np.diff(times) >= 0).all()
    assert 14 < end <= 15
    background = transits.find_background(times, WINDOW, end, 0.01)
    assert background == pytest.approx(BACKGROUND, rel=5 / (BACKGROUND * 8) ** 0.5)
    level = transits.find_threshold(background, WINDOW, end, 0.01).photons
    rough = transits.find_transits(times, WINDOW, level)
    assert len(rough) == 40
    found = transits.align_transits(times, rough, WINDOW / 6, trace, background)
    assert abs(found - starts).max() < WINDOW / 6
    assert abs(found - starts).std() < WINDOW / 30
    counts = transits.count_bins(times, found, WINDOW / 6, 6)
    wanted = trace + BACKGROUND * WINDOW / 6
    assert (abs(counts.mean(axis=0) - wanted) < 5 * (wanted / 40) ** 0.5 + 0.1 * wanted).all()


def test_photons_on_each_input_are_read_between_markers(tmp_path):
    path = tmp_path / "two.ptu"
    times, codes = np.array([5, 9, 9, 40, 2**40, 2**40 + 3]), np.array([0, 1, -1, 0, 1, 0])
    with PtuWriter(path, 1e-9) as writer:
        writer.write(times, codes)
    for number in (0, 1):
        found, end = read_photons(path, number)
        assert np.rint(found * 1e9).tolist() == times[codes == number].tolist()
        assert round(end * 1e9) == 2**40 + 3
