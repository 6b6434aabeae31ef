"""Markers of a recording: which frame each of them starts, and when frames start.

A device gives one marker at the start of each frame; a counter records them on its own clock. A
pass over the frames follows the schedule of its manifest, as that clock shows it, within 200 ppm.
Between passes there may be pauses of any length.

The counter's clock and the device's may differ, and a device may add the same time to every frame.
Either stretches the whole schedule; which one is measured from markers that follow each other.

A recording whose markers do not all follow is refused: times alone cannot tell a pass that lacks
its first marker from one that lacks its last, when all frames are equally long.
"""

import numpy as np

from deepfsi.base.errors import InputError
from deepfsi.base.progress import SILENT, Progress
from deepfsi.base.quantities import time_text
from deepfsi.hardware.counting.acquisition import Acquisition
from deepfsi.hardware.counting.windows import FrameStarts
from deepfsi.hardware.patterns.manifest import Manifest
from deepfsi.hardware.photons.reader import PhotonSource, read_markers

MOST_DRIFT = 2e-4
"""Largest difference of two clocks' rates, of those planned or of those measured."""

FRAMES_OF_BLOCK = 8
"""Frames in a row that are compared with the schedule, at most, and half of a pass."""

MOST_BLOCKS = 64
"""Places of a recording that are compared."""

MOST_PLACES = 4096
"""Places of the schedule that each is compared with, the first ones."""

MOST_RATE = 0.02
"""Most that all frames may be longer or shorter than planned, as a share of each."""

MOST_EXTRA = 0.2
"""Most that may be added to each frame, as a share of the shortest."""

GOLDEN = 0.6180339887498949
"""Golden section: fractional parts of its multiples are spread evenly, out of step with passes."""


def find_frames(
    source: PhotonSource,
    acquisition: Acquisition,
    manifest: Manifest,
    tolerance_s: float | None = None,
    *,
    progress: Progress = SILENT,
) -> FrameStarts:
    """Frames of a recording by its markers."""
    times, bits = read_markers(source, progress)
    wired = bits & acquisition.marker_bit != 0
    if not wired.any():
        advice = "wire the device's trigger to the counter"
        others = [str(number) for number in range(4) if (bits & 1 << number).any()]
        if others:
            advice = f"there are some on {' and '.join(others)}: give --marker {others[0]}"
        raise InputError(
            f"{source.path} has 0 frame markers on marker input "
            f"{acquisition.marker_bit.bit_length() - 1}; {advice}"
        )
    times_s = np.sort(times[wired] * source.tick_s)
    try:
        return align(times_s, manifest, len(acquisition.scenes), tolerance_s)
    except InputError as error:
        raise InputError(f"{source.path} has {len(times_s)} frame markers: {error}") from None


def align(
    times_s: np.ndarray, manifest: Manifest, scenes: int, tolerance_s: float | None = None
) -> FrameStarts:
    """Frames that markers (n,) start; those of a pass that was begun after the last are left out.

    `InputError` unless each marker is where the schedule has it.
    """
    planned = manifest.picture_s
    tolerance = manifest.usual_tolerance_s if tolerance_s is None else tolerance_s
    most = 0.2 * float(planned.min())
    if not 0 < tolerance <= most:
        raise InputError(
            f"a tolerance of {tolerance!r} s is not allowed: give more than 0, up to a fifth "
            f"of the shortest frame ({time_text(most)})"
        )
    whole, begun = divmod(len(times_s), len(planned))
    starts = times_s[: len(times_s) - begun].reshape(whole, len(planned))
    pictures = planned
    if not _follows(starts, planned, tolerance):
        pictures = _as_measured(times_s, planned, tolerance)
        if not _follows(starts, pictures, tolerance):
            raise InputError(_first_departure(times_s, pictures, tolerance))
    if whole != scenes:
        raise InputError(
            f"they are of {whole} whole passes, and there are {scenes} scenes: record again, or "
            "keep the scenes that were recorded in acquisition.json"
        )
    drifts = np.ptp(starts, axis=1) / np.ptp(manifest.starts_s) - 1
    return FrameStarts(starts, pictures, tolerance, drift=float(np.median(drifts)))


def _follows(starts: np.ndarray, pictures: np.ndarray, tolerance: float) -> bool:
    """True if markers (P, F) of passes come when the schedule says."""
    schedule = np.cumsum(pictures)[:-1]
    span = starts[:, -1] - starts[:, 0]
    rate = span / schedule[-1]
    steps = np.diff(np.append(0.0, schedule))
    off = np.abs(np.diff(starts) - steps * rate[:, None]).max(initial=0)
    drift = np.abs(span - schedule[-1]).max(initial=0) - MOST_DRIFT * schedule[-1]
    ends = starts[:-1, -1] + pictures[-1] * (1 - MOST_DRIFT)
    overlap = (ends - starts[1:, 0]).max(initial=-np.inf)
    return bool(max(off, drift, overlap) <= tolerance)


def _as_measured(times: np.ndarray, pictures: np.ndarray, tolerance: float) -> np.ndarray:
    """Picture times (F,) on the clock on which most markers in a row follow, where that differs.

    All frames are longer or shorter by a share of each, or by the same time, whichever fits better.
    """
    size = min(FRAMES_OF_BLOCK, len(pictures) // 2)
    if len(times) <= size:
        return pictures
    planned = np.lib.stride_tricks.sliding_window_view(pictures[:-1], size)[:MOST_PLACES]
    steps = np.lib.stride_tricks.sliding_window_view(np.diff(times), size)
    places = np.unique((np.arange(MOST_BLOCKS) * GOLDEN % 1 * len(steps)).astype(np.int64))
    total = planned.sum(axis=1)
    shortest = float(pictures.min())
    fits: dict[str, list[tuple[float, float]]] = {"rate": [], "extra": []}
    for block in steps[places]:
        rate = block.sum() / total - 1
        extra = (block.sum() - total) / size
        off_rate = np.abs(block - (1 + rate[:, None]) * planned).max(axis=1)
        off_extra = np.abs(block - planned - extra[:, None]).max(axis=1)
        off_rate[np.abs(rate) > MOST_RATE] = np.inf
        off_extra[(extra > MOST_EXTRA * shortest) | (extra < -MOST_RATE * shortest)] = np.inf
        for kind, values, off in (("rate", rate, off_rate), ("extra", extra, off_extra)):
            best = int(np.argmin(off))
            fits[kind].append((values[best], off[best]))
    medians = {}
    for kind, best_fits in fits.items():
        close = [fit for fit in best_fits if fit[1] <= 2 * tolerance]
        if len(close) >= len(best_fits) / 8:
            medians[kind] = np.median(close, axis=0)
    if not medians:
        return pictures
    kind = min(medians, key=lambda kind: float(medians[kind][1]))
    value = float(medians[kind][0])
    measured = (1 + value) * pictures if kind == "rate" else pictures + value
    return measured if abs(measured.sum() / pictures.sum() - 1) > MOST_DRIFT else pictures


def _first_departure(times: np.ndarray, pictures: np.ndarray, tolerance: float) -> str:
    """Where markers leave the schedule, in words."""
    scene, frame = np.divmod(np.arange(len(times) - 1), len(pictures))
    planned = pictures[frame]
    steps = np.diff(times)
    allowed = 2 * tolerance + MOST_DRIFT * planned
    off = (steps - planned) / allowed
    off[(frame == len(pictures) - 1) & (off > 0)] = 0  # a pause after a pass
    first = int(np.argmax(np.abs(off) > 1)) if (np.abs(off) > 1).any() else np.abs(off).argmax()
    return (
        f"they do not follow the schedule, first at {times[first + 1]:.6f} s, "
        f"{time_text(steps[first])} after the one before, where {time_text(planned[first])} were "
        f"planned (scene {scene[first]}, frame {frame[first]}): give the patterns that were shown, "
        "and one marker at the start of each frame"
    )
