"""Photon counter: counts registered from the light that reaches it, event by event.

    light -> efficiency, dark counts -> arrivals -> dead time -> counts -> afterpulses, jitter

Arrivals are a Poisson process. A counter loses arrivals in the dead time τ after each arrival
(*paralysable*, such as a PMT: pulses that overlap stay one) or after each that it registered (a
SPAD: no avalanche while it is quenched). At a steady arrival rate n they register

    m = n exp(-nτ)   paralysable        m = n / (1 + nτ)   non-paralysable

A registered count may have an afterpulse, an exponential delay after its dead time. Afterpulses
blind nothing and have no afterpulses.
"""

from collections.abc import Iterator

import numpy as np
from pydantic import Field

from deepfsi.base.models import StrictModel
from deepfsi.camera.dead_time import DeadTime

DETECTOR_TICK_S = 1e-12
"""Unit of event times, seconds."""

EVENTS_AT_ONCE = 2**19
"""Mean number of events in a chunk."""

LARGEST_JITTER = 8.0
"""Largest jitter, standard deviations: a bound lets events be sorted; larger is clipped."""


class Detector(StrictModel):
    """A photon counter; the default is ideal."""

    efficiency: float = Field(1.0, gt=0, le=1)  # Share of photons that give an arrival
    dark: float = Field(0.0, ge=0, le=1e12)  # Arrivals without light, counts/s
    dead_time_s: float = Field(0.0, ge=0, le=1e-3)  # Time for which it is blind, seconds
    paralysable: bool = False  # Whether a lost arrival makes it blind again
    # Chance of an afterpulse after each registered count
    afterpulse_probability: float = Field(0.0, ge=0, lt=1)
    # Mean delay of an afterpulse after the end of the dead time, seconds
    afterpulse_s: float = Field(1e-7, gt=0, le=1e-3)
    jitter_s: float = Field(0.0, ge=0, le=1e-6)  # Standard deviation of a time stamp, seconds

    def registered(self, rate: np.ndarray) -> np.ndarray:
        """Counts/s without afterpulses at steady arrival rates, shape of `rate`."""
        # Not validated: a dead time may be too long for a correction
        dead = DeadTime.model_construct(seconds=self.dead_time_s, paralysable=self.paralysable)
        return dead.registered(rate)


def divide(durations: np.ndarray, rates: np.ndarray) -> Iterator[tuple[np.ndarray, np.ndarray]]:
    """Cut a course of steady rates into chunks of about `EVENTS_AT_ONCE` events."""
    expected = rates.sum(axis=1) * (durations * DETECTOR_TICK_S)
    counts = np.maximum(np.ceil(expected / EVENTS_AT_ONCE), 1).astype(np.int64)
    source = np.repeat(np.arange(len(counts)), counts)
    index = np.arange(len(source)) - np.repeat(np.cumsum(counts) - counts, counts)
    short, rest = np.divmod(durations, counts)
    lengths = short[source] + (index < rest[source])
    # pieces are gathered into chunks of about `EVENTS_AT_ONCE` events
    load = np.cumsum((expected / counts)[source]) // EVENTS_AT_ONCE
    edges = np.flatnonzero(np.diff(load)) + 1
    for first, last in zip(np.r_[0, edges], np.r_[edges, len(source)], strict=True):
        yield lengths[first:last], rates[source[first:last]]


class Stream:
    """Events of a detector, chunk after chunk."""

    def __init__(self, detector: Detector, rng: np.random.Generator) -> None:
        self.detector = detector
        self.rng = rng
        self._dead = round(detector.dead_time_s / DETECTOR_TICK_S)
        self._last = -self._dead - 1  # not blind at the first arrival

    @property
    def reach(self) -> int:
        """Most ticks by which an event may lie before the chunk that gives it."""
        return int(np.ceil(LARGEST_JITTER * self.detector.jitter_s / DETECTOR_TICK_S))

    def events(self, start: int, durations: np.ndarray, rates: np.ndarray) -> np.ndarray:
        """Events (n,) of a chunk: arrivals at rates (p,), each for a duration (p,)."""
        times = self._register(start + arrivals(durations, rates, self.rng))
        detector = self.detector
        rng = self.rng
        if detector.afterpulse_probability:
            parents = times[rng.random(len(times)) < detector.afterpulse_probability]
            delay = rng.exponential(detector.afterpulse_s / DETECTOR_TICK_S, len(parents))
            times = np.concatenate([times, parents + self._dead + delay.astype(np.int64)])
        if detector.jitter_s:
            shift = np.clip(rng.standard_normal(len(times)), -LARGEST_JITTER, LARGEST_JITTER)
            times = times + np.rint(shift * (detector.jitter_s / DETECTOR_TICK_S)).astype(np.int64)
        return times

    def _register(self, times: np.ndarray) -> np.ndarray:
        if self._dead == 0 or not len(times):
            return times
        if self.detector.paralysable:
            kept = times[np.diff(times, prepend=self._last) >= self._dead]
            self._last = int(times[-1])
        else:
            kept = _thin(times[np.searchsorted(times, self._last + self._dead) :], self._dead)
            self._last = int(kept[-1]) if len(kept) else self._last
        return kept


def arrivals(durations: np.ndarray, rates: np.ndarray, rng: np.random.Generator) -> np.ndarray:
    """Poisson arrivals (n,) at rates (p,), each steady for its duration (p,)."""
    ends = np.cumsum(durations, dtype=np.float64)
    expected = np.cumsum(rates * (durations * DETECTOR_TICK_S))
    count = rng.poisson(expected[-1])
    # waits over their sum are order statistics of uniform times: sorted without a sort
    waits = np.cumsum(rng.standard_exponential(count + 1))
    reached = waits[:-1] * (expected[-1] / waits[-1])
    times = np.interp(reached, np.r_[0, expected], np.r_[0, ends]).astype(np.int64)
    return np.minimum(times, int(ends[-1]) - 1)


def _thin(times: np.ndarray, dead: int) -> np.ndarray:
    """Arrivals that a non-paralysable counter registers if it is not blind at the first one."""
    # An arrival at least `dead` after the one before it is always kept and starts a cluster; all
    # clusters are followed at once, from one kept arrival to the next
    heads = np.flatnonzero(np.diff(times, prepend=times[:1] - dead) >= dead)
    ends = np.r_[heads[1:], len(times)]
    keep = np.zeros(len(times), dtype=bool)
    keep[heads] = True
    crowded = ends - heads > 1
    at = heads[crowded]
    ends = ends[crowded]
    while at.size:
        at = np.searchsorted(times, times[at] + dead)
        inside = at < ends
        at = at[inside]
        ends = ends[inside]
        keep[at] = True
    return times[keep]
