"""Markers: each brought to its frame on any clock, or its pass given up; files that were cut."""

import numpy as np
import pytest
import recording_samples
from hypothesis import assume, given, settings
from hypothesis import strategies as st
from recording_samples import (
    DWELL,
    FUZZ,
    JITTER,
    Run,
    lamp,
    many,
    schedule,
    train,
    troubles,
    unseen,
)

from deepfsi.base.errors import InputError
from deepfsi.hardware.calibration.reconstruction import reconstruct
from deepfsi.hardware.counting import markers
from deepfsi.hardware.counting.count import CountSettings, count_run
from deepfsi.hardware.counting.counts import read_counts
from deepfsi.hardware.photons.reader import PtuFile, read_markers

run, whole = recording_samples.run, recording_samples.whole

EQUAL = schedule([1000] * 16)
FREE = schedule([400, 900, 1300, 2100, 700, 3000, 1500, 800, 600, 1100, 2500, 1900])


def right_or_lost(found: np.ndarray, true: np.ndarray, within: float = 2.5e-5) -> np.ndarray:
    """Check that no frame has a wrong time; which are known."""
    known = np.isfinite(found)
    assert (np.abs(found - true)[known] < within).all()
    return known


@pytest.mark.parametrize("manifest", [EQUAL, FREE], ids=["equal", "free"])
@pytest.mark.parametrize("drift", [-2e-4, 2e-4])
@pytest.mark.parametrize("pause", [0.0, 0.0374])
def test_faults_within_a_pass_are_named_and_mended(manifest, drift, pause):
    true = train(manifest, 4, drift, pauses=pause)
    given = true.copy()
    given[2, 7] += 1.2e-4
    given[3, 2] -= 9e-5
    times = np.append(given.ravel(), true[1, 4] + 3e-5)
    found = markers.align(np.delete(times, [5, 6, true.shape[1] + 9]), manifest, 4)
    assert [(f.kind, f.scene, f.frame) for f in found.faults] == [
        ("missing", 0, 5),
        ("missing", 0, 6),
        ("missing", 1, 9),
        ("late", 2, 7),
        ("late", 3, 2),
        ("extra", 1, 4),
    ]
    for fault, off, side in ((found.faults[3], 120, "late"), (found.faults[4], 90, "early")):
        assert float(fault.detail.split(f" µs {side}")[0]) == pytest.approx(off, abs=1)
    assert np.abs(found.starts_s - true).max() < 10 * JITTER
    assert str(found.faults[0]).startswith("missing scene 0, frame 5: due at 0.02")


@pytest.mark.parametrize("drift", [-2e-4, 2e-4])
@pytest.mark.parametrize("pause", [0.0, 1e-3, 0.0374])
@pytest.mark.parametrize("frame", [0, 1, 18, 19])
@pytest.mark.parametrize("scene", [0, 1, 3])
def test_a_pass_that_lacks_its_first_or_last_marker_is_placed_by_photons(
    drift, pause, frame, scene
):
    true = train(EQUAL, 4, drift, pauses=pause)
    times = np.delete(true.ravel(), scene * len(EQUAL.frames) + frame)
    right_or_lost(markers.align(times, EQUAL, 4).starts_s, true)
    found = markers.align(times, EQUAL, 4, counter=lamp(EQUAL, true))
    lost = (scene, frame) == (3, 19)
    assert right_or_lost(found.starts_s, true).sum() == true.size - lost
    (fault,) = found.faults
    kind = "lost" if lost else "missing"
    assert (fault.kind, fault.scene, fault.frame) == (kind, scene, frame)


@pytest.mark.parametrize(("mask", "placed"), [(650, False), (500, True)])
def test_a_pass_that_may_begin_at_two_frames_is_given_up(mask, placed):
    """Two frames later begins a step that lacks 4 standard errors of ON to OFF, or 9."""
    true, frames = train(EQUAL, 1, jitter=0), len(EQUAL.frames)
    photons = dict.fromkeys(range(2, frames - 2), 300) | {2: mask, 3: 0}
    photons |= dict.fromkeys((0, frames - 2, frames), 1000)  # the last: a lamp after the pass

    def counter(begin, end):
        slots = np.floor((begin - true[0, 0]) / EQUAL.picture_s[0]).astype(int)
        return np.array([photons.get(slot, 0) for slot in slots.tolist()])

    found = markers.align(true.ravel()[1:], EQUAL, 1, counter=counter).starts_s
    assert right_or_lost(found, true).any() == placed


def test_a_long_hole_is_not_filled():
    true = train(EQUAL, 3, 1e-4, pauses=0.05)
    found = markers.align(np.delete(true.ravel(), range(25, 31)), EQUAL, 3)
    assert right_or_lost(found.starts_s, true).sum() == true.size - 6
    (fault,) = found.faults
    assert (fault.kind, fault.scene, fault.frame) == ("lost", 1, 5)
    assert "frames 5 to 10" in fault.detail


@pytest.mark.parametrize(
    ("times", "scenes", "match"),
    [
        (np.zeros(0), 1, "no frame markers"),
        (train(EQUAL, 3).ravel(), 4, "3 whole passes"),
        (train(EQUAL, 3, pauses=0.1).ravel(), 4, "3 whole passes"),
        (train(EQUAL, 4).ravel()[20:-2], 4, "3 whole passes"),  # which one is lacking?
        (train(EQUAL, 3).ravel(), 2, "20 markers follow the last of 2"),
        (np.random.default_rng(0).random(1000), 5, "follow the schedule"),
        (train(FREE, 3).ravel(), 3, "follow the schedule"),
    ],
)
def test_markers_of_other_patterns_are_refused(times, scenes, match):
    with pytest.raises(InputError, match=match):
        markers.align(times, EQUAL, scenes)


@pytest.mark.parametrize("brightest", [0.0, 0.1, 3.0, 200.0, 1e4])
def test_a_pass_in_its_place_is_never_taken_for_a_shifted_one(brightest):
    """Over 500 passes of 1000 frames, however faint."""
    rng = np.random.default_rng(1)
    rates = rng.uniform(0.1, 0.9, 1000)
    rates[2:4] = 1.0, 0.45  # as a Hadamard basis begins
    rates[[0, -2]], rates[[1, -1]] = 1.0, 0.0
    for _ in range(500):
        fits, clear = markers.find_steps(rng.poisson(rates * brightest + 0.01), np.ones(1000))
        assert fits[[0, -1]].all()
        assert clear == (brightest > 10)


@settings(parent=many, max_examples=2 * FUZZ)
@given(
    manifest=st.sampled_from([EQUAL, FREE, schedule([1000, 1010] * 9), schedule([1000])]),
    scenes=st.integers(1, 4),
    clock=st.tuples(st.floats(-2e-4, 2e-4), st.just(0.0), st.just(JITTER))
    | st.tuples(
        st.floats(-1e-2, 1e-2),
        st.sampled_from([0.0, 1e-6, 5e-6, 2e-5]),
        st.sampled_from([0.0, JITTER, 2e-6]),
    ),
    pauses=st.lists(st.sampled_from([0.0, 3e-4, 1e-3, 2e-3, 0.05]), min_size=4, max_size=4),
    trouble=st.just([]) | troubles("missing", "late", "extra", "cut", "start"),
    seed=st.integers(0, 99),
    seen=st.booleans(),
    cut=st.booleans(),
)
def test_no_fault_shifts_a_pass_silently(manifest, scenes, clock, pauses, trouble, seed, seen, cut):
    """Frames last longer by a share, drift, and a time, extra; photons may be seen."""
    drift, extra, jitter = clock
    true = train(manifest, scenes, drift, 0.02, pauses[:scenes], seed, extra, jitter)
    times = true.ravel()
    for each in trouble:
        times = each.strike(times, true)
    assume(not unseen(times, true))
    usual = abs(drift) <= 2e-4 and not extra
    counter = lamp(manifest, true, seed) if seen and usual else None
    try:
        found = markers.align(times, manifest, scenes, counter=counter, cut=cut)
    except InputError as error:
        assert trouble or (drift and extra), error  # noqa: PT017
        assert "\n" not in str(error)  # noqa: PT017
        return
    known = right_or_lost(found.starts_s, true, 2.5e-5 if usual else 3e-5)
    assert known.all() or found.faults


def cut_after(run: Run, number: int, more: int) -> None:
    """Cut a file so many records after its marker of that number."""
    path = run.folder / "photons.ptu"
    offset, content = PtuFile(path).header.offset, path.read_bytes()
    words = np.frombuffer(content[offset : offset + (len(content) - offset) // 4 * 4], "<u4")
    places = np.flatnonzero((words >> 31 == 1) & (words >> 25 & 63 < 16))
    path.write_bytes(content[: offset + 4 * (int(places[number - 1]) + 1 + more)])
    assert len(read_markers(path)[0]) == number


@pytest.mark.parametrize(("pause", "rate"), [(0.0, 0.0), (1e-3, 0.0), (0.02, 5e-3)])
def test_whole_passes_of_a_cut_file_are_counted(run, pause, rate):
    """Between two passes, or in the first frame of one, the file was refused whole."""
    starts = train(run.patterns.manifest, 3, rate, pauses=pause)
    run.record(starts, starts.ravel(), run.photons)
    content = (run.folder / "photons.ptu").read_bytes()
    wanted, frames = count_run(run.folder).counts, starts.shape[1]
    beyond = {1: (-1, 0, 1, 2, 4), 2: (-2, -1, 0, 1), 3: (-1,)}
    for number in [passes * frames + k for passes, some in beyond.items() for k in some]:
        for more in (0, 2):
            cut_after(run, number, more)
            kept = number // frames
            if not kept:
                run.refused("photons.ptu has no whole exposure")
            else:
                counts, whole = count_run(run.folder), np.arange(3) < kept
                assert np.array_equal(counts.valid[:, 0], whole)
                assert np.array_equal(np.isfinite(counts.on_rate), whole)
                assert np.array_equal(np.isfinite(reconstruct(run.folder)).all((1, 2)), whole)
                assert np.array_equal(counts.counts, wanted * whole[:, None, None, None])
                assert {fault.scene for fault in counts.faults} == set(range(kept, 3))
            (run.folder / "photons.ptu").write_bytes(content)


@pytest.mark.parametrize("kept", [[1, 2, 5], [1, 2, 3, 4, 5]])
def test_the_last_pass_of_a_cut_file_is_not_made_of_two(kept):
    """Frames 1 to 4 of a pass and frame 0 of the next fit a whole pass; photons tell."""
    manifest = schedule([1000])
    true = train(manifest, 2)
    times = true.ravel()[kept]
    found = markers.align(times, manifest, 2, cut=True)
    assert np.isnan(found.starts_s).all()
    assert {fault.scene for fault in found.faults if fault.kind == "lost"} == {0, 1}
    try:
        found = markers.align(times, manifest, 2, counter=lamp(manifest, true), cut=True)
    except InputError as error:
        assert "not certain" in str(error)  # noqa: PT017 - one of two right answers
    else:
        right_or_lost(found.starts_s, true, 3e-5)


def test_gates_that_do_not_fit_frames_as_they_were_are_refused(run):
    """Else the next frame cuts each gate, by another share in each."""
    starts = train(run.patterns.manifest, 3, -0.01)
    run.record(starts, starts.ravel(), run.photons)
    said = "1.00% shorter than planned.*--exposure 0.01067 or less"
    run.refused(said, exposure_s=11 * DWELL * 0.972)
    assert count_run(run.folder, CountSettings(exposure_s=11 * DWELL * 0.97)).valid.all()


@pytest.mark.parametrize("rate", [-0.01, 0.005, 0.01])
def test_frames_of_another_length_are_counted_and_the_drift_is_said(run, rate):
    manifest = run.patterns.manifest
    starts = train(manifest, 3, rate)
    run.record(starts, starts.ravel(), run.photons)
    counts = count_run(run.folder, CountSettings(exposure_s=11 * DWELL * 0.9))
    assert counts.valid.all()
    assert counts.drift == pytest.approx(rate, abs=1e-5)
    assert read_counts(run.folder).drift == counts.drift
    length = manifest.picture_s[0] - 4e-5  # in which photons come, evenly
    rail, mask, column, _ = manifest.read
    opened = (counts.gate_s + 2e-5 - 3e-5) / length
    wanted = (run.photons[:, manifest.shown, 0] * opened)[:, column]
    assert (np.abs(counts.counts[:, 0, rail, mask] - wanted) < 1.5).all()
