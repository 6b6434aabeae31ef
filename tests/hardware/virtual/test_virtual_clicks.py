"""Clicks of recordings: by the closed form, and the same of a gated and of a free detector."""

import numpy as np
import pytest
import torch
from virtual_samples import SUMMED_REFLECTANCE, patterns, scenes

from deepfsi import Scanner
from deepfsi.base import InputError
from deepfsi.camera import CounterEffects, DeadTime
from deepfsi.hardware.counting import CountSettings, count_run, read_counts
from deepfsi.hardware.patterns import Patterns
from deepfsi.hardware.pictures import reconstruct
from deepfsi.hardware.virtual import RecordingSettings, VirtualCamera, record_scenes
from deepfsi.lab import check_view, gains_of

GATES = 4
EXPOSURE = 4e-3
FLUX = 1.5e4
"""Photons/s: about one in a gate."""

every_optics = pytest.mark.parametrize(
    ("light", "rails"),
    [("equal-dwell", "dual"), ("free-dwell", "single"), ("two-arm", "dual")],
)


def recorded(folder, name, camera, x, flux=FLUX, **settings):
    how = RecordingSettings(camera, flux, EXPOSURE, **settings)
    record_scenes(folder / "p", x, [str(k) for k in range(len(x))], None, folder / name, how)
    return folder / name


def expected(shown: Patterns, x: np.ndarray) -> np.ndarray:
    """Photons (S, rails, m) of an exposure, by the scanner."""
    scanner = Scanner.from_rails(torch.from_numpy(shown.rails))
    flat = torch.from_numpy(x.reshape(len(x), -1).astype(np.float64))
    return scanner.rates(flat * (FLUX * EXPOSURE / SUMMED_REFLECTANCE)).numpy()


@every_optics
def test_clicks_of_each_readout_are_binomial(tmp_path, light, rails):
    """Mean and variance of all exposures of two scenes, to five standard errors."""
    shown, x = patterns(tmp_path / "p", light, rails), scenes(2)
    gated = recorded(tmp_path, "run", VirtualCamera(gates=GATES), x.repeat(150, axis=0))
    counts = count_run(gated, CountSettings(clicks=GATES))
    assert counts.valid.all()
    assert counts.gates == read_counts(gated).gates == GATES
    found = counts.signal().reshape(2, -1, *counts.counts.shape[2:])
    n, p = found.shape[1], -np.expm1(-expected(shown, x) / GATES)
    assert (found[:, :, p[0] == 0] == 0).all()
    lit = p > 0
    found, p = found.swapaxes(0, 1)[:, lit], p[lit]
    assert p.max() > 0.3
    spread = GATES * p * (1 - p)
    assert abs((found.mean(axis=0) - GATES * p) / np.sqrt(spread / n)).max() < 5
    fourth = spread * (1 + 3 * (GATES - 2) * p * (1 - p))  # central moment
    off = found.var(axis=0) - spread
    assert abs(off.sum()) < 5 * np.sqrt(((fourth - spread**2) / n).sum())


@every_optics
def test_a_gated_and_a_free_detector_give_the_same_clicks(tmp_path, light, rails):
    """Of one seed, photon by photon; a second count of gated photons changes nothing."""
    patterns(tmp_path / "p", light, rails)
    runs = [
        recorded(tmp_path, name, VirtualCamera(gates=gates), scenes(20), seed=3, repeats=1)
        for name, gates in (("gated", GATES), ("free", None))
    ]
    gated, free = (count_run(run, CountSettings(clicks=GATES)) for run in runs)
    photons = count_run(runs[1])
    assert np.array_equal(gated.counts, free.counts)
    assert gated.counts.max() == GATES
    assert photons.counts.max() > GATES
    assert (photons.counts >= free.counts).all()
    assert (gated.variance <= gated.counts).all()


@pytest.mark.parametrize(("gates", "flux"), [(None, FLUX), (None, 30 * FLUX), (40, FLUX)])
def test_all_on_frames_tell_the_budget_by_clicks_or_by_photons(tmp_path, gates, flux):
    """Clicks where gates hold few photons, and the photons of a free detector where many."""
    patterns(tmp_path / "p", "equal-dwell", "dual")
    x = scenes(1).repeat(40, axis=0)
    run = recorded(tmp_path, "run", VirtualCamera(gates=gates), x, flux, repeats=1)
    counts, number = count_run(run, CountSettings(clicks=gates or GATES)), 80 * (gates or GATES)
    wanted = flux * float(x[0].sum()) / SUMMED_REFLECTANCE
    mean = wanted * 2e-3 / (gates or GATES)  # photons in a gate, about
    variance = mean if mean > 1 else np.expm1(mean)
    error = np.sqrt(variance / number) / mean
    assert counts.flux == pytest.approx(np.full(40, wanted), rel=5 * error)
    assert error < 0.1


def test_what_is_of_photons_refuses_clicks(tmp_path):
    patterns(tmp_path / "p", "equal-dwell", "dual")
    gated = recorded(tmp_path, "run", VirtualCamera(gates=GATES), scenes(), repeats=1)
    for settings, match in [
        (
            {"effects": CounterEffects(dead_time=DeadTime(seconds=2e-8))},
            "dead time is of photon counts",
        ),
        ({"background": "0"}, "a background is of photon counts"),
        ({"gains": (1.0,)}, "a flat field is of photon counts"),
        ({"exposure_s": EXPOSURE / 2}, "first photons alone of 4 gates"),
    ]:
        with pytest.raises(InputError, match=match):
            count_run(gated, CountSettings(clicks=GATES, **settings))
    for clicks in (None, 2):
        with pytest.raises(InputError, match="first photons alone of 4 gates"):
            count_run(gated, CountSettings(clicks=clicks))
    assert not (gated / "counts.npz").exists()
    count_run(gated, CountSettings(clicks=GATES))
    for use in (reconstruct, check_view, gains_of):
        with pytest.raises(InputError, match="was counted in clicks, which are not in proportion"):
            use(gated)
