"""PTU files of PicoQuant: their header, the types of their records, and a writer.

A file is a header of tags and then records of 32 bits, as PicoQuant describes them:

- tags: https://github.com/PicoQuant/PicoQuant-Time-Tagged-File-Format-Demos/tree/master/doc
- records: the same folder's `apx_tttrrecords.html`
- the vendor's reader: the same repository's `PTU/Python/Read_PTU.py`
"""

import os
import struct
from collections.abc import Callable, Generator, Iterator
from contextlib import AbstractContextManager, contextmanager
from dataclasses import dataclass, replace
from importlib.metadata import version
from pathlib import Path
from typing import Any, BinaryIO, ClassVar, Literal, Self

import numpy as np

from deepfsi.base.errors import InputError
from deepfsi.base.files import GrowingFile, open_atomically, open_regular
from deepfsi.base.numeric.tables import TABLE_ENDINGS

MAGIC = b"PQTTTR"
"""First bytes of a file."""

LONGEST_HEADER = 2**22
"""Bytes of a header, or of one tag, at most."""

LATEST_WRITTEN_TICK = 2**55
"""Latest time that is written, ticks."""

EVENTS_IN_MEMORY = 2**18
"""Events that are encoded at once."""

MOST_WRAPS = 127
"""Overflows that are written as one record at most: ptufile 2026.2 multiplies them in 32 bits."""

TICKS_S = (1e-15, 1.0)
"""Shortest and longest tick that is believed, seconds."""

CONVERT = (
    "convert it with the package phconvert (T3 mode), or a demo of PicoQuant's to columns of times "
    "and channels, for `deepfsi camera import`"
)
NO_TIMES = "a histogram, which has no times of photons: record in T2 or T3 mode, as .ptu"

FOREIGN = {
    b"PQHISTO": f"is a file of PicoQuant with {NO_TIMES}",
    b"PQRESLT": "is a file of results of PicoQuant, not of photons: give the .ptu file",
    b"PicoHarp 300": f"is a file of a PicoHarp 300 in an older format (.pt2, .pt3): {CONVERT}",
    b"HydraHarp": f"is a file of a HydraHarp in an older format (.ht2, .ht3): {CONVERT}",
    b"TimeHarp": f"is a file of a TimeHarp in an older format (.t3r): {CONVERT}",
    b"\x89HDF": "is an HDF5 file: if it is Photon-HDF5, give its times and channels to `write_ptu`",
    b"SITT": "is a stream of a Swabian Time Tagger (.ttbin): read it with the class FileReader of "
    "its package, save times and channels as two columns, and give these to `camera import`",
}
"""What else counters write, by the first bytes."""

_VALUES: dict[int, Callable[[bytes], Any]] = {
    0xFFFF0008: lambda field: None,  # Empty8
    0x00000008: any,  # Bool8
    **dict.fromkeys(  # Int8, BitSet64, Color8
        (0x10000008, 0x11000008, 0x12000008),
        lambda field: int.from_bytes(field, "little", signed=True),
    ),
    **dict.fromkeys(  # Float8, TDateTime
        (0x20000008, 0x21000008), lambda field: struct.unpack("<d", field)[0]
    ),
}
"""Value of a tag by its type, from its 8 bytes."""

_CONTENTS: dict[int, Callable[[bytes], Any]] = {
    0x2001FFFF: lambda raw: np.frombuffer(raw[: len(raw) // 8 * 8], "<f8"),  # Float8Array
    0x4001FFFF: lambda raw: raw.rstrip(b"\0").decode("windows-1252", "replace"),  # AnsiString
    0x4002FFFF: lambda raw: raw.decode("utf-16-le", "replace").rstrip("\0"),  # WideString
    0xFFFFFFFF: bytes,  # BinaryBlob
}
"""The same of types whose 8 bytes are the number of those that follow, from these."""


@dataclass(frozen=True)
class Kind:
    """A type of record: 32 bits, a channel field above a time field; Generic T2 by default."""

    name: str
    code: int
    mode: Literal["T2", "T3"] = "T2"
    shift: int = 25
    time_bits: int = 25
    wrap: int = 1 << 25
    counted: bool = True
    first: int = 0
    inputs: int = 64

    @property
    def time_mask(self) -> int:
        """Bits of the time."""
        return (1 << self.time_bits) - 1


PICOHARP_T2 = Kind(
    name="PicoHarp 300 T2",
    code=0x00010203,
    shift=28,
    time_bits=28,
    wrap=210_698_240,
    counted=False,
    inputs=5,
)
"""Record of a PicoHarp 300 in T2 mode."""

PICOHARP_T3 = Kind(
    name="PicoHarp 300 T3",
    code=0x00010303,
    mode="T3",
    shift=28,
    time_bits=16,
    wrap=65_536,
    counted=False,
    first=1,
    inputs=4,
)
"""Record of a PicoHarp 300 in T3 mode."""

GENERIC_T2 = Kind("Generic T2", 0x00010207)
"""Record of a recent device in T2 mode, as files are written here."""


def _both_modes(name: str, code: int, *, old: bool = False) -> tuple[Kind, Kind]:
    """Types of records, T2 and T3, of a HydraHarp or later; old ones count no overflows."""
    wrap = 33_552_000 if old else GENERIC_T2.wrap
    t2 = replace(GENERIC_T2, name=f"{name} T2", code=code, wrap=wrap, counted=not old)
    t3 = replace(t2, name=f"{name} T3", code=code + 0x100, mode="T3", time_bits=10, wrap=1 << 10)
    return t2, t3


KINDS = {
    kind.code: kind
    for kind in (
        PICOHARP_T2,
        PICOHARP_T3,
        *_both_modes("HydraHarp V1", 0x00010204, old=True),
        *_both_modes("HydraHarp V2", 0x01010204),
        *_both_modes("TimeHarp 260 N", 0x00010205),
        *_both_modes("TimeHarp 260 P", 0x00010206),
        *_both_modes("Generic", GENERIC_T2.code),
    )
}
"""Types of records by code."""


@dataclass(frozen=True)
class Header:
    """Header of a PTU file: its tags and the type of its records."""

    path: Path  # the file, or a name for a stream
    tags: dict[str, Any]  # values by name
    kind: Kind  # type of the records
    offset: int  # bytes before the first record
    tick_s: float  # seconds of a tick
    claimed: int  # records that the header says there are
    size: int | None = None  # bytes of the file

    @property
    def records(self) -> int:
        """Records to read: those claimed, or those that are there if fewer or unclaimed."""
        # More records than any file has
        most = 2**61 if self.size is None else (self.size - self.offset) // 4
        return min(self.claimed, most) if self.claimed > 0 else most

    @property
    def problems(self) -> tuple[str, ...]:
        """Reasons why the recording may be incomplete: none if the file holds what is claimed."""
        if self.size is None:
            return ()
        body = self.size - self.offset
        if self.claimed > body // 4:
            missing = self.claimed - body // 4
            return (f"{missing} of {self.claimed} records are missing: the file is cut",)
        if self.claimed <= 0 < body:
            return ("the header gives no number of records: the recording was not ended",)
        if 4 * self.claimed < body:
            extra = body - 4 * self.claimed
            return (f"{extra} bytes follow the {self.claimed} records that the header gives",)
        return ()


HeaderParser = Generator[int, bytes, Header]
"""Parser of a header: yields how many bytes it needs next, is sent them, and returns the header.

Fewer than it needs are the end of the file.
"""


def read_header(path: str | os.PathLike[str]) -> Header:
    """Read the header of a PTU file; raise `InputError` if it has none, or a damaged one."""
    parser = parse_header(path)
    with open_regular(path, buffering=0) as file:
        needed = next(parser)
        while True:
            try:
                needed = parser.send(file.read(needed))
            except StopIteration as end:
                return replace(end.value, size=os.fstat(file.fileno()).st_size)


def parse_header(path: str | os.PathLike[str]) -> HeaderParser:
    """Parse a header from bytes as they arrive, of a file of this name, as `read_header`."""
    tags, offset = yield from _parse_tags(path)
    code = _integer(tags, "TTResultFormat_TTTRRecType", path)
    if code not in KINDS:
        raise InputError(
            f"{path} has records of unknown type {code:#010x}: the file is damaged or newer"
        )
    kind = KINDS[code]
    if _integer(tags, "TTResultFormat_BitsPerRecord", path, 32) not in (0, 32):
        raise InputError(f"{path} has records that are not of 32 bits, and only those are known")
    if _integer(tags, "Measurement_Mode", path, int(kind.mode[1])) != int(kind.mode[1]):
        raise InputError(
            f"{path} has {kind.name} records but another measurement mode: it is damaged"
        )
    tick = tags.get("MeasDesc_GlobalResolution")
    if not (isinstance(tick, float) and TICKS_S[0] <= tick <= TICKS_S[1]):
        raise InputError(
            f"{path} is damaged: its time resolution is {str(tick)[:40]}, not 1e-15 to 1 s"
        )
    return Header(
        path=Path(path),
        tags=tags,
        kind=kind,
        offset=offset,
        tick_s=tick,
        claimed=_integer(tags, "TTResult_NumberOfRecords", path, 0),
    )


def refuse_foreign(path: Path) -> None:
    """Raise `InputError` for a file of another counter, which no table of events is."""
    if path.suffix.lower() in TABLE_ENDINGS or not path.is_file():
        return
    with open_regular(path) as file:
        start = file.read(16)
    if start.startswith(MAGIC):
        raise InputError(f"{path} is a PTU file already: it needs no `camera import`")
    if foreign := _foreign_file(start):
        raise InputError(f"{path} {foreign}")


def _foreign_file(start: bytes) -> str:
    """Kind of a file that is no PTU file, and the way on; empty if nothing says it."""
    return next((advice for begin, advice in FOREIGN.items() if start.startswith(begin)), "")


def _parse_tags(
    path: str | os.PathLike[str],
) -> Generator[int, bytes, tuple[dict[str, Any], int]]:
    """Tags of a header by name, and its bytes."""
    start = yield 16
    if start[:8].rstrip(b"\0") != MAGIC:
        if foreign := _foreign_file(start):
            raise InputError(f"{path} {foreign}")
        raise InputError(f"{path} is not a PTU file: it begins with {start[:8]!r}, not {MAGIC!r}")
    tags: dict[str, Any] = {}
    offset = len(start)
    while True:
        raw = yield 48
        offset += len(raw)
        if len(raw) < 48 or offset > LONGEST_HEADER:
            raise InputError(f"{path} has a header without an end within {LONGEST_HEADER} bytes")
        ident, index, code, value = struct.unpack("<32siI8s", raw)
        name = ident.split(b"\0")[0].decode("ascii", "replace")
        if name == "Header_End":
            return tags, offset
        key = name if index < 0 else f"{name}({index})"
        if code in _VALUES:
            tags[key] = _VALUES[code](value)
        elif code in _CONTENTS:
            (size,) = struct.unpack("<q", value)
            content = (yield size) if 0 < size <= LONGEST_HEADER else b""
            if len(content) != size:
                raise InputError(f"{path} is damaged: its tag {key!r} is of {size} bytes")
            offset += size
            tags[key] = _CONTENTS[code](content)
        else:
            raise InputError(f"{path} is damaged: its tag {key!r} is of unknown type {code:#010x}")


def _integer(
    tags: dict[str, Any], name: str, path: str | os.PathLike[str], default: int | None = None
) -> int:
    """Integer of a tag, or the default where there is none."""
    value = tags.get(name, default)
    if not isinstance(value, int):
        raise InputError(
            f"{path} is damaged: its tag {name!r} is {str(value)[:40]!r}, not an integer"
        )
    return value


class PtuWriter:
    """Writer of a T2 file of type Generic, as a context manager.

    The file appears when the block ends. If the block fails there is none.

    Parameters
    ----------
    path
        File to write.
    tick_s
        Seconds of a tick, 1e-15 to 1.
    growing
        True for a file that is there from the start and is read while it is written.

    Raises
    ------
    InputError
        If the tick is out of range, or the file cannot be written.
    """

    record_type: ClassVar[str] = GENERIC_T2.name
    inputs: ClassVar[int] = GENERIC_T2.inputs

    def __init__(
        self, path: str | os.PathLike[str], tick_s: float = 1e-12, *, growing: bool = False
    ) -> None:
        if not TICKS_S[0] <= tick_s <= TICKS_S[1]:
            raise InputError(f"a tick of {tick_s!r} s is not allowed: give 1e-15 to 1")
        self._path = path
        self._tick_s = float(tick_s)
        self._growing = growing
        self._records = self._latest = self._wraps = 0

    def __enter__(self) -> Self:
        self._opened = self._open()
        return self._opened.__enter__()

    def __exit__(self, *error: Any) -> None:
        self._opened.__exit__(*error)

    @contextmanager
    def _open(self) -> Iterator[Self]:
        """Open the file; the header is written again at the end, with the number of records."""
        opened: AbstractContextManager[BinaryIO | GrowingFile] = (
            GrowingFile(self._path) if self._growing else open_atomically(self._path)
        )
        with opened as self._file:
            self._file.write(self._header())
            try:
                yield self
            finally:
                self._file.seek(0)
                self._file.write(self._header())

    def write(self, times: np.ndarray, codes: np.ndarray) -> None:
        """Append events.

        Parameters
        ----------
        times
            Ticks, integers (n,), from 0 to 2^55. They rise over all calls; equal ones are allowed.
        codes
            What each event is, integers (n,): 0 to 63 are a photon on that input, 0 for input 1;
            -1 to -15 are a marker with the bits of the negative.

        Raises
        ------
        InputError
            If times run back or codes mean nothing.
        """
        times = np.asarray(times)
        codes = np.asarray(codes)
        if times.ndim != 1 or times.shape != codes.shape:
            raise InputError(f"{times.shape} times and {codes.shape} codes: give one for each")
        for numbers in (times, codes):
            if numbers.dtype.kind not in "iu":
                raise InputError(
                    f"times and codes of {numbers.dtype} are not allowed: give integers"
                )
        for start in range(0, len(times), EVENTS_IN_MEMORY):
            stop = start + EVENTS_IN_MEMORY
            self._append(times[start:stop], codes[start:stop])

    def _append(self, times: np.ndarray, codes: np.ndarray) -> None:
        """Append at most `EVENTS_IN_MEMORY` events."""
        if int(times[0]) < self._latest or (times[1:] < times[:-1]).any():
            raise InputError("times run back: give events in order, none before 0")
        if int(times[-1]) > LATEST_WRITTEN_TICK:
            raise InputError(f"time {times[-1]} is not allowed: give at most {LATEST_WRITTEN_TICK}")
        if int(codes.min()) < -15 or int(codes.max()) > 63:
            raise InputError("codes are 0 to 63 for photons and -1 to -15 for markers")
        times = times.astype(np.int64)
        codes = codes.astype(np.int64)
        marker = 1 << 31 | -codes << GENERIC_T2.shift
        words = np.where(codes < 0, marker, codes << GENERIC_T2.shift)
        words |= times & GENERIC_T2.time_mask

        # before an event that needs them, overflow records that stand for at most `MOST_WRAPS` each
        wraps = times >> GENERIC_T2.time_bits
        steps = np.diff(wraps, prepend=self._wraps)
        late = np.flatnonzero(steps)
        copies = -(-steps[late] // MOST_WRAPS)
        counts = np.full(int(copies.sum()), MOST_WRAPS)
        counts[np.cumsum(copies) - 1] = steps[late] - (copies - 1) * MOST_WRAPS
        overflows = 1 << 31 | 63 << GENERIC_T2.shift | counts
        words = np.insert(words, np.repeat(late, copies), overflows)

        self._file.write(words.astype("<u4").tobytes())
        self._records += len(words)
        self._latest = int(times[-1])
        self._wraps = int(wraps[-1])

    def _header(self) -> bytes:
        """Header, with the number of records so far."""
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
        return struct.pack("<8s8s", MAGIC, b"1.0.00") + b"".join(
            _encode_tag(name, value) for name, value in tags.items()
        )


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
