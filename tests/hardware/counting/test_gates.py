"""Windows of frames: no light of the next frame in the dark, and late markers named."""

import numpy as np
import pytest
from recording_samples import DWELL, TICK, named, patterns_of, schedule, train

from deepfsi.base import InputError
from deepfsi.hardware.counting import CountSettings, count_run, prepare_run
from deepfsi.hardware.counting.windows import (
    FrameStarts,
    Role,
    WindowCounts,
    Windows,
    find_lateness,
)
from deepfsi.hardware.patterns import GatePlan
from deepfsi.hardware.photons import PtuWriter

FLUX = 1e7
DARK = 100.0
SCENES = 5


@pytest.fixture
def lamp(tmp_path):
    """Record scenes of 1e7 photons/s whose markers come late."""
    patterns = patterns_of(tmp_path / "patterns")
    prepare_run(tmp_path / "run", tmp_path / "patterns", named(SCENES))

    def record(late: float, burst: float = 0.0, rate: float = 0.0) -> None:
        manifest, rng = patterns.manifest, np.random.default_rng(0)
        begins = train(manifest, SCENES, rate, jitter=0)
        rates = np.zeros(len(manifest.frames))
        rates[[0, -2]] = FLUX
        rates[manifest.shown] = FLUX * patterns.fractions.mean(axis=1)
        starts, lengths = begins.ravel(), (1 + rate) * np.tile(manifest.picture_s, SCENES)
        many = rng.poisson(np.tile(rates, SCENES) * lengths)
        photons = np.repeat(starts, many) + np.repeat(lengths, many) * rng.random(many.sum())
        span = starts[-1] + lengths[-1]
        dark = rng.uniform(0, span, rng.poisson(DARK * span))
        flash = begins[2, 2] - burst * rng.random(round(FLUX * burst))
        times = np.concatenate([starts + late, photons, dark, flash])
        codes = np.zeros(len(times), int)
        codes[: len(starts)] = -1
        order = np.argsort(times, kind="stable")
        with PtuWriter(tmp_path / "run" / "photons.ptu", TICK) as writer:
            writer.write(np.rint(times[order] / TICK).astype(np.int64), codes[order])

    return tmp_path / "run", record


@pytest.mark.parametrize(("late", "rate"), [(0, 0), (1e-6, 0), (5e-6, 0), (5e-6, -0.01), (0, 0.01)])
def test_a_late_trigger_gives_no_dark_counts(lamp, late, rate):
    """At 1 µs and 1e7 photons/s there were thousands a second."""
    folder, record = lamp
    record(late, rate=rate)
    counts = count_run(folder)
    seconds = 2 * SCENES * ((1 + rate) * DWELL - 3e-5)
    assert counts.off_rate.mean() == pytest.approx(DARK, abs=5 * np.sqrt(DARK / seconds))
    assert counts.dark_rate[0] == pytest.approx(counts.off_rate.mean())
    assert counts.on_rate.mean() == pytest.approx(FLUX, rel=5 / np.sqrt(FLUX * seconds))
    faults = [fault for fault in counts.faults if fault.kind == "late"]
    assert len(faults) == len(counts.faults) == (late > 0)
    if late:
        said = float(faults[0].detail.removeprefix("all markers, by ").split(" µs")[0]) * 1e-6
        photons = FLUX * late * (SCENES - 1)  # the brightest is left out
        assert said == pytest.approx(late, rel=6 / np.sqrt(photons), abs=5e-8)
        assert "--exposure" not in str(faults[0])  # gates end long before their frames


def lateness(windows: Windows, photons: np.ndarray, seconds: np.ndarray) -> tuple:
    """Fault of counts (S, g) of one detector."""
    counts = WindowCounts(photons[..., None], seconds, windows)
    return find_lateness(counts, slice(0, 1), room_s=1.0)


def test_stray_light_alone_is_no_late_trigger():
    """In none of 1000 recordings of 20 scenes, at 1e5 counts/s in the dark."""
    manifest = schedule([1000] * 4)
    found = FrameStarts(
        np.zeros((1, 8)), np.ones(1, bool), manifest.picture_s, 1e-5, 0.0, np.inf, ()
    )
    windows = Windows.of_gates(manifest, GatePlan(2e-5, np.full(4, 5e-4), 1), found)
    seconds = np.tile(windows.length_s, (20, 1))
    rates = np.where(windows.frame == 1, 1e5, 1e6)
    rng = np.random.default_rng(2)
    for _ in range(1000):
        assert not lateness(windows, rng.poisson(rates * seconds), seconds)
    guard = int(np.argmax(windows.role == Role.GUARD))
    rates[guard] += 1e5  # 1 µs of light: 19 photons more, 4 of their standard errors
    late = [bool(lateness(windows, rng.poisson(rates * seconds), seconds)) for _ in range(50)]
    assert sum(late) < 10
    rates[guard] += 4e5
    assert lateness(windows, rng.poisson(rates * seconds), seconds)


def test_gates_that_hold_light_of_the_next_frame_are_said(lamp):
    folder, record = lamp
    record(5e-6)
    (fault,) = count_run(folder, CountSettings(exposure_s=11 * (DWELL - 2.2e-5))).faults
    assert "gates end 2.0 µs before the next marker" in fault.detail
    assert "--exposure" in fault.detail


def test_a_flash_in_one_pass_is_no_late_trigger(lamp):
    folder, record = lamp
    record(0.0, burst=5e-6)
    assert not [fault for fault in count_run(folder).faults if fault.kind == "late"]


def test_what_a_marker_may_be_off_follows_the_shortest_frame():
    assert schedule([1000] * 4).usual_tolerance_s == 1e-5
    assert schedule([1000, 44]).usual_tolerance_s == pytest.approx(4.4e-6)


def test_settling_leaves_something_of_frames_before_their_guard():
    manifest = schedule([3000] * 4)
    assert named(1).gates(manifest, 4e-3, 9.85e-4).settle_s == 9.85e-4
    with pytest.raises(
        InputError, match=r"leaves nothing of the all-ON .* give less than 0\.00099"
    ):
        named(1).gates(manifest, 4e-3, 9.95e-4)


@pytest.mark.parametrize("longer", [1.0, 20.0])
def test_law_lateness_is_certain_at_six_standard_deviations_of_sound_draws(longer):
    """The guard is `longer` than usual; the counts of the dark frame err, too."""
    manifest = schedule([1000] * 4)
    found = FrameStarts(
        np.zeros((1, 8)), np.ones(1, bool), manifest.picture_s, 1e-5, 0.0, np.inf, ()
    )
    windows = Windows.of_gates(manifest, GatePlan(2e-5, np.full(4, 5e-4), 1), found)
    scenes, guard = 400, int(np.argmax(windows.role == Role.GUARD))
    seconds = np.tile(windows.length_s, (scenes, 1))
    seconds[:, guard] *= longer
    dark = windows.frame == 1
    rates = np.where(dark, 1e5, 1e6)
    mean = np.rint(rates * seconds).astype(int)
    share = seconds[0, guard] / seconds[0, dark & (np.arange(len(dark)) != guard)].sum()
    draws = np.random.default_rng(3).poisson
    guards = draws(mean[0, guard], (20_000,))
    others = draws(mean[0, guard] / share, (20_000,))
    spread = float((guards - share * others).std()) * (scenes - 1) ** 0.5

    def named(excess: float) -> bool:
        photons = mean.copy()
        each, rest = divmod(round(excess), scenes)
        photons[:, guard] += each
        photons[:rest, guard] += 1
        return bool(lateness(windows, photons, seconds))

    assert not named(5.3 * spread)
    assert named(6.7 * spread)
