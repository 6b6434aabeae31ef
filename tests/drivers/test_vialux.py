"""Vialux's driver against a fake of ALP4lib that keeps its rules."""

import numpy as np
import pytest
from driver_samples import make_patterns
from vialux_fake import DEVICE, install

from deepfsi.base.errors import InputError
from deepfsi.base.progress import Progress
from deepfsi.camera.device import Device
from deepfsi.patterns.folder import Patterns
from deepfsi_drivers import vialux


@pytest.fixture
def library(monkeypatch):
    return install(monkeypatch)


@pytest.fixture
def patterns(tmp_path):
    def make(light="free-dwell", format="npy", masks=70, device=DEVICE, dwell=1e-3):
        folder = tmp_path / f"{device.columns} {dwell}"
        return make_patterns(folder, device, masks, light, format, dwell)

    return make


def show(folder, while_it_runs=lambda: None):
    with vialux.VialuxProjector() as projector:
        projector.load(Patterns.read(folder))
        projector.run()
        while_it_runs()
        projector.wait()


@pytest.mark.parametrize("format", ["npy", "bmp", "raw"])
@pytest.mark.parametrize("light", ["equal-dwell", "free-dwell"])
def test_a_pass_shows_every_frame_for_its_time(library, patterns, light, format):
    folder = patterns(light, format)
    shares = []
    with vialux.VialuxProjector() as projector:
        projector.load(Patterns.read(folder), Progress(lambda share, _: shares.append(share)))
        loaded = dict(library.sequences)
        for _ in range(2):
            projector.run()
            projector.wait()
    shown = library.shown[: len(library.shown) // 2]
    assert shown == library.shown[len(shown) :]
    frames = [loaded[s]["frames"][place] for s in shown for place in range(loaded[s]["count"])]
    times = [loaded[s]["us"] for s in shown for _ in range(loaded[s]["count"])]
    manifest = Patterns.read(folder).manifest
    assert times == [frame.picture_us for frame in manifest.frames]
    assert len(set(times)) == (1 if light == "equal-dwell" else len(set(times[2:-2])) + 1)
    assert len(shown) == (1 if light == "equal-dwell" else len(manifest.frames) - 2)
    for frame, wanted in zip(frames, Patterns.read(folder).frames(), strict=True):
        np.testing.assert_array_equal(frame, wanted.ravel())
    modes = {sequence["controls"][vialux.Alp.BIN_MODE] for sequence in loaded.values()}
    assert modes == {vialux.Alp.BIN_UNINTERRUPTED}
    assert shares == sorted(shares)
    assert shares[-1] == 1
    assert not library.allocated


@pytest.mark.parametrize("columns", [1024, 1920, 1280, 60])
def test_rows_of_every_length_reach_the_mirrors(library, patterns, columns):
    """ALP pads the packed rows of 1080p devices to 256 bytes, and says of some not how."""
    device = Device(name="wide", columns=columns, rows=24)
    library.size = columns, 24
    folder = patterns("equal-dwell", masks=3, device=device)
    with vialux.VialuxProjector() as projector:
        projector.load(Patterns.read(folder))
        [sequence] = library.sequences.values()
        for place, wanted in enumerate(Patterns.read(folder).frames()):
            np.testing.assert_array_equal(sequence["frames"][place], wanted.ravel())


def test_numbers_that_the_device_is_told_are_those_of_its_header():
    """The fake takes its numbers from the driver, so it cannot know a wrong one."""
    asked = {"AVAIL_MEMORY": 2003, "QUEUE_AVAIL": 2317, "PROJ_STATE": 2400, "PROJ_ACTIVE": 1200}
    asked |= {"MIN_PICTURE_TIME": 2211, "MAX_PICTURE_TIME": 2213, "FLUT_MAX_ENTRIES9": 2324}
    told = {"BIN_MODE": 2104, "BIN_UNINTERRUPTED": 2106}
    told |= {"DATA_FORMAT": 2110, "DATA_MSB_ALIGN": 0, "DATA_BINARY_TOPDOWN": 2}
    told |= {"QUEUE_MODE": 2314, "SEQUENCE_QUEUE": 1, "RESET_QUEUE": 2319, "DEFAULT": 0}
    told |= {"FLUT_MODE": 2118, "FLUT_9BIT": 1, "FLUT_18BIT": 2, "FLUT_ENTRIES9": 2120}
    told |= {"FLUT_WRITE_9BIT": 2325, "FLUT_WRITE_18BIT": 2326}
    for name, number in (asked | told).items():
        assert getattr(vialux.Alp, name) == number, name


@pytest.mark.parametrize(
    ("step", "failure", "words"),
    [
        ("__init__", OSError("no such library"), "no such library"),
        ("AlpDevAlloc", 1001, "Failure 1001"),
        ("ProjControl", 1099, "code 1099"),
        ("AlpProjInquire", 1012, "Failure 1012"),
        *((step, KeyboardInterrupt(), "^$")
          for step in ("AlpDevInquire", "ProjControl", "SeqPut", "Run")),
    ],
)  # fmt: skip
def test_a_refusal_is_one_line_and_frees_the_device_as_ctrl_c_does(
    library, patterns, step, failure, words
):
    folder = patterns()
    library.fail_at = {step: failure}
    wanted = KeyboardInterrupt if isinstance(failure, KeyboardInterrupt) else InputError
    with pytest.raises(wanted, match=words) as caught:
        show(folder)
    assert "\n" not in str(caught.value)
    assert not library.allocated
    assert not library.fail_at


def test_ctrl_c_while_waiting_halts_and_frees_even_where_halting_fails(library, patterns):
    folder = patterns()

    def trouble():
        library.fail_at = {"AlpProjInquire": KeyboardInterrupt(), "ProjControl": 1012}

    with pytest.raises(KeyboardInterrupt):
        show(folder, trouble)
    assert library.calls[-3:] == ["ProjControl", "Halt", "Free"]
    assert not library.allocated


def test_a_failed_cleanup_is_told_where_nothing_else_was_wrong(library):
    with pytest.raises(InputError, match="Failure 1012"), vialux.VialuxProjector():
        library.fail_at = {"Halt": 1012}
    assert library.calls[-1] == "Free"


def test_a_failed_load_leaves_nothing_to_run_and_another_replaces_it(library, patterns):
    folder = patterns()
    with vialux.VialuxProjector() as projector:
        library.fail_at = {"SeqPut": 1009}
        with pytest.raises(InputError, match="Failure 1009"):
            projector.load(Patterns.read(folder))
        assert not library.sequences
        with pytest.raises(InputError, match="load a pattern folder first"):
            projector.run()
        library.memory = 80  # room for these 74 frames once
        projector.load(Patterns.read(folder))
        projector.load(Patterns.read(folder))
        projector.run()


def test_what_the_device_cannot_show_is_refused(library, patterns):
    library.memory = 50
    for settings, words in (
        ({"device": Device(name="other", columns=72, rows=24)}, "made for 72 x 24 mirrors"),
        ({"light": "equal-dwell", "masks": 1, "dwell": 20.0}, "44 to 10000000 µs"),
        ({}, "has room for 50"),
    ):
        with pytest.raises(InputError, match=words):
            show(patterns(**settings))


def test_a_pass_that_still_runs_is_not_started_again(library, patterns):
    with vialux.VialuxProjector() as projector:
        projector.load(Patterns.read(patterns("equal-dwell", masks=3)))
        projector.run()
        library.stuck = True
        with pytest.raises(InputError, match="still shows a pass"):
            projector.run()
        projector.halt()
        projector.run()


@pytest.mark.parametrize("light", ["equal-dwell", "free-dwell"])  # waiting for the end, the queue
def test_a_device_that_never_ends_is_not_waited_for(library, patterns, monkeypatch, light):
    monkeypatch.setattr(vialux, "GRACE_S", 0.05)
    folder, one = patterns(light, masks=8), np.array([44e-6])
    with vialux.VialuxLooks() as projector:
        projector.load(Patterns.read(folder))
        projector.show(np.array([0]), one)
        library.stuck = True
        with pytest.raises(InputError, match="should have ended"):
            projector.show(np.array([1]), one)
    with pytest.raises(InputError, match="should have ended"):
        show(folder)


# Lists of frames


def test_a_list_repeats_frames_that_were_loaded_once(library, patterns):
    folder = patterns(masks=9)
    looks = [([0, 1], [100e-6, 44e-6]), ([12, 3, 3], [45e-6, 1e-6, 440e-6]), ([5], [1e-3])]
    with vialux.VialuxLooks() as projector:
        projector.load(Patterns.read(folder))
        (sequence,) = library.sequences.values()
        assert sequence["count"] == 13
        for frame, wanted in zip(
            sequence["frames"].values(), Patterns.read(folder).frames(), strict=True
        ):
            np.testing.assert_array_equal(frame, wanted.ravel())
        sent = library.calls.count("SeqPut")
        for frames, dwells in looks:
            projector.show(np.array(frames), np.array(dwells))
            shown, us = library.lists[-1]
            repeats, each_s = projector.pictures(np.array(dwells))
            assert (each_s == 44e-6).all()
            assert us == 44
            assert shown == np.repeat(frames, repeats).tolist()
            assert (repeats * 44e-6 >= np.array(dwells) * (1 - 1e-9)).all()
            assert ((repeats - 1) * 44e-6 < np.array(dwells)).all()
        assert library.calls.count("SeqPut") == sent
    assert [len(shown) for shown, _ in library.lists] == [4, 13, 23]
    assert not library.allocated


def test_a_frame_is_replaced_between_two_lists(library, patterns):
    folder = patterns(masks=3)
    other = np.flipud(list(Patterns.read(folder).frames())[2])
    with vialux.VialuxLooks() as projector:
        projector.load(Patterns.read(folder))
        projector.show(np.array([2, 1]), np.array([1e-3, 44e-6]))
        projector.replace(2, other)
        (sequence,) = library.sequences.values()
        for place, wanted in enumerate(Patterns.read(folder).frames()):
            kept = other if place == 2 else wanted
            np.testing.assert_array_equal(sequence["frames"][place], kept.ravel())
        projector.show(np.array([2, 1]), np.array([1e-3, 44e-6]))
    assert len(library.lists) == 2


def test_more_frames_than_nine_bits_name_take_entries_of_eighteen(library, patterns):
    with vialux.VialuxLooks() as projector:
        projector.load(Patterns.read(patterns("equal-dwell", masks=600)))
        projector.show(np.array([603, 511]), np.array([44e-6, 88e-6]))
        assert library.lists == [([603, 511, 511], 44)]
        with pytest.raises(InputError, match=r"a list of 2049 pictures .* takes 2048"):
            projector.show(np.zeros(2049, int), np.full(2049, 44e-6))
