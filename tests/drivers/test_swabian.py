"""Swabian's driver against a fake of the Time Tagger's library that keeps its rules."""

import sys

import numpy as np
import ptufile
import pytest
from driver_samples import check_counts, collect

from deepfsi.base.errors import InputError
from deepfsi.counting.reader import read_markers
from deepfsi.counting.streaming import FrameGates
from deepfsi_drivers import swabian
from drivers.swabian_fake import ERROR, MISSED, OVERFLOW_BEGIN, OVERFLOW_END, install

FRAME, FRAMES = 10**8, 12  # ps
GATES = FrameGates.of(10e-6, np.linspace(5e-6, 80e-6, FRAMES))


@pytest.fixture
def device(monkeypatch):
    return install(monkeypatch)


@pytest.fixture
def signals() -> tuple[np.ndarray, np.ndarray]:
    """Triggers at the start of frames, and photons of three channels: times and codes."""
    rng = np.random.default_rng(0)
    starts = np.arange(1, FRAMES + 2) * FRAME
    times = np.sort(np.append(starts, rng.integers(0, (FRAMES + 2) * FRAME, 6000)))
    return times, np.where(np.isin(times, starts), -1, rng.integers(0, 3, len(times)))


def test_counts_are_those_of_the_file_that_is_left(device, signals, tmp_path):
    path, times = tmp_path / "photons.ptu", signals[0]
    config = tmp_path / "levels.toml"
    config.write_text("[trigger_levels]\n1 = 0.1\n8 = -0.5\n")
    with swabian.TaggerCounter((2, 0), marker_bit=2, trigger=8, config=config) as counter:
        counter.start(path)
        counter.expect(GATES)
        counter.expect(FrameGates.of(10e-6, [0.0]))  # of the marker that ends the last frame
        for part in np.array_split(np.arange(len(times)), 50):
            device.write(times[part], signals[1][part])
        found = collect(counter, FRAMES)
    check_counts(found[:FRAMES], path, GATES, (2, 0), 1e-12)
    assert device.levels == {1: 0.1, 8: -0.5}
    assert "TimeTagStream [8, 3, 1]" in device.steps
    assert device.steps[-2:] == ["stop", "freeTimeTagger"]


def test_the_file_holds_every_tag_also_those_that_come_last(device, signals, tmp_path):
    """Read by another reader; tags that the device holds when the recording ends are taken."""
    path, (times, codes) = tmp_path / "photons.ptu", signals
    device.cut = lambda count: 0
    with swabian.TaggerCounter((0, 1, 2), trigger=8) as counter:
        counter.start(path)
        device.write(times, codes)
        counter.stop()
    with ptufile.PtuFile(path) as file:
        events = file.decode_records()
    events = events[(events["channel"] >= 0) | (events["marker"] > 0)]  # no overflows
    assert np.array_equal(events["time"], (times - times[0]).astype(np.uint64))
    assert np.array_equal(np.where(events["marker"] > 0, -1, events["channel"]), codes)


@pytest.mark.parametrize(
    ("kinds", "message"),
    [
        ({7: OVERFLOW_BEGIN, 8: MISSED, 9: MISSED, 10: OVERFLOW_END}, "overflowed .* lost 60 tags"),
        ({7: MISSED}, "overflowed 0.0007 s after its first tag, and lost 30 tags"),
        ({7: ERROR}, "error 0.0007 s after its first tag: check its clock"),
    ],
)
def test_what_is_lost_is_said_and_what_came_before_is_kept(device, tmp_path, kinds, message):
    path = tmp_path / "photons.ptu"
    times, types, missed = np.arange(20) * FRAME, np.zeros(20, int), np.zeros(20, int)
    for place, kind in kinds.items():
        types[place], missed[place] = kind, 30 * (kind == MISSED)
    device.cut = lambda count: count
    with swabian.TaggerCounter(trigger=8) as counter:
        counter.start(path)
        counter.expect(FrameGates.of(10e-6, [60e-6] * 20))
        device.add(times=times, channels=np.full(20, 8), types=types, missed=missed)
        with pytest.raises(InputError, match=message) as caught:
            collect(counter, 20)
        with pytest.raises(InputError, match=message):
            counter.stop()
        counter.stop()  # it was told
    assert "\n" not in str(caught.value)
    assert len(read_markers(path)[0]) == 7
    assert device.steps[-1] == "freeTimeTagger"


def test_a_loss_at_the_very_end_is_said_by_stop(device, tmp_path):
    device.cut = lambda count: 0
    lost = np.arange(9) == 5
    with swabian.TaggerCounter(trigger=8) as counter:
        counter.start(tmp_path / "photons.ptu")
        tags = {"times": np.arange(9), "channels": np.ones(9)}
        device.add(**tags, types=MISSED * lost, missed=3 * lost)
        with pytest.raises(InputError, match="lost 3 tags"):
            counter.stop()


@pytest.mark.parametrize("step", ["createTimeTagger", "setTriggerLevel", "TimeTagStream"])
def test_a_refusal_is_one_line_and_lets_go_of_the_device(device, tmp_path, step):
    device.fail_at[step] = RuntimeError("Got the USB error 'Failed'")
    config = tmp_path / "levels.toml"
    config.write_text("[trigger_levels]\n1 = 0.5\n")
    with (
        pytest.raises(InputError, match=r"the Time Tagger cannot .* USB error") as caught,
        swabian.TaggerCounter(trigger=-8, config=config) as counter,
    ):
        counter.start(tmp_path / "photons.ptu")
    assert "\n" not in str(caught.value)
    assert not device.used
    assert ("freeTimeTagger" in device.steps) == (step != "createTimeTagger")
    assert not (tmp_path / "photons.ptu").exists()


def test_a_device_that_is_gone_ends_the_run(device, tmp_path):
    """Whether the library says so, or no fence comes back."""
    with swabian.TaggerCounter(trigger=8) as counter:
        counter.start(tmp_path / "photons.ptu")
        device.dead = True
        with pytest.raises(InputError, match="does not answer"):
            counter.stop()
        device.dead = False
        counter.start(tmp_path / "again.ptu")
        device.fail_at["getData"] = RuntimeError("Connection lost")
        with pytest.raises(InputError, match="cannot hand over its tags: Connection lost"):
            counter.counts_since_marker(60)


def test_no_recording_is_written_over(device, tmp_path):
    (tmp_path / "photons.ptu").touch()
    with swabian.TaggerCounter(trigger=8) as counter, pytest.raises(InputError, match="already"):
        counter.start(tmp_path / "photons.ptu")


def test_the_library_is_found_by_either_name_or_its_lack_is_said(device, monkeypatch):
    module = sys.modules["Swabian.TimeTagger"]
    monkeypatch.setitem(sys.modules, "Swabian.TimeTagger", None)
    monkeypatch.setitem(sys.modules, "TimeTagger", module)
    with swabian.TaggerCounter(trigger=8):
        assert device.used
    monkeypatch.setitem(sys.modules, "TimeTagger", None)
    with pytest.raises(InputError, match="pip install Swabian-TimeTagger"):
        swabian.TaggerCounter(trigger=8).__enter__()
