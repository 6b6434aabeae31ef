"""PTU files: every type of record against ptufile, photons between gates, files that are cut."""

import tracemalloc

import numpy as np
import ptufile
import pytest
from ptu_samples import END, T2, decode, every_source, photon, recorded, save, special, tags_of

from deepfsi.base.errors import InputError
from deepfsi.counting import ptu
from deepfsi.counting.reader import PtuStream, WindowCounter, count_windows, read_markers, summarise

every_kind = pytest.mark.parametrize("kind", ptu.RECORD_TYPES.values(), ids=lambda kind: kind.name)


def gates_over(times: np.ndarray, gates: int) -> tuple[np.ndarray, np.ndarray]:
    """Gates from before the first to after the last, whose edges are often an event's time."""
    rng = np.random.default_rng(1)
    last, others = max(times), rng.integers(-5, max(times) + 10, gates - 4)
    edges = np.sort(np.r_[rng.choice(times, gates), others, -3, 0, last, last + 1])
    return edges[::2], edges[1::2]


@every_source
@every_kind
@pytest.mark.parametrize("chunk", [7, 250, 2**17])
def test_every_type_of_record_is_read_as_ptufile_reads_it(
    tmp_path, monkeypatch, kind, chunk, opened
):
    monkeypatch.setattr(ptu, "RECORDS_AT_ONCE", chunk)
    words = recorded(kind.code)
    path = save(tmp_path / "a.ptu", kind, words)
    what, times, values = map(np.array, zip(*decode(kind.code, words), strict=True))
    assert set(what) == {"photon", "marker", "overflow"} | (
        {"sync"} if kind.mode == "T2" and kind.inputs == 64 else set()
    )
    timed = what != "overflow"
    photons, marker, syncs = (what == name for name in ("photon", "marker", "sync"))
    with ptufile.PtuFile(path) as theirs:
        events = theirs.decode_records()
    assert np.array_equal(events["time"][timed], times[timed])
    assert np.array_equal(events["channel"] >= 0, photons | syncs)  # it says channel 0 of a sync
    assert np.array_equal(events["channel"][photons], values[photons])
    assert np.array_equal(events["marker"] > 0, marker)
    assert np.array_equal(events["marker"][marker], values[marker])

    for ours, wanted in zip(read_markers(opened(path)), (times, values), strict=True):
        assert np.array_equal(ours, wanted[marker])
    contents = summarise(opened(path))
    inputs = np.unique(values[photons] + 1, return_counts=True)
    assert contents.photons == dict(zip(*inputs, strict=True))
    for number in range(4):
        assert contents.markers[number] == np.count_nonzero(values[marker] & 1 << number)
    assert contents.records == len(words)
    assert contents.span_s == times[timed].max() * contents.tick_s
    assert contents.problems == ()

    starts, stops = gates_over(times[timed], 60)
    columns = (0, 2, kind.inputs - 1, 1)
    gated = count_windows(opened(path), starts, stops, columns)
    assert gated.dtype == np.int64
    for column, n in enumerate(columns):
        one = times[photons & (values == n)]
        wanted = np.searchsorted(one, stops) - np.searchsorted(one, starts)
        assert np.array_equal(gated[:, column], wanted)
        assert wanted.sum() > 0


@every_source
@pytest.mark.parametrize("claimed", [3000, 0, "absent", 1200])
def test_of_a_recording_that_may_not_be_whole_only_what_is_sure_is_counted(
    tmp_path, claimed, opened
):
    words = recorded(T2.code)[:3000]
    whole = save(tmp_path / "whole.ptu", T2, words)
    path = tmp_path / "cut.ptu"
    held = 1200 if claimed == 1200 else 2000
    path.write_bytes(
        tags_of(T2, claimed) + END + np.array(words[:2000], "<u4").tobytes() + b"\1\2\3"
    )
    contents, header = summarise(opened(path)), opened(path).header
    assert contents.records == header.records == held
    assert contents.problems == header.problems
    assert len(header.problems) == 1
    found = decode(T2.code, words[:held])
    times, marks = read_markers(opened(path))
    assert len(marks) == sum(what == "marker" for what, _, _ in found)
    assert np.array_equal(times, read_markers(opened(whole))[0][: len(times)])
    sure = max(time for what, time, _ in found if what != "marker")
    edges = np.linspace(0, sure, 50).astype(int)
    gated = count_windows(opened(path), edges[:-1], edges[1:])
    assert np.array_equal(gated, count_windows(opened(whole), edges[:-1], edges[1:]))
    assert gated.sum() > 100
    with pytest.raises(InputError, match="gates end at"):
        count_windows(opened(path), np.array([0]), np.array([sure + 1]))


# Streams ----------------------------------------------------------------------------------------


def test_a_gate_is_counted_when_a_later_record_shows_that_it_has_ended():
    def give(counter, *words):
        stream.feed(np.array(words, "<u4").tobytes())
        (part,) = stream.blocks()
        counter.add(part)
        return counter.take().ravel().tolist()

    stream = PtuStream()
    assert not stream.begun
    stream.feed(tags_of(T2, 0) + END)
    assert stream.begun
    assert list(stream.blocks()) == []
    counter = WindowCounter(stream, (0,))
    counter.expect(np.array([10, 20, 3 * 10**6]), np.array([20, 30, 4 * 10**6]))
    assert give(counter, photon(12), photon(19)) == []
    assert give(counter, photon(20)) == [2]
    assert give(counter, special(1, 40)) == []  # the marker may be a microsecond too late
    counter.expect(np.array([2**25 - 1]), np.array([2**25]))
    assert give(counter, special(1, 10**6 + 30)) == [1]
    assert give(counter, special(63, 1)) == [0, 0]  # an overflow: without light, too


def test_memory_does_not_grow_with_the_stream():
    rng = np.random.default_rng(0)
    times = np.sort(rng.integers(0, 2**25, 2**18)).astype("<u4")
    block = np.append(times, np.uint32(special(63, 1))).tobytes()
    stream = PtuStream()
    stream.feed(tags_of(T2, 0) + END)
    counter, found = WindowCounter(stream, (0,)), 0
    tracemalloc.start()
    for k in range(30):
        counter.expect(np.array([k << 25]), np.array([k + 1 << 25]))
        stream.feed(block)
        for part in stream.blocks():
            counter.add(part)
        found += int(counter.take().sum())
    _, peak = tracemalloc.get_traced_memory()
    tracemalloc.stop()
    assert found == 30 * 2**18
    assert peak < 12e6 < 30 * len(block)
