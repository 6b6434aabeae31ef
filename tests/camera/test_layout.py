"""Devices as data, and cells on them: square, in a region, flipped, turned and inverted."""

import json
import math
import re
from importlib.resources import files

import numpy as np
import pytest

from deepfsi.camera.device import DEVICES, find_device
from deepfsi.camera.layout import DmdLayout, find_grid
from deepfsi.patterns.folder import Patterns
from deepfsi.patterns.frames import unpack
from patterns.pattern_samples import SMALL, export


@pytest.mark.parametrize("name", DEVICES)
@pytest.mark.parametrize("shape", [(32, 32), (8, 8), (3, 5)])
def test_law_cells_are_square_and_in_the_middle_of_each_device(name, shape):
    """In length, not in mirrors: columns of a diamond lattice are two rows apart."""
    device = DEVICES[name]
    grid = find_grid(device, shape)
    step = 2 if device.lattice == "diamond" else 1
    assert grid.height == step * grid.width
    assert grid.aspect == 1
    down, across = grid.down * grid.height, grid.across * grid.width
    assert abs(device.rows - down - 2 * grid.top) <= step + 1
    assert abs(device.columns - across - 2 * grid.left) <= 1
    larger = step * (grid.width + 1) * shape[0] > device.rows
    assert larger or (grid.width + 1) * shape[1] > device.columns  # none larger fit


@pytest.mark.parametrize(
    ("device", "shape", "layout", "cell", "corner"),
    [
        ("dlp7000", (32, 32), {"stretch": True}, (24, 32), (0, 0)),
        ("dlp7000", (32, 32), {}, (24, 24), (0, 128)),
        ("dlp7000", (64,), {}, (768, 16), (0, 0)),
        ("dlp7000", (8, 8), {"region": "400x320+100+40"}, (40, 40), (40, 140)),
        ("dlp4500", (8, 8), {"region": "400x400+1+3"}, (50, 25), (2, 101)),
    ],
)
def test_cells_lie_in_the_region_or_fill_it(device, shape, layout, cell, corner):
    """A spectrum fills the height; a diamond lattice begins at an even row."""
    grid = find_grid(DEVICES[device], shape, DmdLayout(**layout))
    assert ((grid.height, grid.width), (grid.top, grid.left)) == (cell, corner)
    if layout.get("stretch") and "region" not in layout:
        assert grid.aspect == cell[1] / cell[0]


@pytest.mark.parametrize("layout", DmdLayout().orientations(), ids=str)
@pytest.mark.parametrize("device", [SMALL, find_device("dlp4500")], ids=["square", "diamond"])
def test_law_frames_show_the_masks_flipped_and_turned(tmp_path, layout, device):
    """Flipped left to right, then turned clockwise."""
    masks = np.arange(1, 13).reshape(1, 1, 12) / 12
    made = export(
        tmp_path / "p", masks, image_shape=(3, 4), layout=layout, device=device, format="npy"
    )
    grid = made.manifest.grid
    frame = list(Patterns.read(tmp_path / "p").frames())[2]
    lit = unpack(frame, device)[grid.window]
    cells = lit.reshape(grid.down, grid.height, grid.across, grid.width).sum(axis=(1, 3))
    picture = made.on[0].reshape(3, 4)
    picture = picture[:, ::-1] if layout.flip else picture
    assert np.array_equal(cells, np.rot90(picture, -layout.rotate // 90))
    assert Patterns.read(tmp_path / "p").check().manifest.layout == layout


def test_inverted_files_have_a_one_for_every_mirror_that_is_off(tmp_path):
    usual = export(tmp_path / "a")
    inverted = export(tmp_path / "b", layout=DmdLayout(stretch=True, invert=True))
    pairs = zip(
        Patterns.read(tmp_path / "a").frames(), Patterns.read(tmp_path / "b").frames(), strict=True
    )
    assert all(np.array_equal(unpack(a, SMALL), ~unpack(b, SMALL)) for a, b in pairs)
    assert np.array_equal(usual.on, inverted.on)
    Patterns.read(tmp_path / "b").check()


def test_a_manifest_that_says_no_layout_is_of_stretched_cells(tmp_path):
    """Folders of 0.2.0 keep their cells."""
    made, file = export(tmp_path / "p"), tmp_path / "p" / "manifest.json"
    content = json.loads(file.read_text())
    del content["layout"], content["sha256"]
    file.write_text(json.dumps(content))
    assert Patterns.read(tmp_path / "p").manifest.grid == made.manifest.grid


DIAGONAL_INCHES = {
    "dlp7000": 0.7, "dlp9500": 0.95, "dlp650lnir": 0.65, "dlp6500": 0.65, "dlp9000": 0.9,
    "dlp670s": 0.67, "dlp500yx": 0.5, "dlp4500": 0.45, "dlp3010": 0.3, "dlp4710": 0.47,
    "dlp6500-dlpc910": 0.65, "dlp9000x": 0.9,
}  # fmt: skip


@pytest.mark.parametrize("name", DEVICES)
def test_mirrors_and_pitch_give_the_diagonal_of_the_name(name):
    device = DEVICES[name]
    across, down = device.columns * device.pitch_um, device.rows * device.pitch_um
    if device.lattice == "diamond":  # columns are a diagonal apart, rows half a one
        across, down = across * math.sqrt(2), down / math.sqrt(2)
    inches = math.hypot(across, down) / 25400
    assert inches == pytest.approx(DIAGONAL_INCHES[name], rel=0.05)


def test_each_number_has_a_source_or_is_said_to_be_assumed():
    content = files("deepfsi.camera").joinpath("devices.toml").read_text()
    numbers = re.findall(r"^(\w+) = [\d_.]+(.*)$", content, re.MULTILINE)
    assert len(numbers) >= 5 * len(DEVICES)
    document = r"  # .*(DLP[SU]\d{3}|thread \d|data sheet|400 MHz|DLPC900REF-SW|assumed)"
    assert not [name for name, source in numbers if not re.match(document, source)]
