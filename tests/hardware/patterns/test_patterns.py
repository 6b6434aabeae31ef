"""Patterns: what a folder holds is what was designed, mirror by mirror and bit by bit."""

from __future__ import annotations

import contextlib
import hashlib
import json
import math
import os
import tempfile
import tracemalloc
from pathlib import Path

import numpy as np
import pytest
import torch
from hypothesis import given, settings
from hypothesis import strategies as st
from PIL import Image
from scipy.linalg import hadamard

from conftest import CASES, FLOAT32
from deepfsi.errors import InputError
from deepfsi.hardware.patterns.folder import (
    DesignRails,
    check_patterns,
    export_patterns,
    read_frames,
    read_patterns,
)
from deepfsi.hardware.patterns.gates import find_cost, find_gates
from deepfsi.hardware.patterns.mirrors import make_frames, order_mirrors, recount, unpack
from deepfsi.hardware.patterns.sequence import (
    DEVICES,
    Device,
    FrameSettings,
    find_device,
    find_grid,
)
from deepfsi.optics import constraints
from deepfsi.progress import SILENT, Report

FORMATS = ("npy", "png", "raw")
SMALL = find_device("67x50")
"""Not whole bytes across, and cells of 8 x 8 leave margins."""

UNEQUAL = np.array([0.999, 0.001])[None, :, None].repeat(16, axis=2)
"""Two masks of very different shares, rails (1, 2, 16)."""

every_shown = pytest.mark.parametrize(
    ("design", "light", "rails"), [case for case in CASES if case.values[0] != "impulse"]
)
every_format = pytest.mark.parametrize("form", FORMATS)
every_selection = pytest.mark.parametrize("selection", ["ordered", "random"])


def grey(masks: int = 5, pixels: int = 16, rails: int = 2, seed: int = 0) -> np.ndarray:
    """Free-dwell rails, unlike each other in their peaks."""
    rng = np.random.default_rng(seed)
    out = rng.random((rails, masks, pixels)) * rng.random((rails, masks, 1))
    return out / out.max(axis=-1).sum()


def export(
    folder: Path, rails=None, light="free-dwell", image_shape=(4, 4), s=3.0, file=None,
    report=SILENT, **changes,
):  # fmt: skip
    settings = FrameSettings(**{"device": SMALL, "dwell_s": 1e-3, **changes})
    design = DesignRails(grey() if rails is None else rails, light, image_shape, s, file)
    return export_patterns(design, settings, folder, report)


def hadamard_rails(order: int) -> np.ndarray:
    signed = hadamard(order) / (2 * order - 1)
    return np.stack([signed.clip(0), (-signed).clip(0)]).astype(np.float32)


# What a device shows


@every_shown
def test_the_realised_matrix_is_the_design_in_steps_of_each_peak(
    made, tmp_path, design, light, rails
):
    given = made(design, light, rails).rails.double()
    device = find_device("64x48")
    shown = export(
        tmp_path / "p", given.numpy(), light, image_shape=(8, 8), device=device, format="raw"
    )
    manifest = shown.manifest
    # `quantise` also mends what rounding breaks of a column design; dimming leaves no need for it
    law = "free-dwell" if light == "column" else light
    wanted = constraints.quantise(given, law, manifest.grid.mirrors) * manifest.dimmed
    tolerance = FLOAT32 if light == "two-arm" else 1e-12  # arms sum to one time in float32 only
    assert np.allclose(shown.rails, wanted.numpy(), rtol=tolerance, atol=1e-15)

    per_rail = given.sum(dim=0, keepdim=True) if light == "two-arm" else given
    lit = per_rail.amax(dim=-1).T
    assert len(manifest.frames) == int((lit > 0).sum()) + 4
    assert manifest.shares == pytest.approx((lit[lit > 0] * manifest.dimmed).tolist(), rel=1e-12)
    assert manifest.shares.sum() <= 1 + 1e-12
    assert constraints.excess(torch.from_numpy(shown.rails), law) <= FLOAT32
    if light != "column":
        assert manifest.dimmed >= 1 - constraints.SLACK
    else:
        assert manifest.dimmed == pytest.approx(min(1, 1 / float(lit.sum())), rel=1e-12)
    assert np.array_equal(check_patterns(tmp_path / "p").on, shown.on)


def test_column_designs_are_dimmed_and_say_by_how_much(tmp_path):
    rails = constraints.fit(torch.from_numpy(hadamard(16)).double(), "column").numpy()
    shown = export(tmp_path / "p", rails, "column")
    assert shown.manifest.dimmed == pytest.approx(16 / 31, rel=1e-12)  # 31 frames of peak 1/16
    assert np.allclose(shown.rails, rails * 16 / 31, rtol=1e-12)


def test_signed_masks_have_two_frames_and_dark_rails_none(tmp_path):
    rails = np.zeros((2, 4, 16))
    rails[0, 0], rails[1, 2], rails[0, 3, 5], rails[1, 3, 6] = 0.1, 0.2, 0.3, 0.1
    manifest = export(tmp_path / "p", rails).manifest
    assert [(frame.role, frame.mask, frame.rail) for frame in manifest.frames] == [
        ("on", None, None),
        ("off", None, None),
        ("mask", 0, "plus"),
        ("mask", 2, "minus"),
        ("mask", 3, "plus"),
        ("mask", 3, "minus"),
        ("on", None, None),
        ("off", None, None),
    ]
    assert manifest.shares == pytest.approx([0.1, 0.2, 0.3, 0.1])


def test_one_frame_serves_both_arms(tmp_path):
    signed = torch.from_numpy(np.random.default_rng(1).uniform(-1, 1, (3, 16)))
    signed[1] = 0
    signed[2] = -1  # its positive rail is dark, and is shown all the same
    rails = constraints.fit(signed, "two-arm").numpy()
    shown = export(tmp_path / "p", rails, "two-arm")
    masks = [frame for frame in shown.manifest.frames if frame.role == "mask"]
    assert [(frame.mask, frame.rail) for frame in masks] == [(0, "both"), (2, "both")]
    assert np.allclose(shown.rails.sum(axis=0), rails.sum(axis=0), rtol=1e-12)
    assert not shown.on[1].any()


def test_a_rail_of_two_levels_fits_one_mirror_a_pixel(tmp_path):
    rails = (np.random.default_rng(2).random((1, 6, 16)) > 0.4) / 6
    shown = export(tmp_path / "p", rails, device=find_device("4x4"), light="equal-dwell")
    assert shown.manifest.grid.mirrors == 1
    assert np.allclose(shown.rails, rails, rtol=1e-12)


@settings(max_examples=150, deadline=None)
@given(st.data())
def test_frames_are_mirrors_counted_in_cells_and_packed(data):
    down, across = data.draw(st.integers(1, 4)), data.draw(st.integers(1, 4))
    columns = data.draw(st.integers(across, 70) | st.sampled_from([16, 32, 64]))
    device = Device(name="any", columns=columns, rows=data.draw(st.integers(down, 20)))
    shape = (across,) if down == 1 and data.draw(st.booleans()) else (down, across)
    grid = find_grid(device, shape)
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


# Grey levels of scenes that vary within a cell


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
    frames = make_frames(on, device, find_grid(device, (1, 1)), selection, seed)
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
    grid = find_grid(SMALL, (4, 4))
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


# Files


@every_selection
@every_format
@pytest.mark.parametrize("device", [SMALL, find_device("64x32")], ids=lambda one: one.name)
def test_what_is_read_back_is_what_was_written(tmp_path, form, selection, device):
    written = export(
        tmp_path / "p", device=device, format=form, selection=selection, seed=5, file=b"masks"
    )
    read = read_patterns(tmp_path / "p")
    assert read.manifest == written.manifest
    assert read.on.dtype == np.uint32
    assert np.array_equal(read.on, written.on)
    assert np.array_equal(check_patterns(tmp_path / "p").rails, written.rails)
    assert (tmp_path / "p" / "design.safetensors").read_bytes() == b"masks"
    frames = list(read_frames(tmp_path / "p"))
    made = make_frames(written.on, device, written.manifest.grid, selection, 5)
    assert all(np.array_equal(*pair) for pair in zip(frames[2:-2], made, strict=True))
    grid = written.manifest.grid
    cells = np.zeros((device.rows, device.columns), dtype=bool)
    cells[
        grid.top : grid.top + grid.down * grid.height,
        grid.left : grid.left + grid.across * grid.width,
    ] = True  # mirrors beyond the cells stay OFF: their light is none of the scene's
    for place, lit in ((0, True), (1, False), (-2, True), (-1, False)):
        assert np.array_equal(unpack(frames[place], device), cells & lit)


def test_formats_hold_the_same_bits(tmp_path):
    for form in FORMATS:
        export(tmp_path / form, format=form)
    frames = [list(read_frames(tmp_path / form)) for form in FORMATS]
    for same in zip(*frames, strict=True):
        assert np.array_equal(same[0], same[1])
        assert np.array_equal(same[0], same[2])
    packed = np.load(tmp_path / "npy" / "frames.npy")
    assert packed.dtype == np.uint8
    assert np.array_equal(packed, np.stack(frames[0]))
    assert (tmp_path / "raw" / "frames.bin").read_bytes() == packed.tobytes()


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
    if form == "png":
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


def test_a_long_sequence_needs_the_memory_of_a_few_frames():
    rails, device = hadamard_rails(1024), DEVICES["dlp7000"]
    whole = 2051 * device.frame_bytes
    with tempfile.TemporaryDirectory() as folder:
        tracemalloc.start()
        export(Path(folder) / "p", rails, "equal-dwell", image_shape=(32, 32), device=device)
        patterns = read_patterns(Path(folder) / "p")
        known = tracemalloc.get_traced_memory()[1]
        tracemalloc.reset_peak()
        before = tracemalloc.get_traced_memory()[0]
        count = sum(1 for _ in read_frames(Path(folder) / "p"))
        reading = tracemalloc.get_traced_memory()[1] - before
        tracemalloc.stop()
    assert count == 2051
    # 4 bytes a cell and frame for the counts of what was written and what was read, a manifest of
    # some kB a frame, and no more than 32 frames
    some = 2051 * 3e3 + 32 * device.frame_bytes
    assert known < 2 * patterns.on.nbytes + some < whole / 5
    assert reading < patterns.on.nbytes + some


def test_an_export_that_stops_leaves_nothing(tmp_path):
    def stop(share: float, what: str) -> None:
        if share > 0.5:
            raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        export(tmp_path / "p", report=Report(stop))
    assert not list(tmp_path.iterdir())


def test_progress_and_rights_of_the_folder(tmp_path):
    seen: list[float] = []
    export(tmp_path / "deep" / "p", report=Report(lambda share, _: seen.append(share)))
    assert seen == sorted(seen)
    assert seen[-1] == 1
    checked: list[float] = []
    check_patterns(tmp_path / "deep" / "p", Report(lambda share, _: checked.append(share)))
    assert checked == seen
    umask = os.umask(0)
    os.umask(umask)
    assert (tmp_path / "deep" / "p").stat().st_mode & 0o777 == 0o777 & ~umask


# Damage


def damage(folder: Path, form: str, place: int) -> None:
    """Flip the first mirror of a frame."""
    if form == "png":
        path = folder / "frames" / f"{place:04d}.png"
        with Image.open(path) as picture:
            changed = picture.copy()
        changed.putpixel((3, 2), 0 if changed.getpixel((3, 2)) else 255)
        changed.save(path)
        return
    path = folder / ("frames.npy" if form == "npy" else "frames.bin")
    content = bytearray(path.read_bytes())
    start = len(content) - len(read_patterns(folder).manifest.frames) * SMALL.frame_bytes
    content[start + place * SMALL.frame_bytes + 2 * 9] ^= 0x10
    path.write_bytes(content)


@every_format
@pytest.mark.parametrize(("place", "name"), [(0, "all ON"), (4, "mask 1, plus"), (13, "all OFF")])
def test_a_changed_mirror_is_found_and_its_frame_named(tmp_path, form, place, name):
    export(tmp_path / "p", format=form)
    damage(tmp_path / "p", form, place)
    with pytest.raises(InputError, match=rf"frame {place} of .*\({name}\) is not what was"):
        check_patterns(tmp_path / "p")


@every_format
def test_a_missing_frame_is_found_and_named(tmp_path, form):
    export(tmp_path / "p", format=form)
    path = tmp_path / "p" / {"npy": "frames.npy", "png": "frames", "raw": "frames.bin"}[form]
    if form == "png":
        (path / "0009.png").unlink()
    else:
        path.write_bytes(path.read_bytes()[: -4 * SMALL.frame_bytes - 3])
    with pytest.raises(InputError, match=r"0009\.png is missing" if form == "png" else "frame 9;"):
        check_patterns(tmp_path / "p")
    if form != "png":
        path.unlink()
        with pytest.raises(InputError, match=f"{path.name} is missing"):
            check_patterns(tmp_path / "p")


@every_format
def test_other_files_than_the_frames_are_refused(tmp_path, form):
    export(tmp_path / "p", format=form)
    path = (
        tmp_path / "p" / {"npy": "frames.npy", "png": "frames/0003.png", "raw": "frames.bin"}[form]
    )
    whole = path.read_bytes()
    contents = [b"", whole[: len(whole) // 2], whole + b"x" if form != "png" else b"GIF89a"]
    if form == "npy":
        contents += [whole.replace(b"|u1", b"|i1", 1), whole.replace(b"(14,", b"(13,", 1)]
        contents += [b"\x93NUMPY\x01\x00\x76\x00" + b"{" * 118 + whole[128:]]
    for content in contents:
        path.write_bytes(content)
        with pytest.raises(InputError):
            check_patterns(tmp_path / "p")
    if form == "png":
        for mode, size in (("L", (67, 50)), ("1", (50, 67))):
            Image.new(mode, size).save(path)
            with pytest.raises(InputError, match="one bit a pixel"):
                check_patterns(tmp_path / "p")


def change(folder: Path, **changes: object) -> None:
    path = folder / "manifest.json"
    path.write_text(json.dumps({**json.loads(path.read_text()), **changes}))


def test_a_changed_manifest_is_found(tmp_path):
    export(tmp_path / "p")
    frames = json.loads((tmp_path / "p" / "manifest.json").read_text())["frames"]
    frames[3]["share"] *= 0.99
    change(tmp_path / "p", frames=frames)
    with pytest.raises(InputError, match=r"manifest\.json was changed"):
        read_patterns(tmp_path / "p")
    change(tmp_path / "p", sha256=None)
    assert read_patterns(tmp_path / "p").manifest.frames[3].share == frames[3]["share"]


def test_a_manifest_may_be_laid_out_anew(tmp_path):
    export(tmp_path / "p")
    change(tmp_path / "p")
    check_patterns(tmp_path / "p")


@pytest.mark.parametrize(
    ("key", "value", "message"),
    [
        ("light", "free-dwel", "did you mean 'free-dwell'"),
        ("light", "two-arm", "not those of two-arm"),
        ("image_shape", [4, 0], "greater than or equal to 1"),
        ("image_shape", [51, 4], "do not fit"),
        ("image_shape", [4, 5], r"shape \(10, 20\)"),
        ("masks", 3, "mask that does not exist"),
        ("schema_version", 2, "schema_version"),
        ("format", "bmp", "format"),
    ],
)
def test_a_manifest_that_does_not_fit_is_refused(tmp_path, key, value, message):
    export(tmp_path / "p")
    change(tmp_path / "p", **{key: value, "sha256": None})
    with pytest.raises(InputError, match=message):
        read_patterns(tmp_path / "p")


def test_mirror_counts_that_do_not_fit_are_refused(tmp_path):
    shown = export(tmp_path / "p")
    path = tmp_path / "p" / "mirrors.npy"
    wrong = shown.on.copy()
    wrong[4, 7] += 1 if wrong[4, 7] < shown.manifest.grid.mirrors else -1
    np.save(path, wrong)
    with pytest.raises(InputError, match=r"frame 6 of .*\(mask 2, plus\) does not show"):
        check_patterns(tmp_path / "p")
    wrong[4, 7] = shown.manifest.grid.mirrors + 1
    np.save(path, wrong)
    with pytest.raises(InputError, match="more than their 192 mirrors"):
        read_patterns(tmp_path / "p")
    np.save(path, shown.on)
    path.write_bytes(path.read_bytes()[:-70])
    with pytest.raises(InputError, match=r"it breaks off in frame 10;"):
        read_patterns(tmp_path / "p")
    np.save(path, shown.on.astype(np.int64))
    with pytest.raises(InputError, match="uint32 numbers"):
        read_patterns(tmp_path / "p")
    np.save(path, np.array([{}], dtype=object))
    with pytest.raises(InputError, match="uint32 numbers"):
        read_patterns(tmp_path / "p")


def test_another_design_beside_the_frames_is_found(tmp_path):
    export(tmp_path / "p", file=b"masks")
    path = tmp_path / "p" / "design.safetensors"
    path.write_bytes(b"others")
    with pytest.raises(InputError, match="not the design that was exported"):
        check_patterns(tmp_path / "p")
    path.unlink()
    with pytest.raises(InputError, match="cannot be read"):
        check_patterns(tmp_path / "p")


@pytest.fixture(scope="module")
def kept(tmp_path_factory) -> Path:
    folder = tmp_path_factory.mktemp("patterns") / "p"
    export(folder, grey(2))
    return folder


@settings(max_examples=200, deadline=None)
@given(st.binary(max_size=60))
def test_garbage_for_a_manifest_is_an_input_error(kept, content):
    (kept / "manifest.json").write_bytes(content)
    with pytest.raises(InputError):
        read_patterns(kept)


JSON = st.recursive(
    st.none() | st.booleans() | st.integers() | st.floats() | st.text(max_size=5),
    lambda inner: st.lists(inner, max_size=3) | st.dictionaries(st.text(max_size=5), inner),
    max_leaves=4,
)


@settings(max_examples=200, deadline=None)
@given(st.data())
def test_a_mutated_manifest_is_read_or_refused(tmp_path_factory, data):
    folder = tmp_path_factory.getbasetemp() / "mutated"
    if not folder.exists():
        export(folder, grey(2))
        (folder / "as-written.json").write_bytes((folder / "manifest.json").read_bytes())
    manifest = json.loads((folder / "as-written.json").read_text())
    manifest["sha256"] = None
    place = data.draw(
        st.sampled_from([manifest, manifest["device"], *manifest["frames"]]), label="place"
    )
    place[data.draw(st.sampled_from(sorted(place)))] = data.draw(JSON)
    (folder / "manifest.json").write_text(json.dumps(manifest))
    with contextlib.suppress(InputError):
        assert np.isfinite(check_patterns(folder).rails).all()


# Time


def test_equal_dwell_holds_every_frame_as_long(tmp_path):
    manifest = export(tmp_path / "p", grey() / 20, "equal-dwell", dwell_s=7e-4).manifest
    assert {frame.picture_us for frame in manifest.frames} == {700}


@pytest.mark.parametrize(("dwell", "us"), [(123e-6, 123), (70.01e-6, 71), (1.001e-3, 1001)])
def test_pictures_last_whole_microseconds_rounded_up_but_not_by_floating_point(tmp_path, dwell, us):
    manifest = export(tmp_path / "p", grey() / 20, "equal-dwell", dwell_s=dwell).manifest
    assert {frame.picture_us for frame in manifest.frames} == {us}


def test_no_picture_is_shorter_than_the_device_can_show(tmp_path):
    manifest = export(tmp_path / "p", grey() / 20, "equal-dwell", dwell_s=1e-6).manifest
    assert {frame.picture_us for frame in manifest.frames} == {44}


def test_pictures_share_out_what_is_left_beyond_settling(tmp_path):
    manifest = export(tmp_path / "p", dwell_s=5e-3).manifest
    pictures = np.array([frame.picture_us for frame in manifest.frames])
    shown = pictures[manifest.shown]
    wanted = 10 + (5000 - 10) * 10 * manifest.shares / manifest.shares.sum()
    assert (shown >= np.maximum(wanted, 44) - 1e-6).all()
    assert (shown < np.maximum(wanted, 44) + 1).all()
    assert {*pictures[[0, 1, -2, -1]]} == {5000}
    # so all frames allow one exposure, all that is left of their clock
    longest = (5000e-6 - 10e-6) * 10 / manifest.shares.sum()
    assert find_gates(manifest, longest).repeats == 1


@pytest.mark.parametrize("exposure", [1e-3, 4e-3, 0.017])
@pytest.mark.parametrize("light", ["free-dwell", "equal-dwell"])
def test_the_cost_is_the_clock_less_what_gates_are_open(tmp_path, exposure, light):
    manifest = export(tmp_path / "p", light=light, dwell_s=5e-3).manifest
    cost = find_cost(manifest, find_gates(manifest, exposure))
    gates = find_gates(manifest, exposure)
    clock = np.zeros(round(manifest.pass_s * 1e7), dtype=bool)  # steps of 0.1 µs
    for place, opens, length in zip(manifest.shown, gates.starts_s, gates.length_s, strict=True):
        for begin in manifest.starts_s[place] + opens:
            clock[round(begin * 1e7) : round((begin + length) * 1e7)] = True
    steps = len(manifest.shown) * gates.repeats
    assert cost.total == pytest.approx(1 - clock.mean(), abs=(steps + 1) / len(clock))
    assert cost.sentinels * manifest.pass_s == pytest.approx(4 * 5e-3)
    assert cost.settling * manifest.pass_s == pytest.approx(10 * 10e-6)
    assert cost.idle >= 0
    assert find_cost(manifest, find_gates(manifest, exposure, repeats=1)).idle >= cost.idle


def test_a_short_share_costs_time(tmp_path):
    manifest = export(tmp_path / "p", UNEQUAL, dwell_s=1e-3).manifest
    assert [manifest.frames[place].picture_us for place in manifest.shown] == [1989, 44]
    cost = find_cost(manifest, find_gates(manifest, 1.98e-3))
    assert cost.idle * manifest.pass_s == pytest.approx(1e-6 * (1989 + 44 - 20 - 1980))


# What is refused


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        ({"light": "free-dwel"}, "did you mean 'free-dwell'"),
        ({"rails": np.zeros((2, 3, 16))}, "every mask is dark"),
        ({"rails": grey()[0]}, r"rails of shape \(5, 16\)"),
        ({"rails": grey(pixels=15)}, r"give \(2 or 1, masks, 16\)"),
        ({"rails": -grey()}, "0 or more"),
        ({"rails": grey() * np.nan}, "finite"),
        ({"light": "two-arm"}, "do not sum to one time"),
        ({"light": "two-arm", "rails": grey(rails=1)}, "single rail"),
        ({"dwell_s": 0}, "dwell 0 is not allowed"),
        ({"dwell_s": math.inf}, "dwell inf"),
        ({"dwell_s": 999, "rails": UNEQUAL}, "longest picture takes"),
        ({"s": 0}, "summed reflectance 0"),
        ({"selection": "order"}, "did you mean 'ordered'"),
        ({"selection": "random", "seed": -1}, "seed -1"),
        ({"format": "bin"}, "Known: npy, raw, png"),
        ({"device": find_device("3x3")}, "do not fit"),
        ({"image_shape": (16, 1, 1)}, "1 or 2 axes"),
        ({"image_shape": (16, 0)}, "1 or 2 axes"),
        (
            {"device": Device(name="slow", columns=8, rows=8, settle_us=1e3)},
            "leaves no time after 1000 µs",
        ),
    ],
)
def test_what_cannot_be_shown_is_refused_before_anything_is_written(tmp_path, changes, message):
    with pytest.raises(InputError, match=message):
        export(tmp_path / "p", **changes)
    assert not list(tmp_path.iterdir())


def test_a_folder_that_holds_something_is_left_alone(tmp_path):
    (tmp_path / "p").mkdir()
    export(tmp_path / "p")
    before = sorted(path.name for path in (tmp_path / "p").iterdir())
    with pytest.raises(InputError, match="exists already"):
        export(tmp_path / "p")
    assert before == sorted(path.name for path in (tmp_path / "p").iterdir())


def test_a_folder_without_patterns_says_what_to_do(tmp_path):
    with pytest.raises(InputError, match="deepfsi dmd export"):
        read_patterns(tmp_path)
    with pytest.raises(InputError, match="deepfsi dmd export"):
        next(read_frames(tmp_path))
