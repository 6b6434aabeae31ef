"""Files of frames: the same bits in every format; what is not a frame is refused."""

import os
from typing import get_args

import numpy as np
import pytest
from pattern_samples import FORMATS, SMALL, every_format, export, grey
from PIL import Image
from vendor_readers import read_one_bit

from deepfsi.base import InputError
from deepfsi.camera import DEVICES, find_device
from deepfsi.hardware.patterns import folder
from deepfsi.hardware.patterns.folder import check_patterns, read_frames
from deepfsi.hardware.patterns.sequence import Format
from shared.disks import nearly_full


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
