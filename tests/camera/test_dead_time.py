"""Dead time corrected: arrivals and their variance, against the detector that loses them."""

import numpy as np
import pytest

from counting.recording_samples import SHAPE, patterns_of
from deepfsi.base.errors import InputError
from deepfsi.base.tables import NumberTable
from deepfsi.camera.dead_time import DeadTime
from deepfsi.counting.recording import Recording
from deepfsi.counting.tables import TableSettings, count_table
from deepfsi.lab.virtual_detector import Detector
from deepfsi.lab.virtual_optics import VirtualCamera, arrival_rates
from deepfsi_paper.camera import gate_counts
from shared.virtual_runs import record

TAU = 20e-9
both = pytest.mark.parametrize("paralysable", [False, True], ids=["spad", "pmt"])


def registered(paralysable, rate, gate, draws):
    """Counts of gates (draws,) at a steady rate: without paralysis each begins a wait anew."""
    rng = np.random.default_rng(3)
    if paralysable:
        detector = Detector(dead_time_s=TAU, paralysable=True)
        return gate_counts.draw(detector, np.full(draws, rate), np.array(gate), rng)
    waits = TAU + rng.exponential(1 / rate, (draws, int(1.2 * gate / (TAU + 1 / rate)) + 50))
    return np.count_nonzero(np.cumsum(waits, axis=1) - TAU < gate, axis=1)


@both
@pytest.mark.parametrize("blind", [0.02, 0.2, 0.5])
def test_arrivals_have_the_mean_and_the_variance_that_are_said(paralysable, blind):
    """Gates of 100 µs, each a frame. To second order N is too large by y, the counts in a τ."""
    dead, gate, draws = DeadTime(seconds=TAU, paralysable=paralysable), 1e-4, 10_000
    rate = blind / TAU
    seen = registered(paralysable, rate, gate, draws)
    factors = dead.correction(seen / gate)
    found, variance = seen * factors.arrivals, seen * factors.variance
    mean, spread = rate * gate, found.var()
    curve = blind if not paralysable else 5 * blind  # y'' / 2 · variance of the counts, at y = 1/2
    assert abs(found.mean() - mean) < 5 * np.sqrt(spread / draws) + curve
    assert seen.mean() < mean / (1 + 0.9 * blind)  # what would be wrong without
    # Variances of nearly normal numbers are known to √(2/n); edges of a gate add a few τ / gate.
    assert spread == pytest.approx(variance.mean(), rel=5 * np.sqrt(2 / draws) + 20 * TAU / gate)
    if not paralysable:
        assert variance.mean() == pytest.approx(mean * (1 + blind), rel=0.01)


@both
def test_rates_go_there_and_back(paralysable):
    rates = np.linspace(0, 0.45, 50) / TAU
    dead = DeadTime(seconds=TAU, paralysable=paralysable)
    detector = Detector(dead_time_s=TAU, paralysable=paralysable)
    seen = detector.registered(rates)
    np.testing.assert_allclose(seen * dead.correction(seen).arrivals, rates, rtol=1e-12)
    most = detector.registered(np.array((0.5 if paralysable else 1.0) / TAU))
    assert dead.most_registered == pytest.approx(float(most))


FLUX, EXPOSURE, REPEATS = 1.5e7, 2.5e-3, 2


def scenes(number: int) -> np.ndarray:
    return np.random.default_rng(4).uniform(0.1, 0.6, (number, *SHAPE)).astype(np.float32)


@pytest.fixture(scope="module", params=[False, True], ids=["spad", "pmt"])
def run(request, tmp_path_factory):
    """A recording of seven scenes at some 10⁷ counts/s, and what would be counted without loss."""
    folder = tmp_path_factory.mktemp("run")
    shown = patterns_of(folder / "p", "free-dwell")
    camera = VirtualCamera(dead_time_s=TAU, paralysable=request.param, dark=1e4, jitter_s=1e-10)
    images = scenes(7)
    record(folder / "run", folder / "p", images, camera, FLUX, EXPOSURE, repeats=REPEATS, seed=0)
    rates = arrival_rates(shown, images, camera, FLUX)[..., 0]
    return folder / "run", shown, rates, DeadTime(seconds=TAU, paralysable=request.param)


def off_by(counts, shown, rates) -> np.ndarray:
    dark = rates[:, 1:2]
    wanted = (
        (rates[:, shown.manifest.mask_frames] - dark) * counts.lengths_s[0] * counts.counts.shape[1]
    )
    found = counts.signal().sum(axis=(1, 2))
    return (found - wanted) / np.sqrt(counts.variance.sum(axis=(1, 2)))


def test_a_recording_is_corrected_gate_by_gate_with_its_budget(run):
    folder, shown, rates, dead = run
    bare, counts = (Recording.read(folder).count(), Recording.read(folder).count(dead_time=dead))
    assert counts.faults == ()
    assert np.array_equal(bare.counts, counts.counts)
    assert np.array_equal(bare.arrivals, bare.counts)
    assert abs(off_by(bare, shown, rates)).max() > 10
    assert abs(off_by(counts, shown, rates)).max() < 5
    flux = rates[:, 0] - rates[:, 1]
    assert bare.flux.mean() < 0.9 * flux.mean()
    seconds = 2 * shown.manifest.picture_s[0] * len(rates)
    error = 5 * np.sqrt(2 / (flux.mean() * seconds))
    assert counts.flux.mean() == pytest.approx(flux.mean(), rel=error)
    assert counts.dark_rate.mean() == pytest.approx(1e4, abs=5 * np.sqrt(1e4 / seconds))
    again = Recording.read(folder).read_counts()
    for name in ("counts", "arrivals", "variance"):
        assert np.array_equal(getattr(again, name), getattr(counts, name))
    assert again.dead_time == dead
    assert (counts.variance > counts.arrivals).all()


def test_a_counter_near_saturation_is_named(run):
    folder, shown, rates, dead = run
    slow = dead.model_copy(update={"seconds": 200e-9})
    with pytest.raises(InputError, match=r"counts/s on input 1 in all ON, .* dim the light"):
        Recording.read(folder).count(dead_time=slow)
    values = NumberTable(np.rint(rates * shown.manifest.picture_s))
    with pytest.raises(InputError, match="all ON"):
        count_table(values, shown.manifest, TableSettings(dead_time=slow))
