"""Times of frames: pictures hold their masks for as long as was asked, and as the device can."""

import numpy as np
import pytest
from pattern_samples import export, grey

from deepfsi.hardware.patterns.timing import find_gates


@pytest.mark.parametrize(
    ("dwell", "us"), [(7e-4, 700), (123e-6, 123), (70.01e-6, 71), (1.001e-3, 1001), (1e-6, 44)]
)
def test_equal_dwell_holds_every_frame_for_whole_microseconds_that_the_device_can(
    tmp_path, dwell, us
):
    """Rounded up, but not by floating point."""
    manifest = export(tmp_path / "p", grey() / 20, "equal-dwell", dwell_s=dwell).manifest
    assert {frame.picture_us for frame in manifest.frames} == {us}


def test_pictures_share_out_what_is_left_beyond_settling(tmp_path):
    manifest = export(tmp_path / "p", dwell_s=5e-3).manifest
    pictures = np.array([frame.picture_us for frame in manifest.frames])
    shown = pictures[manifest.shown]
    wanted = 10 + (5000 - 10) * 10 * manifest.shares / manifest.shares.sum()
    assert (shown >= np.maximum(wanted, 44) - 1e-6).all()
    assert (shown < np.maximum(wanted, 44) + 1).all()
    assert {*pictures[[0, 1, -2, -1]]} == {5000}
    # so all frames allow one exposure, all that is left of their clock
    longest = (5000e-6 - 10e-6) * 10 / manifest.shares.sum()
    assert find_gates(manifest, longest).repeats == 1
