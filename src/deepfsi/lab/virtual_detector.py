"""Photon counter: counts registered from the light that reaches it, event by event.

    light -> efficiency, dark counts -> arrivals -> dead time -> counts -> afterpulses, jitter

Arrivals are a Poisson process. A counter loses arrivals in the dead time τ after each arrival
(*paralysable*, such as a PMT: pulses that overlap stay one) or after each that it registered (a
SPAD: no avalanche while it is quenched). At a steady arrival rate n they register

    m = n exp(-nτ)   paralysable        m = n / (1 + nτ)   non-paralysable

A registered count may have an afterpulse, an exponential delay after its dead time. Afterpulses
blind nothing and have no afterpulses.

A *gated* detector only registers the first arrival in each gate: r arrivals that are expected in G
equal gates give Binomial(G, 1 - exp(-r / G)) clicks.
"""

import math
from collections.abc import Iterator
from dataclasses import dataclass, field
from typing import Self

import numpy as np
from pydantic import Field, model_validator

from deepfsi.base.models import StrictModel
from deepfsi.camera.dead_time import DeadTime
from deepfsi.patterns.manifest import GatePlan

DETECTOR_TICK_S = 1e-12
"""Unit of event times, seconds."""

EVENTS_AT_ONCE = 2**19
"""Mean number of events in a chunk."""

LARGEST_JITTER = 8.0
"""Most standard deviations of jitter, so that events can be sorted; more are brought to it."""


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
    # Of an exposure of a frame, in each of which it fires at most once; None if it is always open
    gates: int | None = Field(None, ge=1, le=10**6)

    @model_validator(mode="after")
    def _blind_until_a_gate_ends(self) -> Self:
        if self.gates and (self.dead_time_s or self.afterpulse_probability or self.jitter_s):
            raise ValueError(
                "a gated detector is blind until its gate ends, and has no dead time, afterpulses "
                "or jitter here: leave them or gates out"
            )
        return self

    @property
    def dead_time(self) -> DeadTime:
        """Dead time of the detector, also one that is too long to be corrected."""
        return DeadTime.model_construct(seconds=self.dead_time_s, paralysable=self.paralysable)

    def registered(self, rate: np.ndarray) -> np.ndarray:
        """Counts/s without afterpulses at steady arrival rates, shape of `rate`."""
        return self.dead_time.registered(rate)


def divide(durations: np.ndarray, rates: np.ndarray) -> Iterator[tuple[np.ndarray, np.ndarray]]:
    """Cut a course of steady rates into chunks of about `EVENTS_AT_ONCE` events."""
    expected = rates.sum(axis=1) * (durations * DETECTOR_TICK_S)
    parts = np.maximum(np.ceil(expected / EVENTS_AT_ONCE), 1).astype(np.int64)
    source = np.repeat(np.arange(len(parts)), parts)
    part = np.arange(len(source)) - np.repeat(np.cumsum(parts) - parts, parts)
    short, rest = np.divmod(durations, parts)
    pieces = short[source] + (part < rest[source])
    load = np.cumsum((expected / parts)[source]) // EVENTS_AT_ONCE
    edges = np.flatnonzero(np.diff(load)) + 1
    for first, last in zip(np.r_[0, edges], np.r_[edges, len(source)], strict=True):
        yield pieces[first:last], rates[source[first:last]]


class LightLevels:
    """Light that fluctuates from picture to picture, as factors of its mean.

    Factors are log-normal with the mean 1. With a correlation time τ their logarithms are an
    Ornstein-Uhlenbeck process: correlated by exp(-t / τ) over a time t.
    """

    def __init__(self, relative: float, seconds: float, rng: np.random.Generator) -> None:
        self._sigma = math.sqrt(math.log1p(relative**2))
        self._seconds = seconds
        self._rng = rng
        self._last: tuple[float, float] | None = None  # time and value of the last picture

    def factors(self, starts_s: np.ndarray) -> np.ndarray:
        """Light of pictures that start at these times, which follow all before, over its mean."""
        normal = self._rng.standard_normal(len(starts_s))
        if self._seconds:
            for k, start in enumerate(starts_s.tolist()):
                if self._last is not None:
                    kept = math.exp(-max(start - self._last[0], 0.0) / self._seconds)
                    normal[k] = kept * self._last[1] + math.sqrt(1 - kept**2) * normal[k]
                self._last = start, float(normal[k])
        return np.asarray(np.exp(self._sigma * normal - self._sigma**2 / 2))


@dataclass
class Shutter:
    """Gates of one detector in the frames of a recording; times are ticks."""

    starts: np.ndarray  # (n,): Of all frames, rising
    gates: GatePlan  # of a pass of F frames, which n is a multiple of
    _fired: int = field(default=-1, init=False)  # the last gate in which it did

    def first(self, times: np.ndarray) -> np.ndarray:
        """First arrival of each gate, of later arrivals (a,) than before."""
        gates = self.gates
        frames = len(self.gates.click_width_s)
        frame = np.searchsorted(self.starts, times, side="right") - 1
        since = times - self.starts[frame] - self.gates.settle_s / DETECTOR_TICK_S
        # Edges of gates are whole ticks, to which they are rounded
        width = gates.click_width_s[frame % frames] / DETECTOR_TICK_S
        gate = np.floor((since + 0.5) / width).astype(np.int64)
        most = gates.clicks * gates.click_exposures
        inside = (frame >= 0) & (gate >= 0) & (gate < most[frame % frames])
        times = times[inside]
        which = (frame * most.max() + gate)[inside]
        fires = np.diff(which, prepend=self._fired) > 0
        self._fired = int(which[-1]) if len(which) else self._fired
        return times[fires]


class Stream:
    """Events of one detector, chunk after chunk."""

    def __init__(
        self, detector: Detector, rng: np.random.Generator, shutter: Shutter | None = None
    ) -> None:
        self.detector = detector
        self.rng = rng
        self._shutter = shutter
        self._dead = round(detector.dead_time_s / DETECTOR_TICK_S)
        self._last = -self._dead - 1

    @property
    def reach(self) -> int:
        """Most ticks by which an event may lie before the chunk that gives it."""
        return int(np.ceil(LARGEST_JITTER * self.detector.jitter_s / DETECTOR_TICK_S))

    def events(self, start: int, durations: np.ndarray, rates: np.ndarray) -> np.ndarray:
        """Events that follow from the arrivals of a chunk."""
        # durations, rates (p,)
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
        if self._shutter is not None:
            return self._shutter.first(times)
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
    """Poisson arrivals at rates that are steady in pieces."""
    # durations, rates (p,)
    ends = np.cumsum(durations, dtype=np.float64)
    expected = np.cumsum(rates * (durations * DETECTOR_TICK_S))
    count = rng.poisson(expected[-1])
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
    many = ends - heads > 1
    at = heads[many]
    ends = ends[many]
    while at.size:
        at = np.searchsorted(times, times[at] + dead)
        inside = at < ends
        at = at[inside]
        ends = ends[inside]
        keep[at] = True
    return times[keep]
