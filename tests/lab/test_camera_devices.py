"""The virtual camera with every device: each cell gets its light, each mirror where it lies."""

import numpy as np
import pytest

from deepfsi.camera.device import DEVICES
from deepfsi.camera.layout import DmdLayout, find_grid
from deepfsi.lab import virtual_optics as camera
from deepfsi.lab.virtual_optics import CAMERAS, arrival_rates
from deepfsi.patterns.folder import Patterns
from deepfsi.patterns.rails import DesignRails

IDEAL = CAMERAS["ideal"]
DIAMOND = DEVICES["dlp4500"].model_copy(update={"columns": 58, "rows": 119})


@pytest.mark.parametrize("name", DEVICES)
def test_law_each_device_counts_its_realised_masks(tmp_path, name):
    """Of a scene of one value a cell, the ideal camera sends each frame its share of the light."""
    sides = {side: getattr(DEVICES[name], side) // 19 for side in ("columns", "rows")}
    device = DEVICES[name].model_copy(update=sides)
    x = np.random.default_rng(2).uniform(0.1, 1, (1, 2, 3))
    masks = np.random.default_rng(3).random((1, 2, 6)) / 2
    rails = DesignRails(masks, "free-dwell", (2, 3), 3.0)
    kind = "planes" if device.packed else "npy"
    shown = Patterns.from_rails(rails, device, 1e-3, format=kind).write(tmp_path / "p")
    flow = arrival_rates(shown, x, IDEAL, 1e6)[0, :, 0] * 3e-6
    assert flow[[0, -2]] == pytest.approx(x.sum(), rel=1e-4)
    assert flow[1] == flow[-1] == 0
    assert flow[shown.manifest.mask_frames] == pytest.approx(shown.fractions @ x.ravel(), rel=1e-4)


def places() -> tuple[np.ndarray, np.ndarray]:
    """Middles of a diamond lattice's mirrors in diagonals: odd rows lie half a one to the right."""
    rows, columns = np.indices((DIAMOND.rows, DIAMOND.columns))
    return columns + 0.5 + 0.5 * (rows % 2), (rows + 1) / 2


def test_mirrors_of_a_diamond_lattice_get_the_light_of_their_places():
    """The area is that of the cells' mirrors: 56 diagonals across, 58 down."""
    grid = find_grid(DIAMOND, (2, 4), DmdLayout(stretch=True))
    x, y = places()
    used = np.zeros(x.shape, bool)
    used[grid.window] = True
    assert used.sum() == 56 * 116
    left, top = x[used].mean() - 28, y[used].mean() - 29
    assert (left, top) == pytest.approx((1.25, 0.25))
    ramp = (np.arange(5600) + 0.5) / 5600
    fall = (np.arange(5800) + 0.5)[:, None] / 5800
    light = camera.irradiance((ramp + 10 * fall)[None], IDEAL, DIAMOND, grid)[0] * grid.mirrors
    wanted = (x - left) / 56 + 10 * (y - top) / 58
    assert light[used] == pytest.approx(wanted[used], abs=2e-3)
    assert not light[~used].any()
