"""Events of other counters: a PTU file with the same events, or one line."""

import numpy as np
import ptufile
import pytest

from deepfsi.base.errors import InputError
from deepfsi.counting.events import read_events, write_ptu

RNG = np.random.default_rng(5)
TIMES = 10**9 + np.sort(RNG.integers(0, 10**6, 500))
CHANNELS = RNG.choice([2, 5, 7, 8], 500)
UNIT = 81e-12
TABLE = np.stack([TIMES, CHANNELS], axis=1)


@pytest.mark.parametrize("kind", ["ticks", "seconds"])
def test_events_are_those_of_the_ptu_file(tmp_path, kind):
    """Read back by ptufile: in order of time, the trigger as marker 0."""
    mixed = np.argsort(CHANNELS, kind="stable")  # taggers may write one channel after another
    times = TIMES[mixed] * UNIT if kind == "seconds" else TIMES[mixed]
    path = tmp_path / "p.ptu"
    made = write_ptu(path, times, CHANNELS[mixed], marker=8, inputs=(7, 2), tick_s=UNIT)
    assert made == (7, 2)
    with ptufile.PtuFile(path) as file:
        assert file.tags["MeasDesc_GlobalResolution"] == UNIT
        found = file.decode_records()
    assert len(found) == (CHANNELS != 5).sum()
    first = TIMES[CHANNELS != 5][0]
    for channel, code, marker in ((7, 0, 0), (2, 1, 0), (8, -1, 1)):
        ours = found["time"][(found["channel"] == code) & (found["marker"] == marker)]
        assert np.array_equal(ours, TIMES[channel == CHANNELS] - first)
    assert write_ptu(tmp_path / "all.ptu", TIMES, CHANNELS, marker=8) == (2, 5, 7)


@pytest.mark.parametrize("start", [-(10**12), 0, 2**53, 2**62])
def test_a_tagger_may_be_on_for_any_time(tmp_path, start):
    """Times in ps pass 2^53 after 2.5 hours; only their differences count."""
    np.savetxt(tmp_path / "tags.csv", np.add(TABLE, [start, 0]), "%d", ",")
    write_ptu(tmp_path / "p.ptu", *read_events(tmp_path / "tags.csv"), marker=8, tick_s=UNIT)
    with ptufile.PtuFile(tmp_path / "p.ptu") as file:
        found = np.sort(file.decode_records()["time"])
    assert np.array_equal(found, TIMES - TIMES[0])


FAR = TIMES * 1000  # 1 ms with ticks of 1 ps, whose order within 1 us is free
BACK = r"time runs back on channel 8, event \d+: from"


@pytest.mark.parametrize(
    ("times", "channels", "wanted", "said"),
    [
        (FAR, CHANNELS, (8, 2, 9), "channel 9 has no events"),
        (FAR, CHANNELS, (8, 2, 2), "each once"),
        # sorted by time, parts of a recording would lie over each other:
        (FAR % 2**29, CHANNELS, (8,), BACK),
        (np.where(np.arange(500) < 250, FAR, FAR - FAR[250]), CHANNELS, (8,), BACK),
    ],
)
def test_channels_and_clocks_that_cannot_be_are_refused(tmp_path, times, channels, wanted, said):
    marker, *inputs = wanted
    with pytest.raises(InputError, match=said):
        write_ptu(tmp_path / "p.ptu", times, channels, marker=marker, inputs=inputs)
    assert not (tmp_path / "p.ptu").exists()
