"""The photon counter obeys closed forms, and draws in sum what it gives event by event."""

from decimal import Decimal, localcontext
from math import comb, factorial

import numpy as np
import pytest
from scipy.special import gammainc
from scipy.stats import chi2

from deepfsi.hardware.virtual import detector as module
from deepfsi.hardware.virtual.detector import TICK_S, Detector, Stream, arrivals, divide, draw, thin

TAU = 5e-8
DEAD = round(TAU / TICK_S)
PARALYSABLE = Detector(dead_time_s=TAU, paralysable=True)
NON_PARALYSABLE = Detector(dead_time_s=TAU)
DETECTORS = {
    "ideal": Detector(),
    "paralysable": PARALYSABLE,
    "non-paralysable": NON_PARALYSABLE,
    "afterpulses": Detector(afterpulse_probability=0.2),
    "afterpulses after paralysis": Detector(
        dead_time_s=TAU, paralysable=True, afterpulse_probability=0.1
    ),
    "all": Detector(dead_time_s=TAU, afterpulse_probability=0.1, jitter_s=1e-10),
}
every_detector = pytest.mark.parametrize("detector", DETECTORS.values(), ids=DETECTORS)


def rng(seed: int = 0) -> np.random.Generator:
    return np.random.default_rng(seed)


def record(detector: Detector, durations: np.ndarray, rates: np.ndarray, seed=0) -> np.ndarray:
    """All events of a course of rates, sorted."""
    stream, start, events = Stream(detector, rng(seed)), 0, []
    for pieces, flow in divide(durations, rates[:, None]):
        events.append(stream.events(start, pieces, flow[:, 0]))
        start += int(pieces.sum())
    return np.sort(np.concatenate(events))


def steady(detector: Detector, rate: float, gates: int, length_s: float, seed=0) -> np.ndarray:
    """Counts of equal gates, with pauses as long between them, in which the light stays on."""
    gate = round(length_s / TICK_S)
    pause = gate + round(20 * detector.afterpulse_s / TICK_S) + 2 * DEAD
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
        return np.array(
            [
                float(
                    sum((-1) ** (k - j) * comb(k, j) * moments[k] for k in range(j, len(moments)))
                )
                for j in range(len(moments))
            ]
        )


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


@pytest.mark.parametrize("load", [0.02, 0.2, 1.0, 3.0])
@pytest.mark.parametrize("detector", [PARALYSABLE, NON_PARALYSABLE], ids=["pmt", "spad"])
def test_dead_time_follows_its_closed_form(detector, load):
    rate, seconds = load / TAU, 2e6 * TAU / load
    registered = rate * np.exp(-load) if detector.paralysable else rate / (1 + load)
    expected = registered * seconds
    events = record(detector, np.array([round(seconds / TICK_S)]), np.array([rate]))
    assert abs(len(events) - expected) <= 5 * np.sqrt(expected)  # dead time only calms counts
    assert detector.registered(rate) * seconds == pytest.approx(expected)
    assert np.diff(events).min() >= DEAD


@pytest.mark.parametrize("load", [0.05, 0.5, 2.0])
@pytest.mark.parametrize("length", [0.5, 1.5, 4.0, 20.0])
def test_few_paralysable_counts_have_their_exact_distribution(load, length):
    counts = draw(PARALYSABLE, load / TAU, np.full(200_000, length * TAU), rng())
    chances = paralysable_chances(load, length)
    assert_drawn_from(counts, chances)


@pytest.mark.parametrize("load", [0.1, 0.3, 1.0])
def test_many_paralysable_counts_are_close_to_their_exact_distribution(load):
    """The smallest variance at which they are drawn from cumulants, the worst."""
    rate = load * np.exp(-load)
    length = (module.LEAST_DRAWN_VARIANCE * 1.01 - rate**2) / (rate - 2 * rate**2)
    chances = paralysable_chances(load, length)
    counts = draw(PARALYSABLE, load / TAU, np.full(4_000_000, length * TAU), rng())
    seen = np.bincount(counts, minlength=len(chances)) / len(counts)
    sampling = np.sqrt(chances.clip(0) / len(counts)).sum() / np.sqrt(2 * np.pi)
    assert abs(seen - chances).sum() / 2 <= 0.0011 + 1.3 * sampling
    mean = rate * length
    variance = mean - rate**2 * (2 * length - 1)
    assert abs(counts.mean() - mean) <= 5 * np.sqrt(variance / len(counts))
    assert abs(counts.var() - variance) <= 5 * variance * np.sqrt(2 / len(counts))


@pytest.mark.parametrize("load", [0.05, 0.5, 5.0])
@pytest.mark.parametrize("length", [0.5, 1.5, 4.0, 20.0])
def test_non_paralysable_counts_have_their_exact_distribution(load, length):
    counts = draw(NON_PARALYSABLE, load / TAU, np.full(200_000, length * TAU), rng())
    assert_drawn_from(counts, non_paralysable_chances(load, length))


@every_detector
@pytest.mark.parametrize(("rate", "length_s"), [(1e7, 4e-8), (1e7, 2e-6), (4e6, 3e-5)])
def test_counts_in_sum_are_as_event_by_event(detector, rate, length_s):
    one_by_one = steady(detector, rate, 20_000, length_s)
    assert_alike(draw(detector, rate, np.full(100_000, length_s), rng(1)), one_by_one)
    mean = detector.registered(rate) * length_s * (1 + detector.afterpulse_probability)
    assert abs(one_by_one.mean() - mean) <= 5 * one_by_one.std() / len(one_by_one) ** 0.5


@pytest.mark.parametrize("detector", [PARALYSABLE, NON_PARALYSABLE], ids=["pmt", "spad"])
def test_gates_know_nothing_of_their_neighbours(detector):
    """Dim gates between bright ones count what they should, and independently."""
    rate = np.tile([0.1 / TAU, 3 / TAU], 200_000)
    counts = draw(detector, rate, np.full(len(rate), 1.5 * TAU), rng())
    mean = detector.registered(rate[:2]) * 1.5 * TAU
    pairs = counts.reshape(-1, 2)
    assert np.all(abs(pairs.mean(axis=0) - mean) <= 5 * pairs.std(axis=0) / len(pairs) ** 0.5)
    assert abs(np.corrcoef(counts[:-1:2], counts[1::2])[0, 1]) <= 5 / len(pairs) ** 0.5


def test_afterpulses_are_as_many_as_they_should_be_and_come_in_time():
    detector = Detector(dead_time_s=TAU, afterpulse_probability=0.3, afterpulse_s=2e-7)
    rate, seconds = 10.0, 1e4  # so rare that each count's afterpulse can be told
    events = record(detector, np.array([round(seconds / TICK_S)]), np.array([rate]))
    gaps = np.diff(events) * TICK_S
    after = gaps[gaps < 1e-5]
    expected = rate * seconds * 0.3
    assert abs(len(after) - expected) <= 5 * np.sqrt(expected) + 20
    assert after.min() >= TAU
    assert np.median(after) - TAU == pytest.approx(2e-7 * np.log(2), rel=0.05)


def test_jitter_moves_time_stamps_by_its_deviation():
    course = np.array([round(1e-2 / TICK_S)]), np.array([1e7])
    sharp = Stream(Detector(), rng()).events(0, *course)
    moved = Stream(Detector(jitter_s=2e-10), rng()).events(0, *course) - sharp
    assert abs(moved.mean()) <= 5 * 200 / len(moved) ** 0.5
    assert moved.std() == pytest.approx(200, rel=5 / (2 * len(moved)) ** 0.5)


def test_arrivals_are_poisson_and_even_in_each_piece():
    durations, flow = np.array([3000, 1000, 2000]) * 1000, np.array([1e9, 0.0, 4e9])
    edges = np.cumsum(np.r_[0, durations])
    runs = [arrivals(durations, flow, rng(seed)) for seed in range(300)]
    counts = np.array([np.histogram(run, edges)[0] for run in runs])
    mean = flow * durations * TICK_S
    assert (counts[:, 1] == 0).all()
    assert np.all(abs(counts.mean(axis=0) - mean) <= 5 * np.sqrt(mean / len(runs)))
    spread = mean * np.sqrt(2 / len(runs)) + np.sqrt(mean / len(runs))
    assert np.all(abs(counts.var(axis=0, ddof=1) - mean) <= 5 * spread)
    every = np.concatenate(runs)
    late = every[every >= edges[2]] - edges[2]
    assert abs(late.mean() / durations[2] - 0.5) <= 5 / np.sqrt(12 * len(late))
    assert all((np.diff(run) >= 0).all() for run in runs)


def test_no_light_gives_no_counts():
    assert len(record(Detector(), np.array([10**9, 10**9]), np.zeros(2))) == 0
    for each in DETECTORS.values():
        assert (draw(each, np.zeros(5), np.full(5, 1e-3), rng()) == 0).all()


@pytest.mark.parametrize("seed", range(20))
def test_thinning_keeps_what_a_loop_keeps(seed):
    dice = rng(seed)
    times = np.cumsum(dice.exponential(10 ** dice.uniform(0, 3), 3000)).astype(np.int64)
    kept, last = [], -(10**9)
    for time in times.tolist():
        if time >= last + 100:
            kept.append(time)
            last = time
    assert thin(times, 100).tolist() == kept


@pytest.mark.parametrize("detector", [PARALYSABLE, NON_PARALYSABLE], ids=["pmt", "spad"])
def test_dead_time_is_carried_from_chunk_to_chunk(monkeypatch, detector):
    monkeypatch.setattr(module, "EVENTS_AT_ONCE", 3)
    rate, pieces = 1 / TAU, 4000
    durations = np.full(pieces, 4 * DEAD)
    events = record(detector, durations, np.full(pieces, rate))
    expected = detector.registered(rate) * pieces * 4 * TAU
    assert np.diff(events).min() >= DEAD
    assert abs(len(events) - expected) <= 5 * np.sqrt(expected)


def test_chunks_are_the_course_in_pieces(monkeypatch):
    monkeypatch.setattr(module, "EVENTS_AT_ONCE", 1000)
    durations = np.array([10**9, 3 * 10**12, 1, 7 * 10**10])
    flow = np.array([[1e4, 5.0], [2e4, 0.0], [1e3, 1e3], [0.0, 3e5]])
    chunks = list(divide(durations, flow))
    assert sum(int(pieces.sum()) for pieces, _ in chunks) == durations.sum()
    light = sum((rates * pieces[:, None]).sum(axis=0) for pieces, rates in chunks)
    assert light == pytest.approx((flow * durations[:, None]).sum(axis=0))
    loads = [float((rates.sum(axis=1) * pieces).sum() * TICK_S) for pieces, rates in chunks]
    assert max(loads) <= 2 * 1000
    assert len(chunks) > 50
