"""Calibrations: what was done to scenes is found from pictures of spots, white and black."""

import numpy as np
import pytest
from calibration_samples import GRID, VIEW, apply, calibration_of, pictures_of, vignette

from deepfsi.base import InputError
from deepfsi.camera import Device, DmdLayout, find_grid
from deepfsi.hardware.calibration import camera_view, fit
from deepfsi.hardware.calibration.view import view_matrix
from deepfsi.hardware.counting import Calibration, count_run
from deepfsi.hardware.patterns import DesignRails, FrameSettings, export_patterns
from deepfsi.hardware.virtual import camera
from deepfsi_paper.camera import gate_counts


def off_corners(found):
    """By how much a view of the display's corners is off, in sides of the device."""
    corners = np.array([[x, y] for x in (0.05, 0.95) for y in (0.05, 0.95)])
    return np.abs(apply(found.homography, corners) - apply(VIEW, corners)).max()


@pytest.mark.parametrize("noise", [0.0, 0.01])
@pytest.mark.parametrize("blur_cells", [0.4, 1.0])
def test_a_calibration_finds_what_was_done(blur_cells, noise):
    side = np.sqrt(GRID.mirrors)
    blur = blur_cells * side / 24 / 32, blur_cells * side / 32 / 32
    flat = vignette((32, 32))
    scenes = fit.spot_scenes((32, 32))
    shown = np.concatenate([scenes, np.ones((1, 32, 32), np.float32)])
    pictures = pictures_of(shown, VIEW, blur, flat, noise)
    found = fit.fit_calibration(
        scenes, pictures[:-1], GRID, white=pictures[-1], dark=3.0, ambient=5.0
    )
    assert 32 * off_corners(found) < 0.15
    assert found.residual < 0.08
    assert (found.spots, found.shown) == (25, 25)
    np.testing.assert_allclose(found.blur, blur, rtol=0.05)
    filled = view_matrix((32, 32), calibration_of(VIEW, blur), (32, 32)).sum(axis=1) > 0.99
    ratio = np.array(found.flat)[filled.reshape(32, 32)] / flat[filled.reshape(32, 32)]
    assert ratio.std() / ratio.mean() < 0.01 + 1.5 * noise
    assert (found.dark, found.ambient) == (3.0, 5.0)
    # the aim of it all: the view of a scene nobody calibrated with
    scene = np.random.default_rng(5).random((1, 32, 32), dtype=np.float32)
    truth = pictures_of(scene, VIEW, blur, flat, 0.0)
    mine = camera_view(scene.reshape(1, -1), (32, 32), found).reshape(truth.shape)
    gain = (mine * truth).sum() / (mine**2).sum()
    assert np.abs(gain * mine - truth).mean() < 0.01 + noise


def test_a_calibration_that_is_not_to_be_trusted_says_why():
    sure = calibration_of()
    assert sure.doubts == []
    doubts = sure.model_copy(update={"spots": 15, "residual": 0.3, "error": 0.2}).doubts
    assert "only 15 of 25 spots" in doubts[0]
    assert "0.30 cells" in doubts[1]
    assert "4 times the light" in doubts[2]
    assert sure.model_copy(update={"spots": 9, "shown": 9}).doubts == []


def test_a_spot_that_is_not_where_the_others_say_is_left_out():
    scenes = fit.spot_scenes((32, 32))
    pictures = pictures_of(scenes, VIEW, (0.01, 0.01), ((1.0,),), 0.005)
    pictures[7] = np.roll(pictures[7], 2, axis=1)
    pictures[12] = np.nan  # no valid exposure
    found = fit.fit_calibration(scenes, pictures, GRID)
    assert found.spots == 23
    assert 32 * off_corners(found) < 0.05


@pytest.mark.parametrize("kind", ["few", "line", "diagonal", "chaos"])
def test_too_little_for_a_homography_is_an_error(kind):
    rng = np.random.default_rng(0)
    display = rng.random((9, 2))
    device = display.copy()
    if kind == "few":
        device[3:] = np.nan
    elif kind == "line":
        display[:, 1] = device[:, 1] = 0.5
    elif kind == "diagonal":
        display[:, 1] = device[:, 1] = 0.7 * display[:, 0] + 0.1
    else:
        display, device = display[:5], rng.random((5, 2))
        device[:2] = np.nan
    with pytest.raises(InputError, match="spots are seen") as caught:
        fit.find_homography(display, device, (32, 32))
    assert "\n" not in str(caught.value)


def test_a_recorded_run_is_calibrated_end_to_end(tmp_path):
    """Spots, white and black: pattern folder, photon file, counts, calibration, view."""
    device, shape = Device(name="d", columns=128, rows=128), (16, 16)
    grid = find_grid(device, shape, DmdLayout(stretch=True))
    eyes = camera.VirtualCamera(
        view=tuple(map(tuple, VIEW.tolist())), blur=3.0, vignetting=0.2, dark=1e3, ambient=2e4
    )
    raster = np.eye(256)[None] / 256
    export_patterns(
        DesignRails(raster, "equal-dwell", shape, summed_reflectance=150.0),
        FrameSettings(device, 4e-3),
        tmp_path / "patterns",
    )
    spots = fit.spot_scenes((32, 32), (3, 3), 4)
    scenes = np.concatenate([spots, np.ones((1, 32, 32)), np.zeros((1, 32, 32))])
    names = [f"scene {k}" for k in range(len(scenes))]
    settings = camera.RecordingSettings(eyes, flux=2e7, exposure_s=1.0)
    camera.record_scenes(tmp_path / "patterns", scenes, names, None, tmp_path / "run", settings)
    counts = count_run(tmp_path / "run")
    pictures = counts.counts[:, 0, 0].reshape(-1, *shape)  # of a raster
    dark, ambient = gate_counts.black_rates(counts.on_rate[-1:], counts.off_rate[-1:])
    assert dark == pytest.approx(1e3, abs=6 * np.sqrt(1e3 / 8e-3))
    assert ambient == pytest.approx(2e4, abs=6 * np.sqrt(2e4 / 8e-3))
    uniform = {"white": pictures[-2], "black": pictures[-1]}
    found = fit.fit_calibration(spots, pictures[:-2], grid, **uniform, dark=dark, ambient=ambient)
    found.save(tmp_path / "run" / "calibration")
    found = Calibration.load(tmp_path / "run" / "calibration")
    scene = np.random.default_rng(0).random((4, 8, 8)).repeat(4, axis=1).repeat(4, axis=2)
    mirrors = camera.irradiance(scene, eyes, device, grid)
    truth = mirrors.reshape(4, 16, 8, 16, 8).sum(axis=(2, 4))
    seen = camera_view(scene.reshape(4, -1), (32, 32), found, shape).reshape(truth.shape)
    assert np.sqrt(((seen - truth) ** 2).mean()) < 0.15 * truth.std()
    assert seen.sum() == pytest.approx(truth.sum(), rel=0.05)
