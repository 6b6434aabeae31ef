"""Clicks of recordings: by the closed form, and the same of a gated and of a free detector."""

import numpy as np
import ptufile
import pytest
from virtual_samples import SUMMED_REFLECTANCE, every_optics, expected, patterns, record, scenes

from deepfsi.base.errors import InputError
from deepfsi.camera.dead_time import DeadTime
from deepfsi.counting.events import PtuWriter
from deepfsi.counting.recording import Recording
from deepfsi.counting.windows import Windows
from deepfsi.lab.calibration import find_gains
from deepfsi.lab.registration import check_view
from deepfsi.lab.virtual_optics import CAMERAS

GATES = 4
EXPOSURE = 4e-3
FLUX = 1.5e4
"""Photons/s: about one in a gate."""

LIGHT = {"flux": FLUX, "exposure_s": EXPOSURE, "camera": CAMERAS["ideal"]}


def gate(run, gates):
    """Leave in a photon file the first photon of each gate, as a gated detector records."""
    recording = Recording.read(run)
    plan = recording.acquisition.gates(recording.manifest)
    windows = Windows.of_clicks(recording.manifest, plan, gates)
    width, number_of = np.zeros(len(recording.manifest.frames)), np.bincount(windows.frame)
    width[windows.frame] = windows.length_s
    with ptufile.PtuFile(run / "photons.ptu") as file:
        events = file.decode_records()
    events = events[(events["channel"] >= 0) | (events["marker"] > 0)]
    times, marked = events["time"].astype(np.int64), events["marker"] > 0
    frame = np.cumsum(marked) - 1
    place = frame % len(recording.manifest.frames)
    since = times - times[marked][frame] - plan.settle_s * 1e12 + 0.5  # edges are whole ticks
    number = np.floor(since * 1e-12 / width[place]).astype(int)
    open_ = (number >= 0) & (number < number_of[place]) & ~marked
    gates_of = np.stack([frame, number, events["channel"]])[:, open_]
    kept = marked.copy()
    kept[np.flatnonzero(open_)[np.unique(gates_of, axis=1, return_index=True)[1]]] = True
    with PtuWriter(run / "photons.ptu") as writer:
        writer.write(times[kept], np.where(marked, -1, events["channel"])[kept])


@every_optics
def test_clicks_of_each_readout_are_binomial(tmp_path, light, rails):
    """Mean and variance of all exposures of two scenes, to five standard errors."""
    shown, x = patterns(tmp_path / "p", light, rails), scenes(2)
    run = record(tmp_path, x.repeat(150, axis=0), **LIGHT)
    counts = Recording.read(run).count(click_gates=GATES)
    assert counts.valid.all()
    assert counts.gates == Recording.read(run).read_counts().gates == GATES
    found = counts.signal().reshape(2, -1, *counts.counts.shape[2:])
    n, p = found.shape[1], -np.expm1(-expected(shown, x, FLUX * EXPOSURE) / GATES)
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
    """Photon by photon; a second count of gated photons changes nothing."""
    patterns(tmp_path / "p", light, rails)
    run = record(tmp_path, scenes(20), repeats=1, seed=3, **LIGHT)
    free, photons = (Recording.read(run).count(click_gates=GATES), Recording.read(run).count())
    gate(run, GATES)
    gated = Recording.read(run).count(click_gates=GATES)
    assert np.array_equal(gated.counts, free.counts)
    assert gated.counts.max() == GATES
    assert photons.counts.max() > GATES
    assert (photons.counts >= free.counts).all()
    assert (gated.variance <= gated.counts).all()


@pytest.mark.parametrize(("gates", "flux"), [(None, FLUX), (None, 30 * FLUX), (40, FLUX)])
def test_all_on_frames_tell_the_budget_by_clicks_or_by_photons(tmp_path, gates, flux):
    """Clicks where gates hold few photons, and the photons of a free detector where many."""
    patterns(tmp_path / "p")
    x = scenes(1).repeat(40, axis=0)
    run = record(tmp_path, x, repeats=1, **(LIGHT | {"flux": flux}))
    if gates:
        gate(run, gates)
    counts = Recording.read(run).count(click_gates=gates or GATES)
    number = 80 * (gates or GATES)
    wanted = flux * float(x[0].sum()) / SUMMED_REFLECTANCE
    mean = wanted * 2e-3 / (gates or GATES)  # photons in a gate, about
    variance = mean if mean > 1 else np.expm1(mean)
    error = np.sqrt(variance / number) / mean
    assert counts.flux == pytest.approx(np.full(40, wanted), rel=5 * error)
    assert error < 0.1


def test_clicks_without_light_have_no_budget(tmp_path):
    """Black scenes and dark counts: no stated flux takes the place of what was measured."""
    patterns(tmp_path / "p")
    dark = LIGHT | {"camera": CAMERAS["ideal"].model_copy(update={"dark": 2e3})}
    run = record(tmp_path, 0 * scenes(20), **dark, seed=3)
    with pytest.raises(InputError, match="no light on input"):
        Recording.read(run).count(click_gates=GATES)


def test_what_is_of_photons_refuses_clicks(tmp_path):
    patterns(tmp_path / "p")
    run = record(tmp_path, scenes(), repeats=1, **LIGHT)
    dead = DeadTime(seconds=2e-8)
    with pytest.raises(InputError, match="are of photon counts, and clicks"):
        Recording.read(run).count(click_gates=GATES, dead_time=dead)
    assert not (run / "counts.npz").exists()
    Recording.read(run).count(click_gates=GATES)
    for use in (check_view, find_gains):
        with pytest.raises(InputError, match="was counted in clicks, which are not in proportion"):
            use(run)
