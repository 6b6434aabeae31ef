"""Calibrations read as saved; views against point by point averages and the virtual camera."""

import numpy as np
import pytest
from calibration_samples import VIEW, calibration_of, vignette

from deepfsi.base.errors import InputError
from deepfsi.camera.device import Device, find_device
from deepfsi.camera.layout import DmdLayout, find_grid
from deepfsi.counting.recording import Recording
from deepfsi.datasets.load import load_dataset
from deepfsi.lab import virtual_optics as camera
from deepfsi.lab.calibration import reconstruct
from deepfsi.lab.design_data import camera_view, view_dataset
from deepfsi.patterns.folder import Patterns
from deepfsi.patterns.rails import DesignRails
from shared.virtual_runs import record


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
    """Within five standard errors of the counts of a pixel, of a detector that sees a third."""
    eye = np.eye(6)
    rails = {
        "equal-dwell": np.stack([eye, np.roll(eye, 1, axis=1) * 0.5 + 0.25]) / 12,
        "free-dwell": eye[None] / 6,
        "two-arm": np.stack([eye, 1 - eye]) / 6,
    }[light]
    device = Device(name="d", columns=24, rows=16)
    design = DesignRails(rails, light, (2, 3), summed_reflectance=2.0)
    Patterns.from_rails(design, device, 2e-2).write(tmp_path / "p")
    scenes = np.array([[0.1, 0.9, 0.5, 0.3, 0.0, 0.2], [0.6, 0.1, 0.4, 0.5, 1.0, 0.4]])
    eyes = camera.VirtualCamera(efficiency=1 / 3)
    run = record(tmp_path / "run", tmp_path / "p", scenes.reshape(2, 2, 3), eyes, 1e7, 0.1)
    recording = Recording.read(run)
    found = reconstruct(recording, recording.count()).reshape(2, 6)
    counts = 1e7 / 3 / 2 * 0.1 / 12  # of a white pixel
    assert np.abs(3 * found - scenes).max() < 5 * np.sqrt(2 / counts)
