"""Calibrations read as saved; views against point by point averages and the virtual camera."""

import numpy as np
import pytest
from calibration_samples import VIEW, calibration_of, vignette

from deepfsi.base.errors import InputError
from deepfsi.camera.device import Device, find_device
from deepfsi.camera.layout import DmdLayout, find_grid
from deepfsi.datasets.load import load_dataset
from deepfsi.hardware.calibration.view import camera_view, view_dataset
from deepfsi.hardware.virtual import camera


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
