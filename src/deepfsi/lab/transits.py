"""Classes of scenes that pass a pattern, from a photon file without markers."""

import csv
import io
import os
from dataclasses import dataclass
from typing import Any

import numpy as np
import torch

from deepfsi.base.errors import InputError
from deepfsi.base.progress import SILENT, Report
from deepfsi.base.quantities import time_text
from deepfsi.camera.light import check_budget
from deepfsi.design.artifact import Design
from deepfsi.design.exposure.passing import PassingExposure
from deepfsi.design.values import check_classes
from deepfsi.hardware.counting.transits import (
    FINE,
    Threshold,
    align,
    count_bins,
    find_background,
    find_threshold,
    find_transits,
)
from deepfsi.hardware.photons import read_photons
from deepfsi.hardware.virtual.transits import write_transits
from deepfsi.optics.surroundings import library_defaults

FALSE_ALARMS = 0.01
"""Expected false alarms of a record unless another number is asked for."""


@dataclass(frozen=True)
class Transit:
    """One transit of a record."""

    start_s: float  # of its first bin
    counts: tuple[int, ...]  # photons in each bin, background included
    predicted: str
    confidence: float


@dataclass(frozen=True)
class ClassifiedTransits:
    """Transits of a photon file, and how they were found."""

    transits: tuple[Transit, ...]
    background: float  # counts/s
    threshold: Threshold  # photons in a window as long as the bins
    seconds: float  # length of the record
    photons: float  # budget Φ of a transit

    def as_dict(self) -> dict[str, Any]:
        """JSON types only."""
        found = vars(self) | {"threshold": vars(self.threshold)}
        return found | {"transits": [vars(each) for each in self.transits]}

    def as_csv(self) -> str:
        """Table with a line for each transit: start, class, confidence, counts of the bins."""
        text = io.StringIO()
        table = csv.writer(text)
        bins = len(self.transits[0].counts) if self.transits else 0
        table.writerow(["start_s", "class", "confidence", *(f"bin{k + 1}" for k in range(bins))])
        for each in self.transits:
            table.writerow([each.start_s, each.predicted, each.confidence, *each.counts])
        return text.getvalue()


@library_defaults()
def classify_transits(
    design: Design,
    file: str | os.PathLike[str],
    bin_s: float,
    *,
    photons: float | None = None,
    background: float | None = None,
    false_alarms: float = FALSE_ALARMS,
    counter_input: int = 0,
    report: Report = SILENT,
) -> ClassifiedTransits:
    """Find the transits of a photon file, count their bins, and classify them.

    A transit is a rise of the rate above a threshold with a stated number of false alarms. Its
    place is where its photons are likeliest those of the mean trace of the training.

    Parameters
    ----------
    design : Design
        Of scenes that pass a pattern.
    file : str or path
        PTU file; markers in it are not read.
    bin_s : float
        Length of a bin, seconds.
    photons : float, optional
        Budget Φ of a transit, counts; that of the training unless given.
    background : float, optional
        Counts/s without a scene; from the record's stretches without transits unless given.
    false_alarms : float
        Expected false alarms in the whole record, at most.
    counter_input : int
        Input of the counter, from 0.
    report : Report

    Raises
    ------
    InputError
        If the design is of another exposure, the file is damaged, or it does not tell its
        background.
    """
    check_classes(design.values, "a transit's answer")
    path, budget = (
        passing_of(design).transit,
        check_budget(photons or design.info["job"]["photons"]),
    )
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
            f"{time_text(seconds)}, and "
            f"a transit lasts {time_text(window)}: give another `input`, or shorter bins"
        )
    if background is None:
        background = find_background(times, window, seconds, false_alarms)
    threshold = find_threshold(background, window, seconds, false_alarms)
    rough = find_transits(times, window, threshold.photons)
    trace = design.shares.cpu().double().numpy() * budget
    starts = align(times, rough, bin_s, trace, background)
    counts = count_bins(times, starts, bin_s, path.bins)
    found = _classified(design, starts, counts, background * bin_s, budget)
    return ClassifiedTransits(found, background, threshold, seconds, budget)


def _classified(
    design: Design, starts: np.ndarray, counts: np.ndarray, dark: float, budget: float
) -> tuple[Transit, ...]:
    """Transits of starts (n,) and counts (n, T), with so many of the background in a bin."""
    chances = design.classify((counts - dark).astype(np.float32), budget)
    return tuple(
        Transit(start, tuple(own), design.classes[int(np.argmax(each))], float(each.max()))
        for start, own, each in zip(starts.tolist(), counts.tolist(), chances, strict=True)
    )


def passing_of(design: Design) -> PassingExposure:
    """Exposure of a design of passing scenes, or `InputError`."""
    if not isinstance(design.exposure, PassingExposure):
        raise InputError(
            "this design has masks that a device shows one after the other: learn one of scenes "
            "that pass a pattern, with `bins`"
        )
    return design.exposure


@library_defaults()
def simulate_transits(
    design: Design,
    scenes: np.ndarray,
    file: str | os.PathLike[str],
    bin_s: float,
    *,
    photons: float,
    background: float,
    gaps: tuple[float, float] = (2.0, 5.0),
    seed: int = 0,
) -> np.ndarray:
    """Write a photon file of scenes that pass one after the other; their starts, seconds (n,).

    A start is that of the first bin of a transit in its mean place. Scenes are seen from where they
    enter the pattern to where they leave it.

    Parameters
    ----------
    design : Design
        Of scenes that pass a pattern.
    scenes : array, shape (n, N)
        Reflectance.
    file : str or path
        PTU file to write.
    bin_s : float
        Length of a bin, seconds.
    photons : float
        Budget Φ of a transit.
    background : float
        Counts/s without a scene.
    gaps : (float, float)
        Least and most time between transits, in transits.
    seed : int
    """
    path = passing_of(design).transit
    x = torch.from_numpy(np.ascontiguousarray(scenes, dtype=np.float32))
    step = path.speed / FINE  # pixels
    steps = int(np.ceil((path.shifts - 1) / step))
    edges = (path.shifts - 1) / 2 + step * (torch.arange(steps + 1) - steps / 2)
    with torch.no_grad():
        rates = passing_of(design).rates(design.scanner(), x / design.summed_reflectance)
        traces = path.means(rates[:, 0], edges).double().numpy() * photons / FINE
    rng, passage = np.random.default_rng(seed), steps / FINE * bin_s
    window = path.bins * bin_s
    between = rng.uniform(*gaps, size=len(x)) * window
    enters = np.cumsum(between + passage) - passage
    seconds = float(enters[-1] + passage + gaps[1] * window)
    write_transits(file, traces, enters, bin_s / FINE, background, seconds, rng)
    return enters + (passage - window) / 2
