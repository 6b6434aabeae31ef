"""Frames of a recording, found by their markers, and windows of them in which photons are counted.

A device gives one marker at the start of each frame, and a counter records it on its own clock. On
that clock a pass follows the schedule of its manifest within 200 ppm. Pauses between passes may
have any length. The counter's clock and the device's may differ, and a device may add the same time
to every frame. Either stretches the schedule; consecutive markers tell which one it is.

A recording whose markers do not all follow is refused: times alone cannot tell a pass that lacks
its first marker from one that lacks its last, when all frames are equally long.

A marker may come late. Counts up to it then hold light of the next frame: a microsecond of 1e7
photons/s looks like thousands of dark counts/s in an all-OFF frame. So windows other than gates end
a *guard* before the next frame: the tolerance of the markers.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Self

import numpy as np

from deepfsi.base.errors import InputError
from deepfsi.base.progress import SILENT, Progress
from deepfsi.base.quantities import time_text
from deepfsi.counting.acquisition import Acquisition
from deepfsi.counting.reader import PhotonSource, count_windows, read_markers
from deepfsi.patterns.manifest import GatePlan, Manifest


@dataclass(frozen=True)
class Windows:
    """Windows of a pass, one after another."""

    frame: np.ndarray  # (g,): Of each window
    offset_s: np.ndarray  # (g,): When it opens after the start of its frame
    length_s: np.ndarray  # (g,)
    gate: np.ndarray  # (g,), bool: readouts of the masks' frames

    @classmethod
    def of_gates(cls, manifest: Manifest, gates: GatePlan, starts: "FrameStarts") -> Self:
        """Gates of the masks' frames, and windows over the rest of all frames."""
        count = np.ones(len(manifest.frames), np.int64)
        count[manifest.mask_frames] += gates.repeats
        frame = np.repeat(np.arange(len(count)), count)
        first = np.cumsum(count) - count
        gated = first[manifest.mask_frames][:, None] + np.arange(gates.repeats)  # (f, R)
        # A guard takes up to half of a frame after settling
        guard_s = np.minimum(manifest.usual_tolerance_s, 0.5 * (starts.pictures_s - gates.settle_s))
        ends = starts.pictures_s - guard_s
        offset = np.full(len(frame), gates.settle_s)
        offset[gated] = gates.starts_s
        offset[gated[:, -1] + 1] = gates.settle_s + gates.repeats * gates.length_s
        length = np.maximum(ends[frame] - offset, 0.0)
        length[gated] = gates.length_s[:, None]
        gate = np.zeros(len(frame), bool)
        gate[gated] = True
        return cls(frame, offset, length, gate)

    @classmethod
    def of_clicks(cls, manifest: Manifest, gates: GatePlan, click_gates: int) -> Self:
        """Click gates: equal divisions of each gate, and as many of each sentinel frame."""
        # A sentinel is divided after settling, up to the usual tolerance of markers before its end
        width = (manifest.picture_s - gates.settle_s - manifest.usual_tolerance_s) / click_gates
        width[manifest.mask_frames] = gates.length_s / click_gates
        count = np.full(len(width), click_gates)
        count[manifest.mask_frames] *= gates.repeats
        frame = np.repeat(np.arange(len(count)), count)
        order = np.arange(len(frame)) - (np.cumsum(count) - count)[frame]
        return cls(
            frame,
            offset_s=gates.settle_s + order * width[frame],
            length_s=width[frame],
            gate=np.isin(frame, manifest.mask_frames),
        )


@dataclass(frozen=True)
class WindowCounts:
    """Photons in the windows of passes."""

    photons: np.ndarray  # (P, g, inputs), int64
    open_s: np.ndarray  # (P, g): How long each window was open
    windows: Windows

    def per_frame(self) -> tuple[np.ndarray, np.ndarray]:
        """Photons (P, F, inputs) of whole frames, and how long they were counted."""
        first = np.flatnonzero(np.diff(self.windows.frame, prepend=-1))
        photons = np.add.reduceat(self.photons, first, axis=1)
        return photons, np.add.reduceat(self.open_s, first, axis=1)

    def gates(self, repeats: int) -> np.ndarray:
        """Photons (P, R, f, inputs) in the gates of the masks' frames."""
        gated = self.photons[:, self.windows.gate]
        return gated.reshape(len(gated), -1, repeats, gated.shape[-1]).swapaxes(1, 2)


MOST_DRIFT = 2e-4
"""Largest relative difference of two clocks, as planned or as measured."""

MOST_RATE = 0.02
"""Largest share by which all frames may be longer or shorter than planned."""

MOST_EXTRA = 0.2
"""Largest time that may be added to each frame, as a share of the shortest."""


@dataclass(frozen=True)
class FrameStarts:
    """Frames of a recording, as its markers say when they start."""

    starts_s: np.ndarray  # (S, F): Seconds on the counter's clock
    pictures_s: np.ndarray  # (F,): Picture times on the counter's clock
    drift: float  # by how much passes last longer than planned, as a share: their median

    @classmethod
    def find(
        cls,
        source: PhotonSource,
        acquisition: Acquisition,
        manifest: Manifest,
        progress: Progress = SILENT,
    ) -> Self:
        """Frames of a recording by its markers."""
        times, bits = read_markers(source, progress)
        frame_markers = bits & acquisition.marker_bit != 0
        if not frame_markers.any():
            raise InputError(
                f"{source.header.path} has 0 frame markers on marker input "
                f"{acquisition.marker_bit.bit_length() - 1}: write the bit of another one, as "
                "`deepfsi camera inspect` lists them, into acquisition.json, or wire the trigger"
            )
        times_s = np.sort(times[frame_markers] * source.header.tick_s)
        try:
            return cls.of(times_s, manifest, len(acquisition.scenes))
        except InputError as error:
            raise InputError(
                f"{source.header.path} has {len(times_s)} frame markers: {error}"
            ) from None

    @classmethod
    def of(cls, times_s: np.ndarray, manifest: Manifest, scenes: int) -> Self:
        """Frames that markers (n,) start; `InputError` if these do not follow the schedule."""
        planned = manifest.picture_s
        tolerance = manifest.usual_tolerance_s
        # A pass that was begun after the last one is left out
        passes, begun = divmod(len(times_s), len(planned))
        starts = times_s[: len(times_s) - begun].reshape(passes, len(planned))
        pictures = planned
        if not _follows(starts, planned, tolerance):
            pictures = _as_measured(times_s, planned, tolerance)
            if not _follows(starts, pictures, tolerance):
                raise InputError(_first_departure(times_s, pictures, tolerance))
        if passes != scenes:
            raise InputError(
                f"they are of {passes} whole passes, and there are {scenes} scenes: record again, "
                "or keep the scenes that were recorded in acquisition.json"
            )
        # the last frame of a pass has no marker at its end
        drifts = np.ptp(starts, axis=1) / np.cumsum(planned)[-2] - 1
        return cls(starts, pictures, drift=float(np.median(drifts)))

    def count_in(
        self,
        source: PhotonSource,
        windows: Windows,
        inputs: Sequence[int],
        progress: Progress = SILENT,
    ) -> WindowCounts:
        """Photons of the passes in windows.

        A window that reaches into the next, by two clocks and a marker's jitter, ends there.
        """
        tick_s = source.header.tick_s
        opens_s = self.starts_s[:, windows.frame] + windows.offset_s
        edges_s = np.stack([opens_s, opens_s + windows.length_s]).reshape(2, -1)
        begins, ends = np.rint(edges_s / tick_s).astype(np.int64)
        # starts must rise, as counting wants: none may come after a later one
        begins = np.minimum.accumulate(begins[::-1])[::-1]
        ends[:-1] = np.minimum(ends[:-1], begins[1:])
        photons = count_windows(source, begins, ends, inputs, progress=progress)
        shape = opens_s.shape
        return WindowCounts(
            photons.reshape(*shape, -1), ((ends - begins) * tick_s).reshape(shape), windows
        )


def _follows(starts: np.ndarray, pictures: np.ndarray, tolerance: float) -> bool:
    """True if markers (P, F) of passes come when the schedule says."""
    schedule = np.cumsum(pictures)[:-1]
    span = starts[:, -1] - starts[:, 0]
    rate = span / schedule[-1]  # clocks may differ: steps are compared at the rate of their pass
    steps = np.diff(np.append(0.0, schedule))
    off = np.abs(np.diff(starts) - steps * rate[:, None])
    drift = np.abs(span - schedule[-1]) - MOST_DRIFT * schedule[-1]
    overlap = starts[:-1, -1] + pictures[-1] * (1 - MOST_DRIFT) - starts[1:, 0]
    return all((apart <= tolerance).all() for apart in (off, drift, overlap))


def _as_measured(times: np.ndarray, pictures: np.ndarray, tolerance: float) -> np.ndarray:
    """Picture times (F,) on the counter's clock, or as planned if that clock hardly differs.

    All frames are longer by one factor, or by one time, whichever fits more runs of markers.
    """
    # Frames in a row that are compared with the schedule
    size = min(8, len(pictures) // 2)
    if len(times) <= size:
        return pictures
    # Runs of frames in the schedule, the first 4096
    planned = np.lib.stride_tricks.sliding_window_view(pictures[:-1], size)[:4096]
    steps = np.lib.stride_tricks.sliding_window_view(np.diff(times), size)
    # 64 runs of a recording: multiples of the golden section are spread evenly, out of step with
    # passes
    sampled = np.unique((np.arange(64) * 0.6180339887498949 % 1 * len(steps)).astype(np.int64))
    total = planned.sum(axis=1)
    shortest = float(pictures.min())
    blocks = steps[sampled][:, None]
    rate = blocks.sum(axis=2) / total - 1
    extra = (blocks.sum(axis=2) - total) / size
    off_rate = np.abs(blocks - (1 + rate[..., None]) * planned).max(axis=2)
    off_extra = np.abs(blocks - planned - extra[..., None]).max(axis=2)
    off_rate[np.abs(rate) > MOST_RATE] = np.inf
    off_extra[(extra > MOST_EXTRA * shortest) | (extra < -MOST_RATE * shortest)] = np.inf
    medians = {}
    for kind, values, departure in (("rate", rate, off_rate), ("extra", extra, off_extra)):
        best = np.arange(len(departure)), departure.argmin(axis=1)
        fits = np.stack([values[best], departure[best]], axis=1)
        close = fits[fits[:, 1] <= 2 * tolerance]
        if len(close) >= len(fits) / 8:
            medians[kind] = np.median(close, axis=0)
    if not medians:
        return pictures
    kind = min(medians, key=lambda kind: float(medians[kind][1]))
    value = float(medians[kind][0])
    measured = (1 + value) * pictures if kind == "rate" else pictures + value
    return measured if abs(measured.sum() / pictures.sum() - 1) > MOST_DRIFT else pictures


def _first_departure(times: np.ndarray, pictures: np.ndarray, tolerance: float) -> str:
    """Words for the first marker that leaves the schedule."""
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
