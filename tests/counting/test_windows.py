"""Windows of frames: no light of the next frame in the dark, also where markers come late."""

import numpy as np
import pytest
from recording_samples import DWELL, named, patterns_of, train, write_photons

from deepfsi.counting.recording import Recording
from deepfsi.patterns.folder import Patterns

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
        rates[manifest.shown] = FLUX * patterns.fractions.mean(axis=1)
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
