"""Markers: each is of its frame on any clock, or the recording is refused."""

import numpy as np
import pytest
import recording_samples
from hypothesis import given, settings
from hypothesis import strategies as st
from recording_samples import (
    DWELL,
    FUZZ,
    JITTER,
    many,
    schedule,
    train,
    troubles,
)

from deepfsi.base.errors import InputError
from deepfsi.counting.recording import Recording
from deepfsi.counting.windows import FrameStarts

run, whole = recording_samples.run, recording_samples.whole

EQUAL = schedule([1000] * 16)
FREE = schedule([400, 900, 1300, 2100, 700, 3000, 1500, 800, 600, 1100, 2500, 1900])


@pytest.mark.parametrize(
    ("times", "scenes", "match"),
    [
        (np.zeros(0), 1, "0 whole passes"),
        (train(EQUAL, 3).ravel(), 4, "3 whole passes"),
        (train(EQUAL, 3, pauses=0.1).ravel()[:-1], 3, "2 whole passes"),
        (np.delete(train(EQUAL, 3).ravel(), 27), 3, r"2 ms after .* \(scene 1, frame 6\)"),
        (np.random.default_rng(0).random(1000), 5, "follow the schedule"),
        (train(FREE, 3).ravel(), 3, "follow the schedule"),
    ],
)
def test_markers_of_other_patterns_or_scenes_are_refused(times, scenes, match):
    with pytest.raises(InputError, match=match):
        FrameStarts.of(times, EQUAL, scenes)


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
    trouble=st.just([]) | troubles("missing", "late", "extra"),
    seed=st.integers(0, 99),
)
def test_a_fault_within_passes_is_refused(manifest, scenes, clock, pauses, trouble, seed):
    """Frames last longer by a share, drift, and a time, extra."""
    drift, extra, jitter = clock
    true = train(manifest, scenes, drift, 0.02, pauses[:scenes], seed, extra, jitter)
    times = true.ravel()
    for each in trouble:
        times = each.strike(times, true)
    try:
        found = FrameStarts.of(times, manifest, scenes)
    except InputError as error:
        assert trouble or (drift and extra), error  # noqa: PT017
        assert "\n" not in str(error)  # noqa: PT017
        return
    begun = len(times) - true.size  # after the last pass; a marker before the first shifts all
    if begun == 0 and np.isclose(times[0], true[0, 0], atol=2.5e-5):
        usual = abs(drift) <= 2e-4 and not extra
        assert np.abs(found.starts_s - true).max() < (2.5e-5 if usual else 3e-5)


def test_a_recording_that_ends_within_its_last_pass_is_refused(run):
    """One that was stopped in a later pass is counted as far as its scenes go."""
    path = run.folder / "photons.ptu"
    content = path.read_bytes()
    wanted = Recording.read(run.folder).count().counts
    path.write_bytes(content[: len(content) * 4 // 5 // 4 * 4])
    run.refused("of 2 whole passes, and there are 3 scenes")
    scenes = [scene.model_dump() for scene in Recording.read(run.folder).acquisition.scenes]
    run.edit(scenes=scenes[:2])
    assert np.array_equal(Recording.read(run.folder).count().counts, wanted[:2])


def test_gates_that_do_not_fit_frames_as_they_were_are_refused(run):
    """Else the next frame cuts each gate, by another share in each."""
    starts = train(run.patterns.manifest, 3, -0.01)
    run.record(starts, starts.ravel(), run.photons)
    said = "1.00% shorter than planned.*--exposure 0.01067 or less"
    run.refused(said, exposure_s=11 * DWELL * 0.972)
    assert Recording.read(run.folder).count(exposure_s=11 * DWELL * 0.97).valid.all()
