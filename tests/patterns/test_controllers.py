"""Exports for each family of controllers, opened by readers written from their documents."""

import numpy as np
import pytest
from pattern_samples import export, family, grey
from vendor_readers import play_bitmaps, play_dlpc347x, play_dlpc350

from deepfsi.base.errors import InputError
from deepfsi.patterns.folder import Patterns


def exported(folder, device, form, **changes):
    """Mirrors and times of each frame, of an export as packed bits beside one in another format."""
    shown = export(folder / "packed", device=device, format="npy", **changes)
    bits = np.unpackbits(np.load(folder / "packed/frames.npy"), axis=2, count=device.columns)
    export(folder / form, device=device, format=form, **changes)
    return list(bits), [frame.picture_us for frame in shown.manifest.frames]


def assert_shown(played, mirrors, times, dark=0):
    assert len(played) == len(mirrors)
    for frame, wanted, us in zip(played, mirrors, times, strict=True):
        assert np.array_equal(frame.mirrors, wanted)
        assert (frame.exposure_us, frame.dark_us) == (us - dark, dark)


@pytest.mark.parametrize("name", ["dlp6500", "dlp9000", "dlp670s", "dlp500yx"])
def test_a_dlpc900_shows_every_frame_for_its_own_time(tmp_path, name):
    """33 masks of unlike dwells."""
    device, masks = family(name), grey(33, rails=1)
    masks[0, 3] /= 100
    mirrors, times = exported(tmp_path, device, "bmp", rails=masks)
    assert len({*times}) > 20
    assert min(times) == device.shortest_us
    assert_shown(play_bitmaps(tmp_path / "bmp"), mirrors, times)


def test_a_dlpc350_takes_green_red_and_blue_in_turn(tmp_path):
    masks = grey(27, pixels=12, rails=1)
    shown = exported(tmp_path, family("dlp4500"), "planes", rails=masks, image_shape=(3, 4))
    assert_shown(play_dlpc350(tmp_path / "planes"), *shown)


@pytest.mark.parametrize(("masks", "together"), [(44, 24), (45, 7), (42, 23)])
def test_a_dlpc347x_shows_whole_pictures_of_a_video(tmp_path, masks, together):
    """48, 49 and 46 frames, all for one time; no picture is shorter than a frame of the video."""
    rails = grey(masks, rails=1)
    mirrors, times = exported(tmp_path, family("dlp3010"), "planes", rails=rails, dwell_s=5e-4)
    assert len({*times}) == 1
    assert times[0] * together >= 1e6 / 104.2
    assert times[0] >= 1e6 / 2500
    played = play_dlpc347x(tmp_path / "planes", together, times[0] - 202, 202)
    assert_shown(played, mirrors, times, dark=202)


def test_a_number_of_frames_that_fills_no_pictures_is_refused(tmp_path):
    with pytest.raises(InputError, match=r"47 frames, 1 in each picture .* would last 9597 µs"):
        export(tmp_path / "p", grey(43, rails=1), device=family("dlp3010"), format="planes")
    assert not list(tmp_path.iterdir())


@pytest.mark.parametrize(("name", "holds"), [("dlp6500", 400), ("dlp4500", 48)])
def test_more_frames_than_a_controller_holds_are_refused(tmp_path, name, holds):
    """With four sentinels; nothing is written, and what to do is said."""
    device, masks = family(name), grey(holds - 3, rails=1)
    with pytest.raises(InputError, match=rf"{holds + 1} frames do not fit .*fewer masks"):
        export(tmp_path / "p", masks, device=device)
    assert not list(tmp_path.iterdir())
    export(tmp_path / "p", masks[:, 1:], device=device, format="npy")
    Patterns.read(tmp_path / "p").check()
