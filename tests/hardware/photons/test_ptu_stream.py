"""PTU files read while their bytes arrive; through `READERS` other tests do so too."""

import tracemalloc

import numpy as np
import pytest
from ptu_samples import END, T2, Streamed, photon, recorded, save, special, tags_of

from deepfsi.base.errors import InputError
from deepfsi.hardware.photons.gate_counter import GateCounter
from deepfsi.hardware.photons.header import KINDS
from deepfsi.hardware.photons.reader import count_gates, inspect, read_markers
from deepfsi.hardware.photons.stream import StreamReader


@pytest.mark.parametrize("size", [1, 3, 4, 7, 4096])
@pytest.mark.parametrize("kind", KINDS.values(), ids=lambda kind: kind.name)
def test_a_stream_is_the_file_it_becomes_whatever_its_cuts(tmp_path, kind, size):
    path, streamed = save(tmp_path / "a.ptu", kind, recorded(kind.code, 200)), Streamed(size)
    assert streamed.inspect(path) == inspect(path)
    for ours, wanted in zip(streamed.read_markers(path), read_markers(path), strict=True):
        assert np.array_equal(ours, wanted)
        assert len(wanted) > 5
    edges = np.linspace(0, inspect(path).last + 1, 31).astype(np.int64)
    gated = streamed.count_gates(path, edges[:-1], edges[1:], (0, 1, 2))
    assert np.array_equal(gated, count_gates(path, edges[:-1], edges[1:], (0, 1, 2)))
    assert gated.sum() > 100


def test_a_gate_is_counted_when_a_later_record_shows_that_it_has_ended():
    def give(counter, *words):
        (part,) = stream.feed(np.array(words, "<u4").tobytes())
        counter.add(part)
        return counter.take().ravel().tolist()

    stream = StreamReader()
    assert list(stream.feed(tags_of(T2, 0) + END)) == []
    counter = GateCounter(T2, (0,), "it")
    counter.expect(np.array([10, 20, 3 * 10**6]), np.array([20, 30, 4 * 10**6]))
    assert give(counter, photon(12), photon(19)) == []
    assert give(counter, photon(20)) == [2]
    assert give(counter, special(1, 40)) == []  # the marker may be a microsecond too late
    counter.expect(np.array([2**25 - 1]), np.array([2**25]))
    assert give(counter, special(1, 10**6 + 30)) == [1]
    assert give(counter, special(63, 1)) == [0, 0]  # an overflow: without light, too
    with pytest.raises(InputError, match="overlap or run back"):
        counter.expect(np.array([5, 1]), np.array([6, 2]))
    assert give(counter, photon(7)) == []
    with pytest.raises(InputError, match="photons up to 33554439, and a gate begins at 33554439"):
        counter.expect(np.array([2**25 + 7]), np.array([2**25 + 9]))


def test_memory_does_not_grow_with_the_stream():
    rng = np.random.default_rng(0)
    times = np.sort(rng.integers(0, 2**25, 2**18)).astype("<u4")
    block = np.append(times, np.uint32(special(63, 1))).tobytes()
    stream, counter, found = StreamReader(), None, 0
    assert list(stream.feed(tags_of(T2, 0) + END)) == []
    tracemalloc.start()
    for k in range(30):
        counter = counter or GateCounter(T2, (0,), "it")
        counter.expect(np.array([k << 25]), np.array([k + 1 << 25]))
        for part in stream.feed(block):
            counter.add(part)
        found += int(counter.take().sum())
    _, peak = tracemalloc.get_traced_memory()
    tracemalloc.stop()
    assert found == 30 * 2**18
    assert peak < 12e6 < 30 * len(block)


def test_a_stream_after_damage_is_not_read(tmp_path):
    stream = StreamReader("pipe")
    (part,) = stream.feed(tags_of(T2, 0) + END + np.array([9, 5, 10], "<u4").tobytes())
    with pytest.raises(InputError, match="pipe is damaged: record 2 has a time before"):
        part.check("pipe")
    assert list(stream.feed(bytes(8))) == []
