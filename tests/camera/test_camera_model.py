"""Laws of the camera: a laboratory's units, presets, what follows from what, files and refusals."""

import json

import pytest

from deepfsi.base import InputError, seconds
from deepfsi.camera import DEVICES, PRESETS, Camera
from deepfsi.camera.camera import GUARD_S
from shared.noises import saturating


@pytest.mark.parametrize(
    ("time", "wanted"),
    [
        (0.01, 0.01),
        ("0.01", 0.01),
        ("10ms", 0.01),
        ("10 ms", 0.01),
        ("44us", 44e-6),
        ("44µs", 44e-6),
        ("20NS", 20e-9),
        ("3ps", 3e-12),
        ("2s", 2.0),
        (0, 0.0),
        ("1e-3 s", 1e-3),
    ],
)
def test_times_are_seconds_or_have_a_unit(time, wanted):
    assert seconds(time) == pytest.approx(wanted, rel=1e-12)


def test_a_camera_of_an_older_file_keeps_its_stretched_cells_and_levels():
    """Designs of 0.2.0 know no layout: their levels are of cells that fill the device."""
    known = Camera(device="dlp7000").model_dump(mode="json")
    del known["region"], known["stretch"]
    assert Camera.restored(known).mask_levels((32, 32)) == 769
    assert Camera.load(Camera.restored(known), region="768x768").layout.stretch
    plain = Camera().model_dump(mode="json")
    del plain["region"], plain["stretch"]
    assert not Camera.restored(plain).stretch  # no device, no levels: exports are square


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
        ("dmd-3x3", "unknown camera 'dmd-3x3': did you mean 'dmd-2x2'|'dmd-4x4'"),
        ("none.toml", "none.toml is missing: give a TOML file"),
        (5, "a camera cannot be 5: give a preset's name, a TOML file or its fields"),
        ({"ligth": "column"}, "unknown key 'ligth': did you mean 'light'"),
        ({"light": "colum"}, "light = 'colum': .*'column'"),
        ({"rails": "triple"}, "rails = 'triple': .*'single'"),
        ({"light": "two-arm", "rails": "single"}, "rails = 'single': .*use dual rails"),
        ({"light": "column", "detectors": "2x2"}, "detectors = '2x2': .*give light equal-dwell"),
        ({"light": "column", "device": "dlp7000"}, "device = 'dlp7000': .*or leave device out"),
        ({"detectors": "2by2"}, "detectors = '2by2': give ROWSxCOLUMNS such as 2x2"),
        ({"detectors": "0x2"}, "detectors = '0x2': give ROWSxCOLUMNS such as 2x2"),
        ({"detectors": "no.npy"}, "detectors = 'no.npy': no.npy is missing: give a .npy file"),
        ({"readout": "sum"}, "readout = 'sum': .*'both'"),
        ({"device": "dlp7001"}, "device = 'dlp7001': .*did you mean 'dlp7000'"),
        ({"device": "no.toml"}, "device = 'no.toml': no.toml is missing: give a TOML file"),
        ({"exposure": "10 minutes"}, "exposure = '10 minutes': .*give seconds, or such as 10ms"),
        ({"exposure": "10mm"}, "exposure = '10mm': .*is not a time"),
        ({"exposure": 0}, "exposure = 0: give more than 0"),
        ({"shortest_dwell": "44uss"}, "shortest_dwell = '44uss': .*is not a time"),
        (
            {"shortest_dwell": "2s", "exposure": 1},
            "exposure = 1: .*at least: give a longer exposure",
        ),
        ({"device": "dlp7000", "exposure": "30us"}, "exposure = '30us': .*give a longer exposure"),
        ({"levels": 1}, "levels = 1: .*give 2 or more, or 0"),
        ({"levels": 2.5}, "levels = 2.5: give a whole number"),
        ({"flux": 0}, "flux = 0: give more than 0"),
        ({"flux": float("inf")}, "flux = inf: .*finite"),
        ({"dark": -1}, "dark = -1: give 0 or more"),
        ({"dark": 3, "noise": "poisson"}, "noise = 'poisson': .*give noise camera, or leave dark"),
        ({"dark": 3, "noise": saturating}, "shared.noises:saturating noise has no dark counts"),
        ({"dead_time": "1s"}, "dead_time = 1.0: give 1e-05 or less"),
        ({"dead_time_model": "dead"}, "dead_time_model = 'dead': .*'paralysable'"),
        ({"noise": "poison"}, "noise = 'poison': .*did you mean 'poisson'"),
        ({"noise": 3}, "noise = 3: give a noise's name, or noise"),
        ({"sigma": -1}, "sigma = -1: give 0 or more"),
        ({"sigma": float("nan")}, "sigma = nan: .*finite"),
        ({"dark": -1, "flux": 0}, "flux = 0: .*; dark = -1: "),
    ],
)
def test_what_is_no_camera_is_one_line_that_names_the_field(given, match):
    with pytest.raises(InputError, match=match) as error:
        Camera.load(given)
    assert "\n" not in str(error.value)
    assert "Undefined" not in str(error.value)


@pytest.mark.parametrize(
    ("text", "match"),
    [
        ("light = ", "camera.toml is no TOML file"),
        ('light = "colum"', "camera.toml cannot be used at light: .*'column'"),
        ('exposure = "10mm"', "camera.toml cannot be used at exposure: .*is not a time"),
        ('ligth = "column"', "camera.toml has an unknown key 'ligth': did you mean 'light'"),
    ],
)
def test_a_bad_camera_file_is_named(tmp_path, text, match):
    file = tmp_path / "camera.toml"
    file.write_text(text)
    with pytest.raises(InputError, match=match) as error:
        Camera.load(file)
    assert "\n" not in str(error.value)


@pytest.mark.parametrize("name", DEVICES)
def test_a_frame_of_a_device_is_counted_once_its_mirrors_have_settled(name):
    device = DEVICES[name]
    wanted = max(device.shortest_us * 1e-6 - device.settle_us * 1e-6 - GUARD_S, 0)
    assert Camera(device=name).shortest_dwell == pytest.approx(wanted, abs=1e-12)
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
