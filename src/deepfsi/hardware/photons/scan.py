"""Image scans: photons counted between the markers of a line's start and end, in lines and pixels.

A microscope's scanner marks where each line starts and ends, and each frame once, at its start or
end. Software of PicoQuant writes into the header on which inputs, and whether every second line
runs back. Lines without either marker are
left out and named, as are frames of an unusual number of lines.
"""

import io
import os
from collections import Counter
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from deepfsi.base.errors import InputError
from deepfsi.base.files import write_atomically
from deepfsi.base.progress import SILENT, Progress
from deepfsi.base.quantities import plural
from deepfsi.hardware.photons.ptu import Header
from deepfsi.hardware.photons.reader import PtuFile, count_windows, cut_windows, read_markers

TAGS = {"line_start": "ImgHdr_LineStart", "line_end": "ImgHdr_LineStop", "frame": "ImgHdr_Frame"}
"""Tags of a header that number the marker inputs, from 1."""

MOST_NAMED_FAULTS = 10
"""Faults of one kind that are named one by one."""


@dataclass(frozen=True)
class ScanMarkers:
    """Marker inputs of an image scan, 0 to 3; those of the header unless given."""

    line_start: int | None = None
    line_end: int | None = None
    frame: int | None = None  # of the start or the end of each frame

    def of_header(self, header: Header) -> "ScanMarkers":
        """Markers with those that only the header gives."""
        inputs: dict[str, int | None] = dict(vars(self))
        for name, tag in TAGS.items():
            number = header.tags.get(tag)
            if inputs[name] is None and isinstance(number, int) and number > 0:
                inputs[name] = number - 1
        for name in ("line_start", "line_end"):
            if inputs[name] is None:
                raise InputError(
                    "{path} does not say on which marker input the {end} of a line is: give "
                    "{setting}, 0 to 3",
                    setting=name,
                    path=header.path,
                    end=name[5:],
                )
        numbers = [number for number in inputs.values() if number is not None]
        if any(not 0 <= number <= 3 for number in numbers) or len(set(numbers)) < len(numbers):
            raise InputError(
                f"marker inputs {', '.join(map(str, numbers))} of line start, line end and frame: "
                "give different ones, 0 to 3"
            )
        return ScanMarkers(**inputs)


@dataclass(frozen=True)
class Scan:
    """Photons of an image scan, line after line."""

    counts: np.ndarray  # photons, int64 (lines, pixels, inputs)
    frame: np.ndarray  # number of the frame of each line, from 0, (lines,)
    starts_s: np.ndarray
    ends_s: np.ndarray
    faults: tuple[str, ...]  # lines and frames that lack something, in words

    @property
    def frames(self) -> np.ndarray:
        """Photons (frames, lines, pixels) of all inputs, of the frames of the usual lines."""
        sizes = np.bincount(self.frame)
        usual = np.flatnonzero(sizes == _commonest(sizes))
        light = self.counts.sum(axis=2)
        return np.stack([light[self.frame == number] for number in usual])

    def as_dict(self) -> dict[str, Any]:
        """JSON types only, without the counts."""
        sizes = np.bincount(self.frame).tolist()
        return {
            "photons": int(self.counts.sum()),
            "lines": len(self.frame),
            "frames": len(sizes),
            "pixels": self.counts.shape[1],
            "lines_of_frames": sizes,
            "faults": list(self.faults),
        }

    def lines(self) -> list[str]:
        """Say what was counted, and what was left out."""
        content = self.as_dict()
        sizes = ", ".join(plural(content[name], name[:-1]) for name in ("frames", "lines"))
        return [
            *self.faults,
            f"{sizes} of {plural(content['pixels'], 'pixel')}",
            f"{content['photons']} photons between the markers of lines",
        ]

    def save(self, path: Path) -> None:
        """Write counts, frames and times of the lines, .npz."""
        content = io.BytesIO()
        arrays = {name: value for name, value in vars(self).items() if name != "faults"}
        np.savez_compressed(content, **arrays)
        write_atomically(path, content.getvalue())


def count_scan(
    path: str | os.PathLike[str],
    markers: ScanMarkers,
    pixels: int = 1,
    inputs: Sequence[int] = (0,),
    progress: Progress = SILENT,
) -> Scan:
    """Count the photons of each line of an image scan in so many equal pixels."""
    source = PtuFile(path)
    header = source.header
    markers = markers.of_header(header)
    times, bits = read_markers(source, progress.between(0.0, 0.3))
    lines, faults = _find_lines(times, bits, markers, header.tick_s)
    if not len(lines):
        raise InputError(
            f"{path} has no line from a marker on {markers.line_start} to one on "
            f"{markers.line_end}: `deepfsi camera inspect` lists its markers"
        )
    frame_markers = times[(bits & _bit(markers.frame)) > 0]
    numbers = np.searchsorted(frame_markers, lines[:, 0], side="right")
    numbers = np.unique(numbers, return_inverse=True)[1]
    faults += _frame_faults(numbers, header)
    starts, ends = cut_windows(lines[:, 0], lines[:, 1], pixels)
    counts = count_windows(source, starts, ends, inputs=inputs, progress=progress.between(0.3, 1.0))
    counts = counts.reshape(len(lines), pixels, len(inputs))
    if header.tags.get("ImgHdr_BiDirect"):  # every second line of a frame runs back
        back = (np.arange(len(lines)) - np.searchsorted(numbers, numbers)) % 2 == 1
        counts[back] = counts[back, ::-1]
    if header.tags.get("ImgHdr_SinCorrection") and pixels > 1:
        faults.append(
            "the header says that the scanner's speed is no constant: pixels are equal in time, "
            "and not in width"
        )
    seconds = lines * header.tick_s
    return Scan(
        counts=counts,
        frame=numbers,
        starts_s=seconds[:, 0],
        ends_s=seconds[:, 1],
        faults=(*header.problems, *faults),
    )


def _bit(marker: int | None) -> int:
    """Bit of a marker input; 0 of none."""
    return 0 if marker is None else 1 << marker


def _find_lines(
    times: np.ndarray, bits: np.ndarray, markers: ScanMarkers, tick_s: float
) -> tuple[np.ndarray, list[str]]:
    """Starts and ends (lines, 2) in ticks, and the lines that lack a marker."""
    start = _bit(markers.line_start)
    end = _bit(markers.line_end)
    kept = np.flatnonzero(bits & (start | end))
    times = times[kept]
    bits = bits[kept]
    both = np.flatnonzero((bits & start > 0) & (bits & end > 0))
    if len(both):
        raise InputError(
            f"{len(both)} markers are start and end of a line at once, the first at "
            f"{times[both[0]] * tick_s:.6g} s: give inputs that are not marked together"
        )
    starts = bits & start > 0
    first = np.flatnonzero(starts[:-1] & ~starts[1:])
    paired = np.zeros(len(times), bool)
    paired[first] = True
    paired[first + 1] = True
    faults = []
    for is_start, lost, number in (
        (True, "end", markers.line_end),
        (False, "start", markers.line_start),
    ):
        alone = times[~paired & (starts == is_start)] * tick_s
        lines = [
            f"a line {'from' if is_start else 'to'} {time:.6g} s has no {lost}: a marker on "
            f"{number} is lost, and the line is left out"
            for time in alone[:MOST_NAMED_FAULTS]
        ]
        faults += [*lines, *_more_faults(len(alone), f"lines have no {lost}")]
    return np.stack([times[first], times[first + 1]], axis=1), faults


def _more_faults(count: int, words: str) -> list[str]:
    """Line that says how many of so many faults are not named, if any."""
    more = count - MOST_NAMED_FAULTS
    return [f"{more} more {words}"] if more > 0 else []


def _commonest(sizes: np.ndarray) -> int:
    return Counter(sizes.tolist()).most_common(1)[0][0]


def _frame_faults(frame: np.ndarray, header: Header) -> list[str]:
    """Frames of an unusual number of lines, by the header or by the others."""
    sizes = np.bincount(frame)
    planned = header.tags.get("ImgHdr_PixY")
    usual = planned if isinstance(planned, int) and planned > 0 else _commonest(sizes)
    by = "the header says" if usual == planned else "most have"
    wrong = np.flatnonzero(sizes != usual)
    return [
        *(
            f"frame {number + 1} has {sizes[number]} lines, where {by} {usual}"
            for number in wrong[:MOST_NAMED_FAULTS]
        ),
        *_more_faults(len(wrong), "frames have other numbers of lines"),
    ]
