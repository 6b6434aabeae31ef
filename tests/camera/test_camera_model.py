"""Laws of the camera: presets, what follows from what, files and refusals.

Each field with values that are allowed and refused, files and words are golden.
"""

import json

import pytest

from deepfsi.base.errors import InputError
from deepfsi.camera.camera import PRESETS, Camera
from deepfsi.camera.device import DEVICES
from shared.noises import saturating


@pytest.mark.parametrize(
    ("device", "levels", "stretch"), [("dlp7000", 769, True), (None, None, False)]
)
def test_a_camera_of_an_older_file_keeps_its_stretched_cells_and_levels(device, levels, stretch):
    """Designs of 0.2.0 know no layout: their levels are of cells that fill the device."""
    fields = Camera(device=device).model_dump(mode="json")
    del fields["region"], fields["stretch"]
    old = Camera.restored(fields)
    assert old.stretch == stretch
    if device:
        assert old.mask_levels((32, 32)) == levels
        assert Camera.load(old, region="768x768").layout.stretch


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
        ("none.toml", "none.toml is missing"),
        (5, "a camera cannot be 5: give a preset's name, a TOML file or its fields"),
        ({"ligth": "column"}, "unknown key 'ligth': did you mean 'light'"),
        ({"light": "two-arm", "rails": "single"}, "rails = 'single': .*use dual rails"),
        ({"light": "column", "detectors": "2x2"}, "detectors = '2x2': .*give light equal-dwell"),
        ({"light": "column", "device": "dlp7000"}, "device = 'dlp7000': .*or leave device out"),
        ({"detectors": "no.npy"}, "detectors = 'no.npy': no.npy is missing"),
        ({"device": "dlp7001"}, "device = 'dlp7001': .*did you mean 'dlp7000'"),
        ({"device": "no.toml"}, "device = 'no.toml': no.toml is missing"),
        ({"exposure": "10mm"}, "exposure = '10mm': .*is not a time"),
        ({"shortest_dwell": "2s", "exposure": 1}, "exposure = 1: .*give a longer exposure"),
        ({"device": "dlp7000", "exposure": "30us"}, "exposure = '30us': .*give a longer exposure"),
        ({"dark": 3, "noise": "poisson"}, "noise = 'poisson': .*give noise camera, or leave dark"),
        ({"dark": 3, "noise": saturating}, "shared.noises:saturating noise has no dark counts"),
        ({"dead_time": "1s"}, "dead_time = 1.0: give 1e-05 or less"),
        ({"noise": 3}, "noise = 3: give a noise's name, or noise"),
        ({"sigma": float("nan")}, "sigma = nan: .*finite"),
        ({"contrast": 100}, "contrast = 100: contrast is of a projector: give light dose"),
        ({"light": "dose", "contrast": 1}, "contrast = 1: give more than 1"),
        ({"dark": -1, "flux": 0}, "flux = 0: .*; dark = -1: "),
    ],
)
def test_what_is_no_camera_is_one_line_that_names_the_field(given, match):
    with pytest.raises(InputError, match=match) as error:
        Camera.load(given)
    assert "\n" not in str(error.value)
    assert "Undefined" not in str(error.value)


@pytest.mark.parametrize("name", DEVICES)
def test_a_frame_of_a_device_is_counted_once_its_mirrors_have_settled(name):
    device = DEVICES[name]
    wanted = max(device.shortest_us - device.settle_us - 2, 0)  # two microseconds to spare
    assert Camera(device=name).shortest_dwell == pytest.approx(1e-6 * wanted, abs=1e-12)
    assert Camera(device=name, shortest_dwell="1ms").shortest_dwell == 1e-3


def test_words_say_optics_frames_and_light():
    lines = Camera(**{**FULL, "device": "dlp7000", "noise": "camera"}).describe().splitlines()
    assert lines == [
        "one DMD with a detector on each arm (light law two-arm); signed masks of two rails",
        "2x2 detectors on each arm",
        "device dlp7000: 1024 x 768 mirrors, square cells in the middle of the device",
        "frames are counted for 32 µs or longer: up to 312 in an exposure of 10 ms",
        "budget 10000 counts in 10 ms, at 1e6 counts/s with all mirrors of the region ON",
        "2 dark counts of a detector in an exposure",
        "read noise of 0.5 counts rms a readout",
        "dead time 20 ns, paralysable",
    ]
