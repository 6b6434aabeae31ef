"""Image scans: photons counted between the markers of a line's start and end, in lines and pixels.

A microscope's scanner marks where each line starts and ends, and each frame once, at its start or
end. Software of PicoQuant writes into the header on which inputs, and whether every second line
runs back. Lines without either marker are
left out and named, as are frames of an unusual number of lines.
"""

import os
from collections import Counter
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from deepfsi.base.errors import InputError
from deepfsi.base.progress import SILENT, Report
from deepfsi.hardware.photons.gate_counter import cut_gates
from deepfsi.hardware.photons.header import Header, read_header
from deepfsi.hardware.photons.reader import count_gates, read_markers

TAGS = {"line_start": "ImgHdr_LineStart", "line_end": "ImgHdr_LineStop", "frame": "ImgHdr_Frame"}
"""Tags of a header that number the marker inputs, from 1."""

MOST_NAMED = 10
"""Faults of one kind that are named one by one."""


@dataclass(frozen=True)
class ScanMarkers:
    """Marker inputs, 0 to 3, of an image scan; those of the header unless given."""

    line_start: int | None = None
    line_end: int | None = None
    frame: int | None = None

    def bits(self, header: Header) -> tuple[int, int, int]:
        """Bit of each input; 0 for a frame that is not marked."""
        every: dict[str, int | None] = dict(vars(self))
        for name, tag in TAGS.items():
            number = header.tags.get(tag)
            if every[name] is None and isinstance(number, int) and number > 0:
                every[name] = number - 1
        for name in ("line_start", "line_end"):
            if every[name] is None:
                raise InputError(
                    f"{header.path} does not say on which marker input the {name[5:]} of a line "
                    f"is: give `{name}`, 0 to 3"
                )
        numbers = [each for each in every.values() if each is not None]
        if any(not 0 <= each <= 3 for each in numbers) or len(set(numbers)) < len(numbers):
            raise InputError(
                f"marker inputs {', '.join(map(str, numbers))} of line start, line end and frame: "
                "give different ones, 0 to 3"
            )
        start, end, frame = (0 if each is None else 1 << each for each in every.values())
        return start, end, frame


@dataclass(frozen=True)
class Scan:
    """Photons of an image scan, line after line."""

    counts: np.ndarray  # (lines, pixels, inputs) int64
    frame: np.ndarray  # (lines,): number of the frame of each, from 0
    starts_s: np.ndarray  # (lines,): start and end of each line, seconds
    ends_s: np.ndarray
    faults: tuple[str, ...]

    @property
    def frames(self) -> np.ndarray:
        """Photons (frames, lines, pixels) of all inputs, of the frames of the usual lines."""
        sizes = np.bincount(self.frame)
        usual = np.flatnonzero(sizes == _commonest(sizes))
        light = self.counts.sum(axis=2)
        return np.stack([light[self.frame == number] for number in usual])


def count_scan(
    path: str | os.PathLike[str],
    markers: ScanMarkers,
    pixels: int = 1,
    inputs: Sequence[int] = (0,),
    report: Report = SILENT,
) -> Scan:
    """Count the photons of each line of an image scan in so many equal pixels."""
    header = read_header(path)
    start, end, frame = markers.bits(header)
    first, second = report.part(0.0, 0.3), report.part(0.3, 1.0)
    times, bits = read_markers(path, first)
    lines, faults = _lines(times, bits, (start, end), header.tick_s)
    if not len(lines):
        raise InputError(
            f"{path} has no line from a marker on {start.bit_length() - 1} to one on "
            f"{end.bit_length() - 1}: `deepfsi camera inspect` lists its markers"
        )
    numbers = np.searchsorted(times[(bits & frame) > 0], lines[:, 0], side="right")
    numbers = np.unique(numbers, return_inverse=True)[1]
    faults += _frame_faults(numbers, header)
    starts, ends = cut_gates(lines[:, 0], lines[:, 1], pixels)
    counts = count_gates(path, starts, ends, inputs, second)
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
        counts,
        numbers,
        seconds[:, 0],
        seconds[:, 1],
        (*header.problems, *faults),
    )


def _lines(
    times: np.ndarray, bits: np.ndarray, line: tuple[int, int], tick_s: float
) -> tuple[np.ndarray, list[str]]:
    """Starts and ends (lines, 2) in ticks, and the lines that lack a marker."""
    start, end = line
    kept = np.flatnonzero(bits & (start | end))
    times, bits = times[kept], bits[kept]
    both = np.flatnonzero((bits & start > 0) & (bits & end > 0))
    if len(both):
        raise InputError(
            f"{len(both)} markers are start and end of a line at once, the first at "
            f"{times[both[0]] * tick_s:.6g} s: give inputs that are not marked together"
        )
    starts = bits & start > 0
    whole = np.flatnonzero(starts[:-1] & ~starts[1:])
    paired = np.zeros(len(times), bool)
    paired[whole], paired[whole + 1] = True, True
    faults = []
    for is_start, lost, bit in ((True, "end", end), (False, "start", start)):
        alone = np.flatnonzero(~paired & (starts == is_start))
        faults += [
            f"a line {'from' if is_start else 'to'} {times[place] * tick_s:.6g} s has no {lost}: a "
            f"marker on {bit.bit_length() - 1} is lost, and the line is left out"
            for place in alone[:MOST_NAMED]
        ]
        if len(alone) > MOST_NAMED:
            faults.append(f"{len(alone) - MOST_NAMED} more lines have no {lost}")
    return np.stack([times[whole], times[whole + 1]], axis=1), faults


def _commonest(sizes: np.ndarray) -> int:
    return Counter(sizes.tolist()).most_common(1)[0][0]


def _frame_faults(frame: np.ndarray, header: Header) -> list[str]:
    """Frames of an unusual number of lines, by the header or by the others."""
    sizes = np.bincount(frame)
    said = header.tags.get("ImgHdr_PixY")
    usual = said if isinstance(said, int) and said > 0 else _commonest(sizes)
    by = "the header says" if usual == said else "most have"
    wrong = np.flatnonzero(sizes != usual)
    faults = [
        f"frame {number + 1} has {sizes[number]} lines, where {by} {usual}"
        for number in wrong[:MOST_NAMED]
    ]
    if len(wrong) > MOST_NAMED:
        faults.append(f"{len(wrong) - MOST_NAMED} more frames have other numbers of lines")
    return faults
