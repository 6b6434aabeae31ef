"""Cells of each detector, found from a scan of spots."""

import numpy as np
import pytest

from deepfsi.base.errors import InputError
from deepfsi.camera.device import Device
from deepfsi.counting.counts import Counts
from deepfsi.counting.recording import Recording
from deepfsi.lab.calibration import (
    SCAN_NAMES,
    find_detectors,
    scan_rails,
    spot_scenes,
)
from deepfsi.lab.virtual_optics import VirtualCamera
from deepfsi.patterns.folder import Patterns
from shared.virtual_runs import record

DEVICE = Device(name="d", columns=48, rows=48)
CELLS = (8, 6)
PARTS = ((2, 2, 0), (1, 3, 0), (1, 3, 3), (1, 1, 3))
"""Parts of an area of 4 x 3 that the cells divide by two each way."""

EYES = VirtualCamera(blur=1.0, vignetting=0.3, dark=300.0, ambient=1e4, detectors=PARTS)


def scanned(folder, scan="hadamard") -> tuple[Counts, Patterns]:
    """Counts of spots, of white and of black, wired in an order of their own."""
    rails = scan_rails(scan, CELLS, 4)
    shown = Patterns.from_rails(rails, DEVICE, 1e-3).write(folder / "patterns")
    spots = spot_scenes((16, 12), (3, 3), 2)
    scenes = np.concatenate([spots, np.ones((1, 16, 12)), np.zeros((1, 16, 12))])
    wired = {"inputs": (6, 1, 4, 3), "seed": 0}
    run = record(folder / "run", folder / "patterns", scenes, EYES, 1e7, 0.02, **wired)
    return Recording.read(run).count(), shown


@pytest.mark.parametrize("scan", SCAN_NAMES)
def test_each_cell_is_its_detectors(tmp_path, scan):
    found = find_detectors(*scanned(tmp_path, scan))
    assert np.array_equal(found, np.kron(PARTS, np.ones((2, 2), int)))


def test_a_detector_without_cells_is_named(tmp_path):
    """The third input has the light of the fourth, which is wired to nothing."""
    counts, shown = scanned(tmp_path)
    for values in (counts.arrivals, counts.counts, counts.variance):
        values[..., 2] += values[..., 3]
        values[..., 3] = 0
    with pytest.raises(InputError, match="input 4 counts most in no cell"):
        find_detectors(counts, shown)


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
