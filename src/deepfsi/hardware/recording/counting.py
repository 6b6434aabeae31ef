"""Photons of a recording counted frame by frame, for the exposure it was made for or another."""

import os
from dataclasses import replace
from pathlib import Path

import numpy as np

from deepfsi.errors import InputError
from deepfsi.hardware.patterns.sequence import Manifest
from deepfsi.hardware.patterns.timing import Gates
from deepfsi.hardware.ptu.header import Header, read_header
from deepfsi.hardware.ptu.reader import count_gates
from deepfsi.hardware.recording.acquisition import gates_of, read_acquisition
from deepfsi.hardware.recording.alignment import find_steps
from deepfsi.hardware.recording.counts import Counts
from deepfsi.hardware.recording.faults import Fault
from deepfsi.hardware.recording.gates import (
    Windows,
    check_gates,
    find_frames,
    find_lateness,
    in_ticks,
)
from deepfsi.progress import SILENT, Report

LEAST_GATE_TICKS = 10
"""Ticks of the counter that a gate must have at least."""

_READ_BY: dict[str | None, tuple[tuple[int, int], ...]] = {
    "plus": ((0, 0),),
    "minus": ((1, 0),),
    "both": ((0, 0), (1, 1)),
}
"""Rails for which a frame is read, and the place of their input."""


def count(
    folder: str | os.PathLike[str],
    *,
    exposure_s: float | None = None,
    settle_s: float | None = None,
    repeats: int | None = None,
    tolerance_s: float | None = None,
    inputs: tuple[int, ...] | None = None,
    marker_bit: int | None = None,
    report: Report = SILENT,
) -> Counts:
    """Count the photons of each readout and write counts.npz.

    Parameters
    ----------
    exposure_s : float, optional
        Total exposure, seconds; as recorded unless given. A shorter one is a gate within frames.
    settle_s : float, optional
        As recorded unless given.
    repeats : int, optional
        Exposures of each scene, from gates that follow each other in each frame. Unless given, as
        recorded, or with another exposure as many as fit (and are at most 2^21 readouts).
    tolerance_s : float, optional
        By how much a marker may be off; a tenth of the shortest frame, at most 10 µs, unless given.
    inputs, marker_bit
        In place of the acquisition's, where it was recorded otherwise.

    Raises
    ------
    InputError
        If files are missing, damaged or do not fit, gates do not fit, or no exposure is whole.
    """
    recorded, patterns = read_acquisition(folder)
    acquisition, manifest = recorded.rewired(inputs, marker_bit), patterns.manifest
    gates = gates_of(acquisition, manifest, exposure_s, settle_s, repeats)
    header = read_header(Path(folder) / "photons.ptu")
    _check_ticks(header, gates)
    frames = find_frames(header, acquisition, manifest, tolerance_s, report.part(0.0, 0.4))
    check_gates(header, gates, manifest, frames)
    windows = Windows.of(manifest, gates, frames)
    whole, faults = frames.whole, frames.faults
    opens = frames.starts_s[whole][:, windows.frame] + windows.offset
    closes = np.minimum(opens + windows.length, frames.until_s)
    found, seconds = _count_windows(
        header, opens, closes, acquisition.inputs, report.part(0.4, 1.0)
    )
    photons, spent = windows.sum_frames(found), windows.sum_frames(seconds)
    fits = _show_ends(header, photons[..., 0], spent)
    faults += [_shifted(scene) for scene in np.flatnonzero(whole)[~fits].tolist()]
    faults += find_lateness(windows, found[fits, :, 0], seconds[fits])
    whole[whole] = fits
    spent = np.where(spent > 0, spent, np.nan)
    rates = photons[fits] / spent[fits, :, None]
    exposure = acquisition.exposure_s if exposure_s is None else exposure_s
    counts = _assemble(manifest, gates, windows, whole, found[fits], rates, exposure)
    counts = replace(counts, drift=frames.drift, inputs=acquisition.inputs, faults=tuple(faults))
    counts.save(Path(folder), recorded)
    return counts


def _shifted(scene: int) -> Fault:
    """A scene that is given up since its sentinels are not where they should be."""
    detail = "its first and last frames are not the brightest and darkest: it may be shifted"
    return Fault(kind="lost", scene=scene, frame=None, detail=detail)


def _check_ticks(header: Header, gates: Gates) -> None:
    """Raise `InputError` if the counter's times are too coarse for the gates."""
    if gates.length_s.min() < LEAST_GATE_TICKS * header.tick_s:
        raise InputError(
            f"{header.path} has times in steps of {header.tick_s:g} s, too coarse for gates of "
            f"{gates.length_s.min():g} s: give a longer exposure"
        )


def _count_windows(
    header: Header, opens: np.ndarray, closes: np.ndarray, inputs: tuple[int, ...], report: Report
) -> tuple[np.ndarray, np.ndarray]:
    """Photons (S, g, inputs) in windows (S, g), and how long each was open, seconds (S, g).

    Where two clocks and a marker's jitter make a window reach into the next it ends there. One
    whose frame's start is not known is not open.
    """
    tick_s, known = header.tick_s, np.isfinite(opens).ravel()
    starts = in_ticks(opens.ravel()[known], tick_s)
    stops = in_ticks(closes.ravel()[known], tick_s)
    starts = np.minimum(np.minimum.accumulate(starts[::-1])[::-1], stops.max(initial=0))
    stops[:-1] = np.minimum(stops[:-1], starts[1:])
    found = np.zeros((opens.size, len(inputs)), np.int64)
    seconds = np.zeros(opens.size)
    found[known] = count_gates(header.path, starts, stops, inputs, report)
    seconds[known] = (stops - starts) * tick_s
    return found.reshape(*opens.shape, len(inputs)), seconds.reshape(opens.shape)


def _show_ends(header: Header, photons: np.ndarray, seconds: np.ndarray) -> np.ndarray:
    """Passes whose first and last two frames are all ON and all OFF, as far as photons tell.

    From photons and seconds (S, F). At least one of each must have been recorded.
    """
    fits = np.array(
        [
            spent[[0, -2]].any()
            and spent[[1, -1]].any()
            and find_steps(found, spent)[0][[0, -1]].all()
            for found, spent in zip(photons, seconds, strict=True)
        ]
    )
    if not fits.any():
        raise InputError(
            f"{header.path} has no pass that begins and ends with a bright and a dark frame: give "
            "the patterns that were shown, and the input that the detector is wired to"
        )
    return fits


def _assemble(
    manifest: Manifest,
    gates: Gates,
    windows: Windows,
    whole: np.ndarray,
    found: np.ndarray,
    rates: np.ndarray,
    exposure_s: float,
) -> Counts:
    """Counts of windows (whole scenes, g, inputs) and rates of frames (whole scenes, F, inputs)."""
    scenes, rails, masks = len(whole), manifest.rails, manifest.masks
    counts = np.zeros((scenes, gates.repeats, rails, masks), np.int64)
    lengths = np.zeros((rails, masks))
    for place, length, own in zip(manifest.shown, gates.length_s, windows.gates, strict=True):
        frame = manifest.frames[place]
        for rail, column in _READ_BY[frame.rail]:
            counts[whole, :, rail, frame.mask] = found[:, own, column]
            lengths[rail, frame.mask] = length
    on, off = np.nanmean(rates[:, [0, -2]], axis=1), np.nanmean(rates[:, [1, -1]], axis=1)
    on_rate, off_rate = np.full(scenes, np.nan), np.full(scenes, np.nan)
    on_rate[whole], off_rate[whole] = on[:, 0], off[:, 0]
    dark = np.full(rails, off[:, 0].mean())
    if manifest.two_arm:
        dark[1] = on[:, 1].mean()
    return Counts(
        counts=counts,
        valid=np.repeat(whole[:, None], gates.repeats, axis=1),
        gate_s=gates.length_s,
        on_rate=on_rate,
        off_rate=off_rate,
        dark_rate=dark,
        exposure_s=exposure_s,
        settle_s=gates.settle_s,
        lengths_s=lengths,
        drift=0.0,
        inputs=(),
        faults=(),
    )
