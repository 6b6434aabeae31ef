"""Cells of a diamond lattice against a drawing of its mirrors.

The drawing knows the pitch and how the data sheet DLPS028 places mirrors: squares on a corner, a
row half a diagonal below the one above it, odd rows half a diagonal to the right.
"""

import math

import numpy as np
import pytest
from pattern_samples import export

from deepfsi.camera.device import DEVICES

PITCH_UM = 7.637
DIAGONAL_UM = PITCH_UM * math.sqrt(2)
SCALE = 4.0
"""Pixels of the drawing, per µm."""

SMALL = DEVICES["dlp4500"].model_copy(update={"columns": 19, "rows": 47})
"""Margins on all sides."""

SHAPE = (3, 4)


def draw(lit: np.ndarray) -> np.ndarray:
    """Picture of the mirrors that are ON: pixels whose middle lies in the square of one."""
    rows, columns = lit.shape
    across = (np.arange(math.ceil(SCALE * (columns + 0.5) * DIAGONAL_UM)) + 0.5) / SCALE
    down = (np.arange(math.ceil(SCALE * (rows + 1) * DIAGONAL_UM / 2)) + 0.5) / SCALE
    picture = np.zeros((len(down), len(across)), dtype=int)
    for row, column in np.argwhere(lit):
        x = abs(across - (column + 0.5 + 0.5 * (row % 2)) * DIAGONAL_UM)
        y = abs(down - (row + 1) * DIAGONAL_UM / 2)
        near = np.ix_(np.flatnonzero(y < DIAGONAL_UM / 2), np.flatnonzero(x < DIAGONAL_UM / 2))
        picture[near] += x[near[1]] + y[near[0]] < DIAGONAL_UM / 2
    assert picture.max() <= 1  # mirrors do not overlap
    return picture.astype(bool)


@pytest.fixture(scope="module")
def footprints(tmp_path_factory) -> np.ndarray:
    """Drawing of each cell alone, of twelve masks of one cell each, (12, height, width)."""
    folder = tmp_path_factory.mktemp("cells") / "p"
    masks = np.eye(12)[None] / 12
    export(folder, masks, "equal-dwell", image_shape=SHAPE, device=SMALL, format="npy")
    frames = np.unpackbits(np.load(folder / "frames.npy")[2:-2], axis=2, count=SMALL.columns)
    return np.stack([draw(frame) for frame in frames])


def test_cells_have_one_footprint_at_equal_steps(footprints):
    """A pixel of the drawing is 1/43 of a mirror's diagonal."""
    height, width = 14, 4  # mirrors of a cell: 47 rows and 19 columns for 3 x 4, in pairs of rows
    area = footprints.sum(axis=(1, 2)) / SCALE**2
    assert area == pytest.approx(height * width * PITCH_UM**2, rel=0.01)
    y, x = np.indices(footprints.shape[1:])
    middle = np.array([[x[one].mean(), y[one].mean()] for one in footprints]) / SCALE
    steps = middle.reshape(*SHAPE, 2)
    assert np.allclose(np.diff(steps, axis=1), [width * DIAGONAL_UM, 0], atol=0.1)
    assert np.allclose(np.diff(steps, axis=0), [0, height * DIAGONAL_UM / 2], atol=0.1)
    reach = (width + 1) * DIAGONAL_UM / 2, (height / 2 + 1) * DIAGONAL_UM / 2
    for one, (across, down) in zip(footprints, middle, strict=True):
        assert abs(x[one] / SCALE - across).max() < reach[0] + 1 / SCALE
        assert abs(y[one] / SCALE - down).max() < reach[1] + 1 / SCALE


def test_cells_share_no_mirror_and_leave_no_gap(footprints):
    together = footprints.sum(axis=0)
    rows, columns = np.nonzero(together)
    edge = math.ceil(SCALE * DIAGONAL_UM / 2)
    core = together[rows.min() + edge : rows.max() - edge, columns.min() + edge :]
    core = core[:, : np.ptp(columns) - 2 * edge]
    assert core.max() == 1
    assert core.mean() > 0.995
