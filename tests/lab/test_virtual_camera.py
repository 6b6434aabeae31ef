"""The virtual camera: light where it should be, and counts that agree with the scanner's."""

import numpy as np
import pytest
from virtual_samples import (
    DEVICE,
    OPTICS,
    SHAPE,
    SUMMED_REFLECTANCE,
    expected,
    patterns,
    record,
    scenes,
)

from deepfsi.base.errors import InputError
from deepfsi.camera.layout import DmdLayout, find_grid
from deepfsi.counting.reader import summarise
from deepfsi.counting.recording import Recording
from deepfsi.lab import virtual_detector as detector
from deepfsi.lab import virtual_optics as module
from deepfsi.lab.virtual_optics import CAMERAS, VirtualCamera, arrival_rates
from deepfsi.patterns.folder import Patterns

GRID = find_grid(DEVICE, SHAPE, DmdLayout(stretch=True))
AREA = slice(GRID.top, GRID.top + 24), slice(GRID.left, GRID.left + 36)
IDEAL = CAMERAS["ideal"]
every_optics = pytest.mark.parametrize(
    ("light", "rails"), [*OPTICS, ("free-dwell", "dual"), ("column", "dual")]
)


def assert_poisson(counts: np.ndarray, mean: np.ndarray) -> None:
    """Mean and variance of samples (n, ...), all places together and one by one, to five sigma."""
    n, lit = len(counts), mean > 0
    assert (counts[:, ~lit] == 0).all()
    counts, mean = counts[:, lit].astype(float), mean[lit]
    off = (counts.mean(axis=0) - mean) / np.sqrt(mean / n)
    assert np.all(abs(off) <= 5)
    power = (counts.var(axis=0, ddof=1) - mean) / np.sqrt((2 * mean**2 + mean) / n)
    assert np.all(abs(power) <= 6)  # not yet normal for few samples
    for all_places in (off, power):
        assert abs(all_places.sum()) <= 5 * len(mean) ** 0.5


# Light on the mirrors


def test_nothing_is_seen_behind_the_camera():
    """Of a display that crosses the horizon only one side is seen, that of the area's centre."""
    view = ((-0.8, -0.6, 0.6), (-0.7, -0.6, 0.6), (1, -0.7, -0.2))
    camera = VirtualCamera(view=view)
    seen = module.irradiance(np.ones((1, 3, 4)), camera, DEVICE, GRID)[0][AREA]
    x, y = np.meshgrid((np.arange(36) + 0.5) / 36, (np.arange(24) + 0.5) / 24)
    back = np.linalg.inv(view)
    across, down, depth = (row[0] * x + row[1] * y + row[2] for row in back)
    on_display = (abs(across / depth - 0.5) < 0.5) & (abs(down / depth - 0.5) < 0.5)
    front = depth * (back[2] @ [0.5, 0.5, 1]) > 0
    assert (on_display & front).sum() > 100
    assert (on_display & ~front).sum() > 100
    assert np.array_equal(seen > 0, on_display & front)


# Rates


@every_optics
def test_rates_of_the_ideal_camera_are_those_of_the_realised_masks(tmp_path, light, rails):
    shown, x, flux = patterns(tmp_path / "p", light, rails), scenes(), 1e6
    manifest = shown.manifest
    flow = arrival_rates(Patterns.read(tmp_path / "p"), x, IDEAL, flux)
    assert flow.shape == (3, len(manifest.frames), 2 if light == "two-arm" else 1)
    part = flux / SUMMED_REFLECTANCE * x.reshape(3, -1) @ shown.fractions.T
    whole = flux / SUMMED_REFLECTANCE * x.sum(axis=(1, 2))
    assert flow[:, manifest.mask_frames, 0] == pytest.approx(part, rel=1e-5)
    on, off = ([frame.role for frame in manifest.frames].index(role) for role in ("on", "off"))
    assert flow[:, on, 0] == pytest.approx(whole, rel=1e-5)  # the budget
    assert (flow[:, off, 0] == 0).all()
    if light == "two-arm":
        assert flow.sum(axis=-1) == pytest.approx(np.tile(whole[:, None], flow.shape[1]), rel=1e-5)


@pytest.mark.parametrize("light", ["equal-dwell", "two-arm"])
def test_dark_counts_and_ambient_light_add_to_the_signal(tmp_path, light):
    shown, x = patterns(tmp_path / "p", light), scenes()
    camera = VirtualCamera(ambient=4e5, dark=123.0, efficiency=0.4)
    signal = arrival_rates(Patterns.read(tmp_path / "p"), x, IDEAL, 1e6)
    stray = arrival_rates(Patterns.read(tmp_path / "p"), x, camera, 1e6) - 0.4 * signal
    part = shown.fractions.mean(axis=1) * 24 * 36 / (26 * 36)  # of the whole device
    places = shown.manifest.mask_frames
    assert stray[0, places, 0] == pytest.approx(123 + 0.4 * 4e5 * part, rel=1e-4)
    if light == "two-arm":
        rest = 24 * 36 / (26 * 36) - part
        assert stray[0, places, 1] == pytest.approx(123 + 0.4 * 4e5 * rest, rel=1e-4)
    assert arrival_rates(Patterns.read(tmp_path / "p"), x, camera, 0.0)[:, 1, 0] == pytest.approx(
        123
    )


@pytest.mark.parametrize(
    ("given", "flux", "message"),
    [
        (np.ones((3, 12)), 1e6, "no images"),
        (np.full((1, 3, 4), np.nan), 1e6, "finite numbers"),
        (scenes(), 1e13, "flux"),
    ],
)
def test_scenes_and_fluxes_that_are_none_are_refused(tmp_path, given, flux, message):
    patterns(tmp_path / "p")
    with pytest.raises(InputError, match=message):
        arrival_rates(Patterns.read(tmp_path / "p"), given, IDEAL, flux)


# Files


@every_optics
def test_law_counts_from_a_file_are_poisson_with_the_scanners_mean(tmp_path, light, rails):
    shown = patterns(tmp_path / "p", light, rails, dwell=2e-2)
    exposure, flux, x = 2e-4, 5e6, scenes()
    counted = Recording.read(
        record(tmp_path, x, camera=IDEAL, flux=flux, exposure_s=exposure, seed=7)
    ).count()
    assert counted.valid.all()
    assert counted.faults == ()
    assert counted.counts.shape[1] >= 50
    for drawn, mean in zip(counted.counts, expected(shown, x, flux * exposure), strict=True):
        assert_poisson(drawn, mean)


def test_events_stay_in_order_where_jitter_reaches_over_chunks(tmp_path, monkeypatch):
    """The writer refuses times that run back."""
    monkeypatch.setattr(detector, "EVENTS_AT_ONCE", 10)
    shown = patterns(tmp_path / "p", "two-arm", dwell=1e-4)
    camera = VirtualCamera(jitter_s=1e-6, afterpulse_probability=0.3, afterpulse_s=1e-5)
    flow = arrival_rates(Patterns.read(tmp_path / "p"), scenes(), camera, 1e6)
    module.write_photons(tmp_path / "a.ptu", shown.manifest, flow, camera, np.random.default_rng(0))
    contents = summarise(tmp_path / "a.ptu")
    expected = (flow.sum(axis=2) * shown.manifest.picture_s).sum() * 1.3
    assert abs(sum(contents.photons.values()) - expected) <= 6 * np.sqrt(expected * 1.3)
    assert contents.markers == {0: 3 * len(shown.manifest.frames)}


PICTURES = 20_000


@pytest.mark.parametrize("relative", [0.02, 0.2])
def test_law_levels_have_the_mean_1_and_the_deviation_that_is_asked_for(relative):
    camera = VirtualCamera(fluctuation=relative)
    drawn = camera.fluctuate(np.ones((PICTURES, 1)), np.random.default_rng(1))[:, 0]
    assert (drawn > 0).all()
    assert abs(drawn.mean() - 1) <= 5 * relative / PICTURES**0.5
    # relative error of a variance: (kurtosis + 2) / n, and of this log-normal kurtosis < 16 f²
    error = relative**2 * np.sqrt((2 + 16 * relative**2) / PICTURES)
    assert abs(drawn.var() - relative**2) <= 5 * error
    assert abs(np.corrcoef(drawn[1:], drawn[:-1])[0, 1]) <= 5 / PICTURES**0.5


def test_law_counts_of_a_file_have_the_excess_of_the_light(tmp_path):
    patterns(tmp_path / "p")
    relative, x = 0.1, np.repeat(scenes(1), 300, axis=0)
    camera = VirtualCamera(fluctuation=relative)
    found = Recording.read(
        record(tmp_path, x, camera=camera, flux=2e6, exposure_s=1e-3, seed=7)
    ).count()
    # of complete scenes: all ON of a few is too dark beside their masks
    counts = found.counts[found.valid.all(axis=1)].sum(axis=1)
    lit = counts[:, counts.mean(axis=0) > 50]
    mean = lit.mean(axis=0)
    excess = (lit.var(axis=0, ddof=1) - mean) / mean**2
    # variance of a variance of n - 1 degrees of freedom, of about normal counts
    error = (relative**2 + 1 / mean) * np.sqrt(2 / (len(lit) - 1))
    assert np.all(np.abs(excess - relative**2) <= 5 * error)
    assert excess.mean() > 0.5 * relative**2
    # pictures have light of their own: rails of a mask do not share it
    correlation = np.corrcoef(lit.T)[np.triu_indices(lit.shape[1], 1)]
    assert np.abs(correlation).max() <= 5 / len(lit) ** 0.5


def test_dark_counts_do_not_fluctuate():
    camera = VirtualCamera(fluctuation=0.5, dark=100.0)
    rng = np.random.default_rng(2)
    rates = np.full((50, 2), 100.0)
    assert np.allclose(camera.fluctuate(rates, rng), 100.0)
    bright = camera.fluctuate(rates + 1000, rng)
    assert np.ptp(bright[:, 0]) > 100
    assert np.array_equal(bright[:, 0], bright[:, 1])  # one light for all detectors
