"""Writing PTU files: of simulated and live recordings, and of events of other makes of counter.

The trigger of another make becomes a marker, and the channels of its detectors become inputs. So
whatever reads PTU files reads these.
"""

import os
import struct
from collections.abc import Sequence
from contextlib import AbstractContextManager, ExitStack
from importlib.metadata import version
from pathlib import Path
from typing import Any, BinaryIO, Self

import numpy as np
import numpy.typing as npt

from deepfsi.base.errors import InputError
from deepfsi.base.files import GrowingFile, open_atomically
from deepfsi.base.tables import read_whole_numbers
from deepfsi.counting.ptu import GENERIC_T2, MAGIC, TICKS_S


class PtuWriter:
    """Writer of a T2 file of type Generic, as a context manager.

    The file appears when the block ends, and not at all if the block fails. A `growing` file is
    there from the start, so that it can be read while it is written.
    """

    def __init__(
        self, path: str | os.PathLike[str], tick_s: float = 1e-12, *, growing: bool = False
    ) -> None:
        if not TICKS_S[0] <= tick_s <= TICKS_S[1]:
            raise InputError(f"a tick of {tick_s!r} s is not allowed: give 1e-15 to 1")
        self._path = path
        self._tick_s = float(tick_s)
        self._growing = growing
        self._records = self._latest = self._overflows = 0

    def __enter__(self) -> Self:
        opened: AbstractContextManager[BinaryIO | GrowingFile] = (
            GrowingFile(self._path) if self._growing else open_atomically(self._path)
        )
        with ExitStack() as stack:
            self._file = stack.enter_context(opened)
            self._write_header()
            stack.callback(self._write_header)  # again, with the number of records
            self._opened = stack.pop_all()
        return self

    def __exit__(self, *error: Any) -> None:
        self._opened.__exit__(*error)

    def write(self, times: np.ndarray, codes: np.ndarray) -> None:
        """Append events at ticks (n,), with codes (n,); ticks rise over all calls.

        Codes 0 to 63 are photons on inputs 1 to 64; codes -1 to -15 are markers with bits 1 to 15.
        """
        for start in range(0, len(times), 2**18):  # bounds the memory that words take
            stop = start + 2**18
            self._append(times[start:stop], codes[start:stop])

    def write_records(self, words: np.ndarray) -> None:
        """Append records, uint32 (n,), as a device gives them."""
        self._file.write(words.astype("<u4").tobytes())
        self._records += len(words)

    def _append(self, times: np.ndarray, codes: np.ndarray) -> None:
        """Append events, one or more."""
        in_order = self._latest <= int(times[0]) and (times[1:] >= times[:-1]).all()
        if not in_order or times[-1] > 2**55 or codes.min() < -15 or codes.max() > 63:
            raise InputError(
                "events cannot be written: give times that do not run back, up to 2^55 ticks, and "
                "codes 0 to 63 for photons or -1 to -15 for markers"
            )
        times = times.astype(np.int64)
        codes = codes.astype(np.int64)
        marker = 1 << 31 | -codes << GENERIC_T2.shift
        words = np.where(codes < 0, marker, codes << GENERIC_T2.shift)
        words |= times & GENERIC_T2.time_mask

        # Overflow records before an event that needs them
        overflows = times >> GENERIC_T2.time_bits
        steps = np.diff(overflows, prepend=self._overflows)
        late = np.flatnonzero(steps)  # events whose time needs overflows first
        most = 127  # overflows of one record: ptufile 2026.2 multiplies them in 32 bits
        copies = -(-steps[late] // most)
        counts = np.full(int(copies.sum()), most)
        counts[np.cumsum(copies) - 1] = steps[late] - (copies - 1) * most
        records = 1 << 31 | 63 << GENERIC_T2.shift | counts
        words = np.insert(words, np.repeat(late, copies), records)

        self.write_records(words)
        self._latest = int(times[-1])
        self._overflows = int(overflows[-1])

    def _write_header(self) -> None:
        """Write the header, with the number of records so far."""
        tags: dict[str, str | int | float | None] = {
            "CreatorSW_Name": "deepfsi",
            "CreatorSW_Version": version("deepfsi"),
            "Measurement_Mode": 2,
            "Measurement_SubMode": 1,
            "TTResultFormat_TTTRRecType": GENERIC_T2.code,
            "TTResultFormat_BitsPerRecord": 32,
            "MeasDesc_GlobalResolution": self._tick_s,
            "TTResult_NumberOfRecords": self._records,
            "Header_End": None,
        }
        encoded = b"".join(_encode_tag(name, value) for name, value in tags.items())
        self._file.seek(0)
        self._file.write(struct.pack("<8s8s", MAGIC, b"1.0.00") + encoded)


def _encode_tag(name: str, value: str | int | float | None) -> bytes:
    """Encode one tag, without an index."""

    def tag(code: int, field: bytes, content: bytes = b"") -> bytes:
        return struct.pack("<32siI8s", name.encode("ascii"), -1, code, field) + content

    if isinstance(value, str):
        content = value.encode("windows-1252") + b"\0"
        content += bytes(-len(content) % 8)
        return tag(0x4001FFFF, struct.pack("<q", len(content)), content)
    if isinstance(value, float):
        return tag(0x20000008, struct.pack("<d", value))
    if isinstance(value, int):
        return tag(0x10000008, struct.pack("<q", value))
    return tag(0xFFFF0008, bytes(8))


def write_ptu(
    path: str | os.PathLike[str],
    times: npt.ArrayLike,
    channels: npt.ArrayLike,
    *,
    marker: int | None = None,
    inputs: Sequence[int] = (),
    tick_s: float = 1e-12,
) -> tuple[int, ...]:
    """Write the events of another make of counter as a PTU file, as `camera count` reads it.

    Times (n,), in any order of channels, are ticks if they are integers, and seconds if they are
    floats; the clock begins with the first event. The channel of the device's trigger becomes
    marker 0. Channels of detectors become inputs 1, 2, … in order; default: all other channels.
    Returns the channel of each input.
    """
    opened = PtuWriter(path, tick_s)
    times = np.asarray(times)
    if times.dtype.kind == "f":
        times = np.rint(times / tick_s).astype(np.int64)
    channels = np.asarray(channels)
    available = np.unique(channels).tolist()
    inputs = tuple(inputs) or tuple(channel for channel in available if channel != marker)
    wanted = (*(() if marker is None else (marker,)), *inputs)
    for channel in wanted:
        if channel not in available:
            active = ", ".join(map(str, available[:20])) or "none"
            raise InputError(f"channel {channel} has no events; there are some on {active}")
    most = GENERIC_T2.inputs
    if not 0 < len(inputs) <= most or len(set(wanted)) < len(wanted):
        raise InputError(
            f"channels {inputs} for the detectors beside {marker} for the trigger are not allowed: "
            f"give 1 to {most} other ones, each once"
        )
    codes = np.full(len(times), most)
    for code, channel in enumerate(wanted, start=len(inputs) - len(wanted)):
        events = np.flatnonzero(channels == channel)
        codes[events] = code
        # Channels may follow each other in a list: each counts its time for itself, to 1 µs
        ticks = times[events]
        slack = max(round(1e-6 / tick_s), 1)
        back = np.flatnonzero(ticks[1:] < np.maximum.accumulate(ticks)[:-1] - slack)
        if len(back):
            raise InputError(
                f"time runs back on channel {channel}, event {events[back[0] + 1] + 1}: from "
                f"{ticks[back[0]]} to {ticks[back[0] + 1]} ticks of {tick_s:g} s. The clock began "
                "anew or overflowed, or these are several recordings: give each alone, with times "
                "that count on"
            )
    kept = np.flatnonzero(codes < most)
    order = kept[np.argsort(times[kept], kind="stable")]
    with opened as writer:
        writer.write(times[order] - times[order[0]], codes[order])
    return inputs


def read_events(path: Path) -> tuple[np.ndarray, np.ndarray]:
    """Times in ticks and channels (n,) of a table of events: columns `time` and `channel`."""
    times, channels = read_whole_numbers(path, _columns).T
    # More channels than any counter has: the columns are exchanged
    if (count := len(np.unique(channels))) > 64:
        raise InputError(
            f"{path} has {count} different numbers in its column of channels: name the columns "
            "'time' and 'channel', or give the time first"
        )
    return times, channels


def _columns(names: tuple[str, ...], width: int) -> tuple[int, int]:
    """Columns of the time and the channel: by these names, or the first two of two."""
    lower = [name.strip().lower() for name in names]
    if {"time", "channel"} <= set(lower):
        return lower.index("time"), lower.index("channel")
    if width != 2:
        raise InputError(
            f"a table of events has {width} columns: give two, the time and the channel of each "
            "event, or name those two 'time' and 'channel'"
        )
    return 0, 1
