"""Counts of gates in sum are those of the virtual camera event by event, and of closed forms."""

from decimal import Decimal, localcontext
from math import comb, factorial

import numpy as np
import pytest
from scipy.special import gammainc
from scipy.stats import chi2

from deepfsi.lab.virtual_detector import DETECTOR_TICK_S, Detector, Stream, divide
from deepfsi_paper.camera import gate_counts

TAU = 5e-8
DEAD = round(TAU / DETECTOR_TICK_S)
DETECTORS = {
    "ideal": {},
    "paralysable": {"dead_time_s": TAU, "paralysable": True},
    "non-paralysable": {"dead_time_s": TAU},
    "afterpulses": {"afterpulse_probability": 0.2},
    "both": {"dead_time_s": TAU, "paralysable": True, "afterpulse_probability": 0.1},
    "all": {"dead_time_s": TAU, "afterpulse_probability": 0.1, "jitter_s": 1e-10},
}


def record(detector: Detector, durations: np.ndarray, rates: np.ndarray, seed=0) -> np.ndarray:
    """All events of a course of rates, sorted."""
    stream, start, events = Stream(detector, np.random.default_rng(seed)), 0, []
    for pieces, flow in divide(durations, rates[:, None]):
        events.append(stream.events(start, pieces, flow[:, 0]))
        start += int(pieces.sum())
    return np.sort(np.concatenate(events))


def steady(detector: Detector, rate: float, gates: int, length_s: float, seed=0) -> np.ndarray:
    """Counts of equal gates, with pauses as long between them, in which the light stays on."""
    gate = round(length_s / DETECTOR_TICK_S)
    pause = gate + round(20 * detector.afterpulse_s / DETECTOR_TICK_S) + 2 * DEAD
    durations = np.full(gates + 1, gate + pause)
    events = record(detector, durations, np.full(gates + 1, rate), seed)
    place, within = np.divmod(events, gate + pause)
    kept = (within >= pause) & (place > 0) & (place <= gates)
    return np.bincount(place[kept] - 1, minlength=gates)


def assert_alike(one: np.ndarray, other: np.ndarray) -> None:
    """Mean and variance of two samples agree to five sigma."""
    for moment in (lambda a: a, lambda a: (a - a.mean()) ** 2):
        first, second = moment(one.astype(float)), moment(other.astype(float))
        sigma = np.sqrt(first.var() / len(one) + second.var() / len(other))
        assert abs(first.mean() - second.mean()) <= 5 * sigma


def assert_drawn_from(counts: np.ndarray, chances: np.ndarray) -> None:
    """Chi-squared of the frequencies, at the level of five sigma."""
    expected = chances * len(counts)
    seen = np.bincount(counts, minlength=len(chances))
    assert len(seen) == len(chances)
    often = expected > 10
    rest = len(counts) - seen[often].sum(), len(counts) - expected[often].sum()
    squared = ((seen - expected)[often] ** 2 / expected[often]).sum()
    squared += (rest[0] - rest[1]) ** 2 / max(rest[1], 1)
    assert chi2.sf(squared, often.sum()) > 6e-7


def paralysable_chances(load: float, length: float) -> np.ndarray:
    """Exact distribution of the counts in a gate; load nτ, length T/τ."""
    with localcontext() as context:
        context.prec = 300
        rate, whole = Decimal(load) * Decimal(-load).exp(), Decimal(length)
        moments = [Decimal(1)]
        while (room := whole - len(moments) + 1) > 0 and len(moments) < 400:
            moments.append((rate * room) ** len(moments) / factorial(len(moments)))
        above = [range(j, len(moments)) for j in range(len(moments))]
        sums = [sum((-1) ** (k - ks[0]) * comb(k, ks[0]) * moments[k] for k in ks) for ks in above]
        return np.array(sums, float)


def non_paralysable_chances(load: float, length: float) -> np.ndarray:
    """The same without paralysis, averaged over how long the counter is still blind."""
    most = int(length) + 2
    blind = load / (1 + load)
    waits = np.append((np.arange(2000) + 0.5) / 2000, 0.0)
    weights = np.append(np.full(2000, blind / 2000), 1 - blind)
    reach = np.ones(most + 2)
    for k in range(1, most + 2):
        live = np.maximum(length - waits - (k - 1), 0)
        reach[k] = weights @ gammainc(k, load * live)
    return -np.diff(reach)


@pytest.mark.parametrize("length", [0.5, 4.0])
@pytest.mark.parametrize(
    ("load", "paralysable"),
    [*((x, True) for x in (0.05, 0.5, 2)), *((x, False) for x in (0.05, 0.5, 5))],
)
def test_counts_have_their_exact_distribution(load, length, paralysable):
    detector, lengths = Detector(dead_time_s=TAU, paralysable=paralysable), np.full(200_000, length)
    counts = gate_counts.draw(detector, load / TAU, lengths * TAU, np.random.default_rng(0))
    law = paralysable_chances if paralysable else non_paralysable_chances
    assert_drawn_from(counts, law(load, length))


@pytest.mark.parametrize("kind", DETECTORS)
@pytest.mark.parametrize(("rate", "length_s"), [(1e7, 4e-8), (1e7, 2e-6)])
def test_counts_in_sum_are_as_event_by_event(kind, rate, length_s):
    detector = Detector(**DETECTORS[kind])
    one_by_one = steady(detector, rate, 20_000, length_s)
    assert_alike(
        gate_counts.draw(detector, rate, np.full(100_000, length_s), np.random.default_rng(1)),
        one_by_one,
    )
    mean = detector.registered(rate) * length_s * (1 + detector.afterpulse_probability)
    assert abs(one_by_one.mean() - mean) <= 5 * one_by_one.std() / len(one_by_one) ** 0.5
