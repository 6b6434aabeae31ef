"""The photon counter obeys closed forms, event by event."""

import numpy as np
import pytest

from deepfsi.lab import virtual_detector as module
from deepfsi.lab.virtual_detector import DETECTOR_TICK_S, Detector, Stream, divide

TAU = 5e-8
DEAD = round(TAU / DETECTOR_TICK_S)
PARALYSABLE = Detector(dead_time_s=TAU, paralysable=True)
NON_PARALYSABLE = Detector(dead_time_s=TAU)


def rng(seed: int = 0) -> np.random.Generator:
    return np.random.default_rng(seed)


def record(detector: Detector, durations: np.ndarray, rates: np.ndarray) -> np.ndarray:
    """All events of a course of rates, sorted."""
    stream, start, events = Stream(detector, rng()), 0, []
    for pieces, flow in divide(durations, rates[:, None]):
        events.append(stream.events(start, pieces, flow[:, 0]))
        start += int(pieces.sum())
    return np.sort(np.concatenate(events))


@pytest.mark.parametrize("load", [0.02, 0.2, 1.0, 3.0])
@pytest.mark.parametrize("detector", [PARALYSABLE, NON_PARALYSABLE], ids=["pmt", "spad"])
def test_dead_time_follows_its_closed_form(detector, load):
    rate, seconds = load / TAU, 2e6 * TAU / load
    registered = rate * np.exp(-load) if detector.paralysable else rate / (1 + load)
    expected = registered * seconds
    events = record(detector, np.array([round(seconds / DETECTOR_TICK_S)]), np.array([rate]))
    assert abs(len(events) - expected) <= 5 * np.sqrt(expected)  # dead time only calms counts
    assert detector.registered(rate) * seconds == pytest.approx(expected)
    assert np.diff(events).min() >= DEAD


def test_afterpulses_are_as_many_as_they_should_be_and_come_in_time():
    detector = Detector(dead_time_s=TAU, afterpulse_probability=0.3, afterpulse_s=2e-7)
    rate, seconds = 10.0, 1e4  # so rare that each count's afterpulse can be told
    events = record(detector, np.array([round(seconds / DETECTOR_TICK_S)]), np.array([rate]))
    gaps = np.diff(events) * DETECTOR_TICK_S
    after = gaps[gaps < 1e-5]
    expected = rate * seconds * 0.3
    assert abs(len(after) - expected) <= 5 * np.sqrt(expected) + 20
    assert after.min() >= TAU
    assert np.median(after) - TAU == pytest.approx(2e-7 * np.log(2), rel=0.05)


def test_jitter_moves_time_stamps_by_its_deviation():
    course = np.array([round(1e-2 / DETECTOR_TICK_S)]), np.array([1e7])
    sharp = Stream(Detector(), rng()).events(0, *course)
    moved = Stream(Detector(jitter_s=2e-10), rng()).events(0, *course) - sharp
    assert abs(moved.mean()) <= 5 * 200 / len(moved) ** 0.5
    assert moved.std() == pytest.approx(200, rel=5 / (2 * len(moved)) ** 0.5)


def test_arrivals_are_poisson_and_even_in_each_piece():
    durations, flow = np.array([3000, 1000, 2000]) * 1000, np.array([1e9, 0.0, 4e9])
    edges = np.cumsum(np.r_[0, durations])
    runs = [module.arrivals(durations, flow, rng(seed)) for seed in range(300)]
    counts = np.array([np.histogram(run, edges)[0] for run in runs])
    mean = flow * durations * DETECTOR_TICK_S
    assert (counts[:, 1] == 0).all()
    assert np.all(abs(counts.mean(axis=0) - mean) <= 5 * np.sqrt(mean / len(runs)))
    spread = mean * np.sqrt(2 / len(runs)) + np.sqrt(mean / len(runs))
    assert np.all(abs(counts.var(axis=0, ddof=1) - mean) <= 5 * spread)
    every = np.concatenate(runs)
    late = every[every >= edges[2]] - edges[2]
    assert abs(late.mean() / durations[2] - 0.5) <= 5 / np.sqrt(12 * len(late))
    assert all((np.diff(run) >= 0).all() for run in runs)


@pytest.mark.parametrize("detector", [PARALYSABLE, NON_PARALYSABLE], ids=["pmt", "spad"])
def test_dead_time_is_carried_from_chunk_to_chunk(monkeypatch, detector):
    monkeypatch.setattr(module, "EVENTS_AT_ONCE", 3)
    rate, pieces = 1 / TAU, 4000
    durations = np.full(pieces, 4 * DEAD)
    events = record(detector, durations, np.full(pieces, rate))
    expected = detector.registered(rate) * pieces * 4 * TAU
    assert np.diff(events).min() >= DEAD
    assert abs(len(events) - expected) <= 5 * np.sqrt(expected)
