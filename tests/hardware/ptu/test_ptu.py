"""PTU files: every type of record against ptufile and the format's own words, and bad files."""

from __future__ import annotations

import os
import resource
import struct
import tracemalloc
from datetime import timedelta
from functools import cache
from pathlib import Path
from unittest import mock

import numpy as np
import ptufile
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from ptufile.ptufile import encode_tag

from deepfsi.errors import InputError
from deepfsi.hardware.ptu import reader as ptu
from deepfsi.hardware.ptu.reader import Writer, count_gates, inspect, read_header, read_markers

REAL = Path(os.environ.get("DEEPFSI_DATA", "no data")) / "ptu"
real_ptu = pytest.mark.skipif(not REAL.is_dir(), reason="needs ptu/ in $DEEPFSI_DATA")
every_kind = pytest.mark.parametrize("kind", ptu.KINDS.values(), ids=lambda kind: kind.name)
T2 = ptu.GENERIC_T2

FUZZ = int(os.environ.get("DEEPFSI_FUZZ", "300"))
"""Mutated files that the fuzz test reads."""


# The format, record by record, as its description says it ----------------------------------------


def decode(code: int, words: list[int]) -> list[tuple[str, int, int]]:
    """What each record is, its time, and its input or marker bits."""
    wraps, out = 0, []
    for word in words:
        top = word >> 28
        if code == 0x00010203:
            time, marker = word & 0xFFFFFFF, word & 15
            if top == 15 and marker == 0:
                wraps += 210698240
                out.append(("overflow", wraps, 1))
            elif top == 15:
                out.append(("marker", wraps + time, marker))
            else:
                out.append(("photon" if top <= 4 else "unknown", wraps + time, top))
        elif code == 0x00010303:
            time, marker = word & 0xFFFF, word >> 16 & 0xFFF
            if top == 15 and marker == 0:
                wraps += 65536
                out.append(("overflow", wraps, 1))
            elif top == 15:
                out.append(("marker" if marker <= 15 else "unknown", wraps + time, marker))
            else:
                out.append(("photon" if 1 <= top <= 4 else "unknown", wraps + time, top - 1))
        else:
            t3, old = code >> 8 & 3 == 3, code >> 24 == 0 and code & 0xFF == 4
            time = word & (0x3FF if t3 else 0x1FFFFFF)
            channel = word >> 25 & 63
            if not word >> 31:
                out.append(("photon", wraps + time, channel))
            elif channel == 63:
                wrap = 1024 if t3 else 33552000 if old else 33554432
                wraps += wrap * (1 if old else max(time, 1))
                out.append(("overflow", wraps, 1))
            elif channel == 0 and not t3:
                out.append(("sync", wraps + time, 0))
            else:
                out.append(("marker" if 1 <= channel <= 15 else "unknown", wraps + time, channel))
    return out


def encode(kind: ptu.Kind, events: list[tuple[str, int, int]], rng: np.random.Generator) -> list:
    """Records of events; a long pause is one overflow record or many."""
    words, wraps = [], 0
    hydra = kind.inputs == 64
    for what, time, value in events:
        while time // kind.wrap > wraps:
            steps = 1
            if kind.counted and rng.random() < 0.5:
                steps = int(min(time // kind.wrap - wraps, kind.time_mask))
            one = 0 if steps == 1 and rng.random() < 0.5 else steps
            words.append(1 << 31 | 63 << 25 | (one if kind.counted else 7) if hydra else 15 << 28)
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
    kind, rng = ptu.KINDS[code], np.random.default_rng(seed)
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


def tags_of(kind: ptu.Kind, records: int, **changes: object) -> bytes:
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


def save(path: Path, kind: ptu.Kind, words: list[int], **changes: object) -> Path:
    body = np.array(words, "<u4").tobytes()
    path.write_bytes(tags_of(kind, len(words), **changes) + END + body)
    return path


def gates_over(times: list[int], gates: int, seed: int = 1) -> tuple[np.ndarray, np.ndarray]:
    """Gates from before the first to after the last, whose edges are often an event's time."""
    rng = np.random.default_rng(seed)
    edges = np.sort(
        np.concatenate(
            [
                rng.choice(times, gates),
                rng.integers(-5, max(times) + 10, gates - 4),
                [-3, 0, max(times), max(times) + 1],
            ]
        )
    )
    return edges[::2], edges[1::2]


def counted(found: list[tuple[str, int, int]], starts, stops, inputs) -> np.ndarray:
    photons = np.array([(time, n) for what, time, n in found if what == "photon"]).reshape(-1, 2)
    inside = (photons[:, 0] >= starts[:, None]) & (photons[:, 0] < stops[:, None])
    return np.stack([(inside & (photons[:, 1] == n)).sum(axis=1) for n in inputs], axis=1)


# Reading -----------------------------------------------------------------------------------------


@every_kind
@pytest.mark.parametrize("chunk", [1, 7, 250, 2**17])
def test_every_type_of_record_is_read_as_ptufile_reads_it(tmp_path, monkeypatch, kind, chunk):
    monkeypatch.setattr(ptu, "CHUNK", chunk)
    monkeypatch.setattr(ptu, "BLOCK", chunk // 3 + 1)
    words = recorded(kind.code, 400 if chunk == 1 else 3000)
    path = save(tmp_path / "a.ptu", kind, words)
    found = decode(kind.code, words)
    assert {what for what, _, _ in found} == {"photon", "marker", "overflow"} | (
        {"sync"} if kind.mode == "T2" and kind.inputs == 64 else set()
    )
    with ptufile.PtuFile(path) as theirs:
        events = theirs.decode_records()
        timed = np.array([what != "overflow" for what, _, _ in found])
        assert events["time"][timed].tolist() == [time for w, time, _ in found if w != "overflow"]
        syncs = np.array([what == "sync" for what, _, _ in found])
        photons = (events["channel"] >= 0) & ~syncs  # ptufile calls a sync event channel 0
        inputs, times = events["channel"][photons].astype(int), events["time"][photons].astype(int)
        marker = events["marker"] > 0
        wanted = events["time"][marker], events["marker"][marker]

    for ours, their in zip(read_markers(path), wanted, strict=True):
        assert np.array_equal(ours, their)
    contents = inspect(path)
    assert contents.photons == dict(zip(*np.unique(inputs, return_counts=True), strict=True))
    for bit in (1, 2, 4, 8):
        assert contents.markers[bit] == np.count_nonzero(wanted[1] & bit)
    assert contents.syncs == syncs.sum()
    assert contents.overflows == sum(what == "overflow" for what, _, _ in found)
    assert contents.records == len(words)
    real = [time for what, time, _ in found if what != "overflow"]
    assert (contents.first, contents.last) == (min(real), max(real))
    assert contents.span_s == contents.last * contents.tick_s
    assert contents.problems == ()

    starts, stops = gates_over(real, 60)
    columns = (0, 2, kind.inputs - 1, 1)
    gated = count_gates(path, starts, stops, columns)
    assert gated.dtype == np.int64
    for column, n in enumerate(columns):
        one = times[inputs == n]
        wanted = np.searchsorted(one, stops) - np.searchsorted(one, starts)
        assert np.array_equal(gated[:, column], wanted)
        assert wanted.sum() > 0


@real_ptu
@pytest.mark.parametrize(
    ("name", "wanted"),
    {
        "hydraharp_v20_t2": ("HydraHarp V2 T2", 435319, 129754, {0: 305565}, 1e-12, 4999964931763),
        "picoharp_v30_t2": (
            *("PicoHarp 300 T2", 929254, 9077),
            *({0: 531477, 1: 388700}, 4e-12, 1912597668189),
        ),
        "hydraharp_v20_t3": (
            *("HydraHarp V2 T3", 106349, 28466),
            *({0: 45012, 1: 32871}, 200e-9, 49999358),
        ),
    }.items(),
)
def test_real_files_hold_what_their_description_says(name, wanted):
    path = REAL / f"{name}.ptu"
    kind, records, overflows, photons, tick, last = wanted
    contents = inspect(path)
    assert contents.kind == kind
    assert contents.tick_s == pytest.approx(tick, rel=1e-5)
    found = (contents.records, contents.overflows, contents.photons, contents.last)
    assert found == (records, overflows, photons, last)
    assert (contents.markers, contents.syncs, contents.problems) == ({}, 0, ())
    assert contents.span_s == pytest.approx(last * tick, rel=1e-5)
    header = read_header(path)
    assert header.delay_s == (pytest.approx(64e-12) if header.kind.mode == "T3" else None)

    with ptufile.PtuFile(path) as theirs:
        events = theirs.decode_records()
        assert theirs.number_photons == sum(photons.values())
        for tag, value in theirs.tags.items():
            listed = isinstance(value, list)
            ours = [v for k, v in header.tags.items() if k.split("(")[0] == tag]
            if not hasattr(value, "year"):  # a date, which stays a number here
                assert ours == (value if listed else [value])
    edges = np.linspace(0, last + 1, 2001).astype(np.int64)
    gated = count_gates(path, edges[:-1], edges[1:], (0, 1))
    for n in (0, 1):
        times = events["time"][events["channel"] == n].astype(np.int64)
        assert np.array_equal(gated[:, n], np.histogram(times, np.append(edges[:-1], last + 1))[0])
        assert gated[:, n].sum() == photons.get(n, 0)


def test_all_types_of_tags_are_read(tmp_path):
    array = struct.pack("<32siIq3d", b"Array", -1, 0x2001FFFF, 24, 1.5, -2, 3)
    colour = struct.pack("<32siIq", b"Colour", -1, 0x12000008, 0xFF8000)
    bits = struct.pack("<32siIq", b"Bits", -1, 0x11000008, 5)
    date = struct.pack("<32siId", b"Date", -1, 0x21000008, 45000.25)
    more = {"Yes": True, "No": False, "Ansi": "µs", "Wide": "λ = 3", "Blob": b"\1\2", "None": None}
    path = tmp_path / "tags.ptu"
    path.write_bytes(
        tags_of(T2, 0, **more)
        + array
        + colour
        + bits
        + date
        + encode_tag("Curve", 5, 0)
        + encode_tag("Curve", 7, 1)
        + END
    )
    tags = read_header(path).tags
    found = {name: tags[name] for name in more}
    assert found == {**more, "Blob": b"\1\2".ljust(8, b"\0")}
    assert tags["Array"].tolist() == [1.5, -2, 3]
    assert (tags["Colour"], tags["Bits"], tags["Date"]) == (0xFF8000, 5, 45000.25)
    assert (tags["Curve(0)"], tags["Curve(1)"]) == (5, 7)


def test_progress_ends_at_one(tmp_path, monkeypatch):
    monkeypatch.setattr(ptu, "CHUNK", 1000)
    path, shares = save(tmp_path / "a.ptu", T2, recorded(T2.code)), []
    inspect(path, progress=shares.append)
    assert len(shares) > 3
    assert shares == sorted(shares)
    assert shares[-1] == 1


def test_memory_does_not_grow_with_the_file(tmp_path):
    path, rng, million = tmp_path / "long.ptu", np.random.default_rng(0), 10**6
    with Writer(path) as writer:
        for k in range(8):
            times = np.sort(rng.integers(k * 10**11, (k + 1) * 10**11, million))
            writer.write(times, rng.integers(0, 3, million))
    edges = np.arange(0, 8 * 10**11, 10**9)
    tracemalloc.start()
    gated = count_gates(path, edges[:-1], edges[1:], (0, 1, 2))
    inspect(path)
    _, peak = tracemalloc.get_traced_memory()
    tracemalloc.stop()
    assert path.stat().st_size > 32e6
    assert gated.sum() > 7.9 * million
    assert peak < 12e6


@pytest.mark.parametrize("word", [1 << 31, 1 << 31 | 63 << 25, 1 << 31 | 1 << 25])
def test_memory_is_bounded_where_every_record_is_special(tmp_path, word):
    path = save(tmp_path / "a.ptu", T2, np.full(2**21, word))
    tracemalloc.start()
    count_gates(path, np.array([0]), np.array([1]))
    inspect(path)
    _, peak = tracemalloc.get_traced_memory()
    tracemalloc.stop()
    assert peak < 150e6


@pytest.mark.parametrize(
    ("starts", "stops", "inputs", "message"),
    [
        ([0, 5], [6, 9], (0,), "overlap"),
        ([5, 0], [6, 3], (0,), "overlap"),
        ([5], [4], (0,), "overlap"),
        ([5], [6, 7], (0,), "one for each"),
        ([5.0], [6.0], (0,), "integer"),
        ([5], [6], (64,), "input 64"),
        ([5], [6], (-1,), "input -1"),
    ],
)
def test_gates_that_cannot_be_are_refused(tmp_path, starts, stops, inputs, message):
    path = save(tmp_path / "a.ptu", T2, [5, 6])
    with pytest.raises(InputError, match=message):
        count_gates(path, np.array(starts), np.array(stops), inputs)


def test_no_gates_and_no_records_give_no_counts(tmp_path):
    path = save(tmp_path / "a.ptu", T2, [5, 6])
    assert count_gates(path, np.array([]), np.array([])).shape == (0, 1)
    empty = tmp_path / "empty.ptu"
    with Writer(empty):
        pass
    contents = inspect(empty)
    assert (contents.records, contents.last, contents.span_s) == (0, None, 0)
    assert contents.problems == ()
    assert count_gates(empty, np.array([0]), np.array([9])) == [[0]]


# Writing -----------------------------------------------------------------------------------------


def test_what_is_written_is_read_back_by_us_and_by_ptufile(tmp_path):
    rng, n = np.random.default_rng(4), 5000
    steps = rng.integers(0, 10**6, n)
    steps[[10, 11, 400]] = 2**25, 2**35, 3 * 2**48  # pauses of one overflow and of many
    times = np.cumsum(steps)
    codes = rng.integers(-15, 64, n).astype(np.int16)
    path = tmp_path / "new" / "a.ptu"
    with Writer(path, tick_s=5e-12) as writer:
        for part in np.array_split(np.arange(n), [0, 1, 11, 12, 3000]):
            writer.write(times[part], codes[part])
    assert list(path.parent.iterdir()) == [path]

    contents = inspect(path)
    photons, markers = codes >= 0, codes < 0
    inputs = np.unique(codes[photons], return_counts=True)
    assert contents.photons == dict(zip(*inputs, strict=True))
    assert (contents.first, contents.last) == (times[0], times[-1])
    assert (contents.tick_s, contents.syncs, contents.problems) == (5e-12, 0, ())
    found = read_markers(path)
    assert np.array_equal(found[0], times[markers])
    assert np.array_equal(found[1], -codes[markers])
    with ptufile.PtuFile(path) as theirs:
        events = theirs.decode_records()
        assert theirs.number_records == contents.records == len(events)
        assert theirs.global_resolution == 5e-12
        assert theirs.tags["CreatorSW_Name"] == "deepfsi"
    kept = (events["channel"] >= 0) | (events["marker"] > 0)
    assert np.array_equal(events["time"][kept], times)
    assert np.array_equal(np.where(photons, codes, -1), events["channel"][kept])


def test_the_same_events_give_the_same_bytes_however_they_are_split(tmp_path, monkeypatch):
    times, codes = np.arange(1000) * 10**6, np.zeros(1000, np.int16)
    for name, parts in (("a", 1), ("b", 7)):
        with Writer(tmp_path / name) as writer:
            for part in np.array_split(np.arange(1000), parts):
                writer.write(times[part], codes[part])
    assert (tmp_path / "a").read_bytes() == (tmp_path / "b").read_bytes()


def test_a_stopped_writer_leaves_what_was_there(tmp_path):
    path = tmp_path / "a.ptu"
    path.write_text("before")

    def stop() -> None:
        with Writer(path) as writer:
            writer.write(np.array([5]), np.array([0]))
            raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        stop()
    assert list(tmp_path.iterdir()) == [path]
    assert path.read_text() == "before"


@pytest.mark.parametrize(
    ("times", "codes", "message"),
    [
        ([5, 4], [0, 0], "run back"),
        ([2], [0], "run back"),
        ([-1], [0], "run back"),
        ([2**55 + 1], [0], "at most"),
        ([5], [64], "0 to 63"),
        ([5], [-16], "0 to 63"),
        ([5, 6], [0], "one for each"),
        ([5.0], [0], "integers"),
        ([5], [0.0], "integers"),
    ],
)
def test_events_that_cannot_be_are_refused(tmp_path, times, codes, message):
    def write() -> None:
        with Writer(tmp_path / "a.ptu") as writer:
            writer.write(np.array([3]), np.array([1]))
            writer.write(np.array([], int), np.array([], int))
            writer.write(np.array(times), np.array(codes))

    with pytest.raises(InputError, match=message):
        write()
    assert not list(tmp_path.iterdir())


@pytest.mark.parametrize("tick_s", [0, -1, float("nan"), float("inf"), 1e-20])
def test_ticks_that_cannot_be_are_refused(tmp_path, tick_s):
    with pytest.raises(InputError, match="tick"):
        Writer(tmp_path / "a.ptu", tick_s)


# Files that are cut ------------------------------------------------------------------------------


@pytest.mark.parametrize("claimed", [3000, 2**60, 0, -5, "absent", 1200])
def test_of_a_recording_that_may_not_be_whole_only_what_is_sure_is_counted(tmp_path, claimed):
    words = recorded(T2.code)[:3000]
    whole = save(tmp_path / "whole.ptu", T2, words)
    path = tmp_path / "cut.ptu"
    held = 1200 if claimed == 1200 else 2000
    path.write_bytes(
        tags_of(T2, claimed) + END + np.array(words[:2000], "<u4").tobytes() + b"\1\2\3"
    )
    contents, header = inspect(path), read_header(path)
    assert contents.records == header.records == held
    assert contents.problems == header.problems
    assert len(header.problems) == 1
    found = decode(T2.code, words[:held])
    times, marks = read_markers(path)
    assert len(marks) == sum(what == "marker" for what, _, _ in found)
    assert np.array_equal(times, read_markers(whole)[0][: len(times)])
    sure = max(time for what, time, _ in found if what != "marker")
    edges = np.linspace(0, sure, 50).astype(int)
    gated = count_gates(path, edges[:-1], edges[1:])
    assert np.array_equal(gated, count_gates(whole, edges[:-1], edges[1:]))
    assert gated.sum() > 100
    with pytest.raises(InputError, match="gates end at"):
        count_gates(path, np.array([0]), np.array([sure + 1]))


# Files that are damaged or hostile ---------------------------------------------------------------


def photon(time: int, n: int = 0) -> int:
    return n << 25 | time


def special(code: int, time: int = 0) -> int:
    return 1 << 31 | code << 25 | time


TICK = 10**6  # ticks of 1 ps by which markers may be off


@pytest.mark.parametrize("chunk", [1, 2, 3, 2**17])
@pytest.mark.parametrize(
    ("words", "bad"),
    [
        ([photon(5), photon(9), photon(8), photon(10)], 3),
        ([photon(5), photon(9, 1), photon(8), photon(10)], 3),
        ([photon(9), special(63, 1), photon(2), photon(1)], 4),
        ([photon(9), special(0, 8), photon(9)], 2),
        ([photon(9), special(0, 12), photon(11)], 3),
        ([photon(9), special(0, 12), special(0, 11)], 3),
        ([photon(9), special(1, 8), photon(7)], 3),
        ([special(1, TICK + 1), photon(0)], 2),
        ([special(63, 2), special(0, 12), special(2, 12), photon(11)], 4),
        ([photon(2 * TICK), special(1, TICK - 1)], 2),
        ([special(1, 3 * TICK), special(1, TICK - 1)], 2),
        ([photon(9), special(16, 9), photon(10)], 2),
        ([photon(9), special(62, 9), photon(10)], 2),
        ([photon(9)] + [special(63, 2**25 - 1)] * 2100 + [photon(10)], 2050),
    ],
)
def test_damaged_records_are_named_and_nothing_is_counted(tmp_path, monkeypatch, words, bad, chunk):
    monkeypatch.setattr(ptu, "CHUNK", chunk)
    monkeypatch.setattr(ptu, "BLOCK", chunk // 3 + 1)
    path = save(tmp_path / "bad.ptu", T2, words)
    with pytest.raises(InputError, match=f"record {bad} of {len(words)}"):
        count_gates(path, np.array([0]), np.array([99]))
    contents = inspect(path)
    assert contents.records == bad - 1
    found = decode(T2.code, words[: bad - 1])
    assert sum(contents.photons.values()) == sum(what == "photon" for what, _, _ in found)
    (problem,) = contents.problems
    assert f"record {bad} of {len(words)}" in problem


@pytest.mark.parametrize(
    ("kind", "word"),
    [
        (ptu.PICOHARP_T2, 5 << 28),
        (ptu.PICOHARP_T2, 14 << 28),
        (ptu.PICOHARP_T3, 0),
        (ptu.PICOHARP_T3, 5 << 28),
        (ptu.PICOHARP_T3, 15 << 28 | 16 << 16),
        (ptu.KINDS[0x01010304], special(0)),
    ],
)
def test_records_without_a_meaning_are_refused(tmp_path, kind, word):
    path = save(tmp_path / "bad.ptu", kind, [1 << 28, word])
    for read in (read_markers, lambda path: count_gates(path, np.array([0]), np.array([9]))):
        with pytest.raises(InputError, match="record 2 of 2 has no known meaning"):
            read(path)


def test_one_record_can_stand_for_very_many_overflows(tmp_path):
    """Ptufile is no oracle here: it multiplies in 32 bits."""
    for kind, wraps in ((T2, 200), (T2, 2**25 - 1), (ptu.KINDS[0x00010307], 1023)):
        path = save(tmp_path / "a.ptu", kind, [special(63, wraps), special(1, 4), photon(5)])
        late = wraps * kind.wrap
        assert read_markers(path)[0] == [late + 4]
        assert inspect(path).last == late + 5
        edges = np.array([late, late + 5, late + 6])
        assert count_gates(path, edges[:-1], edges[1:]).ravel().tolist() == [0, 1]


@pytest.mark.parametrize("chunk", [1, 2, 2**17])
def test_markers_may_stand_a_little_beside_their_time(tmp_path, monkeypatch, chunk):
    monkeypatch.setattr(ptu, "CHUNK", chunk)
    monkeypatch.setattr(ptu, "BLOCK", chunk // 3 + 1)
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
    times, bits = read_markers(path)
    assert times.tolist() == [start - TICK, start + 7, start + 6 + TICK]
    assert bits.tolist() == [1, 2, 4]
    assert bits.dtype == np.uint8
    assert count_gates(path, np.array([start + 5]), np.array([start + 7])) == 3


def long_tag(size: int, code: int = 0x4001FFFF) -> bytes:
    return struct.pack("<32siIq", b"Long", -1, code, size)


HEADER = tags_of(T2, 1)
WORD = struct.pack("<I", 5)
BAD_HEADERS = {
    "empty": (b"", "not a PTU file"),
    "short": (b"PQTT", "not a PTU file"),
    "histogram": (b"PQHISTO\0" + HEADER[8:] + END + WORD, "not a PTU file"),
    "pt3": (b"PicoHarp 300\0\0\0\0" + bytes(700), "not a PTU file"),
    "text": (b"time,channel\n" * 100, "not a PTU file"),
    "magic only": (HEADER[:16], "without an end"),
    "no end": (HEADER, "without an end"),
    "cut in a tag": ((HEADER + END)[:-20], "without an end"),
    "endless": (HEADER + encode_tag("More", 1) * (2**22 // 48) + END, "without an end"),
    **{
        f"{size} bytes": (HEADER + long_tag(size, code) + END + WORD, f"is of {size} bytes")
        for size in (-1, 2**40, 2**63 - 1, -(2**63), 2**22 + 8, 5000)
        for code in (0x4001FFFF, 0x4002FFFF, 0x2001FFFF, 0xFFFFFFFF)[:: 1 if size == 2**40 else 4]
    },
    "unknown tag": (HEADER + long_tag(5, 0x30000008) + END + WORD, "unknown type 0x30000008"),
}
for name, changes, message in [
    ("no type", {"TTResultFormat_TTTRRecType": "absent"}, "TTTRRecType"),
    ("unknown type", {"TTResultFormat_TTTRRecType": 0x00010208}, "unknown type 0x00010208"),
    ("text for type", {"TTResultFormat_TTTRRecType": "T2"}, "TTTRRecType"),
    ("64 bits", {"TTResultFormat_BitsPerRecord": 64}, "32 bits"),
    ("other mode", {"Measurement_Mode": 3}, "measurement mode"),
    ("text for records", {"TTResult_NumberOfRecords": "many"}, "NumberOfRecords"),
    ("no tick", {"MeasDesc_GlobalResolution": "absent"}, "time resolution"),
    *(
        (f"tick of {tick}", {"MeasDesc_GlobalResolution": tick}, "time resolution")
        for tick in (0.0, -1e-12, float("nan"), float("inf"), 5e-324, 1e300, 1)
    ),
]:
    BAD_HEADERS[name] = (tags_of(T2, 1, **changes) + END + WORD, message)


@pytest.mark.parametrize(("content", "message"), BAD_HEADERS.values(), ids=BAD_HEADERS)
def test_bad_headers_give_one_line_and_take_no_memory(tmp_path, content, message):
    path = tmp_path / "bad.ptu"
    path.write_bytes(content)
    tracemalloc.start()
    with pytest.raises(InputError, match=message) as error:
        read_header(path)
    assert "\n" not in str(error.value)
    assert len(str(error.value)) < 300
    _, peak = tracemalloc.get_traced_memory()
    tracemalloc.stop()
    assert peak < 30e6


def test_what_is_no_file_is_refused(tmp_path):
    fifo = tmp_path / "fifo"
    os.mkfifo(fifo)
    for path in (tmp_path, fifo, tmp_path / "absent.ptu"):
        with pytest.raises(InputError, match=r"not a file|cannot be read"):
            read_header(path)


def test_a_file_that_shrinks_while_it_is_read_is_refused(tmp_path, monkeypatch):
    monkeypatch.setattr(ptu, "CHUNK", 10)
    path = save(tmp_path / "a.ptu", T2, recorded(T2.code))
    with pytest.raises(InputError, match="shorter"):
        inspect(path, progress=lambda share: os.truncate(path, 3000))


def test_more_markers_than_frames_can_be_are_refused(tmp_path, monkeypatch):
    monkeypatch.setattr(ptu, "MOST_MARKERS", 10)
    path = save(tmp_path / "a.ptu", T2, [special(1, k) for k in range(11)])
    with pytest.raises(InputError, match="more than 10 markers"):
        read_markers(path)


# Fuzzing -----------------------------------------------------------------------------------------


@cache
def seed(code: int) -> bytes:
    """A small whole file of each type, with every type of tag and sort of record."""
    words = recorded(code, 60, seed=code % 97)
    more = encode_tag("Text", "µs") + encode_tag("Wide", "λ") + encode_tag("Blob", b"\1\2")
    array = struct.pack("<32siIq2d", b"Array", 0, 0x2001FFFF, 16, 1, 2)
    body = np.array(words, "<u4").tobytes()
    return tags_of(ptu.KINDS[code], len(words)) + more + array + END + body


VALUES = st.sampled_from([0, 1, 2**15, 2**25, 2**31, 2**32 - 1, 2**63 - 1, 2**63, 2**64 - 1])
CHANGES = st.lists(
    st.tuples(
        st.sampled_from(["byte", "word", "long", "cut", "drop", "double", "end"]),
        st.floats(0, 1, exclude_max=True),
        st.integers(0, 2**64 - 1) | VALUES,
    ),
    min_size=1,
    max_size=6,
)


def mutate(content: bytes, changes: list[tuple[str, float, int]]) -> bytes:
    for how, share, value in changes:
        at = int(share * len(content))
        aligned, size = at // 4 * 4, value % 97
        if how == "byte":
            content = content[:at] + bytes([value % 256]) + content[at + 1 :]
        elif how == "word":
            content = content[:aligned] + struct.pack("<I", value % 2**32) + content[aligned + 4 :]
        elif how == "long":
            content = content[:aligned] + struct.pack("<Q", value) + content[aligned + 8 :]
        elif how == "cut":
            content = content[:at]
        elif how == "drop":
            content = content[:at] + content[at + size :]
        elif how == "double":
            content = content[:at] + content[at : at + size] + content[at:]
        else:
            content += struct.pack("<Q", value)[: size % 9]
    return content


def check_mutated(path: Path, edges: np.ndarray) -> None:
    """Either `InputError`, or the counts that the format's words give record by record."""
    header = read_header(path)
    with path.open("rb") as file:
        file.seek(header.offset)
        words = np.frombuffer(file.read(4 * header.records), "<u4").tolist()
    found = decode(header.kind.code, words)
    contents = inspect(path)
    good = found[: contents.records]
    assert sum(contents.photons.values()) == sum(what == "photon" for what, _, _ in good)
    assert len(good) == len(found) or len(contents.problems) > len(header.problems)
    gated = count_gates(path, edges[:-1], edges[1:], (0, 1))
    assert np.array_equal(gated, counted(found, edges[:-1], edges[1:], (0, 1)))
    marks = [(time, bits) for what, time, bits in found if what == "marker"]
    times, bits = read_markers(path)
    assert list(zip(times.tolist(), bits.tolist(), strict=True)) == marks
    assert "unknown" not in {what for what, _, _ in found}


@pytest.fixture(scope="module")
def scratch(tmp_path_factory):
    return tmp_path_factory.mktemp("fuzz") / "mutated.ptu"


@settings(max_examples=FUZZ, deadline=timedelta(seconds=10))
@given(st.sampled_from(sorted(ptu.KINDS)), CHANGES, st.sampled_from([16, 2**17]))
def test_mutated_files_are_read_right_or_refused(scratch, code, changes, chunk):
    scratch.write_bytes(mutate(seed(code), changes))
    times = [time for _, time, _ in decode(code, recorded(code, 60, seed=code % 97))]
    edges = np.linspace(0, times[-1] // 2, 20).astype(np.int64)
    before = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss
    with mock.patch.multiple(ptu, CHUNK=chunk, BLOCK=chunk // 3 + 1):
        said = ""
        try:
            check_mutated(scratch, edges)
        except InputError as error:
            said = str(error)
    assert "\n" not in said
    assert len(said) < 400
    assert resource.getrusage(resource.RUSAGE_SELF).ru_maxrss - before < 100e3  # KiB
