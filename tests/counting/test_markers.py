"""Markers: each is of its frame on any clock, or the recording is refused."""

import numpy as np
import pytest
import recording_samples
from hypothesis import given, settings
from hypothesis import strategies as st
from recording_samples import DWELL, FUZZ, JITTER, many, schedule, train, troubles

from deepfsi.base.errors import InputError
from deepfsi.counting.recording import Recording
from deepfsi.counting.windows import FrameStarts, WindowCounts, Windows
from deepfsi.patterns.manifest import GatePlan

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
    counted = Recording.read(run.folder).count()
    assert counted.dark_rate == pytest.approx(3 / (DWELL - 3e-5))  # less settling and guard
    wanted = counted.counts
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


def followed(times, manifest=FREE, scenes=3) -> bool:
    try:
        found = FrameStarts.of(np.ravel(times), manifest, scenes)
    except InputError:
        return False
    assert np.array_equal(found.starts_s, times)
    return True


@pytest.mark.parametrize("scale", [1, 0.05])
def test_markers_follow_to_the_tolerance_and_the_drift_of_two_clocks(scale):
    """Of 10 µs, or a tenth of the shortest frame; of 200 ppm, also for a pass that is too early."""
    manifest = schedule([round(scale * us) for us in (400, 900, 1300, 2100, 700, 3000, 1500, 800)])
    ends = {"picture_us": round(1000 * scale)}
    frames = [each if each.role == "mask" else each.model_copy(update=ends)
              for each in manifest.frames]  # fmt: skip
    manifest = manifest.model_copy(update={"frames": tuple(frames)})
    tolerance = 1e-5 if scale == 1 else 2e-6
    true = train(manifest, 3, jitter=0)
    span = true[0, -1] - true[0, 0]
    for factor, follows in ((0.95, True), (1.05, False)):
        for sign in (-1, 1):
            late = true.copy()
            late[1, 4] += sign * factor * tolerance
            assert followed(late, manifest) is follows
        early = true.copy()
        early[1:] -= factor * tolerance + 2e-4 * manifest.picture_s[-1]
        assert followed(early, manifest) is follows
        longer = train(manifest, 1, factor * (2e-4 + tolerance / span), jitter=0)
        assert FrameStarts.of(longer.ravel(), manifest, 1).drift == pytest.approx(
            factor * (2e-4 + tolerance / span)
        )


def test_all_frames_may_be_longer_by_a_share_or_by_a_time():
    """By 2 %, or by 20 % of the shortest frame; shorter by 2 %."""
    for factor, follows in ((0.98, True), (1.02, False)):
        for drift in (0.02, -0.02):
            assert followed(train(FREE, 3, factor * drift, jitter=0)) is follows
        for extra in (8e-5, -8e-6):
            assert followed(train(FREE, 3, 0, extra=factor * extra, jitter=0)) is follows
    longer = FrameStarts.of(train(FREE, 3, 0.01, jitter=0).ravel(), FREE, 3)
    np.testing.assert_allclose(longer.pictures_s, 1.01 * FREE.picture_s)
    later = FrameStarts.of(train(FREE, 3, 0, extra=2e-5, jitter=0).ravel(), FREE, 3)
    np.testing.assert_allclose(later.pictures_s, FREE.picture_s + 2e-5)
    assert later.drift == pytest.approx(2e-5 * 15 / FREE.picture_s[:-1].sum())


def test_the_first_step_that_is_off_by_two_tolerances_is_named():
    """Or the furthest, where none is; a pause after a pass is none."""
    times = train(FREE, 3, pauses=0.05, jitter=0)
    times[0, 5] += 1.9e-5
    for scene, frame, off in ((0, 4, 0.0), (1, 6, 2.2e-5)):
        times[1, 7] += off
        said = rf"first at {times[scene, frame + 1]:.6f} s, .*\(scene {scene}, frame {frame}\)"
        with pytest.raises(InputError, match=said):
            FrameStarts.of(times.ravel(), FREE, 3)


def test_a_pass_on_another_clock_than_the_others_is_refused():
    """800 ppm are off by more than the drift and the tolerance, also where others are by 150."""
    drifts = (1e-4, 1.5e-4, 1.5e-4, 8e-4)
    assert not followed([train(FREE, 1, drift, 0.1 * k, jitter=0)[0]
                         for k, drift in enumerate(drifts)], scenes=4)  # fmt: skip


@pytest.mark.parametrize(("settle", "guard"), [(2e-4, 1e-5), (9.9e-4, 5e-6)])
@pytest.mark.parametrize("repeats", [1, 3])
def test_windows_follow_each_other_from_settling_on(settle, guard, repeats):
    """Gates and a rest in masks' frames, a rest alone in others; click gates are parts of gates."""
    manifest = schedule([1000, 2000])
    pictures, masks = manifest.picture_s, manifest.mask_frames
    gates = GatePlan(1.0, settle, 0.3 * (pictures[masks] - settle) / repeats, repeats)
    starts = FrameStarts(np.zeros((1, 6)), pictures, 0.0)
    counted = Windows.of_gates(manifest, gates, starts)
    clicking = Windows.of_clicks(manifest, gates, 4)
    for frame, picture in enumerate(pictures):
        is_mask = frame in masks
        gate = 0.3 * (picture - settle) / repeats
        for windows, lengths in (
            (counted, [gate] * repeats * is_mask),
            (
                clicking,
                [gate / 4] * 4 * repeats if is_mask else [(picture - settle - 1e-5) / 4] * 4,
            ),
        ):
            own = windows.frame == frame
            length, offset = windows.length_s[own], windows.offset_s[own]
            end = picture - min(1e-5, (picture - settle) / 2)
            rest = [end - settle - sum(lengths)] if windows is counted else []
            np.testing.assert_allclose(length, [*lengths, *rest], atol=1e-12)
            np.testing.assert_allclose(offset, settle + np.cumsum(length) - length)
            assert windows.gate[own].tolist() == [is_mask] * len(lengths) + [False] * len(rest)
    rest = counted.offset_s + counted.length_s
    assert rest[counted.frame == 0] == pytest.approx([1e-3 - guard])
    photons = np.arange(len(counted.frame))[None, :, None] * [1, 10]
    seen = WindowCounts(photons, counted.length_s[None], counted)
    whole, open_s = seen.per_frame()
    for frame in range(6):
        own = counted.frame == frame
        assert whole[0, frame].tolist() == photons[0, own].sum(axis=0).tolist()
        assert open_s[0, frame] == pytest.approx(counted.length_s[own].sum())
    of_masks = seen.gates(repeats)
    assert of_masks.shape == (1, repeats, 2, 2)
    assert of_masks[0, -1, 1].tolist() == photons[0, np.flatnonzero(counted.gate)[-1]].tolist()
