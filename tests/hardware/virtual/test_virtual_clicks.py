"""Clicks of recordings: by the closed form, and the same of a gated and of a free detector."""

import numpy as np
import pytest
import torch
from virtual_samples import SUMMED_REFLECTANCE, patterns, scenes

from deepfsi import Scanner
from deepfsi.base import InputError
from deepfsi.camera import CounterEffects, DeadTime
from deepfsi.hardware.counting import CountSettings, count_run, read_counts
from deepfsi.hardware.counting.corrections import light_of_clicks
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


def test_each_exposure_of_a_frame_has_its_own_gates(tmp_path):
    """Half the exposure: half the photons in as many gates, for two exposures in a frame."""
    shown = patterns(tmp_path / "p", "free-dwell", "single")
    x = scenes(1).repeat(200, axis=0)
    run = recorded(tmp_path, "run", VirtualCamera(), x)
    counts = count_run(run, CountSettings(clicks=GATES, exposure_s=EXPOSURE / 2))
    repeats = counts.counts.shape[1]
    assert repeats >= 2
    p = -np.expm1(-expected(shown, x[:1])[0] / 2 / GATES)
    error = np.sqrt(GATES * p * (1 - p) / len(x))
    for each in range(repeats):
        assert (abs(counts.counts[:, each].mean(axis=0) - GATES * p) < 5 * error).all()


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


def test_where_all_gates_click_the_stated_flux_is_taken(tmp_path):
    patterns(tmp_path / "p", "equal-dwell", "dual")
    run = recorded(tmp_path, "run", VirtualCamera(gates=2), scenes(), 100 * FLUX, repeats=1)
    counts = count_run(run, CountSettings(clicks=2))
    assert (counts.counts[counts.counts > 0] == 2).mean() > 0.9
    assert (counts.flux == 100 * FLUX).all()


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


def test_too_many_gates_and_too_short_ones_are_refused(tmp_path):
    patterns(tmp_path / "p", "equal-dwell", "dual")
    run = recorded(tmp_path, "run", VirtualCamera(), scenes(), repeats=1)
    with pytest.raises(InputError, match="gates of 3 scenes are more than 2097152"):
        count_run(run, CountSettings(clicks=100_000))
    with pytest.raises(InputError, match="too coarse for gates of"):
        count_run(run, CountSettings(clicks=10**9))


@pytest.mark.parametrize(("unfired", "told"), [(24, False), (25, True), (400, True), (1000, False)])
def test_few_gates_without_a_click_tell_no_budget(tmp_path, unfired, told):
    """Of 1000 with all ON; and as many clicks with all ON as with all OFF tell none."""
    manifest = patterns(tmp_path / "p", "equal-dwell", "dual").manifest
    clicks = np.array([[500, 0, 500, 0]])[..., None] - np.array([[unfired, 0, 0, 0]])[..., None]
    ends = clicks, clicks, np.full((1, 4, 1), 500)
    light = light_of_clicks(*ends, width_s=1e-3, scenes=2, manifest=manifest)
    wanted = -np.log(unfired / 1000) / 1e-3 if told else np.nan
    assert light.flux == pytest.approx(np.full(2, wanted), nan_ok=True)
