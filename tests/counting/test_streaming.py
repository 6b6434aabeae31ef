"""Photons counted frame by frame while a recording runs, against those counted at its end."""

import re
from pathlib import Path

import numpy as np
import pytest

from counting.ptu_samples import END, T2, encode, recorded, save, tags_of
from counting.recording_samples import write_photons
from deepfsi.base.errors import InputError
from deepfsi.counting import ptu
from deepfsi.counting.ptu import marker_slack
from deepfsi.counting.reader import PtuFile, count_windows, read_markers
from deepfsi.counting.streaming import FrameCounter, FrameGates

TICK_S, SETTLE = 1e-12, 10e-6


def record(folder, dwells_s, rate):
    """Frames one after another, each with a marker of bit 2 at its start; some of bit 1 between."""
    rng = np.random.default_rng(0)
    starts = 1e-4 + np.append(0, np.cumsum(dwells_s))
    last = starts[-1] + 1e-4
    photons = rng.uniform(0, last, rng.poisson(rate * last))
    times = np.concatenate([photons, starts[:-1], rng.uniform(0, last, 20)])
    codes = np.repeat([0, -2, -1], [len(photons), len(dwells_s), 20])
    codes[: len(photons)] = rng.integers(0, 2, len(photons))
    write_photons(folder, times, codes)
    return folder / "photons.ptu"


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


@pytest.mark.parametrize("seed", range(2))
@pytest.mark.parametrize("kind", ptu.RECORD_TYPES.values(), ids=lambda kind: kind.name)
def test_frames_of_all_types_of_records_are_counted_alike(tmp_path, kind, seed):
    rng = np.random.default_rng(seed)
    path = save(tmp_path / "a.ptu", kind, recorded(kind.code, 600, seed))
    times, bits = read_markers(path)
    header, bit = PtuFile(path).header, int(rng.choice([1, 2, 4, 8]))
    starts = times[bits & bit != 0]
    first, offsets, lengths, markers = frames_of(starts, marker_slack(header.tick_s), rng)
    opens = starts[first] + offsets
    wanted = count_windows(path, opens, opens + lengths, (1, 0, 2))

    counter, content = FrameCounter((1, 0, 2), bit), path.read_bytes()
    counter.expect(FrameGates(offsets * header.tick_s, lengths * header.tick_s, markers))
    found = []
    cuts = np.cumsum(rng.integers(0, 2 ** rng.integers(1, 14), len(content)))
    for piece in np.split(np.frombuffer(content, np.uint8), cuts[cuts < len(content)]):
        found += counter.feed(piece.tobytes()).tolist()
    assert len(found) >= len(wanted) - 3  # the last gates may not have ended
    assert np.array_equal(found, wanted[: len(found)])
    assert np.sum(found) > 50


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
    rng = np.random.default_rng(0)
    events = [("photon", time, 0) for time in rng.integers(0, starts[-1] + 10**9, 20000).tolist()]
    events += [("marker", time, 1) for time in starts.tolist()]
    words = encode(T2, sorted(events, key=lambda event: event[1]), rng)
    return tags_of(T2, 0) + END + np.array(words, "<u4").tobytes()


def see(content, shown_s, pictures_s):
    counter = FrameCounter((0,), stream="it")
    gates = FrameGates(np.full(8, SETTLE), shown_s - 15e-6, np.ones(8, int), pictures_s)
    counter.expect(gates)
    counter.expect(FrameGates.of(SETTLE, []))
    counter.expect(gates)
    return counter.feed(content)


@pytest.mark.parametrize("shown_s", [EVEN, UNEVEN], ids=["even", "uneven"])
@pytest.mark.parametrize("place", [0, 1, 5, 7])
def test_a_marker_that_is_missing_or_doubled_shifts_no_frame(place, shown_s):
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
    ("offset", "lengths", "message"),
    [
        (SETTLE, [30e-6] * 2, "starts no frame"),
        (SETTLE, [70e-6, 70e-6], "before the gate of the frame before has ended"),
        (0.9e-6, [30e-6], "a longer time to settle"),
    ],
)
def test_markers_and_gates_that_do_not_fit_are_refused(tmp_path, offset, lengths, message):
    path = record(tmp_path, [44e-6] * 3, 1e6)
    counter = FrameCounter((0,), marker_bit=2, stream=path)
    with pytest.raises(InputError, match=message) as error:  # noqa: PT012
        counter.expect(FrameGates.of(offset, lengths))
        counter.feed(path.read_bytes())
    assert "\n" not in str(error.value)


def test_the_lines_of_the_page_run(tmp_path, monkeypatch, capsys):
    page = (Path(__file__).parents[2] / "docs/develop/drivers.md").read_text()
    blocks = re.findall(r"^```python\n(.*?)^```", page, re.M | re.S)
    (lines,) = (block for block in blocks if "FrameCounter" in block)
    record(tmp_path, [54e-6, 110e-6], 1e6)
    content = (tmp_path / "photons.ptu").read_bytes()
    monkeypatch.chdir(tmp_path)
    exec(lines.replace("marker_bit=1", "marker_bit=2"), {})
    counter = FrameCounter((0,), 2)
    counter.expect(FrameGates.of(SETTLE, [34e-6, 90e-6]))
    found = counter.feed(content)
    assert len(found) == 2
    assert f"{found}" in capsys.readouterr().out
