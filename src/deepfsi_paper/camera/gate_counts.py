"""Counts of the virtual camera's gates in sum, without a file."""

import numpy as np

from deepfsi.lab.virtual_detector import DETECTOR_TICK_S, Detector, Stream, divide
from deepfsi.patterns.manifest import GatePlan, Manifest

GATES_AT_ONCE = 2**18
"""Gates whose counts are drawn at once."""

LEAST_DRAWN_VARIANCE = 20.0
"""Variance of paralysable counts below which they are simulated one by one."""


def draw_counts(
    rates: np.ndarray,
    manifest: Manifest,
    gates: GatePlan,
    detector: Detector,
    rng: np.random.Generator,
) -> np.ndarray:
    """Counts (S, R, rails, m) that `count` would give of arrivals/s (S, F, 1), without a file."""
    shown = [manifest.frames[place] for place in manifest.mask_frames]
    flow = np.repeat(rates[:, None, manifest.mask_frames, 0], gates.repeats, axis=1)
    out = np.zeros((*flow.shape[:2], manifest.rails, manifest.masks), dtype=np.int64)
    rail = [int(frame.rail == "minus") for frame in shown]
    out[:, :, rail, [frame.mask for frame in shown]] = draw(detector, flow, gates.length_s, rng)
    return out


def draw(
    detector: Detector, rate: np.ndarray, length_s: np.ndarray, rng: np.random.Generator
) -> np.ndarray:
    """Draw the counts, int64, of gates in which the rate has long been steady."""
    # Without dead time counts are Poisson. With a non-paralysable one they are drawn from their
    # exact distribution: k counts fit a gate if k gamma-distributed waits and k - 1 dead times do.
    # With a paralysable one gates are simulated arrival by arrival where the counts' variance is
    # below 20; above, they are drawn with their exact first three moments (Cornish and Fisher), at
    # a distance in total variation from the exact distribution of at most 0.0011, for nτ from 0.01
    # to 2. Afterpulses, of the gate's own counts and of those before it, have the exact mean, and
    # without dead time the exact distribution. Gates that follow each other are drawn
    # independently: what little one passes on to the next (a count that blinds it, an afterpulse)
    # is in the moments of each and not in what they share
    rates, lengths = np.broadcast_arrays(rate, length_s)
    shape = rates.shape
    rates = rates.ravel()
    lengths = lengths.ravel()
    counts = np.empty(len(rates), dtype=np.int64)
    for first in range(0, len(rates), GATES_AT_ONCE):
        block = slice(first, first + GATES_AT_ONCE)
        counts[block] = _draw(detector, rates[block], lengths[block], rng)
    return counts.reshape(shape)


def _draw(
    detector: Detector, rate: np.ndarray, length: np.ndarray, rng: np.random.Generator
) -> np.ndarray:
    if detector.dead_time_s == 0:
        counts = rng.poisson(rate * length)
    elif detector.paralysable:
        counts = _draw_paralysable(detector, rate, length, rng)
    else:
        counts = _draw_non_paralysable(detector, rate, length, rng)
    delay = detector.afterpulse_s
    after = np.maximum(length - detector.dead_time_s, 0)
    # Probability that an afterpulse falls in the gate in which its count fell
    inside = (after + delay * np.expm1(-after / delay)) / length
    late = detector.registered(rate) * length * (1 - inside)
    probability = detector.afterpulse_probability
    return counts + rng.binomial(counts, probability * inside) + rng.poisson(probability * late)


def _draw_paralysable(
    detector: Detector, rate: np.ndarray, length: np.ndarray, rng: np.random.Generator
) -> np.ndarray:
    """Few counts one by one, many from their first three cumulants."""
    # Two counts are never closer than τ and otherwise independent, so k of them, in order, can be
    # anywhere in a gate T in m^k (T - (k-1)τ)^k ways: the factorial moments
    tau, registered = detector.dead_time_s, detector.registered(rate)
    first, second, third = (
        (registered * np.maximum(length - k * tau, 0)) ** (k + 1) for k in range(3)
    )
    variance = second - first**2 + first
    skew = third - 3 * second * first + 2 * first**3 + 3 * (second - first**2) + first
    many = variance >= LEAST_DRAWN_VARIANCE
    counts = np.empty(len(rate), dtype=np.int64)
    width = np.sqrt(variance[many] - 1 / 12)
    bend = skew[many] / width**3 / 6
    normal = rng.standard_normal(int(many.sum()))
    bent = (normal + bend * (normal**2 - 1)) / np.sqrt(1 + 2 * bend**2)
    counts[many] = np.maximum(np.rint(first[many] + width * bent), 0)
    if not many.all():
        counts[~many] = _simulate(detector, rate[~many], length[~many], rng)
    return counts


def _simulate(
    detector: Detector, rate: np.ndarray, length: np.ndarray, rng: np.random.Generator
) -> np.ndarray:
    """Count what a paralysable detector registers in gates, each after a lead of one dead time."""
    tau = detector.dead_time_s
    stream = Stream(Detector(dead_time_s=tau, paralysable=True), rng)
    inside = np.rint(length / DETECTOR_TICK_S).astype(np.int64)
    durations = inside + round(tau / DETECTOR_TICK_S)
    ends = np.cumsum(durations)
    counts = np.zeros(len(rate), dtype=np.int64)
    start = 0
    for pieces, rates in divide(durations, rate[:, None]):
        times = stream.events(start, pieces, rates[:, 0])
        gate = np.searchsorted(ends, times, side="right")
        counts += np.bincount(gate[times >= (ends - inside)[gate]], minlength=len(counts))
        start += int(pieces.sum())
    return counts


def _draw_non_paralysable(
    detector: Detector, rate: np.ndarray, length: np.ndarray, rng: np.random.Generator
) -> np.ndarray:
    """Invert the exact distribution, from a normal guess by single steps."""
    from scipy.special import gammainc, ndtri

    tau = detector.dead_time_s
    registered = detector.registered(rate)
    blind = rng.random(len(rate)) < registered * tau
    left = length - np.where(blind, rng.uniform(0, tau, len(rate)), 0)
    level = rng.random(len(rate))

    def reach(counts: np.ndarray, which: np.ndarray) -> np.ndarray:
        live = np.maximum(left[which] - (counts - 1) * tau, 0)
        return np.where(counts > 0, gammainc(np.maximum(counts, 1), rate[which] * live), 1.0)

    mean = registered * left
    std = np.sqrt(np.maximum(mean, 0)) / (1 + rate * tau)
    guess = mean - std * ndtri(np.maximum(level, 1e-300))
    counts = np.maximum(np.rint(guess), 0).astype(np.int64)
    which = np.arange(len(rate))
    while which.size:
        which = which[reach(counts[which] + 1, which) > level[which]]
        counts[which] += 1
    which = np.arange(len(rate))
    while which.size:
        which = which[reach(counts[which], which) <= level[which]]
        counts[which] -= 1
    return counts
