"""Recordings: each marker brought to its frame or given up, each photon to its readout."""

from __future__ import annotations

import json
import os
import shutil
import zipfile
from dataclasses import dataclass
from hashlib import sha256
from pathlib import Path

import numpy as np
import pytest
from hypothesis import HealthCheck, assume, given, settings
from hypothesis import strategies as st

from deepfsi.errors import InputError
from deepfsi.hardware.patterns.folder import export_patterns
from deepfsi.hardware.patterns.sequence import DEVICES, Frame, Manifest, Patterns, find_device
from deepfsi.hardware.ptu.writer import Writer
from deepfsi.hardware.recording import acquisition
from deepfsi.hardware.recording import acquisition as acq
from deepfsi.hardware.recording.acquisition import (
    Acquisition,
    Scene,
    count,
    picture,
    prepare,
    read_counts,
)
from deepfsi.hardware.recording.alignment import Counter, align, find_steps
from deepfsi.progress import Report

FUZZ = int(os.environ.get("DEEPFSI_FUZZ", "100"))
"""Examples of each test on random faults, and mutated folders."""

TICK = 1e-12
DWELL = 1e-3
JITTER = 2e-7

many = settings(
    max_examples=FUZZ,
    deadline=None,
    suppress_health_check=[HealthCheck.function_scoped_fixture, HealthCheck.too_slow],
)


def schedule(pictures: list[int], sentinel: int = 1000) -> Manifest:
    """Manifest of masks with these picture times, µs."""
    ends = [Frame(role=role, picture_us=sentinel, sha256="0" * 64) for role in ("on", "off")]
    share = 1 / len(pictures)
    masks = [
        Frame(role="mask", mask=i, rail="plus", share=share, picture_us=us, sha256="0" * 64)
        for i, us in enumerate(pictures)
    ]
    return Manifest(
        deepfsi="0",
        device=DEVICES["dlp7000"],
        image_shape=(4, 4),
        masks=len(masks),
        rails=1,
        light="free-dwell",
        dimmed=1,
        summed_reflectance=1,
        selection="ordered",
        format="npy",
        frames=(*ends, *masks, *ends),
    )


EQUAL = schedule([1000] * 16)
FREE = schedule([400, 900, 1300, 2100, 700, 3000, 1500, 800, 600, 1100, 2500, 1900])


def train(
    manifest: Manifest,
    scenes: int,
    drift: float = 0.0,
    offset: float = 0.02,
    pauses: float | list[float] = 0.0,
    seed: int = 0,
) -> np.ndarray:
    """True starts of frames on the counter's clock, (S, F), with jitter."""
    rng = np.random.default_rng(seed)
    gaps = np.broadcast_to(pauses, (scenes,))
    begins = np.arange(scenes) * manifest.pass_s + np.cumsum(gaps) - gaps[0]
    starts = offset + (1 + drift) * (begins[:, None] + manifest.starts_s)
    return starts + rng.uniform(-JITTER, JITTER, starts.shape)


def lamp(manifest: Manifest, starts: np.ndarray, seed: int = 0) -> Counter:
    """Photons as a detector would count them: 1e6/s at all ON, 1e3/s at all OFF."""
    rng = np.random.default_rng(seed)
    rates = rng.uniform(0.1, 0.9, starts.shape) * 1e6
    rates[:, [0, -2]], rates[:, [1, -1]] = 1e6, 1e3
    length = np.append(
        np.diff(starts, axis=1), manifest.picture_s[-1] * np.ones((len(starts), 1)), 1
    )
    edges = np.concatenate([starts, starts + length], axis=1)
    edges = np.stack([starts, starts + length], axis=-1).ravel()
    light = np.stack([rates, np.zeros_like(rates)], axis=-1).ravel() + 1e3
    total = np.concatenate([[0.0], np.cumsum(np.diff(edges) * light[:-1])])

    def counter(begin: np.ndarray, end: np.ndarray) -> np.ndarray:
        def until(t: np.ndarray) -> np.ndarray:
            return np.interp(t, edges, total)

        return rng.poisson(until(end) - until(begin))

    return counter


def right_or_lost(found: np.ndarray, true: np.ndarray) -> np.ndarray:
    """Check that no frame has a wrong time; which are known."""
    known = np.isfinite(found)
    assert (np.abs(found - true)[known] < 2.5e-5).all()
    return known


# Alignment ---------------------------------------------------------------------------------------


@pytest.mark.parametrize("manifest", [EQUAL, FREE], ids=["equal", "free"])
@pytest.mark.parametrize("drift", [-2e-4, 0.0, 2e-4])
@pytest.mark.parametrize("pause", [0.0, 1e-3, 0.0374])
def test_markers_without_faults_are_the_starts(manifest, drift, pause):
    true = train(manifest, 4, drift, pauses=pause)
    found = align(true.ravel()[::-1], manifest, 4)
    assert (found.starts_s == true).all()
    assert found.faults == ()


@pytest.mark.parametrize("manifest", [EQUAL, FREE], ids=["equal", "free"])
@pytest.mark.parametrize("drift", [-2e-4, 2e-4])
@pytest.mark.parametrize("pause", [0.0, 0.0374])
def test_faults_within_a_pass_are_named_and_mended(manifest, drift, pause):
    true = train(manifest, 4, drift, pauses=pause)
    given = true.copy()
    given[2, 7] += 1.2e-4
    given[3, 2] -= 9e-5
    markers = np.append(given.ravel(), true[1, 4] + 3e-5)
    markers = np.delete(markers, [5, 6, true.shape[1] + 9])
    found = align(markers, manifest, 4)
    assert [(f.kind, f.scene, f.frame) for f in found.faults] == [
        ("missing", 0, 5),
        ("missing", 0, 6),
        ("missing", 1, 9),
        ("late", 2, 7),
        ("late", 3, 2),
        ("extra", 1, 4),
    ]
    for fault, off, side in ((found.faults[3], 120, "late"), (found.faults[4], 90, "early")):
        value, unit = fault.detail.split(f" {side}")[0].split()
        assert unit == "µs"
        assert abs(float(value) - off) < 1
    assert np.abs(found.starts_s - true).max() < 10 * JITTER
    assert str(found.faults[0]).startswith("missing scene 0, frame 5: due at 0.02")


@pytest.mark.parametrize("drift", [-2e-4, 2e-4])
@pytest.mark.parametrize("pause", [0.0, 1e-3, 0.0374])
@pytest.mark.parametrize("frame", [0, 1, -2, -1])
@pytest.mark.parametrize("scene", [0, 1, 3])
def test_a_pass_that_lacks_its_first_or_last_marker_is_placed_by_photons(
    drift, pause, frame, scene
):
    true = train(EQUAL, 4, drift, pauses=pause)
    place = np.arange(true.size).reshape(true.shape)[scene, frame]
    markers = np.delete(true.ravel(), place)
    right_or_lost(align(markers, EQUAL, 4).starts_s, true)
    found = align(markers, EQUAL, 4, counter=lamp(EQUAL, true))
    known = right_or_lost(found.starts_s, true)
    ends = scene == 3 and frame == -1
    assert known.sum() == true.size - ends
    (fault,) = found.faults
    assert (fault.kind, fault.scene, fault.frame) == (
        "lost" if ends else "missing",
        scene,
        frame % true.shape[1],
    )


def test_an_equal_schedule_without_photons_gives_up_what_it_cannot_tell():
    true = train(EQUAL, 3, pauses=0.05)
    found = align(true.ravel()[1:], EQUAL, 3)
    assert np.isfinite(found.starts_s).all(axis=1).tolist() == [False, True, True]
    assert found.faults[0].kind == "lost"
    assert found.faults[0].scene == 0


def test_photons_of_a_dark_scene_do_not_place_it():
    true = train(EQUAL, 3, pauses=0.05)
    dark = np.random.default_rng(0)
    counter = lambda begin, end: dark.poisson(3.0, len(begin))  # noqa: E731
    found = align(true.ravel()[1:], EQUAL, 3, counter=counter)
    assert np.isnan(found.starts_s[0]).all()
    assert np.isfinite(found.starts_s[1:]).all()


def test_a_schedule_of_unlike_frames_places_itself():
    true = train(FREE, 3, 1e-4)
    found = align(true.ravel()[1:], FREE, 3)
    assert (right_or_lost(found.starts_s, true)).all()
    assert [(f.kind, f.scene, f.frame) for f in found.faults] == [("missing", 0, 0)]


@pytest.mark.parametrize("manifest", [EQUAL, FREE], ids=["equal", "free"])
@pytest.mark.parametrize("pause", [0.0, 0.0374])
@pytest.mark.parametrize("left", [0.3, 0.61, 0.97])
def test_a_recording_that_ends_early_keeps_whole_passes(manifest, pause, left):
    true = train(manifest, 4, -1e-4, pauses=pause)
    held = round(left * true.size)
    found = align(true.ravel()[:held], manifest, 4, counter=lamp(manifest, true))
    known = right_or_lost(found.starts_s, true)
    whole = held // true.shape[1]
    assert known[:whole].all()
    assert not known[whole + 1 :].any()
    assert {f.scene for f in found.faults if f.kind == "lost"} == set(range(whole, 4))


def test_a_long_hole_is_not_filled():
    true = train(EQUAL, 3, 1e-4, pauses=0.05)
    found = align(np.delete(true.ravel(), range(25, 31)), EQUAL, 3)
    known = right_or_lost(found.starts_s, true)
    assert known.sum() == true.size - 6
    (fault,) = found.faults
    assert (fault.kind, fault.scene, fault.frame) == ("lost", 1, 5)
    assert "frames 5 to 10" in fault.detail


def test_a_clock_that_warms_up_is_followed():
    manifest = schedule([100_000] * 2000, 100_000)
    seconds = manifest.starts_s
    true = 0.5 + seconds * (1 + 1e-4) + 2e-7 / 2 * seconds**2 / 10
    markers = np.delete(true, [700, 1500])
    found = align(markers, manifest, 1)
    assert np.abs(found.starts_s[0] - true).max() < 1e-5
    assert [f.frame for f in found.faults] == [700, 1500]


@pytest.mark.parametrize(
    ("markers", "scenes", "match"),
    [
        (np.zeros(0), 1, "no frame markers"),
        (train(EQUAL, 3).ravel(), 4, "3 whole passes"),
        (train(EQUAL, 3, pauses=0.1).ravel(), 4, "3 whole passes"),
        (train(EQUAL, 4).ravel()[20:-2], 4, "3 whole passes"),  # which one is lacking?
        (train(EQUAL, 3).ravel(), 2, "20 markers follow the last of 2"),
        (np.random.default_rng(0).random(1000), 5, "follow the schedule"),
        (train(FREE, 3).ravel(), 3, "follow the schedule"),
        (train(EQUAL, 1).ravel(), 10**6, "split"),
    ],
)
def test_markers_of_other_patterns_are_refused(markers, scenes, match):
    with pytest.raises(InputError, match=match):
        align(markers, EQUAL, scenes)


@pytest.mark.parametrize("brightest", [0.0, 0.1, 3.0, 200.0, 1e4])
def test_a_pass_in_its_place_is_never_taken_for_a_shifted_one(brightest):
    """Over 500 passes of 1000 frames, however faint."""
    rng = np.random.default_rng(1)
    rates = rng.uniform(0.1, 0.9, 1000)
    rates[2:4] = 1.0, 0.45  # as a Hadamard basis begins
    rates[[0, -2]], rates[[1, -1]] = 1.0, 0.0
    for _ in range(500):
        fits, clear = find_steps(rng.poisson(rates * brightest + 0.01), np.ones(1000))
        assert fits[0]
        assert fits[-1]
        assert clear == (brightest > 10)


@dataclass
class Trouble:
    """What happens to a marker train."""

    kind: str
    scene: int
    frame: int
    amount: float

    def strike(self, markers: np.ndarray, true: np.ndarray) -> np.ndarray:
        scene, frame = self.scene % len(true), self.frame % true.shape[1]
        time = true[scene, frame]
        if not len(markers):
            return markers
        near = int(np.argmin(np.abs(markers - time)))
        there = np.array([near] if abs(markers[near] - time) < 10 * JITTER else [], int)
        if self.kind == "missing":
            return np.delete(markers, there)
        if self.kind == "late":
            return np.sort(np.append(np.delete(markers, there), time + self.amount * DWELL))
        if self.kind == "extra":
            return np.sort(np.append(markers, time + self.amount * DWELL))
        if self.kind == "cut":
            return markers[: max(near, 2)]
        first = int(np.argmin(np.abs(markers - true[0, frame])))
        return markers[first:]  # the recording begins within the first pass


def unseen(markers: np.ndarray, true: np.ndarray) -> bool:
    """Whether a pass left no marker and a later one did: nobody can tell which it was."""
    left = np.isin(true, markers).any(axis=1)
    return bool((np.diff(left.astype(int)) > 0).any())


def troubles(*kinds: str) -> st.SearchStrategy[list[Trouble]]:
    edges = st.sampled_from([0, 1, 2, -1, -2, -3])
    trouble = st.builds(
        Trouble,
        kind=st.sampled_from(kinds),
        scene=st.integers(0, 9),
        frame=st.one_of(edges, st.integers(0, 99)),
        amount=st.floats(-0.45, 0.95),
    )
    return st.lists(trouble, min_size=1, max_size=6)


@many
@given(
    manifest=st.sampled_from([EQUAL, FREE, schedule([1000, 1010] * 9), schedule([1000])]),
    scenes=st.integers(1, 4),
    drift=st.floats(-2e-4, 2e-4),
    pauses=st.lists(st.sampled_from([0.0, 3e-4, 1e-3, 2e-3, 0.05]), min_size=4, max_size=4),
    trouble=troubles("missing", "late", "extra", "cut", "start"),
    seed=st.integers(0, 99),
    seen=st.booleans(),
)
def test_no_fault_shifts_a_pass_silently(manifest, scenes, drift, pauses, trouble, seed, seen):
    true = train(manifest, scenes, drift, pauses=pauses[:scenes], seed=seed)
    markers = true.ravel()
    for each in trouble:
        markers = each.strike(markers, true)
    assume(not unseen(markers, true))
    counter = lamp(manifest, true, seed) if seen else None
    try:
        found = align(markers, manifest, scenes, counter=counter)
    except InputError as error:
        assert "\n" not in str(error)  # noqa: PT017 - being refused is one of two right answers
        return
    right_or_lost(found.starts_s, true)
    if not found.faults:
        assert np.isfinite(found.starts_s).all()


# Counting ----------------------------------------------------------------------------------------

DEVICE = find_device("24x16")
SHAPE = (2, 3)


def patterns_of(folder: Path, light: str = "equal-dwell", **settings) -> Patterns:
    """Six random masks on a small device."""
    rng = np.random.default_rng(4)
    if light == "two-arm":
        part = rng.random((6, 6))
        rails = np.stack([part, 1 - part]) / 6
    elif light == "free-dwell":
        rails = rng.random((1, 6, 6)) * np.linspace(0.2, 1, 6)[:, None]
        rails /= rails.max(axis=2).sum()
    else:
        rails = rng.random((2, 6, 6))
        rails[0, 0], rails[1, 0] = 1.0, 0.0
        rails /= 11 * np.where(rails.any(axis=2), rails.max(axis=2), 1)[..., None]
    given = {"summed_reflectance": 2.0, "design": b"not read", **settings}
    return export_patterns(rails, light, SHAPE, DEVICE, DWELL, folder, **given)


def named(scenes: int, **settings) -> Acquisition:
    given = {"exposure_s": 5e-3, "settle_s": 2e-5, "repeats": 1, **settings}
    return Acquisition(scenes=tuple(Scene(name=f"scene {i}") for i in range(scenes)), **given)


def record(
    path: Path,
    starts: np.ndarray,
    markers: np.ndarray,
    photons: np.ndarray,
    *,
    bit: int = 1,
    inputs: tuple[int, ...] = (0,),
    length: float | np.ndarray = DWELL,
    stray: int = 50,
) -> None:
    """Write photons (S, F, inputs) spread evenly over each frame, from 30 µs on to its end."""
    times, codes = [markers], [np.full(len(markers), -bit)]
    length = np.broadcast_to(length, starts.shape[1])
    for column, each in enumerate(inputs):
        for (scene, frame), many in np.ndenumerate(photons[..., column]):
            inside = starts[scene, frame] + 3e-5 + (length[frame] - 4e-5) * np.arange(many) / many
            times.append(inside)
            codes.append(np.full(len(inside), each))
    times.append(np.linspace(0, markers.min() * 0.9, stray))  # before the first marker
    codes.append(np.zeros(stray, int))
    times, codes = np.concatenate(times), np.concatenate(codes)
    order = np.argsort(times, kind="stable")
    path.unlink(missing_ok=True)
    with Writer(path, TICK) as writer:
        writer.write(np.rint(times[order] / TICK).astype(np.int64), codes[order])


def shining(patterns: Patterns, scenes: int, arms: int = 1, dark: int = 3) -> np.ndarray:
    """Photons (S, F, arms) of random scenes; at all ON some 1000."""
    rng = np.random.default_rng(9)
    light = rng.uniform(100, 200, (scenes, patterns.on.shape[1]))
    part = np.zeros((len(patterns.manifest.frames), patterns.on.shape[1]))
    part[[0, -2]] = 1
    part[patterns.manifest.shown] = patterns.fractions
    both = np.stack([light @ part.T, light @ (1 - part.T)], axis=-1)[..., :arms]
    return np.rint(both).astype(int) + dark


@dataclass
class Run:
    """A recording without faults, and what went into it."""

    folder: Path
    patterns: Patterns
    starts: np.ndarray
    photons: np.ndarray


def made(tmp: Path, light: str = "equal-dwell", scenes: int = 3, **settings) -> Run:
    patterns = patterns_of(tmp / "patterns", light)
    arms = 2 if light == "two-arm" else 1
    inputs = (2, 1)[:arms]
    given = {"inputs": inputs, "marker_bit": 4, **settings}
    prepare(tmp / "run", tmp / "patterns", named(scenes, **given))
    starts = train(patterns.manifest, scenes, 1.5e-4)
    photons = shining(patterns, scenes, arms)
    length = patterns.manifest.picture_s
    record(
        tmp / "run" / "photons.ptu",
        starts,
        starts.ravel(),
        photons,
        bit=4,
        inputs=inputs,
        length=length,
    )
    return Run(tmp / "run", patterns, starts, photons)


@pytest.fixture(scope="module")
def whole(tmp_path_factory) -> Run:
    """A recording of three scenes on one arm: do not change it."""
    run = made(tmp_path_factory.mktemp("whole"), exposure_s=DWELL * 11 * 0.97)
    count(run.folder)
    return run


@pytest.fixture
def run(whole, tmp_path) -> Run:
    """A copy of it to change."""
    shutil.copytree(whole.folder, tmp_path / "run")
    return Run(tmp_path / "run", whole.patterns, whole.starts, whole.photons)


def test_every_photon_of_a_frame_is_counted_for_its_readout(run):
    counts = count(run.folder)
    manifest = run.patterns.manifest
    assert counts.counts.shape == (3, 1, 2, 6)
    assert counts.counts.dtype == np.int64
    assert counts.valid.all()
    assert counts.faults == ()
    for place in manifest.shown:
        frame = manifest.frames[place]
        rail = 0 if frame.rail == "plus" else 1
        assert (counts.counts[:, 0, rail, frame.mask] == run.photons[:, place, 0]).all()
    assert (counts.counts[:, 0, 1, 0] == 0).all()  # a dark rail
    assert len(manifest.shown) == 11
    seconds = DWELL - 2e-5
    assert np.allclose(counts.on_rate, run.photons[:, 0, 0] / seconds, rtol=2e-3)
    assert np.allclose(counts.off_rate, 3 / seconds, rtol=2e-3)
    flux = (run.photons[:, 0, 0] - 3).mean() / seconds
    assert counts.photons == pytest.approx(flux * counts.exposure_s, rel=2e-3)
    dark = counts.background
    assert dark[1, 0] == 0
    assert dark[0, 0] == pytest.approx(3, rel=0.05)
    assert (counts.signal() == counts.counts - dark).all()


def test_counts_are_read_as_they_were_written(run):
    counts, again = count(run.folder), read_counts(run.folder)
    for name in ("counts", "valid", "gate_s", "on_rate", "off_rate", "dark_rate", "lengths_s"):
        assert np.array_equal(getattr(counts, name), getattr(again, name))
        assert getattr(counts, name).dtype == getattr(again, name).dtype
    assert again.exposure_s == counts.exposure_s
    assert again.settle_s == counts.settle_s
    assert again.faults == counts.faults


def test_gates_of_one_frame_are_exposures_of_their_own(run):
    """Photons come evenly, so each of equal gates counts its part, and edges one more or less."""
    counts = count(run.folder, exposure_s=11e-4, settle_s=1e-4, repeats=8)
    manifest = run.patterns.manifest
    assert counts.counts.shape == (3, 8, 2, 6)
    assert counts.counts[:, :, 1, 0].sum() == 0
    for place, gate in zip(manifest.shown, counts.gate_s, strict=True):
        frame = manifest.frames[place]
        here = counts.counts[:, :, 0 if frame.rail == "plus" else 1, frame.mask]
        wanted = run.photons[:, place, 0] * gate / (DWELL - 4e-5)
        assert (np.abs(here - wanted[:, None]) < 1.5).all()
        full = run.photons[:, place, 0] * 8 * gate / (DWELL - 4e-5)
        assert (np.abs(here.sum(axis=1) - full) < 1.5).all()
    assert count(run.folder, exposure_s=11e-4, settle_s=1e-4).counts.shape[1] == 8 + 1
    assert count(run.folder, exposure_s=11e-4, settle_s=6e-4).counts.shape[1] == 4
    assert count(run.folder).counts.shape[1] == 1


def test_gates_open_and_close_when_they_should(tmp_path):
    """One photon a microsecond: which of them are counted tells the gate's edges."""
    patterns = patterns_of(tmp_path / "patterns")
    prepare(tmp_path / "run", tmp_path / "patterns", named(1))
    starts = train(patterns.manifest, 1)
    ticks = np.arange(0, round((starts[0, -1] + 2e-3) * 1e6)) * 10**6
    times = np.concatenate([np.rint(starts[0] / TICK).astype(np.int64), ticks])
    codes = np.concatenate([np.full(starts.shape[1], -1), np.zeros(len(ticks), np.int64)])
    order = np.argsort(times, kind="stable")
    with Writer(tmp_path / "run" / "photons.ptu", TICK) as writer:
        writer.write(times[order], codes[order])
    # All frames are equally bright, so none is shown to be wrong.
    counts = count(tmp_path / "run", exposure_s=11 * 37e-6, settle_s=5e-5, repeats=3)
    for place in patterns.manifest.shown:
        frame = patterns.manifest.frames[place]
        for gate in range(3):
            first = np.rint(starts[0, place] / TICK) + 50e6 + gate * 37e6
            wanted = np.count_nonzero((ticks >= first - 1) & (ticks < first + 37e6 - 1))
            rail = 0 if frame.rail == "plus" else 1
            assert abs(counts.counts[0, gate, rail, frame.mask] - wanted) == 0


@pytest.mark.parametrize("drift", [-2e-4, 2e-4])
def test_gates_that_fill_their_frames_do_not_overlap(run, drift):
    starts = train(run.patterns.manifest, 3, drift)
    given = {"bit": 4, "inputs": (2,), "length": run.patterns.manifest.picture_s}
    record(run.folder / "photons.ptu", starts, starts.ravel(), run.photons, **given)
    wanted = read_counts(run.folder).counts
    counts = count(run.folder, exposure_s=11 * DWELL, settle_s=0.0)
    assert (counts.counts == wanted).all()
    assert count(run.folder, exposure_s=11 * DWELL / 8, settle_s=0.0).counts.shape[1] == 8


@pytest.mark.parametrize("light", ["free-dwell", "two-arm"])
def test_every_light_constraint_is_counted(tmp_path, light):
    run = made(tmp_path, light, exposure_s=1e-3, repeats=2)
    counts = count(run.folder)
    manifest = run.patterns.manifest
    arms = 2 if light == "two-arm" else 1
    assert counts.counts.shape == (3, 2, arms, 6)
    for place, gate in zip(manifest.shown, counts.gate_s, strict=True):
        for arm in range(arms):
            part = gate / (manifest.picture_s[place] - 4e-5)
            wanted = run.photons[:, place, arm] * part
            here = counts.counts[:, 1, arm, manifest.frames[place].mask]
            assert (np.abs(here - wanted) < 1.5).all()
    assert counts.gate_s == pytest.approx(manifest.shares * 1e-3)
    rate = 3 / (DWELL - 2e-5)
    assert np.allclose(counts.dark_rate, [rate] * arms, rtol=2e-3)


@pytest.mark.parametrize("light", ["equal-dwell", "free-dwell", "two-arm"])
def test_a_picture_is_the_scene(tmp_path, light):
    rails = np.stack([np.eye(6), np.roll(np.eye(6), 1, axis=1) * 0.5 + 0.25]) / 12
    if light == "two-arm":
        rails = np.stack([np.eye(6), 1 - np.eye(6)]) / 6
    elif light == "free-dwell":
        rails = np.eye(6)[None] / 6
    patterns = export_patterns(
        rails, light, SHAPE, DEVICE, DWELL, tmp_path / "patterns", summed_reflectance=2.0
    )
    arms = 2 if light == "two-arm" else 1
    flux, exposure = 2e9, 0.9 * DWELL * len(patterns.manifest.shown)
    given = {"inputs": (0, 1)[:arms], "exposure_s": exposure, "settle_s": 3e-5}
    prepare(tmp_path / "run", tmp_path / "patterns", named(2, flux=flux, **given))
    scenes = np.array([[0.1, 0.9, 0.5, 0.3, 0.0, 0.2], [0.6, 0.1, 0.4, 0.5, 1.0, 0.4]])
    part = np.zeros((len(patterns.manifest.frames), 6))
    part[[0, -2]] = 1
    part[patterns.manifest.shown] = patterns.fractions
    light_s = scenes * flux / 2.0
    photons = np.stack([light_s @ part.T, light_s @ (1 - part.T)], axis=-1)[..., :arms]
    starts = train(patterns.manifest, 2)
    record(
        tmp_path / "run" / "photons.ptu",
        starts,
        starts.ravel(),
        np.rint(photons * (DWELL - 4e-5) * 1e-2).astype(int),
        inputs=(0, 1)[:arms],
        length=patterns.manifest.picture_s,
    )
    count(tmp_path / "run")
    found = picture(tmp_path / "run")
    assert found.shape == (2, *SHAPE)
    # A hundredth of the photons, as from a detector of that efficiency.
    assert np.allclose(found.reshape(2, 6) * 1e2, scenes, atol=5e-3)


def test_a_scene_with_faults_is_counted_or_given_up(whole, tmp_path):
    """Frames are told by their photons, so a shifted one would be seen."""
    markers = np.delete(whole.starts.ravel(), [7, whole.starts.shape[1]])
    markers[20] += 2e-4
    prepare(tmp_path / "run", whole.folder / "patterns", acq.read_acquisition(whole.folder)[0])
    record(
        tmp_path / "run" / "photons.ptu",
        whole.starts,
        markers,
        whole.photons,
        bit=4,
        inputs=(2,),
        length=whole.patterns.manifest.picture_s,
    )
    counts, wanted = count(tmp_path / "run"), read_counts(whole.folder)
    assert counts.valid.all()
    assert np.abs(counts.counts - wanted.counts).max() <= 1
    assert [(f.kind, f.scene, f.frame) for f in counts.faults] == [
        ("missing", 0, 7),
        ("missing", 1, 0),
        ("late", 1, 7),
    ]
    assert read_counts(tmp_path / "run").faults == counts.faults


@many
@given(
    trouble=troubles("missing", "late", "extra", "cut", "start", "next", "before"),
    pauses=st.lists(st.sampled_from([0.0, 1e-3, 0.02]), min_size=3, max_size=3),
    drift=st.floats(-2e-4, 2e-4),
)
def test_a_valid_exposure_holds_the_photons_of_its_frames(whole, tmp_path, trouble, pauses, drift):
    """Markers that come one frame too early or too late are among the faults."""
    folder, patterns = tmp_path / "run", whole.patterns
    starts = train(patterns.manifest, 3, drift, pauses=pauses)
    markers = starts.ravel()
    for each in trouble:
        if each.kind == "next":
            markers = np.append(markers, starts[-1, -1] + DWELL * (1 + each.frame % 3))
        elif each.kind == "before":
            markers = np.append(starts[0, 0] - DWELL * (1 + each.frame % 3), markers)
        else:
            markers = each.strike(markers, starts)
    markers = np.unique(markers)
    assume(len(markers) and not unseen(markers, starts))
    if not folder.exists():
        prepare(folder, whole.folder / "patterns", acq.read_acquisition(whole.folder)[0])
    length = patterns.manifest.picture_s
    given = {"bit": 4, "inputs": (2,), "length": length}
    record(folder / "photons.ptu", starts, markers, whole.photons, **given)
    try:
        counts = count(folder)
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
    starts = run.starts
    photons = np.roll(run.photons, 3, axis=1)  # not where ON and OFF should be
    given = {"bit": 4, "inputs": (2,), "length": run.patterns.manifest.picture_s}
    record(run.folder / "photons.ptu", starts, starts.ravel(), photons, **given)
    with pytest.raises(InputError, match="bright and a dark frame"):
        count(run.folder)


def test_a_file_cut_while_recording_keeps_whole_exposures(run):
    path = run.folder / "photons.ptu"
    content = path.read_bytes()
    wanted = read_counts(run.folder).counts
    path.write_bytes(content[: len(content) * 5 // 6 // 4 * 4])
    counts = count(run.folder)
    assert counts.valid[:, 0].tolist() == [True, True, False]
    assert (counts.counts[:2] == wanted[:2]).all()
    assert (counts.counts[2] == 0).all()
    assert np.isnan(counts.on_rate).tolist() == [False, False, True]
    assert np.isnan(picture(run.folder)).all(axis=(1, 2)).tolist() == [False, False, True]
    assert counts.faults[-1].scene == 2


def test_progress_rises_to_one(run):
    told: list[float] = []
    count(run.folder, report=Report(lambda share, what: told.append(share)))
    assert told == sorted(told)
    assert told[-1] == pytest.approx(1)


# Bad folders -------------------------------------------------------------------------------------


def refused(run: Run, match: str, **settings) -> None:
    with pytest.raises(InputError, match=match) as error:
        count(run.folder, **settings)
    assert "\n" not in str(error.value)


@pytest.mark.parametrize(
    "name",
    ["acquisition.json", "photons.ptu", "patterns/manifest.json", "patterns/mirrors.npy"],
)
@pytest.mark.parametrize("content", [None, b"", b"garbage", b"[" * 100_000])
def test_bad_files_are_named(run, name, content):
    path = run.folder / name
    path.unlink()
    if content is not None:
        path.write_bytes(content)
    refused(run, name.split("/")[0])


def edit(run: Run, **changes) -> None:
    path = run.folder / "acquisition.json"
    path.write_text(json.dumps(json.loads(path.read_text()) | changes))


@pytest.mark.parametrize(
    ("changes", "match"),
    [
        ({"scenes": []}, "acquisition.json cannot be used at scenes"),
        ({"scenes": [{"name": "a"}] * 4}, "photons.ptu .* 3 whole passes"),
        ({"scenes": [{"name": "a"}] * 2}, "photons.ptu .* follow the last of 2"),
        ({"scenes": [{"name": "a"}] * 65536}, "photons.ptu .* 65536 scenes"),
        ({"exposure_s": -1}, "exposure_s"),
        ({"exposure_s": 1.0}, "acquisition.json: an exposure of 1 s does not fit"),
        ({"exposure_s": 1e-300}, "acquisition.json: an exposure of 1e-300 s leaves"),
        ({"exposure_s": 1e-12}, "photons.ptu has times in steps of 1e-12 s, too coarse"),
        ({"settle_s": 0.9}, "acquisition.json: an exposure"),
        ({"repeats": 99}, "acquisition.json: 99 repeats do not fit"),
        ({"inputs": [0, 1]}, "acquisition.json has 2 inputs"),
        ({"inputs": [1, 1]}, "two arms need two inputs"),
        ({"inputs": [3]}, "photons.ptu has no pass that begins|light"),
        ({"marker_bit": 1}, "photons.ptu has 0 frame markers"),
        ({"marker_bit": 3}, "marker_bit"),
        ({"manifest_sha256": "0" * 64}, "manifest.json is not the one"),
        ({"unknown": 1}, "unknown"),
        ({"schema_version": 2}, "schema_version"),
    ],
)
def test_acquisitions_that_do_not_fit_are_refused(run, changes, match):
    edit(run, **changes)
    if changes == {"inputs": [3]}:
        assert (count(run.folder).counts == 0).all()
        return
    refused(run, match)


def test_gates_that_do_not_fit_are_refused(run):
    refused(run, "does not fit", exposure_s=0.1)
    refused(run, "settle time", settle_s=float("nan"))
    refused(run, "repeats do not fit", exposure_s=1e-4, repeats=10**6)
    refused(run, "leaves nothing|does not fit", exposure_s=1e-4, settle_s=DWELL)


def test_repeats_are_as_many_as_can_be_counted(run, monkeypatch):
    monkeypatch.setattr(acquisition, "MOST_READOUTS", 3 * 12 * 5)
    assert count(run.folder, exposure_s=1e-3).counts.shape[1] == 5
    refused(run, "give at most 5", exposure_s=1e-3, repeats=6)


def test_counts_of_another_acquisition_are_refused(run):
    edit(run, settle_s=1e-5)
    with pytest.raises(InputError, match=r"counts\.npz is of another acquisition"):
        read_counts(run.folder)
    count(run.folder)
    read_counts(run.folder)


def rewrite(run: Run, compression: int = zipfile.ZIP_STORED, **arrays: np.ndarray) -> None:
    path = run.folder / "counts.npz"
    with np.load(path) as held:
        content = dict(held) | arrays
    write = np.savez if compression == zipfile.ZIP_STORED else np.savez_compressed
    write(path, **content)


@pytest.mark.parametrize(
    "arrays",
    [
        {"counts": np.zeros((3, 1, 2, 5), np.int64)},
        {"counts": np.zeros((3, 1, 2, 6), np.int32)},
        {"counts": np.full((3, 1, 2, 6), -1)},
        {"valid": np.zeros((3, 1), bool)},
        {"valid": np.full((3, 1), 2, np.uint8)},
        {"gate_s": np.full(11, np.nan)},
        {"on_rate": np.full(3, np.inf)},
        {"about": np.frombuffer(b"{}", np.uint8)},
    ],
)
def test_damaged_counts_are_refused(run, arrays):
    rewrite(run, **arrays)
    with pytest.raises(InputError, match=r"counts\.npz is not a whole file"):
        read_counts(run.folder)


def test_compressed_or_cut_counts_are_refused(run):
    rewrite(run, zipfile.ZIP_DEFLATED)
    with pytest.raises(InputError, match=r"counts\.npz is not a whole file"):
        read_counts(run.folder)
    count(run.folder)
    path = run.folder / "counts.npz"
    path.write_bytes(path.read_bytes()[:-100])
    with pytest.raises(InputError, match=r"counts\.npz is not a whole file"):
        picture(run.folder)
    path.unlink()
    with pytest.raises(InputError, match=r"counts\.npz cannot be read .* camera count"):
        read_counts(run.folder)


def test_a_folder_is_prepared_once_and_of_one_export(run, tmp_path):
    held = sorted(p.name for p in run.folder.iterdir())
    assert held == ["acquisition.json", "calibration", "counts.npz", "patterns", "photons.ptu"]
    assert (run.folder / "patterns" / "design.safetensors").read_bytes() == b"not read"
    source = run.folder / "patterns"
    with pytest.raises(InputError, match="exists already"):
        prepare(run.folder, source, named(1))
    with pytest.raises(InputError, match="of other patterns"):
        prepare(tmp_path / "other", source, named(1, manifest_sha256="0" * 64))
    with pytest.raises(InputError, match="2 inputs"):
        prepare(tmp_path / "other", source, named(1, inputs=(0, 1)))
    with pytest.raises(InputError, match="no patterns"):
        prepare(tmp_path / "other", tmp_path / "none", named(1))
    assert not (tmp_path / "other").exists()
    assert list(tmp_path.iterdir()) == [run.folder]


FILES = (
    "acquisition.json",
    "patterns/manifest.json",
    "patterns/mirrors.npy",
    "photons.ptu",
    "counts.npz",
)


@pytest.fixture(scope="module")
def victim(tmp_path_factory) -> Path:
    """A small recording whose files are changed and put back."""
    return made(tmp_path_factory.mktemp("victim"), scenes=2).folder


NUMBERS = ["0", "-1", "1e308", "1e-308", "65537", "9999999999", "null", '""', "[]", "{}", "NaN"]


@st.composite
def mutations(draw: st.DrawFn) -> tuple[str, list[tuple[int, int, bytes]], str]:
    """A file, places in it with what is put for how many bytes, and what becomes of its hash."""
    name = draw(st.sampled_from(FILES))
    word = st.sampled_from([text.encode() for text in NUMBERS]) | st.binary(max_size=8)
    change = st.tuples(st.integers(0, 2**20), st.integers(0, 12), word)
    return name, draw(st.lists(change, min_size=1, max_size=4)), draw(st.sampled_from("snc"))


def mutate(content: bytes, changes: list[tuple[int, int, bytes]], json_: bool) -> bytes:
    """Put something at some places: of JSON at a value, else anywhere."""
    out = bytearray(content)
    for place, many, what in changes:
        at = place % max(len(out), 1)
        if json_:
            at = max(out.find(b": ", at), 0) + 2
            ends = [e for e in (out.find(b",", at), out.find(b"\n", at)) if e >= 0]
            many = min(ends, default=len(out)) - at
        out[at : at + many] = what
    return bytes(out)


@settings(parent=many, max_examples=FUZZ)
@given(mutation=mutations())
def test_changed_folders_are_read_or_refused(victim, mutation):
    if not (victim / "counts.npz").exists():
        count(victim)
    name, changes, rehash = mutation
    held = {each: (victim / each).read_bytes() for each in FILES}
    changed = mutate(held[name], changes, name.endswith("json"))
    try:
        (victim / name).write_bytes(changed)
        if name == "patterns/manifest.json" and rehash != "n":
            sign(victim)
        for work in (read_counts, count, picture):
            try:
                work(victim)
            except InputError as error:
                assert "\n" not in str(error)  # noqa: PT017
    finally:
        for each, content in held.items():
            (victim / each).write_bytes(content)


def sign(folder: Path) -> None:
    """Make hashes fit a changed manifest, as far as it is JSON at all."""
    path = folder / "patterns" / "manifest.json"
    try:
        text = json.loads(path.read_bytes())
    except ValueError:
        return
    if isinstance(text, dict):
        text.pop("sha256", None)
        path.write_text(json.dumps(text, indent=1))
    digest = sha256(path.read_bytes()).hexdigest()
    about = json.loads((folder / "acquisition.json").read_text())
    (folder / "acquisition.json").write_text(json.dumps(about | {"manifest_sha256": digest}))
