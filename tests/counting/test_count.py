"""Photons of a recording: each counted for its readout, or its exposure given up."""

import numpy as np
import pytest
import recording_samples
from recording_samples import DWELL, named, patterns_of, train, write_photons

from deepfsi.base.errors import InputError
from deepfsi.camera.dead_time import NO_DEAD_TIME
from deepfsi.counting.counts import Corrections
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
