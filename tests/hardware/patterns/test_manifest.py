"""Manifest: times of pictures as asked and as the device can; adaptive masks."""

import pytest
from pattern_samples import export, grey


@pytest.mark.parametrize(
    ("dwell", "us"), [(7e-4, 700), (123e-6, 123), (70.01e-6, 71), (1.001e-3, 1001), (1e-6, 44)]
)
def test_equal_dwell_holds_every_frame_for_whole_microseconds_that_the_device_can(
    tmp_path, dwell, us
):
    """Rounded up, but not by floating point."""
    manifest = export(tmp_path / "p", grey() / 20, "equal-dwell", dwell_s=dwell).manifest
    assert {frame.picture_us for frame in manifest.frames} == {us}
