"""Counts of counters that hand over no events: cumulative counts at triggers, or even time bins.

Both become the table that `tables.count_table` reads, a row for each pass and a value for each
frame and input.

Bins have no marker, so passes are found by their light: all ON, then all OFF, at both ends, and no
frame brighter. Of the places s that fit it is the one at which counts are most likely to be
constant within each frame, by the logarithm of the likelihood

    G(s) = Σ_f [S_f log(S_f / n_f) − Σ_b k_b log k_b],    S_f the counts k_b of the n_f bins of f.

The first bin of each frame may hold light of the frame before and is left out: a frame is counted
one bin less than it is shown.
"""

from collections.abc import Iterator

import numpy as np
from scipy.special import xlogy

from deepfsi.base import InputError
from deepfsi.hardware.counting.tables import column_names
from deepfsi.hardware.light import CERTAIN_SIGMAS
from deepfsi.hardware.patterns.sequence import Manifest

ROLL_OVER = 2**32
"""Counts after which a cumulative counter begins again."""

CERTAIN_GAIN = 10.0
"""Logarithm of the odds by which one place of a pass is likelier than any other."""

LEAST_BINS = 2
"""Bins that a frame is shown for at least, one of which is left out."""


def of_cumulative(
    values: np.ndarray, manifest: Manifest, passes: int | None = None, name: str = "the file"
) -> tuple[np.ndarray, list[str]]:
    """Rows of a table, and its columns, of counts (n, inputs) that a trigger latched."""
    # One latch at the start of each frame. With one more at the end of a pass the last frame has an
    # end and is counted; else the all-ON and all-OFF frames are left out
    frames, names, inputs = len(manifest.frames), column_names(manifest), manifest.inputs
    latched = _columns(values, inputs, name)
    fits = [each for each in (frames + 1, frames) if passes in (None, len(latched) / each)]
    fits = [each for each in fits if len(latched) % each == 0]
    if len(fits) != 1:
        raise InputError(
            f"{name} has {len(latched)} cumulative counts, and a pass has {frames} frames, whose "
            f"trigger gives as many, or one more at its end: "
            f"{'say how many `passes` there are' if fits else 'give those of whole passes'}"
        )
    whole = latched.reshape(-1, fits[0], inputs)
    steps = np.diff(whole, axis=1) % ROLL_OVER
    if (steps > ROLL_OVER / 2).any():
        raise InputError(
            f"{name} has counts that fall within a pass: give cumulative ones, in the order of "
            "their triggers"
        )
    if fits[0] > frames:
        return steps.reshape(len(steps), -1), names
    return steps[:, 2 : frames - 2].reshape(len(steps), -1), names[2 * inputs : -2 * inputs]


def of_bins(
    values: np.ndarray,
    manifest: Manifest,
    bin_s: float,
    passes: int | None = None,
    name: str = "the file",
) -> tuple[np.ndarray, list[str]]:
    """Rows of a table, and its columns, of counts (n, inputs) in even time bins."""
    counts = _columns(values, manifest.inputs, name)
    shown = manifest.picture_s / bin_s
    bins = np.rint(shown).astype(np.int64)
    if abs(shown - bins).max() > 1e-6 * max(shown.max(), 1) or bins.min() < LEAST_BINS:
        times = sorted({round(each * 1e6) for each in manifest.picture_s.tolist()})
        raise InputError(
            f"pictures of {times[0]} to {times[-1]} µs are not whole numbers of bins of "
            f"{bin_s * 1e6:g} µs, {LEAST_BINS} or more: export an equal-dwell design or a scan "
            "with such a --dwell, or record in other bins"
        )
    total = np.concatenate([np.zeros((1, manifest.inputs), np.int64), counts.cumsum(axis=0)])
    places = np.array(sorted(_find_passes(total, bins, manifest, passes)), np.int64)
    if not len(places) or len(places) != (passes or len(places)):
        raise InputError(
            f"{name} has {len(places)} passes that begin and end with a bright and a dark frame"
            f"{'' if passes is None else f', and {passes} are asked for'}: give the patterns that "
            "were shown, and the length of the bins"
        )
    ends = places[:, None] + np.cumsum(bins)
    rows = total[ends] - total[ends - bins + 1]
    return rows.reshape(len(rows), -1), column_names(manifest)


def _columns(values: np.ndarray, inputs: int, name: str) -> np.ndarray:
    """Whole numbers (n, inputs) of a table."""
    held = values.T if values.shape[1] != inputs and values.shape[0] == inputs else values
    if held.shape[1] != inputs:
        raise InputError(
            f"{name} has {values.shape[1]} columns, and these patterns have {inputs} inputs: give "
            "a column for each"
        )
    if (held < 0).any() or (held % 1 != 0).any() or held.max() > 2.0**53:
        raise InputError(f"{name} holds what is no count: give whole numbers, 0 or more")
    return held.astype(np.int64)


def _find_passes(
    total: np.ndarray, bins: np.ndarray, manifest: Manifest, passes: int | None
) -> Iterator[int]:
    """First bins of passes, the surest first; `InputError` where a place is not certain."""
    # total (n + 1, inputs): counts before each bin
    length = int(bins.sum())
    starts = len(total) - length
    if starts < 1:
        return
    gain = _gains(total, bins, manifest.detector_count)
    while passes is None or passes > 0:
        best = int(np.argmax(gain))
        if gain[best] == -np.inf:
            return
        near = slice(max(best - length + 1, 0), best + length)
        rivals = gain[near].copy()
        rivals[max(best - 1, 0) - near.start : best + 2 - near.start] = -np.inf
        if rivals.max() > gain[best] - CERTAIN_GAIN:
            raise InputError(
                f"a pass begins at bin {best} or {near.start + int(np.argmax(rivals))}, and the "
                "counts do not tell: use more light, or longer pictures"
            )
        gain[near] = -np.inf
        passes = None if passes is None else passes - 1
        yield best


def _gains(total: np.ndarray, bins: np.ndarray, arm: int) -> np.ndarray:
    """G (starts,) of a pass that begins at each bin; -inf where it cannot."""
    starts, ends = len(total) - int(bins.sum()), np.cumsum(bins)
    gain = np.zeros(starts)
    own_bins = np.diff(total, axis=0)
    saturated = np.concatenate([[0.0], xlogy(own_bins, own_bins).sum(axis=1).cumsum()])
    seen: dict[int, tuple[np.ndarray, int]] = {}
    brightest = np.zeros(starts)
    last = len(bins) - 1
    for frame, (stop, width) in enumerate(zip(ends.tolist(), (bins - 1).tolist(), strict=True)):
        found = total[stop : stop + starts] - total[stop - width : stop - width + starts]
        gain += xlogy(found, found / width).sum(axis=1)
        gain -= saturated[stop : stop + starts] - saturated[stop - width : stop - width + starts]
        own = found[:, :arm].sum(axis=1)
        if frame in (0, 1, last - 1, last):
            seen[frame] = own, width
        else:
            brightest = np.maximum(brightest, own / width - CERTAIN_SIGMAS * np.sqrt(own) / width)
    fits = np.ones(starts, bool)
    for bright, dark in ((0, 1), (last - 1, last)):
        (on, on_bins), (off, off_bins) = seen[bright], seen[dark]
        noise = np.sqrt(on / on_bins**2 + off / off_bins**2)
        fits &= on / on_bins - off / off_bins > CERTAIN_SIGMAS * noise
        fits &= on / on_bins + CERTAIN_SIGMAS * np.sqrt(on) / on_bins >= brightest
    return np.where(fits, gain, -np.inf)
