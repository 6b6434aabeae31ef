"""Clocks: frames that all last longer or shorter than planned, and markers that are off by more."""

import numpy as np
import pytest
import recording_samples
from hypothesis import assume, given
from hypothesis import strategies as st
from recording_samples import DWELL, JITTER, made, many, schedule, train, troubles, unseen

from deepfsi.base import InputError
from deepfsi.hardware.counting import CountSettings, count_run, read_counts
from deepfsi.hardware.counting.markers import align, measure_pictures

run, whole = recording_samples.run, recording_samples.whole

EQUAL = schedule([1000] * 16)
FREE = schedule([400, 900, 1300, 2100, 700, 3000, 1500, 800, 600, 1100, 2500, 1900])
SHORT = schedule([44] * 180, sentinel=44)
UNLIKE = pytest.mark.parametrize("manifest", [EQUAL, FREE, SHORT], ids=["equal", "free", "short"])


@UNLIKE
@pytest.mark.parametrize("pause", [0.0, 0.0374])
@pytest.mark.parametrize(("rate", "extra"), [(5e-3, 0), (-0.01, 0), (0.01, 0), (0, 5e-6)])
def test_frames_that_all_last_longer_than_planned_are_trusted(manifest, pause, rate, extra):
    """5 µs on frames of 1 ms is half a percent: the file was refused whole."""
    true = train(manifest, 4, rate, pauses=pause, extra=extra)
    found = align(true.ravel(), manifest, 4)
    assert (found.starts_s == true).all()
    assert found.faults == ()
    wanted = (1 + rate) * manifest.picture_s + extra
    np.testing.assert_allclose(found.pictures_s, wanted, rtol=2e-4)


@UNLIKE
@pytest.mark.parametrize(("rate", "extra"), [(5e-3, 0), (-0.01, 0), (0, 5e-6)])
def test_faults_are_mended_on_a_stretched_schedule(manifest, rate, extra):
    true = train(manifest, 4, rate, pauses=0.03, extra=extra)
    markers = np.delete(true.ravel(), [5, 6, true.shape[1] + 9])
    found = align(markers, manifest, 4)
    assert [(f.kind, f.scene, f.frame) for f in found.faults] == [
        ("missing", 0, 5),
        ("missing", 0, 6),
        ("missing", 1, 9),
    ]
    assert np.abs(found.starts_s - true).max() < 10 * JITTER


def test_a_clock_is_measured_among_faults():
    """One marker in twenty is missing, and one doubled."""
    rng = np.random.default_rng(3)
    for manifest, extra in ((EQUAL, 0.0), (FREE, 0.0), (FREE, 5e-6)):
        rate = 0.0 if extra else 7e-3
        true = train(manifest, 40, rate, extra=extra).ravel()
        kept = true[rng.random(len(true)) > 0.05]
        doubled = kept[rng.random(len(kept)) < 0.05] + 3e-5
        measured = measure_pictures(np.sort(np.append(kept, doubled)), manifest.picture_s, 1e-5)
        assert measured is not None
        wanted = (1 + rate) * manifest.picture_s + extra
        np.testing.assert_allclose(measured, wanted, rtol=2e-4)


@pytest.mark.parametrize("rate", [0.3, -0.05])
def test_frames_of_another_length_are_refused_with_both(rate):
    with pytest.raises(InputError, match=rf"one each {1 + rate:g} ms, planned 1 ms"):
        align(train(EQUAL, 3, rate).ravel(), EQUAL, 3)


def test_a_tolerance_lets_markers_be_off():
    true = train(EQUAL, 5, jitter=1e-4, pauses=0.05)
    with pytest.raises(InputError, match="not follow the schedule"):
        align(true.ravel(), EQUAL, 5)
    found = align(true.ravel(), EQUAL, 5, tolerance_s=2e-4)
    assert (found.starts_s == true).all()
    with pytest.raises(InputError, match="up to a fifth of the shortest frame"):
        align(true.ravel(), EQUAL, 5, tolerance_s=3e-4)


@pytest.mark.parametrize("rate", [-0.01, 0.005, 0.01])
def test_frames_of_another_length_are_counted_and_the_drift_is_said(run, rate):
    starts = train(run.patterns.manifest, 3, rate)
    run.record(starts, starts.ravel(), run.photons)
    counts = count_run(run.folder, CountSettings(exposure_s=11 * DWELL * 0.9))
    assert counts.valid.all()
    assert counts.drift == pytest.approx(rate, abs=1e-5)
    assert read_counts(run.folder).drift == counts.drift
    length = run.patterns.manifest.picture_s[0] - 4e-5  # in which photons come, evenly
    for place, gate in zip(run.patterns.manifest.shown, counts.gate_s, strict=True):
        frame = run.patterns.manifest.frames[place]
        wanted = run.photons[:, place, 0] * (gate + 2e-5 - 3e-5) / length
        here = counts.counts[:, 0, 0 if frame.rail == "plus" else 1, frame.mask]
        assert (np.abs(here - wanted) < 1.5).all()


def test_gates_that_do_not_fit_frames_as_they_were_are_refused(run):
    """Else the next frame cuts each gate, by another share in each."""
    starts = train(run.patterns.manifest, 3, -0.01)
    run.record(starts, starts.ravel(), run.photons)
    run.refused(
        "1.00% shorter than planned.*--exposure 0.01067 or less", exposure_s=11 * DWELL * 0.972
    )
    assert count_run(run.folder, CountSettings(exposure_s=11 * DWELL * 0.97)).valid.all()


@many
@given(
    manifest=st.sampled_from([EQUAL, FREE, schedule([1000, 1010] * 9), schedule([1000])]),
    scenes=st.integers(1, 4),
    drift=st.floats(-1e-2, 1e-2),
    extra=st.sampled_from([0.0, 1e-6, 5e-6, 2e-5]),
    pauses=st.lists(st.sampled_from([0.0, 3e-4, 1e-3, 2e-3, 0.05]), min_size=4, max_size=4),
    trouble=st.just([]) | troubles("missing", "late", "extra", "cut", "start"),
    jitter=st.sampled_from([0.0, JITTER, 2e-6]),
    cut=st.booleans(),
)
def test_no_fault_shifts_a_stretched_pass_silently(
    manifest, scenes, drift, extra, pauses, trouble, jitter, cut
):
    true = train(manifest, scenes, drift, pauses=pauses[:scenes], extra=extra, jitter=jitter)
    markers = true.ravel()
    for each in trouble:
        markers = each.strike(markers, true)
    assume(not unseen(markers, true))
    try:
        found = align(markers, manifest, scenes, cut=cut)
    except InputError as error:
        assert trouble or (drift and extra), error  # noqa: PT017
        assert "\n" not in str(error)  # noqa: PT017
        return
    known = np.isfinite(found.starts_s)
    assert (np.abs(found.starts_s - true)[known] < 3e-5).all()
    if not found.faults:
        assert known.all()


def test_made_recordings_have_no_drift(tmp_path):
    """Jitter of the markers alone leaves the planned schedule as it is."""
    run = made(tmp_path)
    starts = train(run.patterns.manifest, 3)
    run.record(starts, starts.ravel(), run.photons)
    assert abs(count_run(run.folder).drift) < 2 * JITTER / (14 * DWELL)
