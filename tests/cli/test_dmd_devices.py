"""Devices on the command line: named ones, one's own, and what they cannot show."""

import json

import pytest

from deepfsi.hardware.patterns import read_patterns

SCAN = ("dmd", "export", "hadamard", "--size", "8x8")


def test_free_dwells_go_to_a_dlpc900_and_are_checked(done, tmp_path):
    out = done(*SCAN, "--device", "dlp6500", "-o", tmp_path / "p")
    assert "131 frames of 400, pictures of 1000 to 1000 µs (105 to 16777215 allowed)" in out
    assert {path.name for path in (tmp_path / "p").iterdir()} == {
        "images", "manifest.json", "mirrors.npy", "patterns.csv", "reference.csv",
        "reference.png", "sequence.txt",
    }  # fmt: skip
    said = json.loads(done("dmd", "check", tmp_path / "p", "--json"))
    assert (said["device"], said["frames"], said["most_frames"]) == (
        "dlp6500", 131, 400,
    )  # fmt: skip
    assert said["departures"] == []


def test_a_device_beyond_its_documents_is_told(done, tmp_path):
    words = ["--device", "dlp6500", "--shortest", "44us", "--dwell", "44us", "--format", "raw"]
    warning = "shortest picture 44 µs, and dlp6500 needs 105 (DLPC900 data sheet"
    assert warning in done(*SCAN, *words, "-o", tmp_path / "p")
    assert warning in done("dmd", "check", tmp_path / "p")


def test_times_of_a_video_are_told(done, tmp_path):
    (tmp_path / "video.toml").write_text(
        'columns = 40\nrows = 30\nvideo_us = 9597\nsettle_us = 202\ncontroller = "dlpc347x"\n'
    )
    words = ["dmd", "export", "raster", "--size", "4x5", "--device", tmp_path / "video.toml"]
    out = done(*words, "--dwell", "300us", "-o", tmp_path / "p")
    assert "since all pictures last as long as the longest" in out
    assert "24 frames, pictures of 400 to 400 µs" in out  # 104.2 pictures of 24 in a second


def test_too_many_frames_are_refused_before_any_is_written(refuse, tmp_path):
    words = ["dmd", "export", "hadamard", "--size", "16x16", "--device", "dlp6500"]
    said = refuse(*words, "-o", tmp_path / "p")
    assert "515 frames do not fit dlp6500, whose controller holds 400" in said
    assert "a smaller --size" in said
    assert "dlp7000" in said
    assert not list(tmp_path.iterdir())


def test_a_device_of_ones_own_is_a_toml_file(done, tmp_path):
    (tmp_path / "mine.toml").write_text(
        'columns = 40\nrows = 30\nshortest_us = 200\npatterns = 140\ncontroller = "dlpc900"\n'
    )
    done(*SCAN, "--device", tmp_path / "mine.toml", "-o", tmp_path / "p")
    manifest = read_patterns(tmp_path / "p").manifest
    assert (manifest.device.name, manifest.device.patterns, manifest.format) == (
        "mine", 140, "planes",
    )  # fmt: skip


@pytest.mark.parametrize(
    ("content", "message"),
    [
        (None, "is missing: give a TOML file"),
        ("columns = 40\nrows = ", "is no TOML file"),
        ("columns = 40\n", "rows"),
        ("columns = 40\nrows = 0\n", "rows"),
        ('columns = 40\nrows = 30\nname = "x"\nspeed = 3\n', "speed"),
        ('columns = 40\nrows = 30\ncontroller = "dlpc999"\n', "controller"),
    ],
)
def test_a_toml_file_that_is_no_device_is_refused(refuse, tmp_path, content, message):
    file = tmp_path / "mine.toml"
    if content is not None:
        file.write_text(content)
    assert message in refuse(*SCAN, "--device", file, "-o", tmp_path / "p")


def test_devices_are_listed_with_their_sources(done):
    out = done("dmd", "devices")
    assert all(name in out for name in ("dlp7000", "dlp500yx", "dlp4500", "2716 x 1600", "diamond"))
    every = {one["name"]: one for one in json.loads(done("dmd", "devices", "--json"))["devices"]}
    assert every["dlp9000"]["patterns"] == 400
    assert every["dlp9000"]["sources"]["patterns"].startswith("DLPC900 programmer's guide DLPU018J")
