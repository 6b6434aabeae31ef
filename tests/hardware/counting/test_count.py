"""Photons of a recording: each counted for its readout, or its exposure given up."""

from dataclasses import replace

import numpy as np
import pytest
import recording_samples
from hypothesis import assume, given
from hypothesis import strategies as st
from recording_samples import DWELL, many, train, troubles, unseen

from deepfsi.base.errors import InputError
from deepfsi.hardware.counting import acquisition
from deepfsi.hardware.counting.acquisition import prepare_run, read_run
from deepfsi.hardware.counting.count import CountSettings, count_run
from deepfsi.hardware.counting.counts import read_counts

run, whole = recording_samples.run, recording_samples.whole


def test_every_photon_of_a_frame_is_counted_for_its_readout(run):
    counts = count_run(run.folder)
    manifest = run.patterns.manifest
    assert counts.counts.shape == (3, 1, 2, 6)
    assert counts.counts.dtype == np.int64
    assert counts.valid.all()
    assert counts.faults == ()
    rail, mask, column, _ = manifest.read
    shown = run.photons[:, manifest.shown, 0]
    assert (counts.counts[:, 0, rail, mask] == shown[:, column]).all()
    assert counts.counts.sum() == shown.sum()  # a rail is dark
    seconds = DWELL - 3e-5  # less settling and guard
    assert np.allclose(counts.on_rate, run.photons[:, 0, 0] / seconds, rtol=2e-3)
    assert np.allclose(counts.off_rate, 3 / seconds, rtol=2e-3)
    flux = (run.photons[:, 0, 0] - 3).mean() / seconds
    assert counts.photons == pytest.approx(flux * counts.exposure_s, rel=2e-3)
    dark = counts.background
    assert (dark[:, 1, 0] == 0).all()
    assert dark[:, 0, 0] == pytest.approx(3, rel=0.05)
    assert (counts.signal() == counts.counts - dark[:, None]).all()


@pytest.mark.parametrize(("missing", "counted"), [(1, True), (2, False)])
def test_a_pass_is_whole_if_a_marker_came_after_its_last_mask(run, missing, counted):
    """Else nothing tells that its light was shown, and recorded, up to its end."""
    run.record(run.starts, run.starts.ravel()[:-missing], run.photons)
    counts = count_run(run.folder)
    assert counts.valid[:2].all()
    assert counts.valid[2].all() == counts.valid[2].any() == counted


@many
@given(
    trouble=troubles("missing", "late", "extra", "cut", "start", "next", "before"),
    pauses=st.lists(st.sampled_from([0.0, 1e-3, 0.02]), min_size=3, max_size=3),
    drift=st.floats(-2e-4, 2e-4) | st.floats(-1e-2, 1e-2),
    held=st.just(1.0) | st.floats(0.3, 1.0),
)
def test_a_valid_exposure_holds_the_photons_of_its_frames(
    whole, tmp_path, trouble, pauses, drift, held
):
    """Markers a frame too early or late, frames of other lengths and cuts are among the faults."""
    folder, patterns = tmp_path / "run", whole.patterns
    starts = train(patterns.manifest, 3, drift, pauses=pauses)
    markers = starts.ravel()
    for each in trouble:
        markers = each.strike(markers, starts)
    markers = np.unique(markers)
    assume(len(markers) and not unseen(markers, starts))
    if not folder.exists():
        prepare_run(folder, whole.folder / "patterns", read_run(whole.folder).acquisition)
    replace(whole, folder=folder).record(starts, markers, whole.photons)
    content = (folder / "photons.ptu").read_bytes()
    (folder / "photons.ptu").write_bytes(content[: max(round(held * len(content)), 1000)])
    try:
        counts = count_run(folder)
    except InputError as error:
        assert str(error).startswith(str(folder / "photons.ptu"))  # noqa: PT017
        return
    wanted = read_counts(whole.folder).counts
    valid = counts.valid[:, 0]
    # A marker may be 10 µs off unseen, and cut that much of a gate.
    assert (np.abs(counts.counts - wanted)[valid] <= 2 + 0.03 * wanted[valid]).all()
    assert (counts.counts[~valid] == 0).all()
    assert valid.all() or counts.faults


def test_a_recording_of_other_patterns_is_refused(run):
    photons = np.roll(run.photons, 3, axis=1)  # not where ON and OFF should be
    run.record(run.starts, run.starts.ravel(), photons)
    run.refused("bright and a dark frame")


def test_gates_that_do_not_fit_are_refused(run):
    run.refused("does not fit", exposure_s=0.1)
    run.refused("settle time", settle_s=float("nan"))
    run.refused("repeats do not fit", exposure_s=1e-4, repeats=10**6)
    run.refused("leaves nothing|does not fit", exposure_s=1e-4, settle_s=DWELL)


def test_repeats_are_as_many_as_can_be_counted(run, monkeypatch):
    monkeypatch.setattr(acquisition, "MOST_READOUTS", 3 * 12 * 5)
    assert count_run(run.folder, CountSettings(exposure_s=1e-3)).counts.shape[1] == 5
    run.refused("give at most 5", exposure_s=1e-3, repeats=6)
