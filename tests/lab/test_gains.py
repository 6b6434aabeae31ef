"""Detectors of unequal efficiency: found from scenes, measured with uniform white, corrected."""

import numpy as np
import pytest

from deepfsi.base.errors import InputError
from deepfsi.camera.detectors import DetectorMap
from deepfsi.camera.device import Device
from deepfsi.counting.recording import Recording
from deepfsi.lab.calibration import find_gains
from deepfsi.lab.virtual_optics import VirtualCamera
from deepfsi.patterns.folder import Patterns
from deepfsi.patterns.rails import DesignRails
from deepfsi.training import characterisation
from shared.virtual_runs import record

DEVICE = Device(name="d", columns=64, rows=64, shortest_us=10, settle_us=2)
CELLS = np.kron([[0, 1], [2, 3]], np.ones((2, 2), int))
HALF = (1.0, 1.0, 0.5, 1.0)


def scenes(count_of_each: int, seed: int) -> tuple[np.ndarray, np.ndarray]:
    """Two classes that light the upper or the left half more."""
    rng = np.random.default_rng(seed)
    weight = np.ones((2, 4, 4))
    weight[0, :2] = weight[1, :, :2] = 1.5
    labels = np.repeat([0, 1], count_of_each)
    return rng.uniform(0.35, 0.6, (len(labels), 4, 4)) * weight[labels], labels


def export(folder, light="equal-dwell"):
    x, labels = scenes(500, 0)
    shares = characterisation.detector_shares(x.reshape(len(x), 16), labels, CELLS.ravel())
    masks = np.random.default_rng(1).random((1, 6, 16)) / 6
    if light == "two-arm":
        masks = np.concatenate([masks, 1 / 6 - masks])
    detectors = DetectorMap(count=4, cells=tuple(CELLS.ravel().tolist()), **shares)
    design = DesignRails(masks, light, (4, 4), 7.0, detectors=detectors)
    return Patterns.from_rails(design, DEVICE, 2e-3).write(folder / "p")


def run(folder, x, camera_gains=None, name="run", **settings):
    camera = VirtualCamera(gains=camera_gains, dark=500.0)
    record(folder / name, folder / "p", x, camera, 1e7, 0.01, seed=0)
    return Recording.read(folder / name).count(**settings)


@pytest.mark.parametrize("seed", range(1, 3))
def test_law_sound_scenes_of_any_classes_raise_no_alarm(tmp_path, seed):
    export(tmp_path)
    x, labels = scenes(20, seed)
    for name, some in (("both", labels >= 0), ("first", labels == 0), ("one", labels < 0)):
        some[0] = True
        counts = run(tmp_path, x[some], name=name)
        assert "gain" not in {fault.kind for fault in counts.faults}


@pytest.mark.parametrize("light", ["equal-dwell", "two-arm"])
def test_law_white_tells_each_gain_and_counts_are_corrected_to_two_percent(tmp_path, light):
    arms = 2 if light == "two-arm" else 1
    gains = (*HALF, 0.9, 1.0, 0.8, 1.0)[: 4 * arms]
    export(tmp_path, light)
    run(tmp_path, np.ones((12, 4, 4)), gains, "white")
    found = np.array(find_gains(tmp_path / "white"))
    assert found / found[0] == pytest.approx(np.array(gains), rel=0.02)
    x = np.repeat(scenes(1, 1)[0][:1], 20, axis=0)
    counts = run(tmp_path, x, gains, gains=tuple(found))
    assert counts.faults == ()
    assert Recording.read(tmp_path / "run").read_counts().gains == counts.gains == tuple(found)
    usual = run(tmp_path, x, name="usual")
    mean, wanted = (each.signal().sum(axis=(0, 1)) for each in (counts, usual))
    sent = wanted * counts.photons[0] / usual.photons[0]  # the flux has the mean efficiency
    noise = np.sqrt(counts.variance.sum(axis=(0, 1)) + usual.variance.sum(axis=(0, 1)))
    assert (abs(mean - sent) < 0.02 * sent + 5 * noise).all()


def test_what_is_no_flat_field_is_refused(tmp_path):
    export(tmp_path)
    run(tmp_path, np.full((1, 4, 4), 0.05), name="dim")
    with pytest.raises(InputError, match=r"does not tell each detector's share to 1\.0%"):
        find_gains(tmp_path / "dim")
    run(tmp_path, np.ones((12, 4, 4)), HALF, "white")
    gains = find_gains(tmp_path / "white")
    run(tmp_path, np.ones((12, 4, 4)), HALF, "again", gains=gains)
    with pytest.raises(InputError, match="or it was corrected itself"):
        find_gains(tmp_path / "again")
