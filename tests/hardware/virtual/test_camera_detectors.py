"""Several detectors in the virtual camera, its file and its counts: parts of one detector's law."""

import struct

import numpy as np
import pytest
import torch
from virtual_samples import DEVICE, SHAPE, SUMMED_REFLECTANCE, scenes

from deepfsi import Scanner
from deepfsi.base import InputError
from deepfsi.camera import DetectorMap
from deepfsi.hardware.counting import Counts, count_run, read_counts
from deepfsi.hardware.patterns import (
    DesignRails,
    FrameSettings,
    GatePlan,
    export_patterns,
)
from deepfsi.hardware.photons import ptu
from deepfsi.hardware.pictures import reconstruct
from deepfsi.hardware.virtual import (
    CAMERAS,
    RecordingSettings,
    VirtualCamera,
    arrival_rates,
    record_scenes,
)
from deepfsi.hardware.virtual import camera as camera_module
from deepfsi.physics import Detection, light_law
from deepfsi_paper.camera import gate_counts

CELLS = (0, 0, 1, 2, 0, 0, 1, 2, 3, 3, 3, 2)
"""Detector of each of 3 x 4 cells: parts of 4, 2, 3 and 3 cells."""

D = 4
FLUX, EXPOSURE = 2e7, 1e-3
STRAY = VirtualCamera(ambient=3e5)
OPTICS = [("equal-dwell", "dual"), ("free-dwell", "single"), ("two-arm", "dual")]
every_optics = pytest.mark.parametrize(("light", "rails"), OPTICS)


def design_of(light: str, rails: str, cells=CELLS) -> DesignRails:
    wild = np.random.default_rng(3).random((5, 12)) - (0.5 if rails == "dual" else 0)
    fitted = light_law(light).fit(torch.from_numpy(wild), rails).numpy()
    detectors = None if cells is None else DetectorMap(count=max(cells) + 1, cells=cells)
    return DesignRails(fitted, light, SHAPE, SUMMED_REFLECTANCE, None, None, detectors)


def patterns(folder, light="equal-dwell", rails="dual", cells=CELLS):
    return export_patterns(design_of(light, rails, cells), FrameSettings(DEVICE, 2e-3), folder)


def expected(shown, x, photons) -> np.ndarray:
    """Mean counts of each detector by the scanner, (S, rails, m, D)."""
    scanner = Scanner.from_rails(
        torch.from_numpy(shown.rails),
        detection=Detection.by(DetectorMap.of(np.array(CELLS), SHAPE)),
    )
    flat = torch.from_numpy(x.reshape(len(x), -1).astype(np.float64))
    rates = scanner.rates(flat * (photons / SUMMED_REFLECTANCE)).numpy()
    return rates.reshape(*rates.shape[:-1], -1, D)


@every_optics
def test_detectors_divide_the_light_of_one(tmp_path, light, rails):
    """Stray light too; dark counts come once for each detector."""
    x = scenes()
    cameras = STRAY, STRAY.model_copy(update={"dark": 100.0})
    for folder, cells in ((tmp_path / "one", None), (tmp_path / "several", CELLS)):
        patterns(folder, light, rails, cells)
    one = arrival_rates(tmp_path / "one", x, STRAY, FLUX)
    several, dark = (arrival_rates(tmp_path / "several", x, each, FLUX) for each in cameras)
    assert several.shape[-1] == D * one.shape[-1]
    parts = several.reshape(*one.shape, D)
    np.testing.assert_allclose(parts.sum(axis=-1), one, rtol=1e-5)
    np.testing.assert_allclose(dark, several + 100)


@every_optics
def test_counts_of_each_detector_are_poisson_with_the_scanners_mean(tmp_path, light, rails):
    shown, x = patterns(tmp_path, light, rails), scenes(1)
    rates = arrival_rates(tmp_path, x, CAMERAS["ideal"], FLUX)
    once, times = GatePlan.of(shown.manifest, EXPOSURE, repeats=1), 4000
    gates = GatePlan(once.settle_s, once.length_s, times)
    counts = gate_counts.draw_counts(
        rates, shown.manifest, gates, CAMERAS["ideal"], np.random.default_rng(1)
    )
    mean = expected(shown, x, FLUX * EXPOSURE)[0]
    assert counts.shape == (1, times, *mean.shape)
    lit = mean > 0
    assert (counts[0][:, ~lit] == 0).all()
    found = counts[0][:, lit]
    off = (found.mean(axis=0) - mean[lit]) / np.sqrt(mean[lit] / times)
    assert np.abs(off).max() < 5
    spread = (found.var(axis=0) / mean[lit] - 1) / np.sqrt((2 + 1 / mean[lit]) / times)
    assert np.abs(spread).max() < 6


def test_each_detector_has_a_dead_time_of_its_own(tmp_path):
    """So several lose less than one: each is as blind as its own light makes it."""
    slow, x = VirtualCamera(dead_time_s=2e-7), scenes(1)
    totals = []
    for folder, cells in ((tmp_path / "one", None), (tmp_path / "several", CELLS)):
        manifest = patterns(folder, "free-dwell", "single", cells).manifest
        once = GatePlan.of(manifest, EXPOSURE, repeats=1)
        rates = arrival_rates(folder, x, slow, FLUX)
        gates = GatePlan(once.settle_s, once.length_s, 2000)
        counts = gate_counts.draw_counts(rates, manifest, gates, slow, np.random.default_rng(1))
        counted = counts.reshape(2000, manifest.masks, -1).mean(axis=0)
        arriving = rates[0, manifest.shown] * once.length_s[:, None]
        wanted = slow.registered(rates[0, manifest.shown]) * once.length_s[:, None]
        assert np.abs(counted - wanted).max() < 5 * np.sqrt(arriving.max() / 2000) + 1e-3
        totals.append(counted.sum())
    assert totals[1] > 1.5 * totals[0]


@every_optics
def test_a_recording_is_counted_input_by_input(tmp_path, light, rails):
    """From scenes to a file and back, wired in another order; the budget is all detectors'."""
    shown, x = patterns(tmp_path / "p", light, rails), scenes(4)
    inputs = tuple(reversed(range(3, 3 + shown.manifest.inputs)))
    camera = VirtualCamera(dark=2000.0)
    settings = RecordingSettings(camera, FLUX, EXPOSURE, repeats=1, seed=2, inputs=inputs)
    made = record_scenes(tmp_path / "p", x, list("abcd"), None, tmp_path / "run", settings)
    assert made.inputs == inputs
    counts = count_run(tmp_path / "run")
    assert counts.faults == ()
    assert counts.inputs == inputs
    mean = expected(shown, x, FLUX * EXPOSURE)
    assert counts.counts.shape == (4, 1, *mean.shape[1:])
    noise = np.sqrt(mean + counts.background + 1)
    off = (counts.signal()[:, 0] - mean) / noise
    assert np.abs(off).max() < 5
    assert counts.dark_rate.shape == (4, len(shown.rails), D)
    on_s = 2 * 2e-3 * 4  # a scene has two dark frames
    assert np.abs(counts.dark_rate - 2000).max() < 5 * np.sqrt(2000 / on_s)
    bright = x.sum(axis=(1, 2)).mean() / SUMMED_REFLECTANCE
    assert counts.photons == pytest.approx(FLUX * EXPOSURE * bright, rel=5e-3)
    again = read_counts(tmp_path / "run")
    assert np.array_equal(again.signal(), counts.signal())


def test_a_picture_is_each_detectors_of_its_own_cells(tmp_path):
    """Twenty counts of five masks tell twelve cells, where those of one detector could not."""
    shown, x, flux = patterns(tmp_path / "p", "free-dwell", "single"), scenes(2), 1e9
    settings = RecordingSettings(CAMERAS["ideal"], flux, EXPOSURE, repeats=1)
    record_scenes(tmp_path / "p", x, list("ab"), None, tmp_path / "run", settings)
    count_run(tmp_path / "run")
    mean, noise = expected(shown, x, flux * EXPOSURE)[:, 0], np.empty((2, 12))
    for each in range(D):
        own = np.array(CELLS) == each
        back = np.linalg.pinv(shown.rails[0][:, own])
        noise[:, own] = np.sqrt(mean[..., each] @ (back**2).T) * SUMMED_REFLECTANCE / 1e6
    off = (reconstruct(tmp_path / "run") - x).reshape(2, 12) / noise
    assert noise.max() < 0.1
    assert np.abs(off).max() < 5


@pytest.fixture
def disturbed(tmp_path):
    """Count a recording in which one detector sees other light in some frames."""

    def make(change, x=None) -> Counts:
        manifest = patterns(tmp_path / "p", "free-dwell", "single").manifest
        x = scenes(6) if x is None else x
        settings = RecordingSettings(CAMERAS["ideal"], FLUX, EXPOSURE, repeats=1)
        record_scenes(tmp_path / "p", x, list("abcdef"), None, tmp_path / "run", settings)
        rates = arrival_rates(tmp_path / "p", x, CAMERAS["ideal"], FLUX)
        change(rates)
        path, rng = tmp_path / "run" / "photons.ptu", np.random.default_rng(5)
        camera_module.write_photons(path, manifest, rates, CAMERAS["ideal"], rng)
        return count_run(tmp_path / "run")

    return make


def test_stray_light_on_one_detector_is_found_where_all_together_hide_it(disturbed):
    """In scene 2 detector 1 sees a mask half as bright again as all ON."""

    def change(rates):
        rates[2, 4, 1] = 1.5 * rates[2, 0, 1]
        assert rates[2, 4].sum() < rates[2, 0].sum()

    [fault] = disturbed(change).faults
    assert (fault.kind, fault.scene, fault.frame) == ("brighter", 2, 4)
    assert "on input 2" in fault.detail


def test_stray_light_on_a_part_that_is_dark_is_found(disturbed):
    """Nothing else lights detector 2 in scene 1."""
    x = scenes(6)
    x[1].ravel()[np.array(CELLS) == 2] = 0

    def change(rates):
        assert (rates[1, :, 2] == 0).all()
        rates[1, 4, 2] = 0.1 * rates[1, 0].sum()
        assert rates[1, 4].sum() < rates[1, 0].sum()

    [fault] = disturbed(change, x).faults
    assert (fault.kind, fault.scene, fault.frame) == ("brighter", 1, 4)
    assert "on input 3" in fault.detail


def test_a_counter_with_too_few_inputs_is_refused(tmp_path):
    patterns(tmp_path / "p", "two-arm")
    settings = RecordingSettings(CAMERAS["ideal"], FLUX, EXPOSURE)
    record_scenes(tmp_path / "p", scenes(1), ["a"], None, tmp_path / "run", settings)
    path = tmp_path / "run" / "photons.ptu"
    kinds = [struct.pack("<q", kind.code) for kind in (ptu.GENERIC_T2, ptu.PICOHARP_T2)]
    path.write_bytes(path.read_bytes().replace(*kinds, 1))
    with pytest.raises(InputError, match=r"PicoHarp 300 T2.* has up to 5 inputs, .* need 8"):
        count_run(tmp_path / "run")
