"""Counts that do not come from the scene."""

import numpy as np

from deepfsi.camera import Device
from deepfsi.hardware.calibration import expected_background
from deepfsi.hardware.patterns import Frame, Manifest, Patterns


def patterns_of(frames, on, rails):
    sha256 = "0" * 64
    manifest = Manifest(
        deepfsi="0",
        device=Device(name="d", columns=8, rows=8),
        image_shape=(2, 2),
        masks=2,
        rails=rails,
        light="two-arm" if frames[0][1] == "both" else "equal-dwell",
        dimmed=1,
        summed_reflectance=1,
        selection="ordered",
        mirrors_sha256="0" * 64,
        format="npy",
        frames=tuple(
            Frame(role="mask", mask=mask, rail=rail, share=share, picture_us=100, sha256=sha256)
            for mask, rail, share in frames
        ),
    )
    return Patterns(manifest, np.array(on, dtype=np.uint32))


def test_background_counts_dark_always_and_ambient_through_open_mirrors():
    frames = [(0, "plus", 0.2), (1, "minus", 0.4)]
    patterns = patterns_of(frames, [[16, 0, 0, 0], [16, 16, 8, 8]], 2)
    wanted = [[0.2 * 10 * (5 + 100 * 0.25), 0], [0, 0.4 * 10 * (5 + 100 * 0.75)]]
    found = expected_background(patterns, 10.0, 5.0, 100.0)
    np.testing.assert_allclose(found, wanted)


def test_background_on_two_arms():
    frames = [(0, "both", 0.3), (1, "both", 0.7)]
    patterns = patterns_of(frames, [[16, 0, 0, 0], [16, 16, 16, 0]], 2)
    found = expected_background(patterns, 1.0, np.array([5.0, 7.0]), np.array([100.0, 10.0]))
    wanted = [[0.3 * (5 + 25), 0.7 * (5 + 75)], [0.3 * (7 + 7.5), 0.7 * (7 + 2.5)]]
    np.testing.assert_allclose(found, wanted)
