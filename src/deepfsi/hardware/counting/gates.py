"""Gates of a recording: frames found by their markers, and windows in which photons are counted.

A marker may come late, and what is counted up to the next one then holds some light of the next
frame: a microsecond of 1e7 photons/s looks like thousands of dark counts/s in an all-OFF frame. So
windows other than gates end a *guard*, the tolerance of the markers, before the next frame. The
guard of the all-OFF frames is counted by itself: light in it tells by how much markers are late.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from deepfsi.base import SILENT, InputError, Progress
from deepfsi.hardware.counting.acquisition import Acquisition
from deepfsi.hardware.counting.alignment import Counter, align
from deepfsi.hardware.counting.passes import MOST_DRIFT
from deepfsi.hardware.light import CERTAIN_SIGMAS, Fault
from deepfsi.hardware.patterns.sequence import Manifest
from deepfsi.hardware.patterns.timing import Gates
from deepfsi.hardware.photons import (
    PhotonSource,
    count_windows,
    marker_slack_s,
    read_markers,
)

GUARD_SHARE = 0.5
"""Share of a frame after settling that a guard takes at most, where it is cut in parts."""


@dataclass(frozen=True)
class Frames:
    """Frames of a recording."""

    starts_s: np.ndarray  # (S, F): Seconds on the counter's clock; NaN where it is not known
    whole: np.ndarray  # (S,): bool; scenes whose masks' frames were all recorded
    pictures_s: np.ndarray  # (F,): Picture times on the counter's clock
    tolerance_s: float  # by how much a marker may be off
    drift: float  # by how much passes last longer than planned, as a share: their median
    until_s: float  # up to when all photons are in the file, seconds; infinite unless it is cut
    faults: list[Fault]  # of the markers


def find_frames(
    header: PhotonSource,
    acquisition: Acquisition,
    manifest: Manifest,
    tolerance_s: float | None,
    report: Progress,
    by_light: bool = True,
) -> Frames:
    """Frames of a recording by its markers, and by photons where markers leave a doubt."""
    path, tick_s = header.path, header.tick_s
    times, bits = read_markers(path, report)
    _check_markers(header, bits, acquisition.marker_bit)
    times = times[bits & acquisition.marker_bit != 0]
    last = float(times.max(initial=0)) * tick_s
    # The file of a recording that was cut holds all photons up to the last marker.
    until = last - 2 * marker_slack_s(tick_s) if header.problems else np.inf
    inputs = acquisition.inputs[: manifest.detector_count]
    try:
        aligned = align(
            times * tick_s,
            manifest,
            len(acquisition.scenes),
            tolerance_s=tolerance_s,
            counter=_photon_counter(header, inputs, until) if by_light else None,
            cut=bool(header.problems),
        )
    except InputError as error:
        raise InputError(f"{path} has {len(times)} frame markers: {error}") from None
    starts = aligned.starts_s.copy()
    if header.problems:
        starts[starts >= last] = np.nan  # the frame that was being recorded when the file ended
    shown = starts[:, manifest.shown]
    # A mask's frame is whole if a marker came after it.
    whole = np.isfinite(shown).all(axis=1) & (shown[:, -1] < last)
    if not whole.any():
        why = aligned.faults[0] if aligned.faults else "it ends too early"
        raise InputError(f"{path} has no whole exposure ({why}): record again")
    return Frames(
        starts_s=starts,
        whole=whole,
        pictures_s=aligned.pictures_s,
        tolerance_s=aligned.tolerance_s,
        drift=_find_drift(starts, manifest.starts_s),
        until_s=until,
        faults=list(aligned.faults),
    )


def _check_markers(header: PhotonSource, bits: np.ndarray, wanted: int) -> None:
    """Raise `InputError`, with the marker inputs that have some, if a file has none of a bit."""
    if (bits & wanted != 0).any():
        return
    others = [str(number) for number in range(4) if (bits & 1 << number != 0).any()]
    advice = "wire the device's trigger to the counter"
    if others:
        advice = f"there are some on {' and '.join(others)}: give --marker {others[0]}"
    raise InputError(
        f"{header.path} has 0 frame markers on marker input {wanted.bit_length() - 1}; {advice}"
    )


def _photon_counter(header: PhotonSource, inputs: tuple[int, ...], until: float) -> Counter:
    """Count photons on some inputs in any windows, as far as all are in the file."""
    end = max(int(until / header.tick_s), 0) if np.isfinite(until) else None

    def counter(starts: np.ndarray, stops: np.ndarray) -> np.ndarray:
        edges = np.clip(in_ticks(np.stack([starts, stops]), header.tick_s), 0, end)
        return count_overlapping(header.path, edges[0], edges[1], inputs).sum(axis=1)

    return counter


def _find_drift(starts: np.ndarray, planned: np.ndarray) -> float:
    """By how much passes (S, F) last longer than planned, as a share: their median."""
    drifts = []
    for each in starts:
        known = np.flatnonzero(np.isfinite(each))
        if len(known) > 1:
            drifts.append(np.ptp(each[known]) / np.ptp(planned[known]) - 1)
    return float(np.median(drifts))


@dataclass(frozen=True)
class Windows:
    """Windows of a pass in order: its gates, and what they leave between settling and guard."""

    frame: np.ndarray  # (g,): Of each window
    # (g,): When a window opens after its frame's start, and for how long, seconds
    offset: np.ndarray
    length: np.ndarray  # (g,)
    gates: np.ndarray  # (f, R): Places of the gates among the windows
    guards: np.ndarray  # (2,): Places of the guards of the all-OFF frames
    frames: int  # frames of a pass, F
    room: float  # least time from the last gate of a frame to the next frame, seconds

    @classmethod
    def of(cls, manifest: Manifest, gates: Gates, found: Frames) -> "Windows":
        """Windows of a pass over the frames of a manifest as they were found in a recording."""
        repeats, frames = gates.repeats, len(manifest.frames)
        dark = np.flatnonzero([frame.role == "off" for frame in manifest.frames])
        each = np.ones(frames, np.int64)
        each[manifest.shown] += repeats
        each[dark] += 1
        frame = np.repeat(np.arange(frames), each)
        first = np.cumsum(each) - each
        places = first[manifest.shown][:, None] + np.arange(repeats)
        ends = found.pictures_s - found.tolerance_s
        offset = np.full(len(frame), gates.settle_s)
        offset[places] = gates.starts_s
        offset[places[:, -1] + 1] = gates.settle_s + repeats * gates.length_s
        guards = first[dark] + 1
        offset[guards] = ends[dark]
        length = np.maximum(ends[frame] - offset, 0.0)
        length[places] = gates.length_s[:, None]
        length[guards] = found.tolerance_s
        gated = gates.settle_s + repeats * gates.length_s
        room = float((found.pictures_s[manifest.shown] - gated).min())
        return cls(frame, offset, length, places, guards, frames, room)

    def sum_frames(self, values: np.ndarray) -> np.ndarray:
        """Sums over the windows of each frame but guards, along the second axis."""
        kept = values.copy()
        kept[:, self.guards] = 0
        return np.add.reduceat(kept, np.searchsorted(self.frame, np.arange(self.frames)), axis=1)


def check_gates(header: PhotonSource, gates: Gates, manifest: Manifest, found: Frames) -> None:
    """Raise `InputError` if frames were so much shorter than planned that gates do not fit."""
    pictures = found.pictures_s[manifest.shown]
    room = pictures - gates.settle_s
    over = gates.repeats * gates.length_s - room - MOST_DRIFT * pictures
    if over.max() > 0:
        exposure = float((room / manifest.shares).min()) / gates.repeats
        raise InputError(
            f"{header.path} has frames {-found.drift:.2%} shorter than planned, and "
            f"{gates.repeats} exposures do not fit: give --exposure {exposure:.4g} or less, or "
            "fewer --repeats"
        )


def find_lateness(windows: Windows, photons: np.ndarray, seconds: np.ndarray) -> tuple[Fault, ...]:
    """Name markers that all come late: light of the first mask is in the guard before it."""
    # photons, seconds (S, g)
    found, found_s = windows.sum_frames(photons), windows.sum_frames(seconds)
    (dark, light), (dark_s, light_s) = found[:, 1:3].T, found_s[:, 1:3].T
    guard, guard_s = photons[:, windows.guards[0]], seconds[:, windows.guards[0]]
    known = (dark_s > 0) & (light_s > 0)
    if np.count_nonzero(known) > 1:  # a burst of stray light in one of them is another fault
        known[np.argmax(np.where(known, guard, -1))] = False
    share = guard_s[known] / dark_s[known]
    excess = float((guard[known] - dark[known] * share).sum())
    noise = float(np.sqrt((dark[known] * share * (1 + share)).sum() + 1))
    rate = float((light[known] / light_s[known] - dark[known] / dark_s[known]).sum())
    if excess <= CERTAIN_SIGMAS * noise or rate <= 0:
        return ()
    late = excess / rate
    detail = (
        f"all markers, by {late * 1e6:.1f} µs: the light of each frame begins before its marker"
    )
    if windows.room < late:
        detail += (
            f", and gates end {max(windows.room, 0) * 1e6:.1f} µs before the next marker: mend the "
            "trigger, or count a shorter --exposure"
        )
    return (Fault(kind="late", detail=detail),)


@dataclass(frozen=True)
class FrameParts:
    """Equal parts of each frame of a pass, between settling and guard."""

    frame: np.ndarray  # (F K,): Of each part
    # (F K,): When a part begins after its frame's start, and for how long, seconds
    offset: np.ndarray
    length: np.ndarray  # (F K,)
    middles: np.ndarray  # (F, K): Middle of each part after the start of the pass, seconds


def find_frame_parts(found: Frames, settle_s: float, number: int) -> FrameParts:
    """Parts of the frames of a recording."""
    pictures = found.pictures_s
    rest = pictures - settle_s
    each = np.maximum(rest - np.minimum(found.tolerance_s, GUARD_SHARE * rest), 0.0) / number
    offset = settle_s + each[:, None] * np.arange(number)
    starts = np.cumsum(pictures) - pictures
    middles = starts[:, None] + offset + each[:, None] / 2
    frame = np.repeat(np.arange(len(pictures)), number)
    return FrameParts(frame, offset.ravel(), np.repeat(each, number), middles)


def count_overlapping(
    path: Path,
    starts: np.ndarray,
    stops: np.ndarray,
    inputs: Sequence[int],
    report: Progress = SILENT,
) -> np.ndarray:
    """Photons (n, inputs) in windows, starts and stops (n,), that may overlap, in any order."""
    edges = np.stack([starts, stops])
    unique, places = np.unique(edges, return_inverse=True)
    found = count_windows(path, unique[:-1], unique[1:], inputs, report)
    before = np.pad(np.cumsum(found, axis=0), ((1, 0), (0, 0)))[places.reshape(edges.shape)]
    return np.asarray(before[1] - before[0])


def in_ticks(seconds: np.ndarray, tick_s: float) -> np.ndarray:
    """Times in ticks, rounded."""
    return np.rint(seconds / tick_s).astype(np.int64)
