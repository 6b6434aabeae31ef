"""Frames: mirrors as many as counted, in an order that stands for the cell, in every file."""

import os

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from pattern_samples import BOARD, every_format, export

from deepfsi.base.errors import InputError
from deepfsi.camera.device import Device
from deepfsi.camera.layout import DmdLayout, find_grid
from deepfsi.patterns import frames as frames_module
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
        assert frame.shape == device.frame_shape
        assert np.array_equal(np.packbits(mirrors, axis=1), frame)
        cells = np.kron(counts.reshape(down, across), np.ones((grid.height, grid.width)))
        inside = np.zeros_like(mirrors)
        inside[grid.top :, grid.left :][: len(cells), : cells.shape[1]] = order < cells
        assert np.array_equal(mirrors, inside)


@every_format
def test_a_full_disk_leaves_no_patterns_whichever_file_it_cuts(tmp_path, form):
    """Libraries that write a small array or picture by themselves say nothing of what was lost."""
    whole = tmp_path / "whole"
    export(whole, device=BOARD, format=form)
    for path in [each for each in whole.rglob("*") if each.is_file()]:
        with nearly_full(path.stat().st_size - 1), pytest.raises(InputError, match="cannot write"):
            export(tmp_path / "cut", device=BOARD, format=form)
        assert os.listdir(tmp_path) == ["whole"]
