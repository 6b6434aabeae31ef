"""Frames: mirrors as many as counted, in an order that stands for the cell, in every file."""

import os

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from pattern_samples import BOARD, every_format, export
from PIL import Image

from deepfsi.base.errors import InputError
from deepfsi.camera.device import Device
from deepfsi.camera.layout import DmdLayout, find_grid
from deepfsi.patterns import frames as frames_module
from deepfsi.patterns.folder import Patterns
from deepfsi.patterns.frames import make_frames, unpack
from shared.disks import nearly_full


@settings(max_examples=150, deadline=None)
@given(st.data())
def test_frames_are_mirrors_counted_in_cells_and_packed(data):
    down, across = data.draw(st.integers(1, 4)), data.draw(st.integers(1, 4))
    columns = data.draw(st.integers(across, 70) | st.sampled_from([16, 32, 64]))
    device = Device(name="any", columns=columns, rows=data.draw(st.integers(down, 20)))
    shape = (across,) if down == 1 and data.draw(st.booleans()) else (down, across)
    grid = find_grid(device, shape, DmdLayout(stretch=True))
    on = np.random.default_rng(data.draw(st.integers(0, 9))).integers(
        0, grid.mirrors + 1, (3, down * across)
    )
    order = np.tile(frames_module.order_mirrors(grid.height, grid.width), (down, across))
    for counts, frame in zip(on, make_frames(on, device, grid), strict=True):
        mirrors = unpack(frame, device)
        assert mirrors.shape == (device.rows, device.columns)
        assert frame.nbytes == device.frame_bytes
        assert np.array_equal(np.packbits(mirrors, axis=1), frame)
        assert np.array_equal(frames_module.recount(mirrors, grid), counts)
        cells = np.kron(counts.reshape(down, across), np.ones((grid.height, grid.width)))
        inside = np.zeros_like(mirrors)
        inside[grid.top :, grid.left :][: len(cells), : cells.shape[1]] = order < cells
        assert np.array_equal(mirrors, inside)


def gradients(height: int, width: int) -> np.ndarray:
    """Scenes at the mirrors of one cell, (12, height, width): a gradient at 12 angles."""
    y, x = (np.arange(height) + 0.5) / height - 0.5, (np.arange(width) + 0.5) / width - 0.5
    turns = np.arange(12) * np.pi / 12 + 0.05
    return np.stack([np.cos(turn) * x + np.sin(turn) * y[:, None] for turn in turns])


def errors(scenes: np.ndarray) -> np.ndarray:
    """Light of the first k mirrors less k/K of the cell's, for k = 0 to K: (n, K + 1)."""
    height, width = scenes.shape[1:]
    device = Device(name="cell", columns=width, rows=height)
    on = np.arange(height * width + 1)[:, None]
    grid = find_grid(device, (1, 1), DmdLayout(stretch=True))
    frames = make_frames(on, device, grid)
    shown = np.stack([unpack(frame, device).ravel() for frame in frames])
    flat = scenes.reshape(len(scenes), -1)
    return flat @ shown.T - flat.sum(axis=1, keepdims=True) * on.T / (height * width)


@pytest.mark.parametrize("shape", [(24, 32), (6, 8), (33, 60), (64, 80), (1, 40)])
def test_ordered_mirrors_weigh_a_gradient_to_less_than_one_mirror(shape):
    """At every grey level and angle; random ones are off by √(k (1 − k/K) / 12) of one."""
    scenes = gradients(*shape)
    scenes = scenes[np.ptp(scenes, axis=(1, 2)) > 0]
    spans = np.ptp(scenes, axis=(1, 2))[:, None]
    assert (abs(errors(scenes)) < spans + 1e-12).all()


@every_format
def test_a_full_disk_leaves_no_patterns_whichever_file_it_cuts(tmp_path, form):
    """Libraries that write a small array or picture by themselves say nothing of what was lost."""
    whole = tmp_path / "whole"
    export(whole, device=BOARD, format=form)
    for path in [each for each in whole.rglob("*") if each.is_file()]:
        with nearly_full(path.stat().st_size - 1), pytest.raises(InputError, match="cannot write"):
            export(tmp_path / "cut", device=BOARD, format=form)
        assert os.listdir(tmp_path) == ["whole"]


FILES = {
    "npy": "frames.npy",
    "raw": "frames.bin",
    "png": "frames/0003.png",
    "bmp": "frames/0003.bmp",
    "planes": "images/0000.bmp",
}


@every_format
def test_other_files_than_the_frames_are_refused(tmp_path, form):
    export(tmp_path / "p", device=BOARD, format=form)
    path = tmp_path / "p" / FILES[form]
    whole = path.read_bytes()
    for content in (b"", whole[: len(whole) // 2]):
        path.write_bytes(content)
        with pytest.raises(InputError):
            Patterns.read(tmp_path / "p").check()
    if form not in ("npy", "raw"):
        mode, said = ("RGB", "is a 40 x 26 BMP") if form == "planes" else ("L", "one bit a pixel")
        Image.new(mode, (40, 26)).save(path)
        with pytest.raises(InputError, match=said):
            Patterns.read(tmp_path / "p").check()
