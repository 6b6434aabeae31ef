"""Light over time: arrivals in frames, their flux and background, and exact tests.

A row of passes is cut at both ends of a segment that is brighter or darker than the rest, beyond
chance and beyond the allowed ratio. Each segment is then cut in the same way.

The flux of a scene is the mean over all passes between two changes of the lamp. Its own pass alone
would not do: scenes differ in brightness, and a dim one is to stay dim. Training scenes tell how
bright a scene may be (`Brightness`). All-ON rates that change by more tell of a changed light.

Two windows of one light share their photons like a coin's throws: given the sum, the photons of one
are binomial, with its share of the time. So no rate need be known, and tests of few photons are as
sound as tests of many.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from itertools import pairwise, product
from typing import ClassVar, Self

import numpy as np

from deepfsi.patterns.manifest import Brightness, Frame

FALSE_ALARMS = 1e-3
"""Largest chance of any fault of the light in a sound acquisition."""

EXCESS = 1.1
"""Largest variance of sound counts over Poisson's, as afterpulses of up to 5 % make it."""

CERTAIN_SIGMAS = 6.0
"""Standard errors beyond which something is certain."""

HARMLESS = 0.05
"""Largest change of a light without a fault, as a share of it."""

HARMLESS_DARK = 0.02
"""Largest change of the background without a fault, as a share of the light with all mirrors ON."""

SPREAD_SIGMAS = 5.0
"""Standard deviations by which scenes of one class may differ from their mean."""

AllowedRatio = Callable[[np.ndarray, np.ndarray], np.ndarray]
"""Largest ratio of the rates of two segments, from the numbers of their passes."""


@dataclass(frozen=True)
class Arrivals:
    """Photons that arrived in frames, as estimated from counts."""

    ARRAYS: ClassVar = ("photons", "variance", "seconds")

    frames: tuple[Frame, ...]  # frames in the order in which they were shown
    photons: np.ndarray  # ([P,] F, inputs)
    variance: np.ndarray  # of their noise
    seconds: np.ndarray  # ([P,] F): how long they were counted; 0 if they are not yet

    @classmethod
    def join(cls, lists: Sequence[Self]) -> Self:
        """Frames of lists that were shown one after another."""
        joined = (np.concatenate([getattr(one, name) for one in lists]) for name in cls.ARRAYS)
        return cls(tuple(frame for one in lists for frame in one.frames), *joined)

    @classmethod
    def stack(cls, passes: Sequence[Self]) -> Self:
        """Passes over the same frames."""
        stacked = (np.stack([getattr(one, name) for one in passes]) for name in cls.ARRAYS)
        return cls(passes[-1].frames, *stacked)


@dataclass(frozen=True)
class LightCurve:
    """Light over time on an arm's detectors together, or on one of them."""

    photons: np.ndarray  # (P, F)
    seconds: np.ndarray  # (P, F)
    scenes: np.ndarray  # (P,): scene of each pass
    bright: tuple[int, int]
    dark: tuple[int, int]
    frames: tuple[Frame, ...]
    name: str  # what a fault calls the inputs
    sees_part: bool = False  # True of a detector that sees a part of the device, which may be dark

    def together(self, frames: Sequence[int]) -> tuple[np.ndarray, np.ndarray]:
        """Photons (P,) and seconds (P,) of the frames, summed."""
        which = list(frames)
        return self.photons[:, which].sum(axis=1), self.seconds[:, which].sum(axis=1)


def light_curves(
    arrivals: Arrivals, scenes: np.ndarray, arm_inputs: Sequence[tuple[int, ...]]
) -> list[LightCurve]:
    """Curves of each arm's detectors together, then of each detector if an arm has more than one.

    `scenes` (P,) has the scene of each pass, `arm_inputs` the inputs of each arm's detectors.
    """
    last = len(arrivals.frames) - 1
    on = (0, last - 1)
    off = (1, last)
    arms = []
    detectors = []
    for arm, inputs in enumerate(arm_inputs):
        first = arm * len(inputs)
        photons, seconds = _as_poisson(arrivals, slice(first, first + len(inputs)))
        curve = LightCurve(
            photons,
            seconds,
            scenes,
            bright=on if arm == 0 else off,
            dark=off if arm == 0 else on,
            frames=arrivals.frames,
            name=f" on input {name_inputs(inputs)}" if len(arm_inputs) > 1 else "",
        )
        arms.append(curve)
        for column, number in enumerate(inputs if len(inputs) > 1 else (), first):
            photons, seconds = _as_poisson(arrivals, slice(column, column + 1))
            name = f" on input {number + 1}"
            detectors.append(
                replace(curve, photons=photons, seconds=seconds, name=name, sees_part=True)
            )
    return arms + detectors


def _as_poisson(arrivals: Arrivals, columns: slice) -> tuple[np.ndarray, np.ndarray]:
    """Photons and seconds (P, F) of inputs together, scaled so that noise is Poisson's."""
    # Corrections of dead time and gains leave the rate right and its noise other than Poisson's:
    # fewer photons in less time have that rate with that relative error
    photons = arrivals.photons[..., columns].sum(axis=-1)
    noise = arrivals.variance[..., columns].sum(axis=-1)
    share = np.divide(photons, noise, out=np.ones_like(noise), where=noise > 0)
    return photons * share, arrivals.seconds * share


def rates_of(photons: np.ndarray, seconds: np.ndarray) -> np.ndarray:
    """Counts/s; 0 of what was not counted."""
    return np.divide(photons, seconds, out=np.zeros(seconds.shape), where=seconds > 0)


def name_inputs(inputs: Sequence[int]) -> str:
    """Inputs as people number them: `1`, `1 and 2`, or `1 to 4`."""
    if len(inputs) > 2 and tuple(inputs) == tuple(range(inputs[0], inputs[0] + len(inputs))):
        return f"{inputs[0] + 1} to {inputs[-1] + 1}"
    return " and ".join(str(number + 1) for number in inputs)


def excess_p_value(
    photons: np.ndarray,
    seconds: np.ndarray,
    base: np.ndarray,
    base_s: np.ndarray,
    ratio: np.ndarray | float = 1.0,
) -> np.ndarray:
    """Chance that a window holds its photons or more, given its sum with a base window."""
    from scipy.special import betainc

    photons, seconds, base, base_s, ratio = np.broadcast_arrays(
        *(np.asarray(array, np.float64) for array in (photons, seconds, base, base_s, ratio))
    )
    out = np.ones(photons.shape)
    which = (photons > 0) & (seconds > 0) & (base_s > 0)
    open_s = (ratio * seconds)[which]
    share = open_s / (open_s + base_s[which])
    # given the sum, at least `photons` of a binomial; `EXCESS` widens it for afterpulses
    out[which] = betainc(photons[which] / EXCESS, base[which] / EXCESS + 1, share)
    return out


def change_p_value(
    photons: np.ndarray,
    seconds: np.ndarray,
    base: np.ndarray,
    base_s: np.ndarray,
    ratio: np.ndarray | float,
) -> np.ndarray:
    """Chance that one of two windows holds more photons by as much as it does.

    Either window may be brighter by `ratio`.
    """
    above = excess_p_value(photons, seconds, base, base_s, ratio=ratio)
    below = excess_p_value(base, base_s, photons, seconds, ratio=ratio)
    # the smaller of two p-values, doubled (Bonferroni)
    return 2 * np.minimum(above, below)


def _find_segments(passes: np.ndarray, allowed: AllowedRatio, level: float) -> list[slice]:
    """Segments between the change points of passes: counts, variances, seconds (3, P)."""
    segments = []
    todo = [(0, passes.shape[1])]
    sums = np.pad(np.cumsum(passes, axis=1), ((0, 0), (1, 0)))  # of the first 0 … P passes
    while todo:
        start, stop = todo.pop()
        cut = _find_cut(sums[:, start : stop + 1], allowed, level)
        if cut is None:
            segments.append(slice(start, stop))
            continue
        edges = [0, *cut, stop - start]
        # the segment and both rests are searched again: several changes are found one by one
        todo += [(start + a, start + b) for a, b in pairwise(edges) if b > a]
    return sorted(segments, key=lambda segment: int(segment.start))


def _find_cut(sums: np.ndarray, allowed: AllowedRatio, level: float) -> tuple[int, int] | None:
    """Start and stop of the segment that stands out most from the rest; None if none does."""
    passes = sums.shape[1] - 1
    if passes < 2:  # a single pass has no rest to differ from
        return None
    edges = np.arange(1, passes)
    starts = [np.zeros_like(edges)]
    stops = [edges]
    length = 1
    # lengths double, so that candidates grow as P log P; `_refine` then moves both ends
    while length <= passes // 2:
        first = np.arange(1, passes - length)
        starts.append(first)
        stops.append(first + length)
        length *= 2
    start = np.concatenate(starts)
    stop = np.concatenate(stops)
    clearness, p_values = _compare(sums, start, stop, allowed)
    best = int(np.argmax(clearness))
    # all candidate segments share the level (Bonferroni)
    if p_values[best] * len(start) > level:
        return None
    return _refine(sums, (int(start[best]), int(stop[best])), allowed)


def _refine(sums: np.ndarray, cut: tuple[int, int], allowed: AllowedRatio) -> tuple[int, int]:
    """Move both ends of a segment, pass by pass, while it stands out more."""
    passes = sums.shape[1] - 1
    while True:
        tries = [(cut[0] + i, cut[1] + j) for i, j in product((0, -1, 1), repeat=2)]
        tries = [(a, b) for a, b in tries if 0 <= a < b <= passes and b - a < passes]
        start, stop = np.array(tries).T
        best = tries[int(np.argmax(_compare(sums, start, stop, allowed)[0]))]
        if best == cut:
            return cut
        cut = best


def _compare(
    sums: np.ndarray, start: np.ndarray, stop: np.ndarray, allowed: AllowedRatio
) -> tuple[np.ndarray, np.ndarray]:
    """Difference of each segment from the rest in standard errors, and its p-value."""
    passes = sums.shape[1] - 1
    inner = sums[:, stop] - sums[:, start]
    outer = sums[:, -1:] - sums[:, :1] - inner
    photons, seconds = np.stack([_as_photons(inner), _as_photons(outer)], axis=1)
    ratio = allowed(stop - start, passes - (stop - start))
    # half a photon keeps the logarithm of a dark segment finite
    some = photons + 0.5
    apart = np.abs(np.subtract(*np.log(some / seconds))) - np.log(ratio)
    clearness = apart / np.sqrt((1 / some).sum(axis=0))
    p_values = change_p_value(photons[0], seconds[0], photons[1], seconds[1], ratio=ratio)
    return clearness, p_values


def _as_photons(sums: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Photons, and the time they take, of Poisson counts with the same rate and relative error."""
    counts = np.maximum(sums[0], 0.0)
    variances = sums[1]
    seconds = sums[2]
    # Counts below their noise, or less than 0, tell as little as those that are as large as it
    size = np.maximum(counts, np.sqrt(variances))
    weight = np.divide(size, variances, out=np.ones_like(size), where=variances > 0)
    return counts * weight, seconds * weight


@dataclass(frozen=True)
class Background:
    """Counts of an input without light, pooled over the passes that agree."""

    photons: np.ndarray  # (P,): of all-OFF frames; for the second of two arms, of all-ON ones
    seconds: np.ndarray  # (P,)

    @classmethod
    def of(cls, curve: LightCurve, level: float) -> Self:
        """Background of each pass, from the dark frames of the segment that holds it."""
        photons, seconds = curve.together(curve.dark)
        light = rates_of(*curve.together(curve.bright)) - rates_of(photons, seconds)
        usual = max(0.0, float(np.median(light)))
        # a single count more keeps the ratio finite
        ratio = 1 + HARMLESS_DARK * usual * seconds.sum() / (photons.sum() + 1)
        passes = np.stack([photons, photons, seconds]).astype(np.float64)
        pooled = photons.astype(np.float64)
        pooled_s = seconds.copy()
        for segment in _find_segments(passes, lambda *_: np.array(ratio), level):
            pooled[segment] = photons[segment].sum()
            pooled_s[segment] = seconds[segment].sum()
        return cls(pooled, pooled_s)

    @property
    def rate(self) -> np.ndarray:
        """Counts/s, (P,)."""
        return rates_of(self.photons, self.seconds)


@dataclass(frozen=True)
class _Level:
    """Brightness of the scenes between two changes of the lamp."""

    first: int  # scene
    last: int
    rate: float  # counts/s


@dataclass(frozen=True)
class Flux:
    """Light of the scenes with all mirrors ON, without background."""

    rate: np.ndarray  # (P,): counts/s, the mean over the passes that agree
    levels: tuple[_Level, ...] = ()
    trend: float | None = None  # last brightness over first, of a lamp that rises or falls steadily

    @classmethod
    def of(
        cls,
        curve: LightCurve,
        background: Background,
        used: np.ndarray,
        brightness: Brightness | None,
        level: float,
    ) -> Self:
        """Flux from the passes `used` (P,), bool, of scenes that differ by a known brightness."""
        if not used.any():
            return cls(np.zeros(len(used)))
        on, on_s = curve.together(curve.bright)
        used = used & (on_s > 0)
        if not used.any():  # light was seen behind masks alone
            return cls(np.full(len(used), np.nan))
        rate = background.rate
        # a Poisson rate n / T has the variance n / T²
        noise = on + rates_of(rate, background.seconds) * on_s**2
        passes = np.stack([on - rate * on_s, noise, on_s])[:, used]
        segments = [slice(0, passes.shape[1])]
        lit = np.flatnonzero(used)
        if brightness is not None:
            segments = _find_segments(passes, _allowed_ratio(brightness), level)
            line = _fit_decay(passes, segments, brightness)
            if line is not None:
                rates = np.interp(np.arange(len(used)), lit, line)
                return cls(rates, trend=line[-1] / line[0])
        # unused passes take the level of the segment before them
        starts = [0, *(int(lit[segment.start]) for segment in segments[1:]), len(used)]
        lengths = np.diff(starts)
        scenes = curve.scenes[lit]
        levels = [
            _Level(scenes[segment.start], scenes[segment.stop - 1], _mean_rate(passes, segment))
            for segment in segments
        ]
        return cls(np.repeat([level.rate for level in levels], lengths), tuple(levels))


def _mean_rate(passes: np.ndarray, segment: slice) -> float:
    """Mean counts/s of a segment of passes (3, P)."""
    return float(passes[0, segment].sum() / passes[2, segment].sum())


def _fit_decay(
    rows: np.ndarray, segments: list[slice], brightness: Brightness
) -> np.ndarray | None:
    """Rates (P,) of a light that rises or falls steadily; None if it is steady or steps."""
    counts, variances, seconds = rows
    passes = len(counts)
    # A line through fewer passes fits their noise
    if passes < 5 or not (counts > 0).all():
        return None
    logs = np.log(counts / seconds)
    when = np.arange(passes) - (passes - 1) / 2
    line = logs.mean() + when * ((logs @ when) / (when @ when))
    change = abs(float(line[-1] - line[0]))
    noise = brightness.within**2 + float((variances / counts**2).mean())
    error = np.sqrt(noise / (when @ when)) * (passes - 1)
    # Two classes one after the other are a step, and the line through it is half as much longer
    sound = 1.5 * np.log(brightness.between * (1 + HARMLESS)) + SPREAD_SIGMAS * error
    if len(segments) == 1 and change <= sound:
        return None
    steps = np.concatenate(
        [np.full(segment.stop - segment.start, _mean_rate(rows, segment)) for segment in segments]
    )
    # each step has a level, and all but the first an edge
    free = max(passes - 2 * len(segments) + 1, 1)
    by_line = float(((logs - line) ** 2).sum()) / (passes - 2)
    by_steps = float(((logs - np.log(steps)) ** 2).sum()) / free
    return np.asarray(np.exp(line)) if by_line < by_steps else None


def _allowed_ratio(brightness: Brightness) -> AllowedRatio:
    """Largest ratio of the mean brightness of two groups of scenes."""
    low = brightness.low
    high = brightness.high
    # New scenes may fill 1.25 times the training scenes' range of brightness (in log)
    most = 1.25 * np.log(high / low) if low > 0 else np.inf

    def allowed(one: np.ndarray, other: np.ndarray) -> np.ndarray:
        noise = SPREAD_SIGMAS * brightness.within * np.sqrt(1 / one + 1 / other)
        return np.exp(np.minimum(np.log(brightness.between) + noise, most)) * (1 + HARMLESS)

    return allowed
