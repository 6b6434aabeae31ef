"""Gates of a recording: frames found by their markers, and windows in which photons are counted."""

from dataclasses import dataclass

import numpy as np

from deepfsi.errors import InputError
from deepfsi.hardware.patterns.sequence import Manifest
from deepfsi.hardware.patterns.timing import Gates
from deepfsi.hardware.ptu.header import Header
from deepfsi.hardware.ptu.reader import count_gates, read_markers
from deepfsi.hardware.recording.acquisition import Acquisition
from deepfsi.hardware.recording.alignment import align
from deepfsi.hardware.recording.faults import Fault
from deepfsi.progress import Report


def find_frames(
    header: Header, acquisition: Acquisition, manifest: Manifest, report: Report
) -> tuple[np.ndarray, np.ndarray, list[Fault]]:
    """Start of each frame (S, F) in seconds, scenes whose masks' frames are whole (S,), faults.

    Parameters
    ----------
    header : Header
        Of the photon file.
    acquisition : Acquisition
    manifest : Manifest
        Of the patterns that were shown.
    report : Report
        Given the share of the file whose markers are read.
    """
    path, tick_s = header.path, header.tick_s
    times, bits = read_markers(path, report)
    times = times[bits & acquisition.marker_bit != 0]
    end = int(times.max(initial=0)) - header.kind.wrap if header.problems else None

    def counter(starts: np.ndarray, stops: np.ndarray) -> np.ndarray:
        edges = np.clip(np.stack([in_ticks(starts, tick_s), in_ticks(stops, tick_s)]), 0, end)
        unique, places = np.unique(edges, return_inverse=True)
        found = count_gates(path, unique[:-1], unique[1:], acquisition.inputs[:1])[:, 0]
        before = np.append(0, np.cumsum(found))[places.reshape(edges.shape)]
        return before[1] - before[0]

    try:
        aligned = align(times * tick_s, manifest, len(acquisition.scenes), counter=counter)
    except InputError as error:
        raise InputError(f"{path} has {len(times)} frame markers: {error}") from None
    starts = aligned.starts_s.copy()
    last = float(times.max(initial=0)) * tick_s
    if header.problems:
        starts[starts >= last] = np.nan  # the frame that was being recorded when the file ended
    shown = starts[:, manifest.shown]
    # A mask's frame is whole if a marker came after it.
    whole = np.isfinite(shown).all(axis=1) & (shown[:, -1] < last)
    if not whole.any():
        why = aligned.faults[0] if aligned.faults else "it ends too early"
        raise InputError(f"{path} has no whole exposure ({why}): record again")
    return starts, whole, list(aligned.faults)


@dataclass(frozen=True)
class Windows:
    """Windows of a pass in order: its gates, and what of each frame they leave after settling.

    Attributes
    ----------
    frame : array, shape (g,)
        Of each window.
    offset, length : arrays, shape (g,)
        When a window opens after its frame's start, and for how long, seconds.
    gates : array, shape (f, R)
        Places of the gates among the windows.
    frames : int
        Frames of a pass, F.
    """

    frame: np.ndarray
    offset: np.ndarray
    length: np.ndarray
    gates: np.ndarray
    frames: int

    @classmethod
    def of(cls, manifest: Manifest, gates: Gates) -> "Windows":
        """Windows of a pass over the frames of a manifest."""
        repeats, frames = gates.repeats, len(manifest.frames)
        each = np.ones(frames, np.int64)
        each[manifest.shown] += repeats
        frame = np.repeat(np.arange(frames), each)
        first = np.cumsum(each) - each
        places = first[manifest.shown][:, None] + np.arange(repeats)
        offset = np.full(len(frame), gates.settle_s)
        offset[places] = gates.starts_s
        offset[places[:, -1] + 1] = gates.settle_s + repeats * gates.length_s
        length = np.maximum(manifest.picture_s[frame] - offset, 0.0)
        length[places] = gates.length_s[:, None]
        return cls(frame, offset, length, places, frames)

    def sum_frames(self, values: np.ndarray) -> np.ndarray:
        """Sums over the windows of each frame, along the second axis."""
        return np.add.reduceat(values, np.searchsorted(self.frame, np.arange(self.frames)), axis=1)


def in_ticks(seconds: np.ndarray, tick_s: float) -> np.ndarray:
    """Times in ticks, rounded."""
    return np.rint(seconds / tick_s).astype(np.int64)
