"""A camera's view to test with, and pictures that it takes."""

import numpy as np

from deepfsi.camera.device import find_device
from deepfsi.camera.layout import DmdLayout, find_grid
from deepfsi.counting.acquisition import Calibration
from deepfsi.lab.design_data import camera_view

VIEW = np.array([[0.9, 0.05, 0.02], [-0.04, 0.88, 0.06], [0.05, -0.06, 1]])
GRID = find_grid(find_device("dlp7000"), (32, 32), DmdLayout(stretch=True))


def vignette(shape, loss=0.4):
    down, across = ((np.arange(n) + 0.5) / n - 0.5 for n in shape)
    return 1 - loss * 2 * (across**2 + down[:, None] ** 2)


def calibration_of(view=VIEW, blur=(0.0, 0.0), flat=((1.0,),), **fields):
    flat = tuple(map(tuple, np.asarray(flat).tolist()))
    return Calibration(
        homography=np.asarray(view).tolist(),
        residual=0.1,
        error=0.05,
        spots=25,
        shown=25,
        blur=blur,
        flat=flat,
        **fields,
    )


def apply(view, places):
    places = np.c_[places, np.ones(len(places))] @ np.asarray(view).T
    return places[:, :2] / places[:, 2:]


def pictures_of(scenes, view, blur, flat, noise, seed=0, grid=GRID):
    shape = (grid.down, grid.across)
    calibration = calibration_of(view, blur, flat)
    seen = camera_view(scenes.reshape(len(scenes), -1), scenes.shape[1:], calibration, shape)
    rng = np.random.default_rng(seed)
    return seen.reshape(-1, *shape) + rng.normal(0, noise, (len(scenes), *shape))
