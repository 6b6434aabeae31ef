"""A fake of the Time Tagger's library that keeps its rules, in place of the real one."""

import sys
import threading
import types

import numpy as np

STARTED_PS = 5 * 10**17  # tags count from the start-up of the device: it has been on for days
TAG, ERROR, OVERFLOW_BEGIN, OVERFLOW_END, MISSED = range(5)
COLUMNS = ("times", np.int64), ("channels", np.int32), ("types", np.uint8), ("missed", np.uint16)


class TimeTagStream:
    """Tags of some channels since the last call, in blocks that end anywhere."""

    def __init__(self, tagger, n_max_events, channels):
        tagger.step(f"TimeTagStream {channels}")
        self.device, self.most, self.channels = tagger, n_max_events, channels
        self.device.given = self.device.tags()
        self.device.stream = self

    def getData(self):
        with self.device.lock:
            self.device.step("getData", note=False)
            given = self.device.given
            wanted = np.isin(given["channels"], self.channels) | (given["types"] > 0)
            size = self.most if self.device.synced else self.device.cut(np.count_nonzero(wanted))
            tags = {name: each[wanted][:size][: self.most] for name, each in given.items()}
            self.device.given = {name: each[wanted][size:] for name, each in given.items()}
            return types.SimpleNamespace(
                size=len(tags["times"]),
                getTimestamps=lambda: tags["times"],
                getChannels=lambda: tags["channels"],
                getEventTypes=lambda: tags["types"],
                getMissedEvents=lambda: tags["missed"],
            )

    def stop(self):
        self.device.steps.append("stop")
        self.device.stream = None


class Device:
    """The device and its library; a test gives it signals, as the `Writer` of a PTU file."""

    def __init__(self, trigger):
        self.trigger, self.steps, self.levels, self.lock = trigger, [], {}, threading.Lock()
        self.given, self.stream, rng = self.tags(), None, np.random.default_rng(0)
        self.cut = lambda count: int(rng.integers(0, count + 1))  # tags of those that have come
        self.synced = self.dead = self.used = False
        self.fail_at: dict[str, Exception] = {}

    @staticmethod
    def tags(**columns):
        size = len(columns["times"]) if columns else 0
        return {
            name: np.asarray(columns.get(name, np.zeros(size)), dtype) for name, dtype in COLUMNS
        }

    def step(self, name, note=True):
        if note:
            self.steps.append(name)
        if failure := self.fail_at.pop(name.partition(" ")[0], None):
            raise failure

    def add(self, **columns):
        """Give tags to the library, whose times count from zero."""
        with self.lock:
            more = self.tags(**columns)
            more["times"] = more["times"] + STARTED_PS
            self.given = {
                name: np.concatenate([each, more[name]]) for name, each in self.given.items()
            }

    def write(self, times, codes):
        """Give tags of a trigger, codes below 0, and of detectors."""
        self.add(times=times, channels=np.where(codes < 0, self.trigger, codes + 1))

    def create(self):
        self.step("createTimeTagger")
        if self.used:
            raise RuntimeError("No Time Tagger attached or already in use.")
        self.used = True
        return self

    def setTriggerLevel(self, channel, voltage):
        self.step("setTriggerLevel")
        self.levels[channel] = voltage

    def setStreamBlockSize(self, max_events, max_latency):
        self.step("setStreamBlockSize")
        assert 4096 <= max_events <= 32 * 2**20
        assert 1 <= max_latency <= 10000

    def sync(self, timeout=-1):
        self.step("sync")
        assert timeout > 0, "a device that is gone never answers"
        with self.lock:
            self.synced = self.stream is not None
        return not self.dead

    def free(self, tagger):
        assert tagger is self
        assert self.stream is None, "a stream is used after its tagger"
        self.steps.append("freeTimeTagger")
        self.used = False


def install(monkeypatch, trigger=8) -> Device:
    """Put the fake in place of the library that pip installs."""
    device = Device(trigger)
    module = types.ModuleType("Swabian.TimeTagger")
    module.TimeTagStream = TimeTagStream
    module.createTimeTagger, module.freeTimeTagger = device.create, device.free
    monkeypatch.setitem(sys.modules, "Swabian", types.ModuleType("Swabian"))
    monkeypatch.setitem(sys.modules, "Swabian.TimeTagger", module)
    return device
