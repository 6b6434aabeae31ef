"""Classes of scenes that pass a pattern, from a photon file without markers.

A window of the length L of a transit slides over the record; a transit is where it holds k photons
or more. Background alone, Poisson events of rate b, fills it with N photons, μ = b L in the mean. N
rises to k when a photon comes while N = k − 1; arrivals see the distribution of N at any time. So a
record of the time D has in the mean

    b D P(N = k − 1) + P(N ≥ k)

rises to k, overlapping windows included; the last term is for a record that begins in one. This
bounds the probability of any false alarm, and k is the least that keeps it below the allowed one.
"""

import csv
import io
import math
import os
from collections.abc import Iterator
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np

from deepfsi.base.errors import InputError
from deepfsi.base.progress import SILENT, Progress
from deepfsi.base.quantities import Table, time_text
from deepfsi.camera.light import check_budget
from deepfsi.counting.reader import read_photons

if TYPE_CHECKING:  # they import torch, which those who look for no transits do without
    from deepfsi.design.design import Design
    from deepfsi_flow.exposure import PassingExposure

FINE = 8
"""Steps of a bin in which the start of a transit is sought."""


@dataclass(frozen=True)
class _Threshold:
    """Least photons in a window that make a transit, and how often background has them."""

    photons: int  # k
    false_alarms: float  # expected ones in the record


def false_alarms(
    level: int | np.ndarray, background: float, window: float, duration: float
) -> np.ndarray:
    """Expected number of windows that background alone fills to a level in a record."""
    from scipy.stats import poisson

    mean = background * window
    rises = background * duration * poisson.pmf(level - 1, mean)
    return np.asarray(rises + poisson.sf(level - 1, mean))


def find_threshold(background: float, window: float, duration: float, allowed: float) -> _Threshold:
    """Least level, above the mean, whose false alarms in a record are allowed."""
    least = max(int(background * window) + 1, 2)  # below the mean rises are rare, too
    levels = least + np.arange(100 + int(60 * math.sqrt(least)))  # none is left at the last
    alarms = false_alarms(levels, background, window, duration)
    first = int(np.argmax(alarms <= allowed))
    return _Threshold(int(levels[first]), float(alarms[first]))


def find_transits(times: np.ndarray, window: float, level: int) -> np.ndarray:
    """Starts (n,) of transits in rising times, each of its window with most photons."""
    low = np.searchsorted(times, times - window, side="right")
    bright = np.flatnonzero(np.arange(len(times)) - low + 1 >= level)
    starts: list[float] = []
    first = 0
    # photons of a transit are not counted again in the next one
    while (rise := np.searchsorted(bright, first + level - 1)) < len(bright):
        risen = int(bright[rise])
        until = np.searchsorted(times, times[risen] + window, side="right")
        near = np.arange(risen, until)
        last = int(near[np.argmax(near - np.maximum(low[near], first))])
        starts.append(times[last] - window)
        first = last + 1
    return np.array(starts, float)


def find_background(times: np.ndarray, window: float, duration: float, allowed: float) -> float:
    """Rate of the background, from the record without its transits and a window on each side."""
    # One photon is added, so that none in a short stretch is not taken for none at all
    count = len(times)
    left = duration
    # Rounds in which the background is estimated from what is left beside transits, at most
    for _ in range(50):
        level = find_threshold(count / left, window, duration, allowed).photons
        starts = find_transits(times, window, level)
        spans = _joined(starts - window, starts + 2 * window, duration)
        left = duration - float(np.diff(spans, axis=1).sum())
        if left < 10 * window:
            raise InputError(
                "less than 10 transits of this record's time is without any, too little to know "
                "the background from: give `background`"
            )
        before = count
        count = len(times) - int(np.diff(np.searchsorted(times, spans), axis=1).sum())
        if count == before:
            break
    return (count + 1) / left


def _joined(starts: np.ndarray, stops: np.ndarray, duration: float) -> np.ndarray:
    """Disjoint spans (m, 2) that cover spans which rise and may overlap, within a record."""
    starts = starts.clip(0, duration)
    stops = stops.clip(0, duration)
    if not len(starts):
        return np.zeros((0, 2))
    apart = starts[1:] > stops[:-1]
    return np.stack([starts[np.append(True, apart)], stops[np.append(apart, True)]], axis=1)


def align_transits(
    times: np.ndarray, starts: np.ndarray, bin_s: float, trace: np.ndarray, background: float
) -> np.ndarray:
    """Starts (n,), up to half a transit off, that a mean trace (T,) of counts makes likeliest.

    Σ log(1 + rate / background) over the photons is the log-likelihood, but for a constant.
    """
    cells = FINE * len(trace)
    rate = np.repeat(trace, FINE) / bin_s
    # Background over the mean rate of a transit that a stray photon is held against at least
    weight = np.log1p(rate / max(background, 0.01 * rate.mean()))
    step = bin_s / FINE
    aligned = []
    for start in starts:
        origin = start - cells // 2 * step
        inside = times[np.searchsorted(times, origin) :]
        inside = inside[: np.searchsorted(inside, origin + 2 * cells * step)]
        counts = np.bincount(((inside - origin) / step).astype(int), minlength=2 * cells)
        score = np.correlate(counts[: 2 * cells].astype(float), weight, "valid")
        # photons do not tell steps of equal score apart: their middle is taken
        best = np.flatnonzero(score == score.max())
        aligned.append(origin + step * float(best.mean()))
    return np.array(aligned)


def count_bins(times: np.ndarray, starts: np.ndarray, bin_s: float, bins: int) -> np.ndarray:
    """Photons (n, T) in the bins of transits, from their starts (n,)."""
    edges = starts[:, None] + bin_s * np.arange(bins + 1)
    return np.diff(np.searchsorted(times, edges), axis=1)


@dataclass(frozen=True)
class _Transit:
    """One transit of a record."""

    start_s: float  # of its first bin
    counts: tuple[int, ...]  # photons in each bin, background included
    predicted: str
    confidence: float


@dataclass(frozen=True)
class ClassifiedTransits:
    """Transits of a photon file, and how they were found."""

    transits: tuple[_Transit, ...]
    background: float  # counts/s
    threshold: _Threshold  # photons in a window as long as the bins
    seconds: float  # length of the record
    photons: float  # budget Φ of a transit

    def as_dict(self) -> dict[str, Any]:
        """JSON types only."""
        content = vars(self) | {"threshold": vars(self.threshold)}
        return content | {"transits": [vars(transit) for transit in self.transits]}

    def lines(self) -> Iterator[str | Table]:
        """Say each transit, and the threshold that makes one."""
        rows = [
            (
                f"{transit.start_s:.6g}",
                f"{sum(transit.counts)}",
                transit.predicted,
                f"{transit.confidence:.3f}",
            )
            for transit in self.transits
        ]
        yield Table("Transits", ("start, s", "photons", "class", "confidence"), rows)
        yield (
            f"{len(rows)} transits in {time_text(self.seconds)}: {self.threshold.photons} photons "
            f"or more within a transit, at a background of {self.background:.4g} counts/s; "
            f"{self.threshold.false_alarms:.2g} false alarms are expected in the record"
        )

    def as_csv(self) -> str:
        """Table with a line for each transit: start, class, confidence, counts of the bins."""
        text = io.StringIO()
        table = csv.writer(text)
        bins = len(self.transits[0].counts) if self.transits else 0
        table.writerow(["start_s", "class", "confidence", *(f"bin{k + 1}" for k in range(bins))])
        for transit in self.transits:
            answer = [transit.start_s, transit.predicted, transit.confidence]
            table.writerow([*answer, *transit.counts])
        return text.getvalue()


def classify_transits(
    design: "Design",
    file: str | os.PathLike[str],
    bin_s: float,
    *,
    photons: float | None = None,
    background: float | None = None,
    false_alarms: float = 0.01,
    counter_input: int = 0,
    report: Progress = SILENT,
) -> ClassifiedTransits:
    """Find the transits of a photon file, count their bins, and classify them.

    A transit is a rise of the rate above a threshold with a stated number of false alarms, and lies
    where the mean trace of the training makes its photons likeliest.
    """
    from deepfsi.exposure.training_set import check_classes
    from deepfsi.physics.surroundings import library_defaults

    check_classes(design.values, "a transit's answer")
    path = _passing_of(design).transit
    budget = check_budget(photons or design.info["job"]["photons"])
    for name, value in (("bin_s", bin_s), ("false_alarms", false_alarms)):
        if not 0 < value < np.inf:
            raise InputError(f"{name} {value!r} is not allowed: give a number above 0")
    if background is not None and not 0 <= background < np.inf:
        raise InputError(f"a background of {background} counts/s is not allowed: give 0 or more")
    times, seconds = read_photons(file, counter_input, report)
    window = path.bins * bin_s
    if not len(times) or seconds <= window:
        raise InputError(
            f"{file} holds {len(times)} photons on input {counter_input + 1} in "
            f"{time_text(seconds)}, and a transit lasts {time_text(window)}: give another `input`, "
            "or shorter bins"
        )

    @library_defaults()
    def classify() -> ClassifiedTransits:
        rate = background
        if rate is None:
            rate = find_background(times, window, seconds, false_alarms)
        threshold = find_threshold(rate, window, seconds, false_alarms)
        trace = design.exposure.shares.cpu().double().numpy() * budget
        starts = align_transits(
            times,
            find_transits(times, window, threshold.photons),
            bin_s,
            trace=trace,
            background=rate,
        )
        counts = count_bins(times, starts, bin_s, path.bins)
        probabilities = design.classify((counts - rate * bin_s).astype(np.float32), budget)
        transits = tuple(
            _Transit(
                start_s=start,
                counts=tuple(counts[index].tolist()),
                predicted=design.classes[int(np.argmax(probabilities[index]))],
                confidence=float(probabilities[index].max()),
            )
            for index, start in enumerate(starts.tolist())
        )
        return ClassifiedTransits(transits, rate, threshold, seconds=seconds, photons=budget)

    return classify()


def _passing_of(design: "Design") -> "PassingExposure":
    """Exposure of a design of passing scenes, or `InputError`."""
    from deepfsi_flow.exposure import PassingExposure

    if not isinstance(design.exposure, PassingExposure):
        raise InputError(
            "this design has masks that a device shows one after the other: learn one of scenes "
            "that pass a pattern, with `bins`"
        )
    return design.exposure
