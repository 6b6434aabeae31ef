"""Several detectors in the virtual camera, its file and its counts: parts of one detector's law."""

import numpy as np
import pytest
from virtual_samples import (
    SHAPE,
    SUMMED_REFLECTANCE,
    every_optics,
    expected,
    patterns,
    record,
    scenes,
)

from deepfsi.camera.detectors import DetectorMap
from deepfsi.counting.recording import Recording
from deepfsi.lab import virtual_optics as camera_module
from deepfsi.lab.virtual_optics import CAMERAS, VirtualCamera, arrival_rates
from deepfsi.patterns.folder import Patterns
from deepfsi.physics.detection import Detection

IDEAL = CAMERAS["ideal"]
CELLS = (0, 0, 1, 2, 0, 0, 1, 2, 3, 3, 3, 2)
D = 4
FLUX, EXPOSURE = 2e7, 1e-3
DETECTION = Detection.by(DetectorMap.of(np.array(CELLS), SHAPE))


def export(folder, light="equal-dwell", rails="dual"):
    return patterns(folder, light, rails, cells=CELLS)


def means(shown, x, photons) -> np.ndarray:
    """Mean counts of each detector by the scanner, (S, rails, m, D)."""
    rates = expected(shown, x, photons, DETECTION)
    return rates.reshape(*rates.shape[:-1], -1, D)


def test_each_detector_has_a_dead_time_of_its_own(tmp_path):
    """So several lose less than one: each is as blind as its own light makes it."""
    manifest = export(tmp_path / "p", "free-dwell", "single").manifest
    slow, x = VirtualCamera(dead_time_s=2e-7), scenes(1).repeat(30, axis=0)
    run = record(tmp_path, x, camera=slow, flux=FLUX, exposure_s=EXPOSURE, repeats=1, seed=3)
    counts = Recording.read(run).count()
    arriving = arrival_rates(Patterns.read(tmp_path / "p"), x[:1], slow, FLUX)[
        0, manifest.mask_frames
    ].T
    gate_s = counts.lengths_s[0]
    wanted, one = (slow.registered(rates) * gate_s for rates in (arriving, arriving.sum(0)))
    counted = counts.counts[:, 0, 0].mean(axis=0).T
    error = np.sqrt(arriving.max() * gate_s / 30)
    assert (abs(counted - wanted) < 5 * error + 1e-3).all()
    assert counted.sum() > 1.5 * one.sum()


@every_optics
def test_a_recording_is_counted_input_by_input(tmp_path, light, rails):
    """From scenes to a file and back, wired in another order; the budget is all detectors'."""
    shown, x = export(tmp_path / "p", light, rails), scenes(4)
    inputs = tuple(reversed(range(3, 3 + shown.manifest.inputs)))
    settings = {"flux": FLUX, "exposure_s": EXPOSURE, "repeats": 1, "seed": 2, "inputs": inputs}
    counts = Recording.read(
        record(tmp_path, x, camera=VirtualCamera(dark=2000.0), **settings)
    ).count()
    assert counts.faults == ()
    assert counts.inputs == inputs
    mean = means(shown, x, FLUX * EXPOSURE)
    assert counts.counts.shape == (4, 1, *mean.shape[1:])
    noise = np.sqrt(mean + counts.background + 1)
    off = (counts.signal()[:, 0] - mean) / noise
    assert np.abs(off).max() < 5
    assert counts.dark_rate.shape == (4, len(shown.rails), D)
    on_s = 2 * 2e-3 * 4  # a scene has two dark frames
    assert np.abs(counts.dark_rate - 2000).max() < 5 * np.sqrt(2000 / on_s)
    bright = x.sum(axis=(1, 2)).mean() / SUMMED_REFLECTANCE
    assert counts.photons == pytest.approx(FLUX * EXPOSURE * bright, rel=5e-3)
    again = Recording.read(tmp_path / "run").read_counts()
    assert np.array_equal(again.signal(), counts.signal())


@pytest.mark.parametrize("dark", [False, True])
def test_stray_light_on_one_detector_is_found_where_all_together_hide_it(tmp_path, dark):
    """A mask half as bright again as all ON in scene 2; or some light where nothing else is."""
    scene, hit, x = (1, 2, scenes(6)) if dark else (2, 1, scenes(6))
    if dark:
        x[scene].ravel()[np.array(CELLS) == hit] = 0
    manifest = export(tmp_path / "p", "free-dwell", "single").manifest
    run = record(tmp_path, x, camera=IDEAL, flux=FLUX, exposure_s=EXPOSURE, repeats=1)
    rates = arrival_rates(Patterns.read(tmp_path / "p"), x, IDEAL, FLUX)
    assert (rates[scene, 0, hit] == 0) == dark
    rates[scene, 4, hit] = 0.1 * rates[scene, 0].sum() if dark else 1.5 * rates[scene, 0, hit]
    assert rates[scene, 4].sum() < rates[scene, 0].sum()
    rng = np.random.default_rng(5)
    camera_module.write_photons(run / "photons.ptu", manifest, rates, IDEAL, rng)
    [fault] = Recording.read(run).count().faults
    assert (fault.kind, fault.scene, fault.frame) == ("brighter", scene, 4)
    assert f"on input {hit + 1}" in fault.detail
