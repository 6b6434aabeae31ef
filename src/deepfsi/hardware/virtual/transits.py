"""A simulated photon file of scenes that pass a pattern, with background and no markers."""

import os

import numpy as np

from deepfsi.hardware.photons import PtuWriter

TRANSIT_TICK_S = 1e-9
"""Tick of the file, seconds."""


def write_transits(
    path: str | os.PathLike[str],
    traces: np.ndarray,
    starts_s: np.ndarray,
    step_s: float,
    background: float,
    seconds: float,
    rng: np.random.Generator,
) -> None:
    """Write photons of some transits and of the background, counts/s, in a record of some seconds.

    Shapes: traces (n, S), expected counts in each step; starts (n,) of the first step.
    """
    counts = rng.poisson(traces)
    at = starts_s[:, None] + step_s * np.arange(traces.shape[1])
    passing = np.repeat(at.ravel(), counts.ravel())
    passing = passing + step_s * rng.random(len(passing))
    dark = seconds * rng.random(rng.poisson(background * seconds))
    times = np.sort(np.concatenate([passing, dark]))
    ticks = np.rint(times[(times >= 0) & (times < seconds)] / TRANSIT_TICK_S).astype(np.int64)
    with PtuWriter(path, TRANSIT_TICK_S) as writer:
        writer.write(ticks, np.zeros(len(ticks), np.int64))
