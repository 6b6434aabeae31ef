"""Frames: mirrors as many as counted, in an order that stands for the cell, in every file."""

import hashlib
import math
import os
from typing import get_args

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from pattern_samples import FORMATS, SMALL, every_format, export, grey
from PIL import Image
from vendor_readers import read_one_bit

from deepfsi.base import InputError
from deepfsi.camera import DEVICES, Device, DmdLayout, find_device, find_grid
from deepfsi.hardware.patterns import check_patterns, folder, make_frames, read_frames, unpack
from deepfsi.hardware.patterns.frames import Format, order_mirrors, recount
from shared.disks import nearly_full


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


def test_formats_hold_the_same_bits(tmp_path):
    for form in FORMATS:
        export(tmp_path / form, format=form)
    frames = [list(read_frames(tmp_path / form)) for form in FORMATS]
    for same in zip(*frames, strict=True):
        assert np.array_equal(same[0], same[1])
        assert all(np.array_equal(same[0], each) for each in same[2:])
    packed = np.load(tmp_path / "npy" / "frames.npy")
    assert packed.dtype == np.uint8
    assert np.array_equal(packed, np.stack(frames[0]))
    assert (tmp_path / "raw" / "frames.bin").read_bytes() == packed.tobytes()


EVERY_FORMAT = get_args(Format)
BOARD = DEVICES["dlp6500"].model_copy(update={"columns": 37, "rows": 26})
"""A device of few mirrors that takes every format."""


@pytest.mark.parametrize("form", EVERY_FORMAT)
def test_a_full_disk_leaves_no_patterns_whichever_file_it_cuts(tmp_path, form):
    """Libraries that write a small array or picture by themselves say nothing of what was lost."""
    whole = tmp_path / "whole"
    export(whole, device=BOARD, format=form)
    for path in [each for each in whole.rglob("*") if each.is_file()]:
        with nearly_full(path.stat().st_size - 1), pytest.raises(InputError, match="cannot write"):
            export(tmp_path / "cut", device=BOARD, format=form)
        assert os.listdir(tmp_path) == ["whole"]


def test_frames_ask_for_their_room(tmp_path, monkeypatch):
    """Of every format that has a size known before: at least that of its files of frames."""
    asked = []
    monkeypatch.setattr(folder, "check_disk_space", lambda path, size, advice: asked.append(size))
    for form in EVERY_FORMAT:
        export(tmp_path / form, device=BOARD, format=form)
        names = ("frames*", "frames/*", "images/*")
        parts = [path for name in names for path in (tmp_path / form).glob(name)]
        files = [each.stat().st_size for each in parts if each.is_file()]
        header = 0 if form == "raw" else 128
        assert form == "png" or sum(files) - header * len(files) <= asked[-1] <= sum(files)


@every_format
def test_the_left_mirror_is_the_highest_bit_and_on_is_white(tmp_path, form):
    rails = np.zeros((1, 2, 16))
    rails[0, 0, 0], rails[0, 1, 11] = 0.5, 0.25  # top left; third row, right
    device = find_device("20x4")
    export(tmp_path / "p", rails, image_shape=(4, 4), device=device, format=form)
    wanted = np.zeros((2, 4, 20), dtype=bool)
    wanted[0, 0, :5] = wanted[1, 2, 15:20] = True
    frames = list(read_frames(tmp_path / "p"))[2:4]
    assert frames[0][0].tolist() == [0b11111000, 0, 0]
    assert frames[1][2].tolist() == [0, 0b00000001, 0b11110000]
    if form == "bmp":
        for mirrors, path in zip(wanted, ("0002.bmp", "0003.bmp"), strict=True):
            assert np.array_equal(read_one_bit(tmp_path / "p" / "frames" / path), mirrors)
    elif form == "png":
        for mirrors, path in zip(wanted, ("0002.png", "0003.png"), strict=True):
            with Image.open(tmp_path / "p" / "frames" / path) as picture:
                assert picture.mode == "1"
                assert np.array_equal(np.asarray(picture.convert("L")), mirrors * np.uint8(255))
            header = (tmp_path / "p" / "frames" / path).read_bytes()[16:26]
            assert header == bytes([0, 0, 0, 20, 0, 0, 0, 4, 1, 0])  # one bit, grey
    else:
        content = (tmp_path / "p" / f"frames.{'npy' if form == 'npy' else 'bin'}").read_bytes()
        bits = np.unpackbits(np.frombuffer(content[-6 * 12 :], np.uint8).reshape(6, 4, 3), axis=2)
        assert np.array_equal(bits[2:4, :, :20], wanted)
        assert not bits[:, :, 20:].any()


def test_a_frame_of_the_dlp7000_is_98304_bytes(tmp_path):
    device = DEVICES["dlp7000"]
    shown = export(
        tmp_path / "p", grey(1, 1024, 1), image_shape=(32, 32), device=device, format="raw"
    )
    assert (shown.manifest.grid.height, shown.manifest.grid.width) == (24, 32)
    assert (tmp_path / "p" / "frames.bin").stat().st_size == 5 * 98_304
    assert device.frame_bytes == 98_304


@every_format
def test_a_missing_frame_is_found_and_named(tmp_path, form):
    export(tmp_path / "p", format=form)
    pictures = form in ("png", "bmp")
    path = tmp_path / "p" / {"npy": "frames.npy", "raw": "frames.bin"}.get(form, "frames")
    if pictures:
        (path / f"0009.{form}").unlink()
    else:
        path.write_bytes(path.read_bytes()[: -4 * SMALL.frame_bytes - 3])
    with pytest.raises(InputError, match=rf"0009\.{form} is missing" if pictures else "frame 9;"):
        check_patterns(tmp_path / "p")
    if not pictures:
        path.unlink()
        with pytest.raises(InputError, match=f"{path.name} is missing"):
            check_patterns(tmp_path / "p")


@every_format
def test_other_files_than_the_frames_are_refused(tmp_path, form):
    export(tmp_path / "p", format=form)
    path = (
        tmp_path / "p"
        / {"npy": "frames.npy", "raw": "frames.bin"}.get(form, f"frames/0003.{form}")
    )  # fmt: skip
    whole = path.read_bytes()
    contents = [
        b"",
        whole[: len(whole) // 2],
        b"GIF89a" if form in ("png", "bmp") else whole + b"x",
    ]
    if form == "npy":
        contents += [whole.replace(b"|u1", b"|i1", 1), whole.replace(b"(14,", b"(13,", 1)]
        contents += [b"\x93NUMPY\x01\x00\x76\x00" + b"{" * 118 + whole[128:]]
    for content in contents:
        path.write_bytes(content)
        with pytest.raises(InputError):
            check_patterns(tmp_path / "p")
    if form in ("png", "bmp"):
        for mode, size in (("L", (67, 50)), ("1", (50, 67))):
            Image.new(mode, size).save(path)
            with pytest.raises(InputError, match="one bit a pixel"):
                check_patterns(tmp_path / "p")
