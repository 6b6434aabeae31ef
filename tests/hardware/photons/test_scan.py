"""Image scans: photons between the markers of lines, to the photon, and lost markers named."""

import os
from pathlib import Path

import numpy as np
import ptufile
import pytest
from ptu_samples import T2, encode, save

from deepfsi.base.errors import InputError
from deepfsi.hardware.photons import ptu
from deepfsi.hardware.photons.scan import ScanMarkers, count_scan

FRAMES, LINES, LINE, GAP = 3, 4, 1000, 100
MARKERS = ScanMarkers(0, 1, 2)
HAZELNUT = Path(os.environ.get("DEEPFSI_DATA") or ".") / "ptu" / "hazelnut_flim.ptu"
real = pytest.mark.skipif(not HAZELNUT.is_file(), reason="needs $DEEPFSI_DATA/ptu")


def scan_events(at_end: bool = True, seed: int = 0) -> list[tuple[str, int, int]]:
    """Events of a scan whose frames are marked at their end or their start."""
    rng = np.random.default_rng(seed)
    events, now = [], 50
    for _ in range(FRAMES):
        if not at_end:
            events.append(("marker", now, 4))
        for _ in range(LINES):
            events.append(("marker", now, 1))
            times = np.sort(rng.integers(0, LINE, rng.poisson(60)))
            inputs = rng.integers(0, 2, len(times))
            events += [("photon", now + int(t), int(n)) for t, n in zip(times, inputs, strict=True)]
            events += [("marker", now + LINE, 2), ("photon", now + LINE + 7, 0)]  # one in between
            now += LINE + GAP
        if at_end:
            events.append(("marker", now - GAP, 4))
    return sorted(events, key=lambda event: event[1])


def expected(events, number=0):
    starts = [t for what, t, bits in events if what == "marker" and bits == 1]
    photons = [t for what, t, n in events if what == "photon" and n == number]
    return [sum(start <= t < start + LINE for t in photons) for start in starts]


def write(path, events, kind=T2, **tags):
    return save(path, kind, encode(kind, events, np.random.default_rng(1)), **tags)


def test_the_header_says_which_markers(tmp_path):
    events = scan_events()
    file = write(tmp_path / "bare.ptu", events)
    with pytest.raises(InputError, match="does not say on which marker input the start of a line"):
        count_scan(file, ScanMarkers())
    tags = {"ImgHdr_LineStart": 1, "ImgHdr_LineStop": 2, "ImgHdr_Frame": 3, "ImgHdr_PixY": LINES}
    told = write(tmp_path / "told.ptu", events, **tags)
    found = count_scan(told, ScanMarkers())
    assert found.counts[:, 0, 0].tolist() == expected(events)
    assert not found.faults
    other = write(tmp_path / "other.ptu", events, **(tags | {"ImgHdr_PixY": 5}))
    assert count_scan(other, ScanMarkers()).faults == tuple(
        f"frame {n} has 4 lines, where the header says 5" for n in (1, 2, 3)
    )
    for wrong in (ScanMarkers(0, 0), ScanMarkers(0, 4)):
        with pytest.raises(InputError, match="give different ones, 0 to 3"):
            count_scan(file, wrong)
    with pytest.raises(InputError, match="has no line"):
        count_scan(file, ScanMarkers(3, 2))


def test_lines_that_run_back_are_turned(tmp_path):
    events = scan_events()
    straight = count_scan(write(tmp_path / "a.ptu", events), MARKERS, pixels=7)
    tags = {"ImgHdr_BiDirect": 1, "ImgHdr_SinCorrection": 80}
    turned = count_scan(write(tmp_path / "b.ptu", events, **tags), MARKERS, pixels=7)
    assert np.array_equal(turned.frames[:, ::2], straight.frames[:, ::2])
    assert np.array_equal(turned.frames[:, 1::2], straight.frames[:, 1::2, ::-1])
    assert "equal in time, and not in width" in turned.faults[0]


@pytest.mark.parametrize(("bit", "lost"), [(1, "start"), (2, "end"), (4, "frame")])
def test_each_lost_marker_is_named_and_its_line_left_out(tmp_path, bit, lost):
    whole = scan_events()
    places = [place for place, (what, _, n) in enumerate(whole) if what == "marker" and n == bit]
    for chosen, place in enumerate(places):
        events = whole[:place] + whole[place + 1 :]
        found = count_scan(write(tmp_path / f"{chosen}.ptu", events), MARKERS)
        counts = expected(whole)
        if lost == "frame":  # of the last frame no line follows
            assert len(found.faults) == (chosen < FRAMES - 1)
            assert found.counts[:, 0, 0].tolist() == counts
            continue
        assert f"has no {lost}: a marker on {bit - 1} is lost" in found.faults[0]
        assert f"frame {chosen // LINES + 1} has 3 lines, where most have 4" in found.faults[1]
        assert found.counts[:, 0, 0].tolist() == counts[:chosen] + counts[chosen + 1 :]


def test_two_markers_at_once_are_refused(tmp_path):
    events = [*scan_events(), ("marker", 10**6, 3)]
    with pytest.raises(InputError, match="start and end of a line at once"):
        count_scan(write(tmp_path / "both.ptu", events), MARKERS)


@real
def test_real_lines_frames_and_pixels_are_those_of_ptufile():
    found = count_scan(HAZELNUT, ScanMarkers(), pixels=256)
    assert not found.faults
    with ptufile.PtuFile(HAZELNUT) as file:
        records = file.decode_records()
        image = file.decode_image(channel=0, dtime=-1, keepdims=False)
    assert np.array_equal(found.frames, image)
    before = np.concatenate([[0], np.cumsum(records["channel"] >= 0)])
    starts, ends = (np.flatnonzero(records["marker"] & bit) for bit in (1, 2))
    assert np.array_equal(found.counts.sum(axis=(1, 2)), before[ends] - before[starts])
    assert found.counts.sum() == 6_065_123
    assert np.bincount(found.frame).tolist() == [256] * 5


@pytest.mark.parametrize("kind", [T2, ptu.PICOHARP_T3], ids=["T2", "T3"])
@pytest.mark.parametrize("at_end", [True, False])
def test_counts_of_lines_and_pixels(tmp_path, kind, at_end):
    events = scan_events(at_end)
    file = write(tmp_path / "scan.ptu", events, kind)
    found = count_scan(file, MARKERS, pixels=7, inputs=(0, 1))
    assert found.counts.shape == (FRAMES * LINES, 7, 2)
    for number in (0, 1):
        assert found.counts[..., number].sum(axis=1).tolist() == expected(events, number)
    assert found.frame.tolist() == np.repeat(range(FRAMES), LINES).tolist()
    assert found.frames.shape == (FRAMES, LINES, 7)
    assert not found.faults
    assert np.allclose(np.diff(found.starts_s), (LINE + GAP) * (1e-12 if kind is T2 else 5e-8))
