"""Time stamps of other counters: a PTU file with the same events, or one line."""

from pathlib import Path

import h5py
import numpy as np
import ptufile
import pytest

from deepfsi.base.errors import InputError
from deepfsi.hardware.photons.timestamps import read_timestamps

RNG = np.random.default_rng(5)
TIMES = 10**9 + np.sort(RNG.integers(0, 10**6, 500))
CHANNELS = RNG.choice([2, 5, 7, 8], 500)
UNIT = 81e-12


PHOTON_HDF5 = {
    "photon_data/timestamps": TIMES,
    "photon_data/detectors": CHANNELS.astype(np.uint8),
    "photon_data/timestamps_specs/timestamps_unit": UNIT,
}
"""Fields of the format's specification that tell events."""

TABLE = np.stack([TIMES, CHANNELS], axis=1)


def put(path: Path, content: dict | np.ndarray | str) -> None:
    """A file of datasets, of an array or of text."""
    if isinstance(content, dict):
        with h5py.File(path, "w") as file:
            file.update(content)
    elif isinstance(content, str):
        path.write_text(content)
    elif path.suffix == ".npy":
        np.save(path, content)
    else:
        np.savetxt(path, content, "%s", header="as a time tagger writes it")


@pytest.mark.parametrize("name", ["tags.h5", "tags.txt", "tags.npy"])
def test_events_of_every_file_are_those_of_the_ptu_file(tmp_path, name):
    """Read back by ptufile: in order of time, the trigger as marker 0."""
    mixed = np.argsort(CHANNELS, kind="stable")  # taggers may write one channel after another
    if np.ptp(TIMES[mixed[3:5]]) * UNIT < 1e-6:
        mixed[[3, 4]] = mixed[[4, 3]]
    put(tmp_path / name, PHOTON_HDF5 if name == "tags.h5" else TABLE[mixed])
    stamps = read_timestamps(tmp_path / name, None if name == "tags.h5" else UNIT)
    assert stamps.write(tmp_path / "p.ptu", 8, (7, 2)) == (7, 2)
    with ptufile.PtuFile(tmp_path / "p.ptu") as file:
        assert file.tags["MeasDesc_GlobalResolution"] == UNIT
        found = file.decode_records()
    assert len(found) == (CHANNELS != 5).sum()
    first = TIMES[CHANNELS != 5][0]
    for channel, code, marker in ((7, 0, 0), (2, 1, 0), (8, -1, 1)):
        ours = found["time"][(found["channel"] == code) & (found["marker"] == marker)]
        assert np.array_equal(ours, TIMES[channel == CHANNELS] - first)
    assert stamps.write(tmp_path / "all.ptu", 8) == (2, 5, 7)


@pytest.mark.parametrize(
    ("name", "content", "unit", "said"),
    [
        ("bare.h5", dict(list(PHOTON_HDF5.items())[:2]), None, "no unit of its .*: give `unit`"),
        ("short.h5", PHOTON_HDF5 | {"photon_data/timestamps": TIMES[1:]}, None, "499 .* 500 det"),
        ("other.h5", {"x": TIMES}, None, "it lacks photon_data/timestamps"),
        ("none.h5", None, None, "there is no file"),
        ("three.txt", np.ones((4, 3)), 1e-12, "has 3 columns: give two, the time and the channel"),
        ("three.csv", "time,channel,t\n1,2,3", 1e-12, r"3 columns \(time, channel, t\): give two"),
        ("half.txt", np.array([[0.5, 1]]), 1e-12, "holds 0.5: give whole numbers"),
        ("swapped.txt", TABLE[:, ::-1], UNIT, "different numbers in its column of channels, and"),
        ("rounded.npy", np.add(TABLE, [2.0**54, 0]), UNIT, "above 2.53, here to the nearest 4"),
        ("odd.csv", "time_ns,channel\n1,2", 1e-12, "units of 1e-09 s, and `unit` is 1e-12 s"),
        ("run.ptu", "PQTTTR\0\0" + 100 * " ", None, "is a PTU file already"),
        ("run.ht3", "HydraHarp" + 100 * " ", None, "older format"),
        ("tags.txt", TABLE, None, "no unit of its times"),
        ("tags.txt", TABLE, 5.0, "units of 5 s"),
    ],
)
def test_what_tells_no_events_is_one_line(tmp_path, name, content, unit, said):
    if content is not None:
        put(tmp_path / name, content)
    with pytest.raises(InputError, match=said) as error:
        read_timestamps(tmp_path / name, unit)
    assert "\n" not in str(error.value)


@pytest.mark.parametrize(
    ("heading", "order", "unit"),
    [
        ("channel,time", (1, 0), None),
        ("Time (ps),Channel", (0, 1), 1e-12),
        ("ch,timestamp_ns", (1, 0), 1e-9),
        ("event,t", (1, 0), None),
        ("index,Detector,Macro Time [us],flag", (2, 1), 1e-6),
        ("clicks,channel", (0, 1), None),
        ("a,b", (0, 1), None),
    ],
)
def test_names_of_columns_tell_times_channels_and_the_unit(tmp_path, heading, order, unit):
    names = heading.split(",")
    rows = np.zeros((len(TIMES), len(names)), np.int64)
    rows[:, order[0]], rows[:, order[1]] = TIMES, CHANNELS
    path = tmp_path / "tags.csv"
    np.savetxt(path, rows, "%d", ",", header=heading, comments="")
    stamps = read_timestamps(path, None if unit else UNIT)
    assert stamps.tick_s == (unit or UNIT)
    assert np.array_equal(stamps.times, TIMES)
    assert np.array_equal(stamps.channels, CHANNELS)


@pytest.mark.parametrize("start", [-(10**12), 0, 2**53, 2**62])
def test_a_tagger_may_be_on_for_any_time(tmp_path, start):
    """Times in ps pass 2^53 after 2.5 hours; only their differences count."""
    put(tmp_path / "tags.txt", np.add(TABLE, [start, 0]))
    read_timestamps(tmp_path / "tags.txt", UNIT).write(tmp_path / "p.ptu", 8)
    with ptufile.PtuFile(tmp_path / "p.ptu") as file:
        found = np.sort(file.decode_records()["time"])
    assert np.array_equal(found, TIMES - TIMES[0])


FAR = TIMES * 1000  # 1 ms with ticks of 1 ps, whose order within 1 us is free
BACK = r"time runs back on channel 8, event \d+: from"


@pytest.mark.parametrize(
    ("times", "channels", "given", "said"),
    [
        (FAR, CHANNELS, (3,), "channel 3 has no events; there are some on 2, 5, 7, 8"),
        (FAR, CHANNELS, (8, (2, 9)), "channel 9 has no events"),
        (FAR, CHANNELS, (8, (8, 2)), "each once"),
        (FAR, CHANNELS, (8, (2, 2)), "each once"),
        # sorted by time, parts of a recording would lie over each other:
        (FAR % 2**29, CHANNELS, (8,), BACK),
        (np.where(np.arange(500) < 250, FAR, FAR - FAR[250]), CHANNELS, (8,), BACK),
        (np.tile(FAR, 2), np.tile(CHANNELS, 2), (8,), BACK),
        (RNG.permutation(FAR), CHANNELS, (8,), BACK),
        # events that stand twice:
        (np.repeat(FAR, 2), np.repeat(CHANNELS, 2), (8,), "channel 8 of the trigger .* once"),
        (np.r_[0, np.repeat(FAR, 2)], np.r_[8, np.full(1000, 1)], (8,), "1 has 50. of its 1000"),
    ],
)
def test_channels_and_clocks_that_cannot_be_are_refused(tmp_path, times, channels, given, said):
    put(tmp_path / "tags.npy", np.stack([times, channels], axis=1))
    stamps = read_timestamps(tmp_path / "tags.npy", 1e-12)
    with pytest.raises(InputError, match=said):
        stamps.write(tmp_path / "p.ptu", *given)
    assert not (tmp_path / "p.ptu").exists()
