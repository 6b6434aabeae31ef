"""Laws of the camera: presets, what follows from what, files and refusals.

Each field with values that are allowed and refused, files and words are golden.
"""

import json
import math

import numpy as np
import pytest

from deepfsi.base.errors import InputError
from deepfsi.camera.camera import PRESETS, Camera
from deepfsi.camera.light import check_budget, photons_per_pixel, summed_reflectance
from shared.noises import saturating

FULL = {
    "light": "two-arm",
    "device": "dlp9500",
    "detectors": "2x2",
    "exposure": "10ms",
    "levels": 2,
    "flux": 1e6,
    "dark": 200,
    "dead_time": "20ns",
    "dead_time_model": "paralysable",
    "sigma": 0.5,
}


@pytest.mark.parametrize("given", [{}, FULL, {"dark": 3}, *PRESETS.values()])
def test_a_camera_comes_back_from_json(given):
    """Whole, and so that what followed from other fields follows from them again."""
    camera = Camera(**given)
    fields = json.loads(camera.model_dump_json())
    assert Camera.model_validate(fields) == Camera.restored(fields) == camera
    assert set(Camera.restored(fields).given_fields) <= set(camera.given_fields)
    louder = {"dark": 70.0, "noise": "camera"}
    assert Camera.load(Camera.restored(fields), **louder) == Camera.load(camera, **louder)


@pytest.mark.parametrize(
    ("given", "match"),
    [
        ("dmd-3x3", "did you mean 'dmd-2x2'|'dmd-4x4'"),
        ({"ligth": "column"}, "no such setting: did you mean 'light'"),
        ({"device": "no.toml"}, "device = 'no.toml': no.toml is missing"),
        (
            {"shortest_dwell": "2s", "exposure": 1},
            "counted for 2 s at least: give a longer exposure",
        ),
        ({"dark": 3, "noise": saturating}, "shared.noises:saturating noise has no dark counts"),
        ({"dark": -1, "flux": 0}, "flux = 0: .*; dark = -1: "),
    ],
)
def test_what_is_no_camera_is_one_line_that_names_the_field(given, match):
    with pytest.raises(InputError, match=match) as error:
        Camera.load(given)
    assert "\n" not in str(error.value)
    assert "Undefined" not in str(error.value)


@pytest.mark.parametrize(
    "bad", [0, -1, math.nan, math.inf, "abc", None, [1e3], 10**400], ids=lambda bad: repr(bad)[:12]
)
def test_a_budget_is_finite_and_above_zero(bad):
    with pytest.raises(InputError, match="photon budget"):
        check_budget(bad)


def test_the_training_mean_gets_the_budget(digits):
    photons = photons_per_pixel(digits.x_train, 1e4, summed_reflectance(digits.x_train))
    assert photons.sum(axis=1, dtype=np.float64).mean() == pytest.approx(1e4, rel=1e-6)
