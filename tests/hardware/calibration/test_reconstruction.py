"""Pictures of scenes from their counts."""

import numpy as np
import pytest

from deepfsi.hardware.calibration.scans import reconstruct
from deepfsi.hardware.counting.acquisition import prepare_run
from deepfsi.hardware.counting.count import count_run
from deepfsi.hardware.patterns.folder import FrameSettings, export_patterns
from deepfsi.hardware.patterns.manifest import DesignRails
from hardware.counting.recording_samples import DEVICE, DWELL, SHAPE, Run, named, split, train


@pytest.mark.parametrize("light", ["equal-dwell", "free-dwell", "two-arm"])
def test_a_picture_is_the_scene(tmp_path, light):
    rails = np.stack([np.eye(6), np.roll(np.eye(6), 1, axis=1) * 0.5 + 0.25]) / 12
    if light == "two-arm":
        rails = np.stack([np.eye(6), 1 - np.eye(6)]) / 6
    elif light == "free-dwell":
        rails = np.eye(6)[None] / 6
    patterns = export_patterns(
        DesignRails(rails, light, SHAPE, summed_reflectance=2.0),
        FrameSettings(DEVICE, DWELL),
        tmp_path / "patterns",
    )
    arms = 2 if light == "two-arm" else 1
    flux, exposure = 2e9, 0.9 * DWELL * len(patterns.manifest.shown)
    given = {"inputs": (2, 1)[:arms], "marker_bit": 4, "exposure_s": exposure, "settle_s": 3e-5}
    prepare_run(tmp_path / "run", tmp_path / "patterns", named(2, flux=flux, **given))
    scenes = np.array([[0.1, 0.9, 0.5, 0.3, 0.0, 0.2], [0.6, 0.1, 0.4, 0.5, 1.0, 0.4]])
    photons = split(patterns, scenes * flux / 2.0, arms) * (DWELL - 4e-5) * 1e-2
    starts = train(patterns.manifest, 2)
    run = Run(tmp_path / "run", patterns, starts, np.rint(photons).astype(int))
    run.record(starts, starts.ravel(), run.photons)
    count_run(tmp_path / "run")
    found = reconstruct(tmp_path / "run")
    assert found.shape == (2, *SHAPE)
    # A hundredth of the photons, as from a detector of that efficiency.
    assert np.allclose(found.reshape(2, 6) * 1e2, scenes, atol=5e-3)
