"""Calibrations: what was done to scenes is found from pictures of spots, white and black."""

import numpy as np
import pytest
from calibration_samples import GRID, IDENTITY, VIEW, apply, calibration_of, pictures_of, vignette

from deepfsi.base import InputError
from deepfsi.camera import Device, DmdLayout, find_grid
from deepfsi.hardware.calibration import camera_view, fit
from deepfsi.hardware.calibration.view import view_matrix
from deepfsi.hardware.counting import Calibration, count_run
from deepfsi.hardware.patterns import DesignRails, FrameSettings, export_patterns
from deepfsi.hardware.virtual import camera
from deepfsi_paper.camera.gate_counts import black_rates


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


@pytest.mark.parametrize("blur_cells", [0.0, 0.4])
def test_a_spot_smaller_than_a_cell_is_not_drawn_to_its_centre(blur_cells):
    """Centres of spots of half a cell would leave an error of 0.2 cells, and 5 of 25 spots out."""
    grid = find_grid(Device(name="d", columns=256, rows=192), (8, 8), DmdLayout(stretch=True))
    blur = blur_cells * 8 / 9.24 / 8, blur_cells * 8 / 12.3 / 8
    scenes = fit.spot_scenes((32, 32))
    pictures = pictures_of(scenes, VIEW, blur, ((1.0,),), 0.002, grid=grid)
    found = fit.fit_calibration(scenes, pictures, grid)
    assert found.spots == 25
    assert 8 * off_corners(found) < 0.05


def hadamard_noise(photons):
    """Noise of each cell of a Hadamard picture where a spot of 4 pixels sends so many photons.

    Of the light of both frames of a mask one half is counted, and all cells share its noise:
    in units of a pixel that lights a cell by 1, sqrt(2 / photons) times the spot's 4 pixels.
    """
    return 4 * np.sqrt(2 / photons)


def test_faint_spots_of_hadamard_pictures_are_not_lost():
    """1500 photons a spot: centres of single spots lose a third of them there."""
    scenes = fit.spot_scenes((32, 32))
    off, told, seen = [], [], []
    for seed in range(8):
        pictures = pictures_of(scenes, VIEW, (0.01, 0.01), ((1.0,),), hadamard_noise(1500), seed)
        found = fit.fit_calibration(scenes, pictures, GRID)
        corner = np.array([[0, 0], [0, 1], [1, 0], [1, 1]])
        distance = 32 * (apply(found.homography, corner) - apply(VIEW, corner))
        off.append(np.sqrt((distance**2).sum(axis=1).max()))
        told.append(found.error)
        seen.append(found.spots)
    assert min(seen) >= 24
    # the worst of four corners: beyond the error of one, but not by far
    ratio = np.sqrt(np.mean(np.square(off))) / np.mean(told)
    assert 0.6 < ratio < 1.9


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


def test_other_device_and_cell_number():
    grid = find_grid(Device(name="d", columns=100, rows=90), (16, 20), DmdLayout(stretch=True))
    scenes = fit.spot_scenes((30, 40), (4, 6), 3)
    pictures = pictures_of(scenes, VIEW, (0.03, 0.03), ((1.0,),), 0.003, grid=grid)
    found = fit.fit_calibration(scenes, pictures, grid)
    assert 20 * off_corners(found) < 0.15
    assert found.flat == ((1.0,),)


@pytest.mark.parametrize("shape", [(1, 3), (4, 4), (32, 32)])
def test_a_flat_field_without_noise_is_found(shape):
    rows, columns = shape
    level = np.ones(shape) if rows * columns < 16 else 1 - 0.2 * np.indices(shape)[0] / rows
    found = fit.find_flat(7 * level, (32, 32), IDENTITY)
    np.testing.assert_allclose(found, level / level.max(), atol=1e-9)


def test_noise_of_the_white_picture_stays_out_of_the_flat_field():
    truth = vignette((32, 32))
    white = truth * np.random.default_rng(0).normal(1, 0.1, truth.shape)
    found = fit.find_flat(white, (32, 32), IDENTITY)
    assert np.mean(found / truth) == pytest.approx(1, abs=0.03)
    assert np.std(found / truth) < 0.02


def test_black_is_taken_from_every_picture():
    scenes = fit.spot_scenes((32, 32))
    shown = np.concatenate([scenes, np.ones((1, 32, 32), np.float32)])
    pictures = pictures_of(shown, VIEW, (0.01, 0.01), vignette((32, 32)), 0.0)
    glow = np.random.default_rng(0).random((32, 32))
    plain = fit.fit_calibration(scenes, pictures[:-1], GRID, white=pictures[-1])
    freed = fit.fit_calibration(
        scenes, pictures[:-1] + glow, GRID, white=pictures[-1] + glow, black=glow
    )
    np.testing.assert_allclose(freed.homography, plain.homography, atol=1e-9)
    np.testing.assert_allclose(freed.flat, plain.flat, atol=1e-9)


def test_spots_are_centred_wherever_they_are():
    rng = np.random.default_rng(4)
    centres = rng.uniform(6, 26, (40, 2))
    down, across = np.indices((32, 32)) + 0.5
    spots = np.exp(
        -((down - centres[:, 1, None, None]) ** 2 + (across - centres[:, 0, None, None]) ** 2) / 4
    )
    np.testing.assert_allclose(32 * fit.find_spots(spots), centres, atol=0.01)
    noisy = 32 * fit.find_spots(7 + spots + rng.normal(0, 0.02, spots.shape))
    assert np.abs(noisy - centres).max() < 0.1


def test_a_spot_in_noise_is_not_seen():
    noise = np.random.default_rng(0).normal(0, 1, (40, 32, 32))
    assert np.isnan(fit.find_spots(noise)).all(axis=1).mean() > 0.9
    assert np.isnan(fit.find_spots(np.zeros((1, 8, 8)))).all()


def test_lost_and_wrong_spots_do_not_count():
    rng = np.random.default_rng(7)
    display = np.array([[x, y] for x in np.linspace(0.1, 0.9, 5) for y in np.linspace(0.1, 0.9, 5)])
    device = apply(VIEW, display) + rng.normal(0, 0.001, display.shape)
    device[3] = np.nan
    device[[8, 15, 20]] = rng.random((3, 2))
    matrix, agreed = fit.find_homography(display, device, (32, 32))
    assert agreed.sum() == 21
    assert 32 * np.abs(apply(matrix, display) - apply(VIEW, display)).max() < 0.1


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


def test_spot_scenes_lie_symmetrically():
    scenes = fit.spot_scenes((32, 24), (3, 4), 2)
    assert scenes.shape == (12, 32, 24)
    assert (scenes.sum(axis=(1, 2)) == 4).all()
    assert scenes.sum(axis=0).max() == 1
    for spots, side in (((1, 5), 2), ((5, 5), 7), ((5, 5), 0)):
        with pytest.raises(InputError, match="do not fit"):
            fit.spot_scenes((32, 32), spots, side)


def test_words_on_arrays_that_do_not_fit():
    scenes = fit.spot_scenes((32, 32))
    pictures = np.zeros((25, 32, 32))
    with pytest.raises(InputError, match="one picture of 32 x 32"):
        fit.fit_calibration(scenes, pictures[:3], GRID)
    with pytest.raises(InputError, match="white picture has shape"):
        fit.fit_calibration(scenes, pictures, GRID, white=np.ones((3, 3)))
    with pytest.raises(InputError, match="uniform"):
        fit.fit_calibration(np.ones((25, 32, 32)), pictures, GRID)
    with pytest.raises(InputError, match="0 of 25 spots"):
        fit.fit_calibration(scenes, pictures, GRID)
    with pytest.raises(InputError, match="is dark"):
        fit.find_flat(np.zeros((8, 8)), (8, 8), IDENTITY)


def test_the_virtual_camera_is_calibrated():
    """Spots, white and black shown to it, counted, and found again."""
    device = Device(name="d", columns=512, rows=384)
    grid = find_grid(device, (32, 32), DmdLayout(stretch=True))
    eyes = camera.VirtualCamera(view=tuple(map(tuple, VIEW.tolist())), blur=7.0, vignetting=0.3)
    spots = fit.spot_scenes((32, 32))
    shown = np.concatenate([spots, np.ones((1, 32, 32), np.float32)])
    mirrors = camera.irradiance(shown, eyes, device, grid)
    cells = mirrors.reshape(26, 32, 12, 32, 16).sum(axis=(2, 4))
    pictures = np.random.default_rng(0).poisson(4000 * cells) / 4000
    found = fit.fit_calibration(spots, pictures[:-1], grid, white=pictures[-1])
    scene = np.random.default_rng(1).random((1, 32, 32), dtype=np.float32)
    truth = camera.irradiance(scene, eyes, device, grid).reshape(32, 12, 32, 16).sum(axis=(1, 3))
    mine = camera_view(scene.reshape(1, -1), (32, 32), found).reshape(32, 32)
    gain = (mine * truth).sum() / (mine**2).sum()
    assert np.sqrt(((gain * mine - truth) ** 2).mean()) < 0.02
    assert truth.std() > 0.1


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
    dark, ambient = black_rates(counts.on_rate[-1:], counts.off_rate[-1:])
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
