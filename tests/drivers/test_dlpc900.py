"""The DLPC900's driver against a fake of hidapi that reads its bytes by the vendor's guide."""

import time

import numpy as np
import pytest
from dlpc900_fake import decode, install
from driver_samples import make_patterns

from deepfsi.base.errors import InputError
from deepfsi.base.progress import Progress
from deepfsi.camera.device import DEVICES, Device
from deepfsi.patterns.folder import Patterns
from deepfsi_drivers import dlpc900

SMALL = Device(name="small", columns=64, rows=24, shortest_us=105)


@pytest.fixture
def board(monkeypatch):
    return install(monkeypatch)


@pytest.fixture
def patterns(tmp_path):
    def make(light="free-dwell", format="npy", masks=50, device=SMALL, dwell=1e-3):
        return make_patterns(tmp_path / "p", device, masks, light, format, dwell, least=0.3)

    return make


def show(folder, passes=1, while_it_runs=lambda: None):
    """Show a folder; the shares of its loading that were reported."""
    shares = []
    with dlpc900.Dlpc900Projector() as projector:
        projector.load(Patterns.read(folder), Progress(lambda share, _: shares.append(share)))
        for _ in range(passes):
            projector.run()
            while_it_runs()
            projector.wait()
    return shares


@pytest.mark.parametrize(
    ("status", "settings"),
    [
        *((1, {"light": light, "format": form})
          for light in ("equal-dwell", "free-dwell") for form in ("npy", "bmp", "planes")),
        # 5, 24, 25 and 400 frames, the most that the table takes
        *((1, {"light": "equal-dwell", "masks": masks, "dwell": 105e-6})
          for masks in (1, 20, 21, 396)),
        (17, {}),  # two controllers get a half each
    ],
)  # fmt: skip
def test_a_pass_shows_every_frame_for_its_time(board, patterns, status, settings):
    """In their order, each with its marker; pictures are filled to the last bit."""
    board.status = status
    device = DEVICES["dlp6500"] if settings.get("format") == "planes" else SMALL
    folder = patterns(**settings, device=device)
    shares = show(folder, passes=2)
    frames, wanted = Patterns.read(folder).manifest.frames, list(Patterns.read(folder).frames())
    assert len(board.shown) == 2
    for shown in board.shown:
        for (frame, _, _), packed in zip(shown, wanted, strict=True):
            np.testing.assert_array_equal(frame, packed)
        assert [us for _, us, _ in shown] == [frame.picture_us for frame in frames]
        assert not any(dark for _, _, dark in shown)
    assert board.markers == 2 * len(wanted)
    assert len(board.pictures) == -(-len(wanted) // 24) * (1 + board.dual)
    assert shares == sorted(shares)
    assert shares[-1] == 1
    assert not board.opened


def test_every_picture_is_decoded_to_itself():
    rng = np.random.default_rng(0)
    for values in (1, 2, 3, 256):
        for columns in (1, 2, 127, 128, 129, 400):
            picture = rng.integers(0, values, (5, columns, 3), np.uint8)
            picture[3] = picture[2]
            picture[4, : columns // 2] = picture[3, : columns // 2]
            found = decode(dlpc900.encode_picture(picture), columns, 5)
            np.testing.assert_array_equal(found, picture)


@pytest.mark.parametrize(
    ("trouble", "words"),
    [
        ({"refuse": {0x0206: 3}}, "0x0206 with error 3"),
        ({"refuse": {0x1A2A: 8}}, "0x1A2A with error 8"),
        *(({"silent": {command}}, "does not answer") for command in (0x206, 0x1A0C)),
        ({"hardware": 5}, "hardware type 5"),
        ({"status": 3}, "hardware status 0x03"),
        ({"stuck": True}, "should have ended"),
    ],
    ids=str,
)
def test_trouble_is_one_line_and_the_board_is_closed(board, patterns, monkeypatch, trouble, words):
    if "silent" in trouble:
        monkeypatch.setattr(dlpc900, "REPLY_S", 0.05)
    monkeypatch.setattr(dlpc900, "LATEST_S", 0.05)
    folder = patterns()
    vars(board).update(trouble)
    with pytest.raises(InputError, match=words) as caught:
        show(folder)
    assert "\n" not in str(caught.value)
    assert not board.opened
    assert not board.busy or board.refuse or board.silent


@pytest.mark.parametrize(
    ("trouble", "error", "words"),
    [
        ({"unplugged": True}, InputError, "not sent.*connected"),
        ({"interrupt_at": 0}, KeyboardInterrupt, None),
    ],
)
def test_what_comes_while_a_pass_is_shown_ends_it(board, patterns, trouble, error, words):
    with pytest.raises(error, match=words):
        show(patterns(), while_it_runs=lambda: vars(board).update(trouble))
    assert not board.busy or board.unplugged
    assert not board.opened


def test_a_pass_does_not_end_before_its_time(board, patterns):
    """However soon the controller says that its sequencer stands, as before the first pattern."""
    folder, begun = patterns(), []

    def at_once():
        board.busy = 0
        begun.append(time.monotonic())

    show(folder, while_it_runs=at_once)
    assert time.monotonic() - begun[0] >= Patterns.read(folder).manifest.pass_s


def test_a_second_start_waits_for_the_first(board, patterns):
    board.stuck = True
    with dlpc900.Dlpc900Projector() as projector:
        projector.load(Patterns.read(patterns()))
        projector.run()
        with pytest.raises(InputError, match="still shows"):
            projector.run()
        projector.halt()
        projector.run()
    assert len(board.shown) == 2
    assert not board.busy


@pytest.mark.parametrize("report", [0, 40, *range(208, 216)])
def test_ctrl_c_stops_and_closes_after_the_whole_command(board, patterns, report):
    """Reports of the stop are not taken as the rest of a command that Ctrl-C cut."""
    folder = patterns("equal-dwell", masks=200)
    board.interrupt_at = report
    with pytest.raises(KeyboardInterrupt):
        show(folder)
    assert board.interrupt_at is None
    assert board.commands[-1] == (0x1A24, b"\0") or report == 0
    assert not board._message
    assert not board.opened
