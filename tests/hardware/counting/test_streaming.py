"""Photons counted frame by frame while a recording runs, against those counted at its end."""

import re
from pathlib import Path

import numpy as np
import pytest

from deepfsi.base import InputError
from deepfsi.hardware.counting import FrameCounter, FrameGates
from deepfsi.hardware.photons import (
    PtuFile,
    PtuWriter,
    count_windows,
    marker_slack_s,
    ptu,
    read_markers,
)
from hardware.photons.ptu_samples import END, T2, photon, recorded, save, special, tags_of

TICK_S, SETTLE = 1e-12, 10e-6


def record(path, dwells_s, rate, inputs=2, seed=0, end_s=1e-4):
    """Frames one after another, each with a marker of bit 2 at its start; some of bit 1 between."""
    rng = np.random.default_rng(seed)
    starts = np.rint((1e-4 + np.append(0, np.cumsum(dwells_s))) / TICK_S).astype(np.int64)
    last = int(starts[-1] + end_s / TICK_S)
    photons = rng.integers(0, last, rng.poisson(rate * last * TICK_S))
    others = rng.integers(0, last, 20)
    times = np.concatenate([photons, starts[:-1], others])
    codes = np.concatenate(
        [rng.integers(0, inputs, len(photons)), np.full(len(dwells_s), -2), np.full(20, -1)]
    )
    order = np.argsort(times, kind="stable")
    with PtuWriter(path, TICK_S) as writer:
        writer.write(times[order], codes[order])
    return path


def gates_of(dwells_s):
    """Gates of different lengths that end before their frames do."""
    return FrameGates.of(SETTLE, (np.asarray(dwells_s) - SETTLE) * 0.8)


def feed(counter, content, sizes):
    """Counts, and the bytes that had come when each was given."""
    first, found, when, starts = 0, [], [], []
    for size in sizes:
        counts = counter.feed(content[first : first + size])
        first += size
        found += counts.counts.tolist()
        starts += counts.starts_s.tolist()
        when += [first] * len(counts.counts)
    return np.array(found), starts, when


@pytest.mark.parametrize("rate", [0, 1e5, 1e7])
@pytest.mark.parametrize("size", [1, 1001, 2**20])
def test_frames_are_counted_as_when_the_recording_has_ended(tmp_path, rate, size):
    dwells = np.random.default_rng(3).uniform(44e-6, 200e-6, 24)
    if size == 1:
        dwells = dwells[: 24 if rate < 1e7 else 2]
    path, gates = record(tmp_path / "a.ptu", dwells, rate), gates_of(dwells)
    times, bits = read_markers(path)
    starts = times[bits == 2]
    offsets, lengths = (np.rint(s / TICK_S).astype(int) for s in (gates.offsets_s, gates.lengths_s))
    wanted = count_windows(path, starts + offsets, starts + offsets + lengths, (1, 0))

    counter, content = FrameCounter((1, 0), marker_bit=2), path.read_bytes()
    counter.expect(gates)
    found, found_s, _ = feed(counter, content, [size] * (len(content) // size + 1))
    assert np.array_equal(found, wanted)
    assert found_s == pytest.approx(starts * TICK_S, abs=1e-15)
    assert (wanted.sum() > 0) == (rate > 0)


def frames_of(starts, slack, rng):
    """Frames of one to three markers that a file's markers begin, and gates that fill them."""
    first, offset, told = 0, slack + 1, []
    while (last := first + int(rng.integers(1, 4))) < len(starts):
        while last < len(starts) and starts[last] < starts[first]:  # a marker may be a little off
            last += 1
        room = int(starts[min(last, len(starts) - 1)] - starts[first])
        told.append((first, offset, int(rng.integers(0, room + 1)), last - first))
        first = last
    told.append((first, offset, 1, len(starts) - first))
    return np.array(told).T


@pytest.mark.parametrize("seed", range(3))
@pytest.mark.parametrize("kind", ptu.KINDS.values(), ids=lambda kind: kind.name)
def test_frames_of_all_types_of_records_are_counted_alike(tmp_path, kind, seed):
    rng = np.random.default_rng(seed)
    path = save(tmp_path / "a.ptu", kind, recorded(kind.code, 600, seed))
    times, bits = read_markers(path)
    header, bit = PtuFile(path), int(rng.choice([1, 2, 4, 8]))
    starts = times[bits & bit != 0]
    first, offsets, lengths, markers = frames_of(
        starts, round(marker_slack_s(header.tick_s) / header.tick_s), rng
    )
    opens = starts[first] + offsets
    wanted = count_windows(path, opens, opens + lengths, (1, 0, 2))

    counter, content = FrameCounter((1, 0, 2), bit), path.read_bytes()
    counter.expect(FrameGates(offsets * header.tick_s, lengths * header.tick_s, markers))
    cuts = rng.integers(0, 2 ** rng.integers(1, 14), len(content))
    found, found_s, _ = feed(counter, content, [*cuts, len(content)])
    assert len(found) >= len(wanted) - 3  # the last gates may not have ended
    assert np.array_equal(found, wanted[: len(found)])
    assert np.array_equal(found_s, (starts[first] * header.tick_s)[: len(found)])
    assert found.sum() > 50


def test_a_look_may_be_told_after_the_counts_of_the_last(tmp_path):
    dwells = np.random.default_rng(4).uniform(44e-6, 90e-6, 12)
    path, gates = record(tmp_path / "a.ptu", dwells, 3e6), gates_of(dwells)
    content = path.read_bytes()
    at_once = FrameCounter((0, 1), marker_bit=2)
    at_once.expect(gates)
    wanted = at_once.feed(content).counts

    counter, found, told, most = FrameCounter((0, 1), marker_bit=2), [], 0, 0
    for first in range(0, len(content), 16):
        if len(found) == told and told < 12:
            counter.expect(gates_of(dwells[told : told + 4]))
            told += 4
        found += counter.feed(content[first : first + 16]).counts.tolist()
        most = max(most, told - len(found))
    assert np.array_equal(found, wanted)
    assert (told, most) == (12, 4)


EVEN = np.full(8, 44e-6)
UNEVEN = np.array([60e-6, 44e-6, 300e-6, 44e-6, 44e-6, 500e-6, 44e-6, 44e-6])


def looks(pictures_s, lost=None, doubled=None, off_s=0.0):
    """Bytes of two looks with a pause between, and a marker that is lost, doubled or off."""
    starts = np.rint((1e-4 + np.cumsum([0, *pictures_s[:-1]])) / TICK_S).astype(np.int64)
    starts = np.concatenate([starts, starts + 2 * 10**9])
    if lost is not None:
        starts = np.delete(starts, lost)
    if doubled is not None:
        starts = np.insert(starts, doubled, starts[doubled] + 15 * 10**6)
    starts[3] += round(off_s / TICK_S)
    photons = np.random.default_rng(0).integers(0, starts[-1] + 10**9, 20000)
    times = np.sort(np.append(photons, starts))
    words, wraps = [], 0
    for time in times.tolist():
        while time >> 25 > wraps:
            words.append(special(63, 1))
            wraps += 1
        field = time & (1 << 25) - 1
        words.append(special(1, field) if time in starts else photon(field))
    return tags_of(T2, 0) + END + np.array(words, "<u4").tobytes()


def see(content, shown_s, pictures_s):
    counter = FrameCounter((0,), stream="it")
    gates = FrameGates(np.full(8, SETTLE), shown_s - 15e-6, np.ones(8, int), pictures_s)
    counter.expect(gates)
    counter.expect(FrameGates.of(SETTLE, []))
    counter.expect(gates)
    return counter.feed(content).counts


@pytest.mark.parametrize("shown_s", [EVEN, UNEVEN], ids=["even", "uneven"])
@pytest.mark.parametrize("place", range(8))
def test_a_marker_that_is_missing_or_doubled_shifts_no_frame(place, shown_s):
    """Without the times of the pictures a missing one would be taken for the next."""
    if shown_s is EVEN:
        assert len(see(looks(shown_s, lost=place), shown_s, None)) == 14
    for broken in ({"lost": place}, {"doubled": place}):
        with pytest.raises(InputError, match="a marker is missing or one too many") as error:
            see(looks(shown_s, **broken), shown_s, shown_s)
        assert "\n" not in str(error.value)


@pytest.mark.parametrize("shown_s", [EVEN, UNEVEN], ids=["even", "uneven"])
def test_markers_that_are_a_little_off_and_clocks_that_differ_are_no_fault(shown_s):
    for off_s in (-8e-6, 0.0, 8e-6):
        assert len(see(looks(shown_s, off_s=off_s), shown_s, shown_s)) == 16
    for planned_s in (shown_s * 1.015, shown_s * 0.985, shown_s + 5e-6):
        assert len(see(looks(shown_s), shown_s, planned_s)) == 16


@pytest.mark.parametrize(
    ("told", "message"),
    [
        ([(SETTLE, [30e-6] * 2)], "starts no frame"),
        ([(SETTLE, [70e-6, 70e-6])], "before the gate of the frame before has ended"),
        ([(0.9e-6, [30e-6])], "a longer time to settle"),
        ([(SETTLE, [30e-6, np.nan])], "no times"),
        ([(SETTLE, [30e-6, -1.0])], "no times"),
    ],
)
def test_markers_and_gates_that_do_not_fit_are_refused(tmp_path, told, message):
    path = record(tmp_path / "a.ptu", [44e-6] * 3, 1e6)
    counter = FrameCounter((0,), marker_bit=2, stream=path)
    with pytest.raises(InputError, match=message) as error:  # noqa: PT012
        for offset, lengths in told:
            counter.expect(FrameGates.of(offset, lengths))
        counter.feed(path.read_bytes())
    assert "\n" not in str(error.value)


def test_the_lines_of_the_page_run(tmp_path, monkeypatch, capsys):
    page = (Path(__file__).parents[3] / "docs/develop/drivers.md").read_text()
    (lines,) = re.findall(r"^```python\n(.*?FrameCounter.*?)^```", page, re.M | re.S)
    record(tmp_path / "photons.ptu", [54e-6, 110e-6], 1e6)
    content = (tmp_path / "photons.ptu").read_bytes()
    monkeypatch.chdir(tmp_path)
    exec(lines.replace("marker_bit=1", "marker_bit=2"), {})
    counter = FrameCounter((0,), 2)
    counter.expect(FrameGates.of(SETTLE, [34e-6, 90e-6]))
    found = counter.feed(content)
    assert len(found.counts) == 2
    assert f"{found.starts_s} {found.counts}" in capsys.readouterr().out


def test_a_frame_of_several_pictures_begins_with_its_first_marker(tmp_path):
    """A device that repeats a picture to show it for longer gives a marker each time."""
    path = record(tmp_path / "a.ptu", [44e-6] * 9, 5e6)
    times, bits = read_markers(path)
    starts = times[bits == 2][[0, 3, 4]]
    pictures = np.array([3, 1, 5])
    gates = FrameGates(np.full(3, SETTLE), 44e-6 * pictures - 1.5 * SETTLE, pictures)
    counter = FrameCounter((0,), marker_bit=2)
    counter.expect(gates)
    opens = starts + round(SETTLE / TICK_S)
    closes = opens + np.rint(gates.lengths_s / TICK_S).astype(int)
    assert np.array_equal(
        counter.feed(path.read_bytes()).counts, count_windows(path, opens, closes)
    )


@pytest.mark.parametrize("place", range(8))
def test_a_list_that_lacks_a_marker_is_never_counted_to_its_end(place):
    """A loop that waits for the last mask's counts, before the all-OFF frame, waits in vain."""
    content = looks(EVEN)
    last = FrameCounter((0,))
    last.expect(FrameGates.of(SETTLE, EVEN - 15e-6))
    assert len(last.feed(content[: len(content) // 2]).counts) == 8
    counter = FrameCounter((0,))
    counter.expect(FrameGates.of(SETTLE, EVEN - 15e-6))
    lost = looks(EVEN, lost=place)
    assert len(counter.feed(lost[: len(lost) // 2]).counts) == 6
