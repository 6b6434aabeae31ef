"""The file of a calibration: read as it was saved, or refused."""

from __future__ import annotations

import json

import pytest
from calibration_samples import calibration_of, vignette

from deepfsi.errors import InputError
from deepfsi.hardware.calibration.calibration_file import load_calibration, save_calibration


def test_saved_and_loaded(tmp_path):
    calibration = calibration_of(flat=vignette((3, 4)), dark=1.5)
    path = save_calibration(calibration, tmp_path / "calibration")
    assert path.name == "calibration.json"
    assert load_calibration(tmp_path / "calibration") == calibration


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
    path = save_calibration(calibration_of(), tmp_path)
    path.write_text(json.dumps(json.loads(path.read_text()) | change))
    with pytest.raises(InputError, match=words) as caught:
        load_calibration(tmp_path)
    assert "\n" not in str(caught.value)


def test_a_missing_or_broken_file_is_named(tmp_path):
    with pytest.raises(InputError, match="no calibration at"):
        load_calibration(tmp_path)
    (tmp_path / "calibration.json").write_bytes(b"{\xff")
    with pytest.raises(InputError, match=r"calibration.json. cannot be used"):
        load_calibration(tmp_path)
