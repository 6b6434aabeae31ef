"""Devices on the command line: frames of one's own video device."""

import json


def test_times_of_a_video_are_told(done, tmp_path):
    (tmp_path / "video.toml").write_text(
        'columns = 40\nrows = 30\nvideo_us = 9597\nsettle_us = 202\ncontroller = "dlpc347x"\n'
    )
    words = ["dmd", "export", "raster", "--size", "4x5", "--device", tmp_path / "video.toml"]
    told = json.loads(done(*words, "--dwell", "300us", "-o", tmp_path / "p", "--json"))
    assert told["frames"] == 24
    assert told["picture_us"] == [400, 400]  # 104.2 pictures of 24 in a second
    assert told["uncounted"]["idle"] < 1e-9
