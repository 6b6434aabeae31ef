"""Exports for each family of controllers, opened by readers written from their documents."""

import csv
import json
import shutil
from typing import get_args

import numpy as np
import pytest
from pattern_samples import export, grey
from vendor_readers import (
    load_settings,
    play_dlpc347x,
    play_dlpc350,
    play_dlpc900,
    read_packed,
)

from deepfsi.base import InputError
from deepfsi.camera import DEVICES, Device
from deepfsi.hardware.patterns import check_patterns, frames

SIZE = {"columns": 37, "rows": 26}
"""Rows of no whole bytes, and of no whole 4 bytes of a bitmap."""


def family(name: str) -> Device:
    """A device of few mirrors with the limits of a named one."""
    return DEVICES[name].model_copy(update=SIZE)


def frames_of(folder, device, **changes):
    """Mirrors and times of each frame, of an export as packed bits."""
    shown = export(folder, device=device, format="npy", **changes)
    bits = np.unpackbits(np.load(folder / "frames.npy"), axis=2, count=device.columns)
    return list(bits.astype(bool)), [frame.picture_us for frame in shown.manifest.frames]


def assert_shown(played, mirrors, times, dark=0):
    assert len(played) == len(mirrors)
    for frame, wanted, us in zip(played, mirrors, times, strict=True):
        assert np.array_equal(frame.mirrors, wanted)
        assert (frame.exposure_us, frame.dark_us) == (us - dark, dark)


@pytest.mark.parametrize("name", ["dlp6500", "dlp9000", "dlp670s", "dlp500yx"])
def test_a_dlpc900_shows_every_frame_for_its_own_time(tmp_path, name):
    """33 masks of unlike dwells, in two pictures and one sequence."""
    device, masks = family(name), grey(33, rails=1)
    masks[0, 3] /= 100
    mirrors, times = frames_of(tmp_path / "packed", device, rails=masks)
    export(tmp_path / "p", masks, device=device, format="planes")
    assert len({*times}) > 20
    assert min(times) == device.shortest_us
    assert len([*(tmp_path / "p" / "images").iterdir()]) == 2
    assert_shown(play_dlpc900(tmp_path / "p"), mirrors, times)
    export(tmp_path / "q", masks, device=device, format="bmp")
    assert_shown(load_settings(tmp_path / "q"), mirrors, times)


def test_a_dlpc350_takes_green_red_and_blue_in_turn(tmp_path):
    device = family("dlp4500")
    masks = grey(27, pixels=12, rails=1)
    mirrors, times = frames_of(tmp_path / "packed", device, rails=masks, image_shape=(3, 4))
    export(tmp_path / "p", masks, image_shape=(3, 4), device=device, format="planes")
    assert_shown(play_dlpc350(tmp_path / "p"), mirrors, times)


@pytest.mark.parametrize(("masks", "together"), [(44, 24), (45, 7), (42, 23)])
def test_a_dlpc347x_shows_whole_pictures_of_a_video(tmp_path, masks, together):
    """48, 49 and 46 frames, all for one time; no picture is shorter than a frame of the video."""
    device, rails = family("dlp3010"), grey(masks, rails=1)
    mirrors, times = frames_of(tmp_path / "packed", device, rails=rails, dwell_s=5e-4)
    export(tmp_path / "p", rails, device=device, dwell_s=5e-4, format="planes")
    assert len({*times}) == 1
    assert times[0] * together >= 1e6 / 104.2
    assert times[0] >= 1e6 / 2500
    played = play_dlpc347x(tmp_path / "p", together, times[0] - 202, 202)
    assert_shown(played, mirrors, times, dark=202)
    rows = csv.DictReader((tmp_path / "p" / "patterns.csv").read_text().splitlines())
    assert {(row["exposure_us"], row["dark_us"]) for row in rows} == {(str(times[0] - 202), "202")}


def test_a_number_of_frames_that_fills_no_pictures_is_refused(tmp_path):
    with pytest.raises(InputError, match=r"47 frames, 1 in each picture .* would last 9597 µs"):
        export(tmp_path / "p", grey(43, rails=1), device=family("dlp3010"), format="planes")
    assert not list(tmp_path.iterdir())


def test_an_alp_takes_packed_rows(tmp_path):
    device = family("dlp7000")
    mirrors, _ = frames_of(tmp_path / "packed", device)
    export(tmp_path / "p", device=device, format="raw")
    read = read_packed(tmp_path / "p" / "frames.bin", device.rows, device.columns)
    assert np.array_equal(read, mirrors)
    header = (tmp_path / "packed" / "frames.npy").stat().st_size - len(read) * device.frame_bytes
    read = read_packed(tmp_path / "packed" / "frames.npy", device.rows, device.columns, header)
    assert np.array_equal(read, mirrors)


@pytest.mark.parametrize(
    ("form", "name"),
    [("planes", "patterns.csv"), ("planes", "sequence.txt"), ("bmp", "settings.txt"),
     ("bmp", "patterns.csv"), ("npy", "patterns.csv")],
)  # fmt: skip
def test_tables_that_were_changed_are_found(tmp_path, form, name):
    export(tmp_path / "p", device=family("dlp6500"), format=form)
    path = tmp_path / "p" / name
    path.write_text(path.read_text().replace("1", "2"))
    with pytest.raises(InputError, match=f"{name} does not say what manifest.json says"):
        check_patterns(tmp_path / "p")
    path.unlink()
    if form == "npy":  # earlier versions wrote none
        check_patterns(tmp_path / "p")
        return
    with pytest.raises(InputError, match=f"{name} is missing"):
        check_patterns(tmp_path / "p")


@pytest.mark.parametrize("form", get_args(frames.Format))
@pytest.mark.parametrize("name", ["dlp6500", "dlp7000", "dlp4710"])
def test_every_format_has_its_table_of_times(tmp_path, name, form):
    """Times and the file of each frame, in their order: the sum is that of a pass."""
    device = family(name)
    if form == "planes" and not device.packed:
        pytest.skip("takes no bit-planes")
    manifest = export(tmp_path / "p", grey(28, rails=1), device=device, format=form).manifest
    with (tmp_path / "p" / "patterns.csv").open() as file:
        rows = list(csv.DictReader(file))
    assert [int(row["pattern"]) for row in rows] == list(range(32))
    lasting = [int(row["exposure_us"]) + int(row["dark_us"]) for row in rows]
    assert sum(lasting) * 1e-6 == pytest.approx(manifest.pass_s)
    assert [row["shows"] for row in rows[:3]] == ["all ON", "all OFF", "mask 0, plus"]
    assert {float(row["settle_us"]) for row in rows} == {device.settle_us}
    assert all((tmp_path / "p" / row["image"]).is_file() for row in rows)
    pictures = {"npy": 1, "raw": 1, "planes": 2}.get(form, 32)
    assert len({row["image"] for row in rows}) == pictures
    assert (tmp_path / "p" / "settings.txt").exists() == (name == "dlp6500" and form == "bmp")


def test_pictures_that_were_changed_are_found(tmp_path):
    export(tmp_path / "p", device=family("dlp6500"), format="planes")
    path = tmp_path / "p" / "images" / "0000.bmp"
    whole = path.read_bytes()
    changed = bytearray(whole)
    changed[-4 * 112 + 3 * 18] ^= 0b100  # bit position 2, the first mask
    path.write_bytes(changed)
    with pytest.raises(InputError, match=r"frame 2 of .*\(mask 0, plus\) is not what was exported"):
        check_patterns(tmp_path / "p")
    path.write_bytes(whole[:-100])
    with pytest.raises(InputError, match="cannot be read"):
        check_patterns(tmp_path / "p")
    export(
        tmp_path / "q", device=family("dlp6500").model_copy(update={"columns": 40}), format="planes"
    )
    shutil.copy(tmp_path / "q" / "images" / "0000.bmp", path)
    with pytest.raises(InputError, match="is a 40 x 26 BMP"):
        check_patterns(tmp_path / "p")


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        ({"shortest_us": 2000}, r"frame 0 \(all ON\) lasts 1000 µs, .* 2000 to"),
        ({"longest_us": 900}, r"frame 0 \(all ON\) lasts 1000 µs, .* to 900 µs"),
        ({"patterns": 13}, "14 frames do not fit dlp6500"),
        ({"video_us": 1000}, "shows all for one time"),
    ],
)
def test_check_finds_what_the_device_cannot_show(tmp_path, changes, message):
    """As where a manifest was written by hand."""
    export(tmp_path / "p", device=family("dlp6500"), format="npy")
    path = tmp_path / "p" / "manifest.json"
    manifest = json.loads(path.read_text())
    manifest["device"].update(changes)
    path.write_text(json.dumps({**manifest, "sha256": None}))
    with pytest.raises(InputError, match=message):
        check_patterns(tmp_path / "p")


@pytest.mark.parametrize(("name", "holds"), [("dlp6500", 400), ("dlp500yx", 400), ("dlp4500", 48)])
def test_more_frames_than_a_controller_holds_are_refused(tmp_path, name, holds):
    """With four sentinels; nothing is written, and what to do is said."""
    device = family(name)
    masks = grey(holds - 3, rails=1)
    with pytest.raises(InputError, match=rf"{holds + 1} frames do not fit .*fewer masks"):
        export(tmp_path / "p", masks, device=device)
    assert not list(tmp_path.iterdir())
    export(tmp_path / "p", masks[:, 1:], device=device, format="npy")
    check_patterns(tmp_path / "p")
