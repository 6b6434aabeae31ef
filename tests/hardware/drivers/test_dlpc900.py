"""The DLPC900's driver against a fake of hidapi that reads its bytes by the vendor's guide."""

import time

import numpy as np
import pytest
from dlpc900_fake import decode, install
from driver_samples import make_patterns

from deepfsi.base import InputError, Progress
from deepfsi.camera import DEVICES, Device
from deepfsi.hardware.drivers import dlpc900
from deepfsi.hardware.patterns import read_frames, read_patterns

SMALL = Device(name="small", columns=64, rows=24, shortest_us=105)


@pytest.fixture
def board(monkeypatch):
    return install(monkeypatch)


def patterns(folder, light="free-dwell", format="npy", masks=50, device=SMALL, dwell=1e-3):
    return make_patterns(folder, device, masks, light, format, dwell, least=0.3)


def show(folder, passes=1, while_it_runs=lambda: None):
    with dlpc900.Dlpc900Projector() as projector:
        projector.load(folder)
        for _ in range(passes):
            projector.run()
            while_it_runs()
            projector.wait()


def check_shown(board, folder, passes=1):
    """What was shown is the folder's frames in their order, each for its time with its marker."""
    manifest = read_patterns(folder).manifest
    wanted = list(read_frames(folder))
    assert len(board.shown) == passes
    for shown in board.shown:
        assert len(shown) == len(wanted)
        for (frame, _, _), packed in zip(shown, wanted, strict=True):
            np.testing.assert_array_equal(frame, packed)
        assert [us for _, us, _ in shown] == [frame.picture_us for frame in manifest.frames]
        assert not any(dark for _, _, dark in shown)
    assert board.markers == passes * len(wanted)


@pytest.mark.parametrize("format", ["npy", "png", "planes"])
@pytest.mark.parametrize("light", ["equal-dwell", "free-dwell"])
def test_a_pass_shows_every_frame_for_its_time(board, tmp_path, light, format):
    device = DEVICES["dlp6500"] if format == "planes" else SMALL
    folder = patterns(tmp_path / "patterns", light, format, device=device)
    show(folder, passes=2)
    check_shown(board, folder, passes=2)
    times = {us for _, us, _ in board.shown[0]}
    assert len(times) == 1 if light == "equal-dwell" else len(times) > 20
    assert not board.opened


@pytest.mark.parametrize("masks", [1, 20, 21, 396])
def test_pictures_are_filled_to_the_last_bit(board, tmp_path, masks):
    """5, 24, 25 and 400 frames, the most that the table takes."""
    folder = patterns(tmp_path / "patterns", "equal-dwell", masks=masks, dwell=105e-6)
    show(folder)
    check_shown(board, folder)
    assert len(board.pictures) == -(-(masks + 4) // 24)


def test_two_controllers_get_a_half_each(board, tmp_path):
    board.status |= 16
    folder = patterns(tmp_path / "patterns")
    show(folder)
    check_shown(board, folder)
    assert {side for side, _ in board.pictures} == {0, 1}


def test_every_picture_is_decoded_to_itself():
    rng = np.random.default_rng(0)
    for values in (1, 2, 3, 256):
        for columns in (1, 2, 127, 128, 129, 400):
            picture = rng.integers(0, values, (5, columns, 3), np.uint8)
            picture[3] = picture[2]
            picture[4, : columns // 2] = picture[3, : columns // 2]
            found = decode(dlpc900.encode_picture(picture), columns, 5)
            np.testing.assert_array_equal(found, picture)


def test_lines_that_repeat_cost_a_few_bytes():
    """The guide's example of its table, and a line for which the one above stands."""
    line = [4, 5, 6] * 3 + [0x77] * 15 + [4, 5, 6, 7, 8, 9, 10, 11, 12] + [1, 2, 3] * 130
    picture = np.tile(np.array(line, np.uint8).reshape(1, -1, 3), (2, 1, 1))
    body = dlpc900.encode_picture(picture)[48:]
    first = bytes.fromhex("03040506 05777777 00030405060708090A0B0C 8201010203")
    columns = len(line) // 3
    assert body == first + bytes([0, 1, columns & 127 | 128, columns >> 7]) + bytes([0, 1, 0])


def test_progress_reaches_the_end(board, tmp_path):
    folder, shares = patterns(tmp_path / "patterns"), []
    with dlpc900.Dlpc900Projector() as projector:
        projector.load(folder, Progress(lambda share, _: shares.append(share)))
    assert shares == sorted(shares)
    assert shares[-1] == 1
    assert len(shares) > 5


def test_more_frames_than_the_table_takes_are_refused_before_anything_is_sent(board, tmp_path):
    folder = patterns(tmp_path / "patterns", "equal-dwell", masks=397)
    with pytest.raises(InputError, match="401 frames do not fit dlp6500"):
        show(folder)
    assert {command for command, _ in board.commands} == {0x0206, 0x1A0A, 0x1A24}


def test_exposures_shorter_than_the_shortest_are_refused_before_anything_is_sent(board, tmp_path):
    fast = SMALL.model_copy(update={"shortest_us": 44})
    folder = patterns(tmp_path / "patterns", "equal-dwell", device=fast, dwell=104e-6)
    with pytest.raises(InputError, match="lasts 104 µs, and dlp6500 shows 105"):
        show(folder)
    assert {command for command, _ in board.commands} == {0x0206, 0x1A0A, 0x1A24}


@pytest.mark.parametrize(
    ("command", "code", "words"),
    [
        (0x0206, 3, "invalid command number"),
        (0x1A1B, 5, "not allowed in its mode"),
        (0x1A34, 14, "exposure is out of range"),
        (0x1A31, 15, "pattern number is out of range"),
        (0x1A2A, 8, "out of memory"),
        (0x1A2B, 9, "compression"),
        (0x1A0C, 255, "internal error"),
        (0x1A24, 77, "error 77"),
    ],
)
def test_an_error_of_the_controller_is_one_line(board, tmp_path, command, code, words):
    folder = patterns(tmp_path / "patterns")
    board.refuse = {command: code}
    with pytest.raises(InputError, match=words) as caught:
        show(folder)
    assert "\n" not in str(caught.value)
    assert f"0x{command:04X}" in str(caught.value)
    assert not board.opened


@pytest.mark.parametrize("command", [0x0206, 0x1A34, 0x1A0C, 0x0100])
def test_a_controller_that_does_not_answer_is_named(board, tmp_path, monkeypatch, command):
    monkeypatch.setattr(dlpc900, "REPLY_S", 0.05)
    board.silent = {command}
    with pytest.raises(InputError, match="does not answer") as caught:
        show(patterns(tmp_path / "patterns"))
    assert "\n" not in str(caught.value)
    assert not board.opened


@pytest.mark.parametrize(
    ("hardware", "status", "words"),
    [(5, 1, "hardware type 5"), (1, 0, "hardware status 0x00"), (1, 3, "hardware status 0x03")],
)
def test_a_board_that_is_not_ready_is_refused(board, hardware, status, words):
    board.hardware, board.status = hardware, status
    with pytest.raises(InputError, match=words), dlpc900.Dlpc900Projector():
        pass
    assert not board.opened


def test_a_board_that_is_unplugged_is_named(board, tmp_path):
    def unplug():
        board.unplugged = True

    with pytest.raises(InputError, match=r"not sent.*connected") as caught:
        show(patterns(tmp_path / "patterns"), while_it_runs=unplug)
    assert "\n" not in str(caught.value)
    assert not board.opened


def test_a_pass_that_does_not_end_is_named(board, tmp_path, monkeypatch):
    monkeypatch.setattr(dlpc900, "LATEST_S", 0.05)
    board.stuck = True
    with pytest.raises(InputError, match="should have ended"):
        show(patterns(tmp_path / "patterns"))
    assert not board.busy


def test_a_pass_does_not_end_before_its_time(board, tmp_path):
    """However soon the controller says that its sequencer stands, as before the first pattern."""
    folder = patterns(tmp_path / "patterns")
    begun = []

    def at_once():
        board.busy = 0
        begun.append(time.monotonic())

    show(folder, while_it_runs=at_once)
    assert time.monotonic() - begun[0] >= read_patterns(folder).manifest.pass_s


def test_a_second_start_waits_for_the_first(board, tmp_path):
    board.stuck = True
    with dlpc900.Dlpc900Projector() as projector:
        projector.load(patterns(tmp_path / "patterns"))
        projector.run()
        with pytest.raises(InputError, match="still shows"):
            projector.run()
        projector.halt()
        projector.run()
    assert len(board.shown) == 2
    assert not board.busy


@pytest.mark.parametrize("report", [0, 3, 40, *range(208, 224)])
def test_ctrl_c_stops_and_closes_after_the_whole_command(board, tmp_path, report):
    """Reports of the stop are not taken as the rest of a command that Ctrl-C cut."""
    folder = patterns(tmp_path / "patterns", "equal-dwell", masks=200)
    board.interrupt_at = report
    with pytest.raises(KeyboardInterrupt):
        show(folder)
    assert board.interrupt_at is None
    assert board.commands[-1] == (0x1A24, b"\0") or report == 0
    assert not board._message
    assert not board.opened


def test_ctrl_c_while_a_pass_is_shown_stops_it(board, tmp_path):
    def interrupt():
        board.interrupt_at = 0

    with pytest.raises(KeyboardInterrupt):
        show(patterns(tmp_path / "patterns"), while_it_runs=interrupt)
    assert not board.busy
    assert not board.opened


def test_nothing_is_shown_without_frames(board, tmp_path):
    with dlpc900.Dlpc900Projector() as projector:
        with pytest.raises(InputError, match="load"):
            projector.run()
        folder = patterns(tmp_path / "patterns")
        projector.load(folder)
        board.refuse = {0x1A34: 8}
        with pytest.raises(InputError, match="memory"):
            projector.load(folder)
        board.refuse = {}
        with pytest.raises(InputError, match="load"):
            projector.run()


def test_replies_to_earlier_commands_are_passed_over(board):
    """Such as that to a command before Ctrl-C."""
    with dlpc900.Dlpc900Projector() as projector:
        board.replies.append([0x60, 250, *[0] * 62])  # of another command, which failed
        projector.halt()
    assert not board.replies
