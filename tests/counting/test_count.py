"""Photons of a recording: each counted for its readout, or its exposure given up."""

from dataclasses import replace

import numpy as np
import pytest
import recording_samples
from recording_samples import DWELL, named, patterns_of, schedule, train, write_photons

from deepfsi.base.errors import InputError
from deepfsi.camera.dead_time import NO_DEAD_TIME, DeadTime
from deepfsi.camera.detectors import DetectorMap
from deepfsi.counting.checks import Fault
from deepfsi.counting.counts import ALL_OFF, ALL_ON, ENDS, Corrections, Counts, light_of_clicks
from deepfsi.counting.recording import Recording
from deepfsi.patterns.folder import Patterns

run, whole = recording_samples.run, recording_samples.whole


def test_every_photon_of_a_frame_is_counted_for_its_readout(run):
    counts = Recording.read(run.folder).count()
    manifest = run.patterns.manifest
    assert counts.counts.shape == (3, 1, 2, 6)
    assert counts.counts.dtype == np.int64
    assert counts.valid.all()
    assert counts.faults == ()
    rail, mask, column, _ = manifest.readout_table
    shown = run.photons[:, manifest.mask_frames, 0]
    assert (counts.counts[:, 0, rail, mask] == shown[:, column]).all()
    assert counts.counts.sum() == shown.sum()  # a rail is dark
    seconds = DWELL - 3e-5  # less settling and guard
    flux = (run.photons[:, 0, 0] - 3).mean() / seconds
    assert counts.photons == pytest.approx(flux * counts.exposure_s, rel=2e-3)
    dark = counts.background
    assert (dark[:, 1, 0] == 0).all()
    assert dark[:, 0, 0] == pytest.approx(3, rel=0.05)
    assert (counts.signal() == counts.counts - dark[:, None]).all()


@pytest.mark.parametrize("pauses", [0.0, 0.02])
@pytest.mark.parametrize("trouble", ["early", "late"])
def test_a_run_whose_markers_are_one_frame_off_is_refused(run, pauses, trouble):
    """One is missing at an end and another extra at the other: times fit, the light does not."""
    starts = train(run.patterns.manifest, 3, pauses=pauses)
    markers = starts.ravel()
    step = DWELL if trouble == "late" else -DWELL
    markers = np.append(markers[1:], markers[-1] + step) if step > 0 else markers
    markers = np.append(markers[0] + step, markers[:-1]) if step < 0 else markers
    run.record(starts, markers, run.photons)
    run.refused("no light on input 3: |follow the schedule")


def test_a_recording_of_other_patterns_is_refused(run):
    photons = np.roll(run.photons, 3, axis=1)  # not where ON and OFF should be
    run.record(run.starts, run.starts.ravel(), photons)
    run.refused("no light on input 3: .* patterns that were shown")


def refuse(folder, match: str) -> None:
    with pytest.raises(InputError, match=match):
        Recording.read(folder).read_counts()


def test_counts_are_of_the_acquisition_and_the_photons_beside_them(run):
    photons, wanted = run.folder / "photons.ptu", Recording.read(run.folder).read_counts().counts
    run.edit(settle_s=1e-5)
    refuse(run.folder, r"counts\.npz is of another acquisition")
    run.edit(settle_s=2e-5)
    content = bytearray(photons.read_bytes())
    content[-1] ^= 1
    photons.write_bytes(content)
    refuse(run.folder, r"counts\.npz is of another photons\.ptu")
    photons.unlink()  # kept elsewhere
    assert (Recording.read(run.folder).read_counts().counts == wanted).all()


def test_cut_or_missing_counts_are_refused(run):
    path = run.folder / "counts.npz"
    whole = path.read_bytes()
    path.write_bytes(whole[:-100])
    refuse(run.folder, r"counts\.npz .*not a zip file.* camera count")
    path.unlink()
    refuse(run.folder, r"counts\.npz is missing.* camera count")


@pytest.mark.parametrize("gain", [0.5, 3.0])
def test_law_counts_divided_by_a_gain_have_their_variance(gain):
    mean, draws = 2000.0, 20_000
    factors = Corrections(NO_DEAD_TIME, np.array([gain])).factors(np.zeros(1))
    seen = np.random.default_rng(4).poisson(gain * mean, draws)
    found = seen * factors.arrivals
    assert abs(found.mean() - mean) < 5 * found.std() / draws**0.5
    spread = float((seen * factors.variance).mean())
    assert spread == pytest.approx(found.var(), rel=5 * (2 / draws) ** 0.5)


@pytest.mark.parametrize("silent", [24.5, 25])
def test_law_clicks_tell_the_light_of_their_gates(silent):
    """-log of the share of gates without a click; 25 of them tell it, or photons themselves.

    Two detectors an arm; each arm is dark where the other is bright.
    """
    manifest = schedule([1000]).model_copy(update={"detectors": DetectorMap(count=2)})
    exposures, gates, width = 50, 30, 1e-6
    opened = 2 * exposures * gates  # both frames that are all ON, or all OFF
    rates = np.array([[2e5, 4e5, 3e4, 4e4], [1e4, 2e4, 5e5, 6e5]])[[0, 1, 0, 1]]
    fired = np.tile(-gates * np.expm1(-rates * width), (exposures, 1, 1))
    given = {"gates": gates, "width_s": width, "manifest": manifest}
    found, dark = light_of_clicks(1.1 * fired, fired, **given)
    assert (found, *dark) == pytest.approx((5.7e5, 1e4, 2e4, 3e4, 4e4))
    fired[:, [0, 2], 1] = (1 - silent / opened) * gates
    known = np.log(opened / silent) / width - 2e4 + 1.9e5
    found, _ = light_of_clicks(0 * fired, fired, **given)
    assert found == pytest.approx(known) if silent == 25 else np.isnan(found)
    many = fired.copy()
    many[:, [0, 2], 1] = 3 * gates  # three photons a gate: the detector is not gated
    assert light_of_clicks(many, fired, **given)[0] == pytest.approx(3e6 - 2e4 + 1.9e5)


def test_a_pass_begins_and_ends_all_on_and_all_off():
    frames = schedule([1000] * 3).frames
    for places, roles in ((ENDS, "on off on off"), (ALL_ON, "on on"), (ALL_OFF, "off off")):
        assert [frames[place].role for place in places] == roles.split()


def test_counts_of_detectors_are_less_their_background_where_exposures_are_whole():
    shape = 2, 3, 1, 4, 2  # scenes, repeats, rails, masks, detectors
    rng = np.random.default_rng(0)
    arrivals, dark = rng.uniform(0, 9, shape), rng.uniform(1, 2, (2, 1, 2))
    lengths, valid = rng.uniform(0, 1, (1, 4)), rng.random((2, 3)) < 0.5
    flux = np.array([3.0, 5.0])
    made = Counts(arrivals, arrivals, 3 * arrivals - 8, valid, flux, dark, 0.5, 0, lengths,
                  0, (0,), (Fault(kind="budget", scene=1, detail=""),))  # fmt: skip
    background = np.einsum("srd,rm->srmd", dark, lengths)
    np.testing.assert_allclose(made.background, background)
    alone = np.where(valid[..., None, None, None], background[:, None], 0)
    np.testing.assert_allclose(made.signal(), arrivals - alone)
    np.testing.assert_allclose(made.excess, np.maximum(2 * arrivals - 8, 0))
    assert made.photons.tolist() == [1.5, 2.5]
    assert made.spoilt.tolist() == [False, True]
    assert not replace(made, gates=3).background.any()
    every = replace(made, faults=(Fault(kind="dark", detail=""), Fault(kind="level", detail="")))
    assert every.spoilt.all()
    with pytest.raises(InputError, match="clicks"):
        replace(made, gates=3).check_photons("folder")
    with pytest.raises(InputError, match="give `photons`"):
        replace(made, flux=np.full(2, np.nan)).check_budget("folder")


def test_rates_near_saturation_are_refused_with_the_worst():
    corrections = Corrections(DeadTime.model_validate({"seconds": 1e-7}), np.ones(2))
    rates = np.full((2, 5, 2), 1e3)
    corrections.check(rates, schedule([1000]).frames, (4, 1), "it")
    rates[1, 2, 1], rates[0, 1, 0] = 9e6, 8e6
    with pytest.raises(InputError, match=r"it has 9e\+06 counts/s on input 2 in mask 0"):
        corrections.check(rates, schedule([1000]).frames, (4, 1), "it")
    above, most = (corrections.factors(np.array([[each, 1.0]])) for each in (1e9, 1e7))
    assert above.arrivals[0, 0] <= most.arrivals[0, 0] * (1 + 1e-9)


# Windows: no light of the next frame in the dark, also where markers come late

FLUX, DARK, SCENES = 1e7, 100.0, 5


@pytest.fixture
def lamp(tmp_path):
    """Record scenes of 1e7 photons/s whose markers come late."""
    patterns = patterns_of(tmp_path / "patterns")
    Recording.prepare(tmp_path / "run", Patterns.read(tmp_path / "patterns"), named(SCENES))

    def record(late: float, rate: float = 0.0) -> None:
        manifest, rng = patterns.manifest, np.random.default_rng(0)
        begins = train(manifest, SCENES, rate, jitter=0)
        rates = np.zeros(len(manifest.frames))
        rates[[0, -2]] = FLUX
        rates[manifest.mask_frames] = FLUX * patterns.fractions.mean(axis=1)
        starts, lengths = begins.ravel(), (1 + rate) * np.tile(manifest.picture_s, SCENES)
        many = rng.poisson(np.tile(rates, SCENES) * lengths)
        photons = np.repeat(starts, many) + np.repeat(lengths, many) * rng.random(many.sum())
        span = starts[-1] + lengths[-1]
        dark = rng.uniform(0, span, rng.poisson(DARK * span))
        times = np.concatenate([starts + late, photons, dark])
        codes = np.zeros(len(times), int)
        codes[: len(starts)] = -1
        write_photons(tmp_path / "run", times, codes)

    return tmp_path / "run", record


@pytest.mark.parametrize(("late", "rate"), [(0, 0), (1e-6, 0), (5e-6, 0), (5e-6, -0.01), (0, 0.01)])
def test_a_late_trigger_gives_no_dark_counts(lamp, late, rate):
    """At 1 µs and 1e7 photons/s there were thousands a second."""
    folder, record = lamp
    record(late, rate=rate)
    counts = Recording.read(folder).count()
    seconds = 2 * SCENES * ((1 + rate) * DWELL - 3e-5)
    assert counts.dark_rate.mean() == pytest.approx(DARK, abs=5 * np.sqrt(DARK / seconds))
    assert counts.flux.mean() == pytest.approx(FLUX, rel=5 / np.sqrt(FLUX * seconds))
    assert counts.faults == ()
