"""Devices on the command line: named ones, one's own, and what they cannot show."""

SCAN = ("dmd", "export", "hadamard", "--size", "8x8")


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
