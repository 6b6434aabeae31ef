"""Header of a PTU file: tags that describe the recording, and the types of its records."""

import os
import struct
from collections.abc import Generator
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any, Literal

import numpy as np

from deepfsi.base.errors import InputError
from deepfsi.base.files import open_regular

MAGIC = b"PQTTTR"
"""First bytes of a file."""

LONGEST_HEADER = 2**22
"""Bytes of a header, or of one tag, at most."""

MOST_RECORDS = 2**61
"""More records than any file has."""

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
    b"\x89HDF": "is an HDF5 file: if it is Photon-HDF5, give it to `deepfsi camera import`",
    b"SITT": "is a stream of a Swabian Time Tagger (.ttbin): read it with the class FileReader of "
    "its package, save times and channels as two columns, and give these to `camera import`",
}
"""What else counters write, by the first bytes."""

TABLES = (".txt", ".csv", ".tsv", ".dat", ".npy", ".mat", ".parquet")
"""Ends of the names of tables, which may hold events."""

_TO_TAGS = "save times and channels as two columns, and give these to `deepfsi camera import`"
FOREIGN_ENDS = {
    **dict.fromkeys((".pt2", ".pt3"), FOREIGN[b"PicoHarp 300"]),
    **dict.fromkeys((".ht2", ".ht3"), FOREIGN[b"HydraHarp"]),
    **dict.fromkeys((".t2r", ".t3r"), FOREIGN[b"TimeHarp"]),
    **dict.fromkeys((".phu", ".phd", ".hhd", ".thd"), f"is by its name {NO_TIMES}"),
    ".ttbin": FOREIGN[b"SITT"],
    ".spc": "is by its name a file of Becker & Hickl: the package phconvert writes a Photon-HDF5 "
    "file of those of some cards, which `deepfsi camera import` reads",
    ".sdt": "is by its name a file of Becker & Hickl with histograms or pictures, which have no "
    "times of photons: record in FIFO mode, as .spc",
    **dict.fromkeys(TABLES, f"is no PTU file: {_TO_TAGS}"),
}
"""What else counters write, by the ends of names."""

_NUMBERS = {
    0xFFFF0008: "Empty8",
    0x00000008: "Bool8",
    0x10000008: "Int8",
    0x11000008: "BitSet64",
    0x12000008: "Color8",
    0x20000008: "Float8",
    0x21000008: "TDateTime",
}
"""Types of tags whose value is a number."""

_SIZED = {
    0x2001FFFF: "Float8Array",
    0x4001FFFF: "AnsiString",
    0x4002FFFF: "WideString",
    0xFFFFFFFF: "BinaryBlob",
}
"""Types of tags whose value is the number of bytes that follow."""


@dataclass(frozen=True)
class Kind:
    """A type of record."""

    name: str  # device and mode
    code: int  # of the tag `TTResultFormat_TTTRRecType`
    mode: Literal["T2", "T3"]  # times count ticks of the device, or periods of the sync
    shift: int  # bits below the channel field
    time_bits: int  # lowest bits, which hold the time
    wrap: int  # ticks of an overflow
    counted: bool  # whether one record can stand for many overflows, their number in its time field
    first: int  # channel field of the first input, and how many inputs there can be
    inputs: int

    @property
    def time_mask(self) -> int:
        """Bits of the time."""
        return (1 << self.time_bits) - 1


def _hydra(name: str, code: int, *, old: bool = False) -> tuple[Kind, Kind]:
    """Types of records, T2 and T3, of a HydraHarp or later; old ones count no overflows."""
    wrap = 33_552_000 if old else 1 << 25
    return (
        Kind(f"{name} T2", code, "T2", 25, 25, wrap, not old, 0, 64),
        Kind(f"{name} T3", code + 0x100, "T3", 25, 10, 1 << 10, not old, 0, 64),
    )


PICOHARP_T2 = Kind("PicoHarp 300 T2", 0x00010203, "T2", 28, 28, 210_698_240, False, 0, 5)
"""Record of a PicoHarp 300 in T2 mode."""

PICOHARP_T3 = Kind("PicoHarp 300 T3", 0x00010303, "T3", 28, 16, 65_536, False, 1, 4)
"""Record of a PicoHarp 300 in T3 mode."""

GENERIC_T2, GENERIC_T3 = _hydra("Generic", 0x00010207)
"""Records of a recent device."""

KINDS = {
    kind.code: kind
    for kind in (
        PICOHARP_T2,
        PICOHARP_T3,
        *_hydra("HydraHarp V1", 0x00010204, old=True),
        *_hydra("HydraHarp V2", 0x01010204),
        *_hydra("TimeHarp 260 N", 0x00010205),
        *_hydra("TimeHarp 260 P", 0x00010206),
        GENERIC_T2,
        GENERIC_T3,
    )
}
"""Types of records by code."""


@dataclass(frozen=True)
class Header:
    """Header of a PTU file: its tags and the type of its records."""

    path: Path  # of the file, or what to call a stream
    # Values by name; of a tag with an index, by `Name(index)`. Dates are days since 1899-12-30
    tags: dict[str, Any]
    kind: Kind
    offset: int  # bytes before the first record
    tick_s: float  # seconds of a tick
    claimed: int  # records that the header says there are; 0 or less if it does not say
    size: int | None = None  # bytes of the file; None while they still arrive

    @property
    def records(self) -> int:
        """Records to read: those claimed, or those that are there if fewer or unclaimed."""
        held = MOST_RECORDS if self.size is None else (self.size - self.offset) // 4
        return min(self.claimed, held) if self.claimed > 0 else held

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
    """Header of a PTU file."""
    parser = parse_header(path)
    with open_regular(path, buffering=0) as file:
        needed = next(parser)
        while True:
            try:
                needed = parser.send(file.read(needed))
            except StopIteration as end:
                return replace(end.value, size=os.fstat(file.fileno()).st_size)


def parse_header(path: str | os.PathLike[str]) -> HeaderParser:
    """Header from bytes as they arrive; `path` names the file. Raises as `read_header`."""
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
    if path.suffix.lower() in TABLES or not path.is_file():
        return
    with open_regular(path) as file:
        start = file.read(16)
    if start.startswith(MAGIC):
        raise InputError(f"{path} is a PTU file already: it needs no `camera import`")
    if foreign := _foreign(path, start):
        raise InputError(f"{path} {foreign}")


def _foreign(path: str | os.PathLike[str], start: bytes) -> str:
    """Kind of a file that is no PTU file, and the way on; empty if that is not known."""
    by_start = (said for begin, said in FOREIGN.items() if start.startswith(begin))
    return next(by_start, FOREIGN_ENDS.get(Path(path).suffix.lower(), ""))


def _parse_tags(
    path: str | os.PathLike[str],
) -> Generator[int, bytes, tuple[dict[str, Any], int]]:
    """Tags of a header by name, and its bytes."""
    start = yield 16
    if start[:8].rstrip(b"\0") != MAGIC:
        if foreign := _foreign(path, start):
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
        if code in _NUMBERS:
            tags[key] = _number(_NUMBERS[code], value)
        elif code in _SIZED:
            (size,) = struct.unpack("<q", value)
            content = (yield size) if 0 < size <= LONGEST_HEADER else b""
            if len(content) != size:
                raise InputError(f"{path} is damaged: its tag {key!r} is of {size} bytes")
            offset += size
            tags[key] = _text(_SIZED[code], content)
        else:
            raise InputError(f"{path} is damaged: its tag {key!r} is of unknown type {code:#010x}")


def _number(kind: str, value: bytes) -> bool | int | float | None:
    """Value of a tag that is a number."""
    if kind == "Empty8":
        return None
    number: int | float = struct.unpack("<d" if kind in ("Float8", "TDateTime") else "<q", value)[0]
    return bool(number) if kind == "Bool8" else number


def _text(kind: str, content: bytes) -> str | bytes | np.ndarray:
    """Value of a tag whose bytes follow it."""
    if kind == "AnsiString":
        return content.rstrip(b"\0").decode("windows-1252", "replace")
    if kind == "WideString":
        return content.decode("utf-16-le", "replace").rstrip("\0")
    if kind == "Float8Array":
        return np.frombuffer(content[: len(content) // 8 * 8], "<f8")
    return content


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
