"""Records of PTU files: damaged ones are named, memory is bounded, mutated files are refused."""

import os
import random
import resource
import struct
import time
from pathlib import Path
from typing import Any
from unittest import mock

import numpy as np
import pytest
from ptu_samples import (
    END,
    SOURCES,
    T2,
    decode,
    every_source,
    photon,
    recorded,
    save,
    special,
    tags_of,
)
from ptufile.ptufile import encode_tag

from deepfsi.base.errors import InputError
from deepfsi.counting import ptu
from deepfsi.counting.reader import count_windows, read_markers, summarise
from fuzz.mutations import mangled

FUZZ = int(os.environ.get("DEEPFSI_FUZZ", "300"))
TICK = 10**6
"""Ticks of 1 ps by which markers may be off."""


def counted(found: list[tuple[str, int, int]], starts, stops, inputs) -> np.ndarray:
    photons = np.array([(time, n) for what, time, n in found if what == "photon"]).reshape(-1, 2)
    inside = (photons[:, 0] >= starts[:, None]) & (photons[:, 0] < stops[:, None])
    return np.stack([(inside & (photons[:, 1] == n)).sum(axis=1) for n in inputs], axis=1)


@every_source
@pytest.mark.parametrize("chunk", [1, 3, 2**17])
@pytest.mark.parametrize(
    ("words", "bad"),
    [
        ([photon(5), photon(9, 1), photon(8), photon(10)], 3),
        ([photon(9), special(63, 1), photon(2), photon(1)], 4),
        ([photon(9), special(0, 12), special(0, 11)], 3),
        ([photon(9), special(1, 8), photon(7)], 3),
        ([special(1, TICK + 1), photon(0)], 2),
        ([photon(2 * TICK), special(1, TICK - 1)], 2),
        ([photon(9), special(62, 9), photon(10)], 2),
        ([photon(9)] + [special(63, 2**25 - 1)] * 2100 + [photon(10)], 2050),
    ],
)
def test_damaged_records_are_named_and_nothing_is_counted(
    tmp_path, monkeypatch, words, bad, chunk, opened
):
    monkeypatch.setattr(ptu, "RECORDS_AT_ONCE", chunk)
    path = save(tmp_path / "bad.ptu", T2, words)
    with pytest.raises(InputError, match=f"record {bad} has"):
        count_windows(opened(path), np.array([0]), np.array([99]))
    contents = summarise(opened(path))
    assert contents.records == bad - 1
    found = decode(T2.code, words[: bad - 1])
    assert sum(contents.photons.values()) == sum(what == "photon" for what, _, _ in found)
    (problem,) = contents.problems
    assert f"record {bad} has" in problem


@every_source
def test_one_record_can_stand_for_very_many_overflows(tmp_path, opened):
    """Ptufile is no oracle here: it multiplies in 32 bits."""
    for kind, wraps in ((T2, 200), (T2, 2**25 - 1), (ptu.RECORD_TYPES[0x00010307], 1023)):
        path = save(tmp_path / "a.ptu", kind, [special(63, wraps), special(1, 4), photon(5)])
        late = wraps * kind.wrap
        assert read_markers(opened(path))[0] == [late + 4]
        found = summarise(opened(path))
        assert found.span_s == (late + 5) * found.tick_s
        edges = np.array([late, late + 5, late + 6])
        assert count_windows(opened(path), edges[:-1], edges[1:]).ravel().tolist() == [0, 1]


@every_source
@pytest.mark.parametrize("chunk", [1, 2, 2**17])
def test_markers_may_stand_a_little_beside_their_time(tmp_path, monkeypatch, chunk, opened):
    monkeypatch.setattr(ptu, "RECORDS_AT_ONCE", chunk)
    start = 3 * TICK
    words = [
        photon(start),
        special(1, start - TICK),
        photon(start + 5),
        special(2, start + 7),
        photon(start + 6),
        special(4, start + 6 + TICK),
        photon(start + 6),
    ]
    path = save(tmp_path / "a.ptu", T2, words)
    times, bits = read_markers(opened(path))
    assert times.tolist() == [start - TICK, start + 7, start + 6 + TICK]
    assert bits.tolist() == [1, 2, 4]
    assert bits.dtype == np.uint8
    assert count_windows(opened(path), np.array([start + 5]), np.array([start + 7])) == 3


# Fuzzing -----------------------------------------------------------------------------------------


def sound_file(code: int) -> bytes:
    """A small whole file of each type, with every type of tag and sort of record."""
    words = recorded(code, 60, seed=code % 97)
    more = encode_tag("Text", "µs") + encode_tag("Wide", "λ") + encode_tag("Blob", b"\1\2")
    array = struct.pack("<32siIq2d", b"Array", 0, 0x2001FFFF, 16, 1, 2)
    body = np.array(words, "<u4").tobytes()
    return tags_of(ptu.RECORD_TYPES[code], len(words)) + more + array + END + body


def read(path: Path, edges: np.ndarray, opened: Any) -> str:
    """The refusal, or nothing where the counts are those of the format's words, one by one."""
    try:
        header = opened(path).header
        words = np.frombuffer(path.read_bytes()[header.offset :][: 4 * header.records], "<u4")
        found = decode(header.kind.code, words.tolist())
        contents = summarise(opened(path))
        good = found[: contents.records]
        assert sum(contents.photons.values()) == sum(what == "photon" for what, _, _ in good)
        assert len(good) == len(found) or len(contents.problems) > len(header.problems)
        gated = count_windows(opened(path), edges[:-1], edges[1:], (0, 1))
        assert np.array_equal(gated, counted(found, edges[:-1], edges[1:], (0, 1)))
        times, bits = read_markers(opened(path))
        marks = [(time, bits) for what, time, bits in found if what == "marker"]
        assert list(zip(times.tolist(), bits.tolist(), strict=True)) == marks
        assert "unknown" not in {what for what, _, _ in found}
    except InputError as error:
        return str(error)
    return ""


@pytest.mark.parametrize("code", ptu.RECORD_TYPES)
def test_mutated_files_are_read_right_or_refused(tmp_path, code):
    """A file and a stream say the same, in bounded time and memory."""
    path, sound = tmp_path / "mutated.ptu", sound_file(code)
    times = [time for _, time, _ in decode(code, recorded(code, 60, seed=code % 97))]
    edges = np.linspace(0, times[-1] // 2, 20).astype(np.int64)
    before = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss
    for seed in range(FUZZ // len(ptu.RECORD_TYPES)):
        path.write_bytes(mangled(random.Random(f"{code} {seed}"), sound))
        chunk, began = (16, 2**17)[seed % 2], time.process_time()
        with mock.patch.object(ptu, "RECORDS_AT_ONCE", chunk):
            said = [read(path, edges, opened) for opened in SOURCES.values()]
        assert time.process_time() - began < 20
        assert said[0] == said[1], seed
        assert "\n" not in said[0]
        assert len(said[0]) < 400
    assert resource.getrusage(resource.RUSAGE_SELF).ru_maxrss - before < 100e3  # KiB
