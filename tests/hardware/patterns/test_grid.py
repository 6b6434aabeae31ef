"""Cells of a diamond lattice against a drawing of its mirrors.

The drawing knows the pitch and how the data sheet DLPS028 places mirrors: squares on a corner, a
row half a diagonal below the one above it, odd rows half a diagonal to the right.
"""

import math

import numpy as np
import pytest
from pattern_samples import export

from deepfsi.camera import DEVICES

PITCH_UM = 7.637
DIAGONAL_UM = PITCH_UM * math.sqrt(2)
SCALE = 4.0
"""Pixels of the drawing, per µm."""

SMALL = DEVICES["dlp4500"].model_copy(update={"columns": 19, "rows": 47})
"""Margins on all sides."""

SHAPE = (3, 4)


def centre_um(row: int, column: int) -> tuple[float, float]:
    """Across and down, from the corner of the device."""
    return (column + 0.5 + 0.5 * (row % 2)) * DIAGONAL_UM, (row + 1) * DIAGONAL_UM / 2


def draw(lit: np.ndarray) -> np.ndarray:
    """Picture of the mirrors that are ON: pixels whose middle lies in the square of one."""
    rows, columns = lit.shape
    across = (np.arange(math.ceil(SCALE * (columns + 0.5) * DIAGONAL_UM)) + 0.5) / SCALE
    down = (np.arange(math.ceil(SCALE * (rows + 1) * DIAGONAL_UM / 2)) + 0.5) / SCALE
    picture = np.zeros((len(down), len(across)), dtype=int)
    for row, column in np.argwhere(lit):
        x, y = (
            abs(places - at)
            for places, at in zip((across, down), centre_um(row, column), strict=True)
        )
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


def test_the_device_is_as_large_as_its_data_sheet_says():
    """9.855 mm by 6.161 mm of active mirrors."""
    device = DEVICES["dlp4500"]
    assert device.columns * DIAGONAL_UM / 1000 == pytest.approx(9.855, rel=1e-3)
    assert device.rows * DIAGONAL_UM / 2000 == pytest.approx(6.161, rel=1e-3)


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


def test_a_cell_covers_a_rectangle_but_for_corners_of_mirrors_at_its_edges(footprints):
    """Its rectangle has its area and middle; no mirror reaches beyond by half a diagonal."""
    rows, columns = np.indices(footprints.shape[1:])
    for one in footprints:
        x = abs(columns - columns[one].mean()) / SCALE - 4 * DIAGONAL_UM / 2
        y = abs(rows - rows[one].mean()) / SCALE - 14 * DIAGONAL_UM / 4
        reach = DIAGONAL_UM / 2 + 1 / SCALE
        assert not one[(x > reach) | (y > reach)].any()
        assert one[(x < -reach) & (y < -reach)].all()
        inside = (x <= 0) & (y <= 0)  # what it misses of the rectangle it has outside
        outline = 2 * SCALE * DIAGONAL_UM * (4 + 14 / 2)  # pixels
        missed, outside = (inside & ~one).sum(), (one & ~inside).sum()
        assert abs(missed - outside) < outline / 2
        assert outside > outline


def test_cells_share_no_mirror_and_leave_no_gap(footprints):
    together = footprints.sum(axis=0)
    rows, columns = np.nonzero(together)
    edge = math.ceil(SCALE * DIAGONAL_UM / 2)
    core = together[rows.min() + edge : rows.max() - edge, columns.min() + edge :]
    core = core[:, : np.ptp(columns) - 2 * edge]
    assert core.max() == 1
    assert core.mean() > 0.995
