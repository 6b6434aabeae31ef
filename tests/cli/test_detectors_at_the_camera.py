"""A calibration of several detectors, from spots to the patterns of a design."""

import json

import numpy as np

from deepfsi.patterns.folder import Patterns


def test_a_calibration_tells_a_design_which_detector_sees_what(done, refuse, tmp_path):
    """Spots to a map of cells, a design for it, and its patterns on the same camera."""
    camera, scan, run, out, path, frames = (
        tmp_path / name for name in ("c.toml", "scan", "run", "view", "d.safetensors", "frames")
    )
    spots = scan / "spots"
    camera.write_text("detectors = [[3, 0], [1, 2]]\ndark = 100.0\n")
    words = ["--size", "8x8", "--device", "64x48", "--detectors", 4, "-o", scan]
    done("dmd", "export", "hadamard", *words)
    given = ["--scene", spots, "--flux", 6e6, "--exposure", "100ms", "--virtual", camera, "-o", run]
    done("camera", "simulate", scan, *given)
    done("camera", "count", run)
    told = json.loads(done("camera", "calibrate", run, "--spots", spots, "-o", out, "--json"))
    assert told["detectors"] == str(out / "detectors.npy")
    tiles = np.kron([[3, 0], [1, 2]], np.ones((4, 4), int))
    assert np.array_equal(np.load(out / "detectors.npy"), tiles)

    words = ["--photons", 1e4, "--masks", 2, "--light", "free-dwell", "--rails", "single"]
    words += ["--epochs", 1, "--detectors", out / "detectors.npy"]
    done("design", "--data", "digits", *words, "-o", path)
    done("dmd", "export", path, "--device", "64x48", "-o", frames)
    assert Patterns.read(frames).manifest.detectors.cells == tuple(tiles.ravel().tolist())
    camera.write_text("detectors = [[0, 1, 2]]")
    given = ["--scene", spots, "--flux", 1e6, "--exposure", "1ms", "--virtual", camera]
    said = refuse("camera", "simulate", frames, *given, "-o", tmp_path / "other")
    assert "the camera has 3 detectors, and the patterns are for 4" in said
