"""Scans for a calibration: every cell can be told from all others, at equal dwells."""

import numpy as np
import pytest

from deepfsi.base import InputError
from deepfsi.camera import Device
from deepfsi.hardware.calibration import SCAN_NAMES, scan_rails
from deepfsi.hardware.patterns import FrameSettings, check_patterns, export_patterns


@pytest.mark.parametrize("name", SCAN_NAMES)
@pytest.mark.parametrize("cells", [(8, 8), (6, 9), (1, 5)])
def test_a_scan_tells_all_cells_apart(name, cells):
    scan = scan_rails(name, cells)
    rails = scan.rails.astype(float)
    matrix = rails[0] - (rails[1] if len(rails) == 2 else 0)
    assert np.linalg.matrix_rank(matrix) == np.prod(cells)
    frames = int((rails.max(axis=-1) > 0).sum())
    assert set(np.unique(rails)) == {0, 1 / frames}
    assert scan.summed_reflectance == np.prod(cells)


@pytest.mark.parametrize("name", SCAN_NAMES)
def test_a_scan_is_exported_without_a_design(tmp_path, name):
    settings = FrameSettings(Device(name="d", columns=40, rows=32), 1e-3)
    export_patterns(scan_rails(name, (4, 5)), settings, tmp_path / "p")
    patterns = check_patterns(tmp_path / "p")
    assert patterns.manifest.design_sha256 is None
    np.testing.assert_allclose(patterns.rails, scan_rails(name, (4, 5)).rails, atol=1e-12)


def test_scans_that_cannot_be():
    with pytest.raises(InputError, match="raster"):
        scan_rails("rastr", (8, 8))
    for cells in ((65, 64), (1, 1), (0, 8)):
        with pytest.raises(InputError, match="4096 cells"):
            scan_rails("raster", cells)
