"""Scans for a calibration: every cell can be told from all others, at equal dwells."""

import numpy as np
import pytest

from deepfsi.base.errors import InputError
from deepfsi.hardware.calibration.scans import SCAN_NAMES, scan_rails


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


def test_scans_that_cannot_be():
    with pytest.raises(InputError, match="raster"):
        scan_rails("rastr", (8, 8))
    with pytest.raises(InputError, match="4096 cells"):
        scan_rails("raster", (65, 64))
