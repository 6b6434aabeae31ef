"""Calibrations read as saved; views against point by point averages and the virtual camera."""

import numpy as np
import pytest
from calibration_samples import VIEW, calibration_of, vignette

from counting.recording_samples import DEVICE, DWELL, SHAPE, Run, named, split, train
from deepfsi import InputError, load_dataset
from deepfsi.camera.device import Device, find_device
from deepfsi.camera.layout import DmdLayout, find_grid
from deepfsi.counting.recording import Recording
from deepfsi.lab import virtual_optics as camera
from deepfsi.lab.calibration import reconstruct
from deepfsi.lab.design_data import camera_view, view_dataset
from deepfsi.patterns.folder import Patterns
from deepfsi.patterns.rails import DesignRails


def test_a_data_set_in_the_cameras_view():
    data = load_dataset("digits")
    calibration = calibration_of(VIEW, (0.03, 0.03), vignette((8, 8)))
    view = view_dataset(data, calibration)
    seen = camera_view(data.x_test, (8, 8), calibration, (8, 8))
    np.testing.assert_array_equal(view.x_test, seen)
    assert view.x_train.shape == data.x_train.shape
    assert view.preprocessing.startswith(data.preprocessing + " ")
    assert view.preprocessing != view_dataset(data, calibration_of()).preprocessing
    assert view.hash != data.hash
    np.testing.assert_array_equal(view.y_train, data.y_train)


def test_a_view_beside_the_display_is_refused():
    beside = calibration_of([[1, 0, 5], [0, 1, 0], [0, 0, 1]])
    with pytest.raises(InputError, match="no cell looks"):
        camera_view(np.ones((2, 64)), (8, 8), beside, (4, 4))


@pytest.mark.parametrize("blur", [0.0, 10.0])
@pytest.mark.parametrize(
    ("device", "shape", "tolerance"),
    [
        (find_device("dlp7000"), (32, 32), 2e-3),  # it samples the same points
        (find_device("dlp7000"), (12, 16), 0.015),
        (Device(name="tall cells", columns=170, rows=330), (16, 16), 0.03),
    ],
    ids=["same points", "larger cells", "tall cells"],
)
def test_the_virtual_camera_and_the_operator_agree(device, shape, tolerance, blur):
    grid = find_grid(device, shape, DmdLayout(stretch=True))
    eyes = camera.VirtualCamera(view=tuple(map(tuple, VIEW.tolist())), blur=blur, vignetting=0.3)
    scenes = np.random.default_rng(0).random((3, 16, 16), dtype=np.float32)
    mirrors = camera.irradiance(scenes, eyes, device, grid)
    shape_of_cells = 3, grid.down, grid.height, grid.across, grid.width
    cells = mirrors[:, *grid.window].reshape(shape_of_cells).sum(axis=(2, 4))
    sigma = blur / (grid.down * grid.height), blur / (grid.across * grid.width)
    calibration = calibration_of(VIEW, sigma, vignette(shape, 0.3))
    seen = camera_view(scenes.reshape(3, -1), (16, 16), calibration, shape)
    np.testing.assert_allclose(seen.reshape(cells.shape), cells, atol=tolerance)
    assert cells.std() > 0.1


@pytest.mark.parametrize("light", ["equal-dwell", "free-dwell", "two-arm"])
def test_a_picture_is_the_scene(tmp_path, light):
    rails = np.stack([np.eye(6), np.roll(np.eye(6), 1, axis=1) * 0.5 + 0.25]) / 12
    if light == "two-arm":
        rails = np.stack([np.eye(6), 1 - np.eye(6)]) / 6
    elif light == "free-dwell":
        rails = np.eye(6)[None] / 6
    patterns = Patterns.from_rails(
        DesignRails(rails, light, SHAPE, summed_reflectance=2.0), DEVICE, DWELL
    ).write(tmp_path / "patterns")
    arms = 2 if light == "two-arm" else 1
    flux, exposure = 2e9, 0.9 * DWELL * len(patterns.manifest.mask_frames)
    given = {"inputs": (2, 1)[:arms], "marker_bit": 4, "exposure_s": exposure, "settle_s": 3e-5}
    Recording.prepare(
        tmp_path / "run", Patterns.read(tmp_path / "patterns"), named(2, flux=flux, **given)
    )
    scenes = np.array([[0.1, 0.9, 0.5, 0.3, 0.0, 0.2], [0.6, 0.1, 0.4, 0.5, 1.0, 0.4]])
    photons = split(patterns, scenes * flux / 2.0, arms) * (DWELL - 4e-5) * 1e-2
    starts = train(patterns.manifest, 2)
    run = Run(tmp_path / "run", patterns, starts, np.rint(photons).astype(int))
    run.record(starts, starts.ravel(), run.photons)
    recording = Recording.read(tmp_path / "run")
    found = reconstruct(recording, recording.count())
    assert found.shape == (2, *SHAPE)
    # A hundredth of the photons, as from a detector of that efficiency.
    assert np.allclose(found.reshape(2, 6) * 1e2, scenes, atol=5e-3)
