"""Calibrations: what was done to scenes is found from pictures of spots, white and black."""

import numpy as np
import pytest
from calibration_samples import GRID, VIEW, apply, calibration_of, pictures_of, vignette

from deepfsi.base.errors import InputError
from deepfsi.camera.device import find_device
from deepfsi.camera.layout import DmdLayout, find_grid
from deepfsi.lab import calibration as fit
from deepfsi.lab.design_data import camera_view


def off_corners(found):
    """By how much a view of the display's corners is off, in sides of the device."""
    corners = np.array([[x, y] for x in (0.05, 0.95) for y in (0.05, 0.95)])
    return np.abs(apply(found.homography, corners) - apply(VIEW, corners)).max()


@pytest.mark.parametrize(("blur_cells", "noise"), [(0.4, 0.01), (1.0, 0.0)])
def test_a_calibration_finds_what_was_done(blur_cells, noise):
    side = np.sqrt(GRID.mirrors)
    blur = blur_cells * side / 24 / 32, blur_cells * side / 32 / 32
    flat = vignette((32, 32))
    scenes = fit.spot_scenes()
    shown = np.concatenate([scenes, np.ones((1, 32, 32), np.float32)])
    pictures = pictures_of(shown, VIEW, blur, flat, noise)
    found = fit.fit_calibration(scenes, pictures[:-1], GRID, white=pictures[-1])
    assert 32 * off_corners(found) < 0.15
    assert found.residual < 0.08
    assert (found.spots, found.shown) == (25, 25)
    np.testing.assert_allclose(found.blur, blur, rtol=0.05)
    white = np.ones((1, 1024), np.float32)
    filled = camera_view(white, (32, 32), calibration_of(VIEW, blur), (32, 32))[0] > 0.99
    ratio = np.array(found.flat)[filled.reshape(32, 32)] / flat[filled.reshape(32, 32)]
    assert ratio.std() / ratio.mean() < 0.01 + 1.5 * noise
    # the aim of it all: the view of a scene nobody calibrated with
    scene = np.random.default_rng(5).random((1, 32, 32), dtype=np.float32)
    truth = pictures_of(scene, VIEW, blur, flat, 0.0)
    mine = camera_view(scene.reshape(1, -1), (32, 32), found).reshape(truth.shape)
    gain = (mine * truth).sum() / (mine**2).sum()
    assert np.abs(gain * mine - truth).mean() < 0.01 + noise


def test_a_spot_that_is_not_where_the_others_say_is_left_out():
    scenes = fit.spot_scenes()
    pictures = pictures_of(scenes, VIEW, (0.01, 0.01), ((1.0,),), 0.005)
    pictures[7] = np.roll(pictures[7], 2, axis=1)
    pictures[12] = np.nan  # no valid exposure
    found = fit.fit_calibration(scenes, pictures, GRID)
    assert found.spots == 23
    assert 32 * off_corners(found) < 0.05


def test_few_wide_spots_on_large_cells_are_fitted_and_doubted():
    """Blurred by 1.8 cells of 8 x 8, most spots are lost in their own light."""
    grid = find_grid(find_device("dlp7000"), (8, 8), DmdLayout(stretch=True))
    blur = 1.8 * np.sqrt(grid.mirrors) / 8 / np.array([grid.height, grid.width])
    scenes = fit.spot_scenes(side=4)
    pictures = pictures_of(scenes, VIEW, tuple(blur), ((1.0,),), 0.003, grid=grid)
    found = fit.fit_calibration(scenes, pictures, grid)
    assert found.spots < 16
    assert any("spots are seen" in doubt for doubt in found.doubts)


def test_too_little_for_a_homography_is_an_error():
    places = np.random.default_rng(0).random((9, 2))
    line = np.c_[places[:, 0], np.full(9, 0.5)] @ [[1, 0.7], [0, 1]]
    few = np.where(np.arange(9)[:, None] < 3, places, np.nan)
    for display, device in ((places, few), (line, line)):
        with pytest.raises(InputError, match="spots are seen"):
            fit.find_homography(display, device, (32, 32))


@pytest.mark.parametrize("name", fit.SCAN_NAMES)
@pytest.mark.parametrize("cells", [(8, 8), (6, 9), (1, 5)])
def test_a_scan_tells_all_cells_apart(name, cells):
    scan = fit.scan_rails(name, cells)
    rails = scan.rails.astype(float)
    matrix = rails[0] - (rails[1] if len(rails) == 2 else 0)
    assert np.linalg.matrix_rank(matrix) == np.prod(cells)
    frames = int((rails.max(axis=-1) > 0).sum())
    assert set(np.unique(rails)) == {0, 1 / frames}
    assert scan.summed_reflectance == np.prod(cells)


def test_a_scan_of_too_many_cells_is_refused():
    with pytest.raises(InputError, match="4096 cells"):
        fit.scan_rails("raster", (65, 64))
