"""Mirrors: as many as counted, in an order that stands for the cell, packed."""

import hashlib
import math

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from pattern_samples import SMALL

from deepfsi.camera import Device, DmdLayout, find_grid
from deepfsi.hardware.patterns.mirrors import make_frames, order_mirrors, recount, unpack


@settings(max_examples=150, deadline=None)
@given(st.data())
def test_frames_are_mirrors_counted_in_cells_and_packed(data):
    down, across = data.draw(st.integers(1, 4)), data.draw(st.integers(1, 4))
    columns = data.draw(st.integers(across, 70) | st.sampled_from([16, 32, 64]))
    device = Device(name="any", columns=columns, rows=data.draw(st.integers(down, 20)))
    shape = (across,) if down == 1 and data.draw(st.booleans()) else (down, across)
    grid = find_grid(device, shape, DmdLayout(stretch=True))
    seed = data.draw(st.integers(0, 9))
    on = np.random.default_rng(seed).integers(0, grid.mirrors + 1, (3, down * across))
    order = np.tile(order_mirrors(grid.height, grid.width), (down, across))
    for selection in ("ordered", "random"):
        for counts, frame in zip(on, make_frames(on, device, grid, selection, seed), strict=True):
            mirrors = unpack(frame, device)
            assert mirrors.shape == (device.rows, device.columns)
            assert frame.nbytes == device.frame_bytes
            assert np.array_equal(np.packbits(mirrors, axis=1), frame)
            assert np.array_equal(recount(mirrors, grid), counts)
            assert mirrors.sum() == counts.sum()  # none outside
            if selection == "ordered":
                cells = np.kron(counts.reshape(down, across), np.ones((grid.height, grid.width)))
                inside = np.zeros_like(mirrors)
                inside[grid.top :, grid.left :][: len(cells), : cells.shape[1]] = order < cells
                assert np.array_equal(mirrors, inside)


@pytest.mark.parametrize("shape", [(1, 1), (1, 7), (24, 32), (5, 2000), (97, 130)])
def test_every_mirror_of_a_cell_has_one_place(shape):
    order = order_mirrors(*shape)
    assert order.shape == shape
    assert np.array_equal(np.sort(order, axis=None), np.arange(math.prod(shape)))


def test_the_order_of_mirrors_is_the_same_everywhere_and_for_ever():
    order = order_mirrors(24, 32).astype("<u4")
    assert hashlib.sha256(order.tobytes()).hexdigest() == ORDER


ORDER = "c0570779855637cb5afbd595f9be830ac529379054b92459fa75d9277794e9a4"


cells = pytest.mark.parametrize("shape", [(24, 32), (6, 8), (33, 60), (64, 80), (1, 40)])


def varying(height: int, width: int) -> dict[str, np.ndarray]:
    """Scenes at the mirrors of one cell, (n, height, width): each kind at 12 angles."""
    y, x = (np.arange(height) + 0.5) / height - 0.5, (np.arange(width) + 0.5) / width - 0.5
    turns = np.arange(12) * np.pi / 12 + 0.05
    across = np.stack([np.cos(turn) * x + np.sin(turn) * y[:, None] for turn in turns])
    offsets = np.array([-0.3, -0.1, 0.05, 0.2])
    far = (across[:, None] - offsets[:, None, None]).reshape(-1, height, width)
    return {
        "gradient": across,
        "edge": (far > 0).astype(float),
        "blurred edge": 1 / (1 + np.exp(-far / 0.08)),
        "wave": 1 + np.sin(2 * np.pi * across),
    }


def errors(scenes: np.ndarray, selection: str, seed: int = 0) -> np.ndarray:
    """Light of the first k mirrors less k/K of the cell's, for k = 0 to K: (n, K + 1)."""
    height, width = scenes.shape[1:]
    device = Device(name="cell", columns=width, rows=height)
    on = np.arange(height * width + 1)[:, None]
    grid = find_grid(device, (1, 1), DmdLayout(stretch=True))
    frames = make_frames(on, device, grid, selection, seed)
    shown = np.stack([unpack(frame, device).ravel() for frame in frames])
    flat = scenes.reshape(len(scenes), -1)
    return flat @ shown.T - flat.sum(axis=1, keepdims=True) * on.T / (height * width)


def expected_square(scenes: np.ndarray) -> np.ndarray:
    """Variance of a sum of k of K values drawn without replacement, (n, K + 1)."""
    mirrors = math.prod(scenes.shape[1:])
    k = np.arange(mirrors + 1)
    return scenes.var(axis=(1, 2))[:, None] * k * (mirrors - k) / (mirrors - 1)


@cells
@pytest.mark.parametrize("kind", varying(2, 2))
def test_ordered_mirrors_err_less_than_random_ones_on_every_scene(shape, kind):
    scenes = varying(*shape)[kind]
    scenes = scenes[np.ptp(scenes, axis=(1, 2)) > 0]
    ordered = np.square(errors(scenes, "ordered")).mean(axis=1)
    assert (ordered < expected_square(scenes).mean(axis=1)).all()


@cells
def test_ordered_mirrors_weigh_a_gradient_to_less_than_one_mirror(shape):
    """At every grey level and angle; random ones are off by √(k (1 − k/K) / 12) of one."""
    scenes = varying(*shape)["gradient"]
    scenes = scenes[np.ptp(scenes, axis=(1, 2)) > 0]
    spans = np.ptp(scenes, axis=(1, 2))[:, None]
    assert (abs(errors(scenes, "ordered")) < spans + 1e-12).all()


@pytest.mark.parametrize(
    ("kind", "least"), [("gradient", 8), ("edge", 3), ("blurred edge", 8), ("wave", 8)]
)
def test_ordered_mirrors_err_several_times_less_on_the_papers_cells(kind, least):
    scenes = varying(24, 32)[kind]
    ratio = expected_square(scenes).mean() / np.square(errors(scenes, "ordered")).mean()
    assert ratio**0.5 > least


def test_random_mirrors_err_as_drawn_without_replacement():
    scenes = np.concatenate(list(varying(6, 8).values()))
    draws = 400
    drawn = np.stack([errors(scenes, "random", seed) for seed in range(draws)])
    variance = expected_square(scenes)
    assert (abs(drawn.mean(axis=0)) <= 5 * np.sqrt(variance / draws) + 1e-12).all()
    inner = variance[:, 8:-8]  # where sums are near enough to normal for the variance's own error
    within = 5 * inner * (2 / draws) ** 0.5
    assert (abs(drawn[:, :, 8:-8].var(axis=0) - inner) <= within).all()


def test_random_mirrors_are_drawn_anew_for_each_cell_and_frame_and_follow_the_seed():
    grid = find_grid(SMALL, (4, 4), DmdLayout(stretch=True))
    on = np.full((2, 16), grid.mirrors // 2)

    def draw(seed: int) -> np.ndarray:
        frames = make_frames(on, SMALL, grid, "random", seed)
        inside = [unpack(frame, SMALL)[grid.top : 49, grid.left : 65] for frame in frames]
        cells = np.stack(inside).reshape(2, 4, grid.height, 4, grid.width).swapaxes(2, 3)
        return cells.reshape(32, -1)

    first = draw(3)
    assert np.array_equal(first, draw(3))
    assert not np.array_equal(first, draw(4))
    assert len(np.unique(first, axis=0)) == 32
