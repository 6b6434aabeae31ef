"""Calibration: what was done to scenes is found from pictures, and done to a data set alike."""

from __future__ import annotations

import json
import time

import numpy as np
import pytest
from scipy import ndimage

from deepfsi.datasets import load_dataset
from deepfsi.errors import InputError
from deepfsi.hardware.calibration import fit as cal
from deepfsi.hardware.patterns.folder import DesignRails, export_patterns
from deepfsi.hardware.patterns.sequence import (
    Device,
    Frame,
    FrameSettings,
    Manifest,
    Patterns,
    find_device,
    find_grid,
)
from deepfsi.hardware.recording.counting import count
from deepfsi.hardware.virtual import camera

VIEW = np.array([[0.9, 0.05, 0.02], [-0.04, 0.88, 0.06], [0.05, -0.06, 1]])
IDENTITY = np.eye(3)
GRID = find_grid(find_device("dlp7000"), (32, 32))


def vignette(shape, loss=0.4):
    down, across = ((np.arange(n) + 0.5) / n - 0.5 for n in shape)
    return 1 - loss * 2 * (across**2 + down[:, None] ** 2)


def calibration_of(view=VIEW, blur=(0.0, 0.0), flat=((1.0,),), **fields):
    flat = tuple(map(tuple, np.asarray(flat).tolist()))
    return cal.Calibration(
        homography=np.asarray(view).tolist(),
        residual=0.1,
        spots=25,
        shown=25,
        blur=blur,
        flat=flat,
        **fields,
    )


def apply(view, places):
    places = np.c_[places, np.ones(len(places))] @ np.asarray(view).T
    return places[:, :2] / places[:, 2:]


def slow_view(scene, view, shape, blur=(0.0, 0.0), flat=1.0, points=40):
    """The camera's view point by point: the display's pixel, blurred as an image, averaged."""
    edge = [int(np.ceil(4 * b * n * points)) for b, n in zip(blur, shape, strict=True)]
    places = [
        (np.arange(-e, n * points + e) + 0.5) / (n * points)
        for e, n in zip(edge, shape, strict=True)
    ]
    x, y = np.meshgrid(places[1], places[0])
    u, v = apply(np.linalg.inv(view), np.c_[x.ravel(), y.ravel()]).T
    h, w = scene.shape
    inside = (u >= 0) & (u < 1) & (v >= 0) & (v < 1)
    rows, columns = (np.clip((p * n).astype(int), 0, n - 1) for p, n in ((v, h), (u, w)))
    light = np.where(inside, scene[rows, columns], 0).reshape(x.shape)
    sigma = [b * n * points for b, n in zip(blur, shape, strict=True)]
    light = ndimage.gaussian_filter(light, sigma, mode="constant", truncate=4)
    light = light[edge[0] : edge[0] + shape[0] * points, edge[1] : edge[1] + shape[1] * points]
    return flat * light.reshape(shape[0], points, shape[1], points).mean(axis=(1, 3))


def pictures_of(scenes, view, blur, flat, noise, seed=0, grid=GRID):
    shape = (grid.down, grid.across)
    calibration = calibration_of(view, blur, flat)
    seen = cal.camera_view(scenes.reshape(len(scenes), -1), scenes.shape[1:], calibration, shape)
    rng = np.random.default_rng(seed)
    return seen.reshape(-1, *shape) + rng.normal(0, noise, (len(scenes), *shape))


# The operator


@pytest.mark.parametrize("blur", [(0.0, 0.0), (0.04, 0.02)])
@pytest.mark.parametrize("shape", [(8, 8), (12, 10)])
def test_view_is_the_area_average_of_the_blurred_image(blur, shape):
    scene = np.random.default_rng(1).random((9, 11), dtype=np.float32)
    flat = vignette(shape)
    seen = cal.camera_view(
        scene.reshape(1, -1), scene.shape, calibration_of(VIEW, blur, flat), shape
    ).reshape(shape)
    wanted = slow_view(scene, VIEW, shape, blur, flat)
    np.testing.assert_allclose(seen, wanted, atol=6e-3)
    assert wanted.std() > 0.1


def test_identity_is_no_change():
    x = np.random.default_rng(2).random((5, 48), dtype=np.float32)
    seen = cal.camera_view(x, (6, 8), calibration_of(IDENTITY))
    np.testing.assert_allclose(seen, x, atol=1e-6)
    assert seen.dtype == np.float32


def test_down_and_across_keep_their_places():
    """A display shifted to the right and down by a quarter, on cells of another number."""
    shift = [[1, 0, 0.25], [0, 1, 0.5], [0, 0, 1]]
    scene = np.zeros((4, 4), dtype=np.float32)
    scene[0, 1] = 1
    seen = cal.camera_view(scene.reshape(1, -1), (4, 4), calibration_of(shift), (2, 8))
    wanted = np.zeros((2, 8))
    wanted[1, 4:6] = 0.5
    np.testing.assert_allclose(seen.reshape(2, 8), wanted, atol=1e-6)


def test_rows_sum_to_what_the_display_fills():
    half = [[0.5, 0, 0], [0, 1, 0], [0, 0, 1]]
    view = cal.view_matrix((8, 8), calibration_of(half), (4, 4))
    np.testing.assert_allclose(view.sum(axis=1).reshape(4, 4), [[1, 1, 0, 0]] * 4, atol=1e-12)


def test_flat_field_of_another_size_is_interpolated():
    at = (32, 32)
    fine = cal.view_matrix(at, calibration_of(IDENTITY, flat=vignette((64, 64))), at)
    same = cal.view_matrix(at, calibration_of(IDENTITY, flat=vignette(at)), at)
    assert abs(fine - same).max() < 2e-3


# The data set


def test_a_data_set_in_the_cameras_view():
    data = load_dataset("digits")
    calibration = calibration_of(VIEW, (0.03, 0.03), vignette((8, 8)))
    view = cal.view_dataset(data, calibration)
    np.testing.assert_array_equal(
        view.x_test, cal.camera_view(data.x_test, (8, 8), calibration, (8, 8))
    )
    assert view.x_train.shape == data.x_train.shape
    assert view.preprocessing.startswith(data.preprocessing + " ")
    assert view.preprocessing != cal.view_dataset(data, calibration_of()).preprocessing
    assert view.hash != data.hash
    np.testing.assert_array_equal(view.y_train, data.y_train)
    larger = cal.view_dataset(data, calibration, (16, 12))
    assert (larger.image_shape, larger.pixels) == ((16, 12), 192)


def test_sixty_thousand_images_in_seconds():
    x = np.random.default_rng(0).random((60_000, 1024), dtype=np.float32)
    calibration = calibration_of(VIEW, (0.02, 0.015), vignette((32, 32)))
    start = time.process_time()
    seen = cal.camera_view(x, (32, 32), calibration)
    assert time.process_time() - start < 30
    one = cal.camera_view(x[-1:], (32, 32), calibration)
    np.testing.assert_allclose(seen[-1:], one, rtol=1e-6)


# Fits


@pytest.mark.parametrize("noise", [0.0, 0.01])
@pytest.mark.parametrize("blur_cells", [0.4, 1.0])
def test_a_calibration_finds_what_was_done(blur_cells, noise):
    side = np.sqrt(GRID.mirrors)
    blur = blur_cells * side / 24 / 32, blur_cells * side / 32 / 32
    flat = vignette((32, 32))
    scenes = cal.spot_scenes((32, 32))
    shown = np.concatenate([scenes, np.ones((1, 32, 32), np.float32)])
    pictures = pictures_of(shown, VIEW, blur, flat, noise)
    found = cal.calibrate(scenes, pictures[:-1], GRID, white=pictures[-1], dark=3.0, ambient=5.0)
    corners = np.array([[x, y] for x in (0.05, 0.95) for y in (0.05, 0.95)])
    assert 32 * np.abs(apply(found.homography, corners) - apply(VIEW, corners)).max() < 0.15
    assert found.residual < 0.08
    assert (found.spots, found.shown) == (25, 25)
    np.testing.assert_allclose(found.blur, blur, rtol=0.05)
    filled = cal.view_matrix((32, 32), calibration_of(VIEW, blur), (32, 32)).sum(axis=1) > 0.99
    ratio = np.array(found.flat)[filled.reshape(32, 32)] / flat[filled.reshape(32, 32)]
    assert ratio.std() / ratio.mean() < 0.01 + 1.5 * noise
    assert (found.dark, found.ambient) == (3.0, 5.0)
    # the aim of it all: the view of a scene nobody calibrated with
    scene = np.random.default_rng(5).random((1, 32, 32), dtype=np.float32)
    truth = pictures_of(scene, VIEW, blur, flat, 0.0)
    mine = cal.camera_view(scene.reshape(1, -1), (32, 32), found).reshape(truth.shape)
    gain = (mine * truth).sum() / (mine**2).sum()
    assert np.abs(gain * mine - truth).mean() < 0.01 + noise


def test_other_device_and_cell_number():
    grid = find_grid(Device(name="d", columns=100, rows=90), (16, 20))
    scenes = cal.spot_scenes((30, 40), (4, 6), 3)
    pictures = pictures_of(scenes, VIEW, (0.03, 0.03), ((1.0,),), 0.003, grid=grid)
    found = cal.calibrate(scenes, pictures, grid)
    corners = np.array([[x, y] for x in (0.05, 0.95) for y in (0.05, 0.95)])
    assert 20 * np.abs(apply(found.homography, corners) - apply(VIEW, corners)).max() < 0.15
    assert found.flat == ((1.0,),)


@pytest.mark.parametrize("shape", [(1, 3), (4, 4), (32, 32)])
def test_a_flat_field_without_noise_is_found(shape):
    rows, columns = shape
    level = np.ones(shape) if rows * columns < 16 else 1 - 0.2 * np.indices(shape)[0] / rows
    found = cal.find_flat(7 * level, (32, 32), IDENTITY)
    np.testing.assert_allclose(found, level / level.max(), atol=1e-9)


def test_noise_of_the_white_picture_stays_out_of_the_flat_field():
    truth = vignette((32, 32))
    white = truth * np.random.default_rng(0).normal(1, 0.1, truth.shape)
    found = cal.find_flat(white, (32, 32), IDENTITY)
    assert np.mean(found / truth) == pytest.approx(1, abs=0.03)
    assert np.std(found / truth) < 0.02


def test_black_is_taken_from_every_picture():
    scenes = cal.spot_scenes((32, 32))
    shown = np.concatenate([scenes, np.ones((1, 32, 32), np.float32)])
    pictures = pictures_of(shown, VIEW, (0.01, 0.01), vignette((32, 32)), 0.0)
    glow = np.random.default_rng(0).random((32, 32))
    plain = cal.calibrate(scenes, pictures[:-1], GRID, white=pictures[-1])
    freed = cal.calibrate(scenes, pictures[:-1] + glow, GRID, white=pictures[-1] + glow, black=glow)
    np.testing.assert_allclose(freed.homography, plain.homography, atol=1e-9)
    np.testing.assert_allclose(freed.flat, plain.flat, atol=1e-9)


def test_spots_are_centred_wherever_they_are():
    rng = np.random.default_rng(4)
    centres = rng.uniform(6, 26, (40, 2))
    down, across = np.indices((32, 32)) + 0.5
    spots = np.exp(
        -((down - centres[:, 1, None, None]) ** 2 + (across - centres[:, 0, None, None]) ** 2) / 4
    )
    np.testing.assert_allclose(32 * cal.find_spots(spots), centres, atol=0.01)
    noisy = 32 * cal.find_spots(7 + spots + rng.normal(0, 0.02, spots.shape))
    assert np.abs(noisy - centres).max() < 0.1


def test_a_spot_in_noise_is_not_seen():
    noise = np.random.default_rng(0).normal(0, 1, (40, 32, 32))
    assert np.isnan(cal.find_spots(noise)).all(axis=1).mean() > 0.9
    assert np.isnan(cal.find_spots(np.zeros((1, 8, 8)))).all()


def test_lost_and_wrong_spots_do_not_count():
    rng = np.random.default_rng(7)
    display = np.array([[x, y] for x in np.linspace(0.1, 0.9, 5) for y in np.linspace(0.1, 0.9, 5)])
    device = apply(VIEW, display) + rng.normal(0, 0.001, display.shape)
    device[3] = np.nan
    device[[8, 15, 20]] = rng.random((3, 2))
    found = cal.find_homography(display, device, (32, 32))
    assert found.spots == 21
    assert 32 * np.abs(apply(found.matrix, display) - apply(VIEW, display)).max() < 0.1
    assert 0.01 < found.residual < 0.1


@pytest.mark.parametrize("kind", ["few", "line", "chaos"])
def test_too_little_for_a_homography_is_an_error(kind):
    rng = np.random.default_rng(0)
    display = rng.random((9, 2))
    device = display.copy()
    if kind == "few":
        device[3:] = np.nan
    elif kind == "line":
        display[:, 1] = device[:, 1] = 0.5
    else:
        display, device = display[:5], rng.random((5, 2))
        device[:2] = np.nan
    with pytest.raises(InputError, match="spots are seen") as caught:
        cal.find_homography(display, device, (32, 32))
    assert "\n" not in str(caught.value)


def test_spot_scenes_lie_symmetrically():
    scenes = cal.spot_scenes((32, 24), (3, 4), 2)
    assert scenes.shape == (12, 32, 24)
    assert (scenes.sum(axis=(1, 2)) == 4).all()
    assert scenes.sum(axis=0).max() == 1
    for spots, side in (((1, 5), 2), ((5, 5), 7), ((5, 5), 0)):
        with pytest.raises(InputError, match="do not fit"):
            cal.spot_scenes((32, 32), spots, side)


def test_words_on_arrays_that_do_not_fit():
    scenes = cal.spot_scenes((32, 32))
    pictures = np.zeros((25, 32, 32))
    with pytest.raises(InputError, match="one picture of 32 x 32"):
        cal.calibrate(scenes, pictures[:3], GRID)
    with pytest.raises(InputError, match="white picture has shape"):
        cal.calibrate(scenes, pictures, GRID, white=np.ones((3, 3)))
    with pytest.raises(InputError, match="uniform"):
        cal.calibrate(np.ones((25, 32, 32)), pictures, GRID)
    with pytest.raises(InputError, match="0 of 25 spots"):
        cal.calibrate(scenes, pictures, GRID)
    with pytest.raises(InputError, match="is dark"):
        cal.find_flat(np.zeros((8, 8)), (8, 8), IDENTITY)
    with pytest.raises(InputError, match="one row of h"):
        cal.camera_view(np.ones((2, 7)), (2, 4), calibration_of())
    with pytest.raises(InputError, match="no images"):
        cal.view_matrix((8,), calibration_of(), (4, 4))
    away = [[1, 0, 5], [0, 1, 0], [0, 0, 1]]
    with pytest.raises(InputError, match="no cell looks"):
        cal.view_matrix((8, 8), calibration_of(away), (4, 4))


# The background


def patterns_of(frames, on, rails):
    sha256 = "0" * 64
    manifest = Manifest(
        deepfsi="0",
        device=Device(name="d", columns=8, rows=8),
        image_shape=(2, 2),
        masks=2,
        rails=rails,
        light="two-arm" if frames[0][1] == "both" else "equal-dwell",
        dimmed=1,
        summed_reflectance=1,
        selection="ordered",
        format="npy",
        frames=tuple(
            Frame(role="mask", mask=mask, rail=rail, share=share, picture_us=100, sha256=sha256)
            for mask, rail, share in frames
        ),
    )
    return Patterns(manifest, np.array(on, dtype=np.uint32))


def test_background_counts_dark_always_and_ambient_through_open_mirrors():
    frames = [(0, "plus", 0.2), (1, "minus", 0.4)]
    patterns = patterns_of(frames, [[16, 0, 0, 0], [16, 16, 8, 8]], 2)
    wanted = [[0.2 * 10 * (5 + 100 * 0.25), 0], [0, 0.4 * 10 * (5 + 100 * 0.75)]]
    np.testing.assert_allclose(cal.background(patterns, 10.0, 5.0, 100.0), wanted)
    counts = np.full((3, 2, 2, 2), 1000)
    np.testing.assert_allclose(
        cal.subtract_background(counts, patterns, 10.0, 5.0, 100.0),
        np.broadcast_to(1000 - np.array(wanted), counts.shape),
    )
    with pytest.raises(InputError, match="not of these patterns"):
        cal.subtract_background(counts[..., :1], patterns, 10.0, 5.0)


def test_background_on_two_arms():
    frames = [(0, "both", 0.3), (1, "both", 0.7)]
    patterns = patterns_of(frames, [[16, 0, 0, 0], [16, 16, 16, 0]], 2)
    found = cal.background(patterns, 1.0, np.array([5.0, 7.0]), np.array([100.0, 10.0]))
    wanted = [[0.3 * (5 + 25), 0.7 * (5 + 75)], [0.3 * (7 + 7.5), 0.7 * (7 + 2.5)]]
    np.testing.assert_allclose(found, wanted)


def test_background_on_one_rail():
    frames = [(0, "plus", 0.5), (1, "plus", 0.5)]
    patterns = patterns_of(frames, [[16, 0, 0, 0], [16, 16, 16, 16]], 1)
    np.testing.assert_allclose(cal.background(patterns, 2.0, 3.0, 8.0), [[5, 11]])


def test_rates_of_a_black_run():
    on, off = np.array([12.0, np.nan, 14.0]), np.array([4.0, 5.0, 6.0])
    assert cal.black_rates(on, off) == (5.0, 8.0)
    assert cal.black_rates(off, off + 1) == (6.0, 0.0)
    with pytest.raises(InputError, match="no pass"):
        cal.black_rates(np.array([np.nan]), np.array([1.0]))


# The file


def test_saved_and_loaded(tmp_path):
    calibration = calibration_of(flat=vignette((3, 4)), dark=1.5)
    path = cal.save_calibration(calibration, tmp_path / "calibration")
    assert path.name == "calibration.json"
    assert cal.load_calibration(tmp_path / "calibration") == calibration


@pytest.mark.parametrize(
    ("change", "words"),
    [
        ({"homography": [[1, 0, 0], [2, 0, 0], [0, 0, 1]]}, "cannot be inverted"),
        ({"homography": [[1, 0, 0], [0, 1, 0]]}, "homography.2"),
        ({"flat": [[1, 1], [1]]}, "differ in length"),
        ({"flat": [[0, 0]]}, "dark everywhere"),
        ({"flat": [[2]]}, "flat.0.0"),
        ({"dark": -1}, "dark"),
        ({"schema_version": 2}, "schema_version"),
        ({"new": 1}, "new"),
    ],
)
def test_a_damaged_file_is_named(tmp_path, change, words):
    path = cal.save_calibration(calibration_of(), tmp_path)
    path.write_text(json.dumps(json.loads(path.read_text()) | change))
    with pytest.raises(InputError, match=words) as caught:
        cal.load_calibration(tmp_path)
    assert "\n" not in str(caught.value)


def test_a_missing_or_broken_file_is_named(tmp_path):
    with pytest.raises(InputError, match="no calibration at"):
        cal.load_calibration(tmp_path)
    (tmp_path / "calibration.json").write_bytes(b"{\xff")
    with pytest.raises(InputError, match=r"calibration.json. cannot be used"):
        cal.load_calibration(tmp_path)


# The virtual camera


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
    grid = find_grid(device, shape)
    eyes = camera.Camera(view=tuple(map(tuple, VIEW.tolist())), blur=blur, vignetting=0.3)
    scenes = np.random.default_rng(0).random((3, 16, 16), dtype=np.float32)
    mirrors = camera.irradiance(scenes, eyes, device, grid)
    kept = mirrors[
        :,
        grid.top : grid.top + grid.down * grid.height,
        grid.left : grid.left + grid.across * grid.width,
    ]
    cells = kept.reshape(3, grid.down, grid.height, grid.across, grid.width).sum(axis=(2, 4))
    spread = blur / (grid.down * grid.height), blur / (grid.across * grid.width)
    calibration = calibration_of(VIEW, spread, vignette(shape, 0.3))
    seen = cal.camera_view(scenes.reshape(3, -1), (16, 16), calibration, shape)
    np.testing.assert_allclose(seen.reshape(cells.shape), cells, atol=tolerance)
    assert cells.std() > 0.1


def test_the_virtual_camera_is_calibrated():
    """Spots, white and black shown to it, counted, and found again."""
    grid = find_grid(Device(name="d", columns=512, rows=384), (32, 32))
    device = Device(name="d", columns=512, rows=384)
    eyes = camera.Camera(view=tuple(map(tuple, VIEW.tolist())), blur=7.0, vignetting=0.3)
    spots = cal.spot_scenes((32, 32))
    shown = np.concatenate([spots, np.ones((1, 32, 32), np.float32)])
    mirrors = camera.irradiance(shown, eyes, device, grid)
    cells = mirrors.reshape(26, 32, 12, 32, 16).sum(axis=(2, 4))
    pictures = np.random.default_rng(0).poisson(4000 * cells) / 4000
    found = cal.calibrate(spots, pictures[:-1], grid, white=pictures[-1])
    scene = np.random.default_rng(1).random((1, 32, 32), dtype=np.float32)
    truth = camera.irradiance(scene, eyes, device, grid).reshape(32, 12, 32, 16).sum(axis=(1, 3))
    mine = cal.camera_view(scene.reshape(1, -1), (32, 32), found).reshape(32, 32)
    gain = (mine * truth).sum() / (mine**2).sum()
    assert np.sqrt(((gain * mine - truth) ** 2).mean()) < 0.02
    assert truth.std() > 0.1


def test_a_recorded_run_is_calibrated_end_to_end(tmp_path):
    """Spots, white and black: pattern folder, photon file, counts, calibration, view."""
    device, shape = Device(name="d", columns=128, rows=128), (16, 16)
    grid = find_grid(device, shape)
    eyes = camera.Camera(
        view=tuple(map(tuple, VIEW.tolist())), blur=3.0, vignetting=0.2, dark=1e3, ambient=2e4
    )
    raster = np.eye(256)[None] / 256
    export_patterns(
        DesignRails(raster, "equal-dwell", shape, summed_reflectance=150.0),
        FrameSettings(device, 4e-3),
        tmp_path / "patterns",
    )
    spots = cal.spot_scenes((32, 32), (3, 3), 4)
    scenes = np.concatenate([spots, np.ones((1, 32, 32)), np.zeros((1, 32, 32))])
    names = [f"scene {k}" for k in range(len(scenes))]
    settings = camera.RecordingSettings(eyes, flux=2e7, exposure_s=1.0)
    camera.record(tmp_path / "patterns", scenes, names, None, tmp_path / "run", settings)
    counts = count(tmp_path / "run")
    pictures = counts.counts[:, 0, 0].reshape(-1, *shape)  # of a raster
    dark, ambient = cal.black_rates(counts.on_rate[-1:], counts.off_rate[-1:])
    assert dark == pytest.approx(1e3, abs=6 * np.sqrt(1e3 / 8e-3))
    assert ambient == pytest.approx(2e4, abs=6 * np.sqrt(2e4 / 8e-3))
    found = cal.calibrate(
        spots,
        pictures[:-2],
        grid,
        white=pictures[-2],
        black=pictures[-1],
        dark=dark,
        ambient=ambient,
    )
    cal.save_calibration(found, tmp_path / "run" / "calibration")
    found = cal.load_calibration(tmp_path / "run" / "calibration")
    scene = np.random.default_rng(0).random((4, 8, 8)).repeat(4, axis=1).repeat(4, axis=2)
    mirrors = camera.irradiance(scene, eyes, device, grid)
    truth = mirrors.reshape(4, 16, 8, 16, 8).sum(axis=(2, 4))
    seen = cal.camera_view(scene.reshape(4, -1), (32, 32), found, shape).reshape(truth.shape)
    assert np.sqrt(((seen - truth) ** 2).mean()) < 0.15 * truth.std()
    assert seen.sum() == pytest.approx(truth.sum(), rel=0.05)
