"""PicoQuant's driver against a fake of snAPI that keeps its rules."""

import sys
import threading
import types
from enum import Enum

import numpy as np
import pytest
from driver_samples import check_counts, collect

from deepfsi.base.errors import InputError
from deepfsi.counting.events import PtuWriter
from deepfsi.counting.reader import PtuFile
from deepfsi.counting.streaming import FrameGates
from deepfsi_drivers import picoquant

TICK_S, FRAME = 5e-12, 10**7
GATES = FrameGates.of(10e-6, np.linspace(5e-6, 30e-6, 12))


class MeasMode(Enum):
    T2 = 2


class Raw:
    """Records handed over in blocks, in one buffer that the next block overwrites."""

    def __init__(self, api):
        self.api, self.running, self.left = api, False, None

    def startBlock(self, acqTime, size, savePTU):
        assert not savePTU
        assert 0 < acqTime <= 360_000_000
        self.buffer = np.zeros(size, np.uint32)
        self.left = np.split(self.api.words, np.sort(self.api.cuts))
        self.running = self.api.step("startBlock")
        return self.running

    def getBlock(self):
        assert self.running
        come = self.left and self.api.shown.is_set()
        block = self.left.pop(0) if come else self.buffer[:0]
        self.buffer[:] = 0xFFFFFFFF
        self.buffer[: len(block)] = block
        return self.buffer[: len(block)]

    def isFinished(self):
        return self.api.dead and not self.left

    def stopMeasure(self):
        self.api.steps.append("stopMeasure")
        self.running = False


class Api:
    """The class `snAPI`, as far as the driver may use it, and its `device`."""

    steps: list[str]
    refused: set[str]
    words: np.ndarray
    cuts: np.ndarray
    shown: threading.Event  # records come once frames are shown
    made: list["Api"]
    dead = False

    def __init__(self):
        self.made.append(self)
        self.device, self.raw, self.deviceConfig = self, Raw(self), ()

    def step(self, name, *values):
        self.steps.append(" ".join(map(str, (name, *values))))
        return name not in self.refused

    def getDevice(self, *serial):
        return self.step("getDevice", *serial)

    def initDevice(self, mode):
        assert mode is MeasMode.T2
        self.deviceConfig = {"BaseResolution": TICK_S * 1e12, "Resolution": 80.0}
        return self.step("initDevice")

    def loadIniConfig(self, path):
        return self.step("loadIniConfig", path)

    def setMarkerEdges(self, *edges):
        return self.step("setMarkerEdges", *edges)

    def setMarkerEnable(self, *enabled):
        return self.step("setMarkerEnable", *enabled)

    def setOflCompression(self, holdtime):
        assert holdtime == 0
        return False  # as devices answer that cannot

    def closeDevice(self):
        self.steps.append("closeDevice")


@pytest.fixture
def api(monkeypatch, tmp_path):
    """A fake whose device records 12 frames, a marker of bit 2 at the start of each."""
    rng = np.random.default_rng(0)
    starts = np.arange(1, 13) * FRAME
    times = np.sort(np.append(starts, rng.integers(0, 14 * FRAME, 4000)))
    codes = np.where(np.isin(times, starts), -2, rng.integers(0, 3, len(times)))
    with PtuWriter(tmp_path / "made.ptu", TICK_S) as writer:
        writer.write(times, codes)
    header = PtuFile(tmp_path / "made.ptu").header
    words = np.fromfile(header.path, "<u4", offset=header.offset)
    state = {"steps": [], "refused": set(), "words": words, "made": []}
    state["shown"] = threading.Event()
    fake = type("snAPI", (Api,), {**state, "cuts": rng.integers(0, len(words), 100)})
    module = types.ModuleType("snAPI.Main")
    module.snAPI, module.MeasMode = fake, MeasMode
    monkeypatch.setitem(sys.modules, "snAPI", types.ModuleType("snAPI"))
    monkeypatch.setitem(sys.modules, "snAPI.Main", module)
    return fake


def test_counts_are_those_of_the_file_that_is_left(api, tmp_path):
    path, settings = tmp_path / "photons.ptu", {"serial": "1045483", "config": tmp_path / "a.ini"}
    settings["config"].touch()
    with picoquant.SnapiCounter((2, 0), marker_bit=2, **settings) as counter:
        counter.start(path)
        counter.expect(GATES)
        api.shown.set()
        found = collect(counter, 12)
    check_counts(found, path, GATES, (2, 0), TICK_S)
    asked = "getDevice 1045483", f"loadIniConfig {settings['config']}"
    assert {*asked, "setMarkerEnable 0 1 0 0", "setMarkerEdges 0 1 0 0"} <= {*api.steps}
    assert api.steps[-2:] == ["stopMeasure", "closeDevice"]


@pytest.mark.parametrize(
    "step", ["getDevice", "initDevice", "setMarkerEdges", "setMarkerEnable", "startBlock"]
)
def test_a_refusal_is_one_line_and_lets_go_of_the_device(api, tmp_path, step):
    api.refused.add(step)
    with (
        pytest.raises(InputError, match="the PicoQuant device cannot") as caught,
        picoquant.SnapiCounter() as counter,
    ):
        counter.start(tmp_path / "photons.ptu")
    assert "\n" not in str(caught.value)
    assert api.steps[-1] == "closeDevice"
    assert not (tmp_path / "photons.ptu").exists()


def test_a_device_that_stops_and_records_that_are_lost_are_named(api, tmp_path):
    api.dead = True
    api.shown.set()
    with picoquant.SnapiCounter(marker_bit=4) as counter:
        counter.start(tmp_path / "photons.ptu")
        counter.expect(GATES)
        with pytest.raises(InputError, match="stopped by itself"):
            counter.counts_since_marker(60)
        with pytest.raises(InputError, match="stopped by itself"):
            counter.counts_since_marker(0.0)
    longest = int(np.diff(np.sort(api.cuts)).max())
    with picoquant.SnapiCounter(marker_bit=4, buffer=longest) as counter:
        counter.start(tmp_path / "other.ptu")
        with pytest.raises(InputError, match="a larger `buffer`"):
            collect(counter, 1)


def test_records_are_counted_while_nobody_asks(api, tmp_path):
    with picoquant.SnapiCounter(marker_bit=2) as counter:
        counter.start(tmp_path / "photons.ptu")
        counter.expect(GATES)
        (made,) = api.made
        api.shown.set()
        while made.raw.left:
            threading.Event().wait(0.001)
        assert len(collect(counter, 12)) == 12
        assert len(counter.counts_since_marker(0.0)) == 0
