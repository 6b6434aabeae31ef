"""PTU files to test with, written and decoded record by record as the format's words say."""

from collections.abc import Iterator
from dataclasses import replace
from functools import cache
from pathlib import Path

import numpy as np
import pytest
from ptufile.ptufile import encode_tag

from deepfsi.base.progress import SILENT, Progress
from deepfsi.counting import ptu
from deepfsi.counting.ptu import Decoded
from deepfsi.counting.reader import PtuFile, PtuStream

T2 = ptu.GENERIC_T2


def decode(code: int, words: list[int]) -> list[tuple[str, int, int]]:
    """Records by name, each with its time and its input or marker bits."""
    wraps, out = 0, []
    for word in words:
        top, what, step = word >> 28, "unknown", 1
        if code == 0x00010203:
            time, value, wrap = word & 0xFFFFFFF, top, 210698240
            if top == 15:
                value = word & 15
                what = "marker" if value else "overflow"
            elif top <= 4:
                what = "photon"
        elif code == 0x00010303:
            time, value, wrap = word & 0xFFFF, top - 1, 65536
            if top == 15:
                value = word >> 16 & 0xFFF
                what = ("marker" if value <= 15 else "unknown") if value else "overflow"
            elif 1 <= top <= 4:
                what = "photon"
        else:
            t3 = code >> 8 & 3 == 3
            time, value = word & (0x3FF if t3 else 0x1FFFFFF), word >> 25 & 63
            wrap = 1024 if t3 else 33554432
            if not word >> 31:
                what = "photon"
            elif value == 63:
                what, step = "overflow", max(time, 1)
            elif value == 0 and not t3:
                what = "sync"
            elif 1 <= value <= 15:
                what = "marker"
        if what == "overflow":
            wraps, time, value = wraps + step * wrap, 0, 1
        out.append((what, wraps + time, value))
    return out


def encode(
    kind: ptu.RecordType, events: list[tuple[str, int, int]], rng: np.random.Generator
) -> list:
    """Records of events; a long pause is one overflow record or many."""
    words, wraps = [], 0
    hydra = kind.inputs == 64
    for what, time, value in events:
        while time // kind.wrap > wraps:
            steps = 1
            if hydra and rng.random() < 0.5:
                steps = int(min(time // kind.wrap - wraps, kind.time_mask))
            one = 0 if steps == 1 and rng.random() < 0.5 else steps
            words.append(1 << 31 | 63 << 25 | one if hydra else 15 << 28)
            wraps += steps
        field = time - wraps * kind.wrap
        delay = int(rng.integers(0, 4096)) if kind.mode == "T3" else 0
        if what == "photon":
            word = (value + kind.first) << kind.shift
            word |= delay << (10 if hydra else 16) | field
        elif what == "sync":
            word = 1 << 31 | field
        elif hydra:
            word = 1 << 31 | value << 25 | field
        elif kind.mode == "T2":
            word = 15 << 28 | field & ~15 | value
        else:
            word = 15 << 28 | value << 16 | field
        words.append(word)
    return words


@cache
def recorded(code: int, events: int = 3000, seed: int = 0) -> list[int]:
    """Records of every sort, with pauses from none to many overflows."""
    kind, rng = ptu.RECORD_TYPES[code], np.random.default_rng(seed)
    steps = rng.integers(0, kind.wrap // 40, events)
    steps[rng.random(events) < 0.1] = 0
    steps[rng.random(events) < 0.05] *= 300
    sorts = ["photon", "marker"] + ["sync"] * (kind.mode == "T2" and kind.inputs == 64)
    what = rng.choice(sorts, events, p=[0.9, 0.1] if len(sorts) == 2 else [0.8, 0.1, 0.1])
    inputs = rng.integers(0, 3, events)
    inputs[rng.random(events) < 0.05] = kind.inputs - 1
    values = np.where(what == "marker", rng.integers(1, 16, events), inputs)
    return encode(
        kind, list(zip(what, np.cumsum(steps).tolist(), values.tolist(), strict=True)), rng
    )


def tags_of(kind: ptu.RecordType, records: int, **changes: object) -> bytes:
    tags = {
        "Measurement_Mode": int(kind.mode[1]),
        "Measurement_SubMode": 1,
        "MeasDesc_GlobalResolution": 1e-12 if kind.mode == "T2" else 5e-8,
        "MeasDesc_Resolution": 4e-12,
        "TTResultFormat_TTTRRecType": kind.code,
        "TTResultFormat_BitsPerRecord": 32,
        "TTResult_NumberOfRecords": records,
        **changes,
    }
    known = [encode_tag(name, value) for name, value in tags.items() if value != "absent"]
    return b"PQTTTR\0\0" + b"1.0.00\0\0" + b"".join(known)


END = encode_tag("Header_End", None)


def save(path: Path, kind: ptu.RecordType, words: list[int], **changes: object) -> Path:
    body = np.array(words, "<u4").tobytes()
    path.write_bytes(tags_of(kind, len(words), **changes) + END + body)
    return path


def photon(time: int, n: int = 0) -> int:
    return n << 25 | time


def special(code: int, time: int = 0) -> int:
    return 1 << 31 | code << 25 | time


class StreamedFile(PtuStream):
    """A file as a stream whose bytes arrive in random cuts, often none or a part of a record."""

    def __init__(self, path: Path) -> None:
        super().__init__(path)
        self.pieces = cut(path.read_bytes())
        for piece in self.pieces:
            self.feed(piece)
            if self.begun:
                break
        else:
            ptu.Header.read(path)  # refused, as a file that ends within its header
        self.header = replace(self.header, size=path.stat().st_size)

    def blocks(self, progress: Progress = SILENT) -> Iterator[Decoded]:
        yield from super().blocks()
        for piece in self.pieces:
            self.feed(piece)
            yield from super().blocks()


def cut(content: bytes) -> Iterator[bytes]:
    first, rng = 0, np.random.default_rng(len(content))
    while first < len(content):
        size = int(rng.integers(0, 2 ** int(rng.integers(1, 20))))
        yield content[first : first + size]
        first += size


SOURCES = {"file": PtuFile, "stream": StreamedFile}
every_source = pytest.mark.parametrize("opened", SOURCES.values(), ids=SOURCES)
