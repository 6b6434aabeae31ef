"""Corrections: the masks' background, measured with the scene dark, and unequal detectors."""

import numpy as np
import pytest
from recording_samples import schedule

from deepfsi.camera.dead_time import NO_DEAD_TIME
from deepfsi.camera.detectors import DetectorMap
from deepfsi.camera.device import Device
from deepfsi.counting.counts import Ambient, Corrections, Estimate
from deepfsi.counting.recording import CountSettings, Recording
from deepfsi.lab.virtual_optics import (
    VirtualCamera,
    arrival_rates,
)
from deepfsi.patterns.folder import Patterns
from deepfsi.patterns.rails import DesignRails
from shared.virtual_runs import record

DEVICE = Device(name="small", columns=36, rows=26, shortest_us=10, settle_us=2)
SHAPE, FLUX, EXPOSURE, SCENES, MASKS = (3, 4), 2e7, 10e-3, 8, 10
STEADY = np.random.default_rng(4).uniform(0.8, 1, SHAPE).astype(np.float32)


def patterns(folder, law: str):
    wild = np.random.default_rng(3).uniform(0, 1, (MASKS, 12)).astype(np.float32)
    rails, light, cells = wild[None] / wild.max(axis=1).sum(), "free-dwell", None
    if law == "two-arm":
        rails, light = np.stack([wild, 1 - wild]) / MASKS, law
    if law == "detectors":
        cells = DetectorMap(count=2, cells=(0, 0, 1, 1) * 3)
    made = DesignRails(rails, light, SHAPE, float(STEADY.sum()), None, None, cells)
    Patterns.from_rails(made, DEVICE, 1.2e-3).write(folder)
    return Patterns.read(folder)


def recorded(folder, shown, x, seed: int = 0):
    """Scenes in ambient light as strong as they; one that is dark is named black."""
    names = [f"s{k}" if scene.any() else "black" for k, scene in enumerate(x)]
    camera = VirtualCamera(dark=300.0, ambient=FLUX)
    return record(folder, shown, x, camera, FLUX, EXPOSURE, names, repeats=1, seed=seed)


@pytest.mark.parametrize("law", ["single", "two-arm", "detectors"])
def test_scenes_are_rid_of_ambient_light_as_strong_as_they(tmp_path, law):
    """Means within 5 standard errors, by the variance that is stated; far off without."""
    shown = patterns(tmp_path / "patterns", law)
    black = np.zeros((1, *SHAPE), np.float32)
    lit = np.repeat(STEADY[None], SCENES, axis=0)
    run = recorded(tmp_path / "run", tmp_path / "patterns", np.concatenate([lit, black]))
    counts = Recording.read(run).count(CountSettings(background="black"))
    wanted = arrival_rates(shown, lit[:1], VirtualCamera(), FLUX)[0]
    raw = Recording.read(run).count()
    read = counts.lengths_s > 0
    manifest = shown.manifest
    rail, mask, column, arm = manifest.read
    frames = wanted[manifest.shown].reshape(len(manifest.shown), -1, manifest.detector_count)
    clean = np.zeros((manifest.rails, manifest.masks, manifest.detector_count))
    clean[rail, mask] = frames[column, arm] * counts.gate_s[column][:, None]
    clean = clean.reshape(counts.ambient.shape)[read]
    seen = slice(0, SCENES)
    found = counts.signal()[seen, 0].mean(axis=0)[read]
    noise = (counts.variance[seen, 0].mean(axis=0) / SCENES + counts.ambient_variance)[read]
    z = (found - clean) / np.sqrt(noise)
    assert abs(z).max() < 5
    assert (z**2).mean() == pytest.approx(1, abs=5 * np.sqrt(2 / z.size))
    off = (raw.signal()[seen, 0].mean(axis=0)[read] - clean) / np.sqrt(noise)
    assert abs(off).mean() > 10
    flux = wanted[0][: manifest.detector_count].sum()
    assert counts.flux[0] == pytest.approx(flux, rel=0.02)
    assert raw.flux[0] > 1.6 * flux  # cells leave some of the device dark
    assert not counts.valid[SCENES].any()
    assert [fault.scene for fault in counts.faults if "subtracted" in fault.detail] == [SCENES]


@pytest.mark.parametrize("exposures", [1, 5])
def test_law_the_variance_that_is_stated_is_that_of_draws(exposures):
    """Of the mean of exposures in gates, less dark counts that all-OFF frames tell."""
    manifest, draws = schedule([1000] * 4), 2000
    lengths, seconds = np.array([1e-3, 2e-3, 3e-3, 1e-3]), np.full(8, 2e-3)
    rates, dark = np.array([3e4, 6e4, 2e4, 5e4]), 4e4
    means = np.concatenate([[9e4, dark], rates, [9e4, dark]])
    rng, found = np.random.default_rng(5), []
    for _ in range(draws):
        gates = rng.poisson(rates * lengths, (exposures, 4))[..., None].astype(float)
        frames = rng.poisson(means * seconds)[:, None].astype(float)
        each = Ambient.of(
            manifest, Estimate(gates, gates), lengths, frames=frames, frames_s=seconds
        )
        found.append((each.counts.ravel(), each.variance.ravel()))
    counts, variance = np.array(found).swapaxes(0, 1)
    wanted = (rates - dark) * lengths
    spread = counts.std(axis=0)
    assert (abs(counts.mean(axis=0) - wanted) < 5 * spread / draws**0.5).all()
    np.testing.assert_allclose(variance.mean(axis=0), spread**2, rtol=5 * (2 / draws) ** 0.5)


@pytest.mark.parametrize("gain", [0.5, 3.0])
def test_law_counts_divided_by_a_gain_have_their_variance(gain):
    mean, draws = 2000.0, 20_000
    factors = Corrections(NO_DEAD_TIME, np.array([gain])).factors(np.zeros(1))
    seen = np.random.default_rng(4).poisson(gain * mean, draws)
    found = seen * factors.arrivals
    assert abs(found.mean() - mean) < 5 * found.std() / draws**0.5
    spread = float((seen * factors.variance).mean())
    assert spread == pytest.approx(found.var(), rel=5 * (2 / draws) ** 0.5)
