"""Time stamps of other counters: a PTU file with the same events, or one line."""

import json
import os
import shutil
from pathlib import Path

import h5py
import numpy as np
import ptufile
import pytest

from deepfsi.base import InputError
from deepfsi.hardware.photons import read_photons, read_timestamps
from deepfsi.hardware.photons.timestamps import Timestamps

RNG = np.random.default_rng(5)
TIMES = 10**9 + np.sort(RNG.integers(0, 10**6, 500))
CHANNELS = RNG.choice([2, 5, 7, 8], 500)
UNIT = 81e-12


def photon_hdf5(path, unit=UNIT, **fields) -> None:
    """Write the fields of the format's specification that tell events."""
    with h5py.File(path, "w") as file:
        file["photon_data/timestamps"] = fields.get("times", TIMES)
        file["photon_data/detectors"] = CHANNELS.astype(np.uint8)
        if unit:
            file["photon_data/timestamps_specs/timestamps_unit"] = unit


@pytest.mark.parametrize("name", ["tags.h5", "tags.txt", "tags.npy"])
def test_events_of_every_file_are_those_of_the_ptu_file(tmp_path, name):
    """Read back by ptufile: in order of time, the trigger as marker 0."""
    mixed = np.argsort(CHANNELS, kind="stable")  # taggers may write one channel after another
    mixed[[3, 4]] = mixed[[4, 3]] if np.ptp(TIMES[mixed[3:5]]) * UNIT < 1e-6 else mixed[[3, 4]]
    table = np.stack([TIMES, CHANNELS], axis=1)[mixed]
    if name == "tags.h5":
        photon_hdf5(tmp_path / name)
    elif name == "tags.txt":
        np.savetxt(tmp_path / name, table, "%d", header="as a time tagger writes it")
    else:
        np.save(tmp_path / name, table)
    stamps = read_timestamps(tmp_path / name, None if name == "tags.h5" else UNIT)
    assert stamps.write(tmp_path / "p.ptu", 8, (7, 2)) == (7, 2)
    with ptufile.PtuFile(tmp_path / "p.ptu") as file:
        assert file.tags["MeasDesc_GlobalResolution"] == UNIT
        found = file.decode_records()
    kept = CHANNELS != 5
    assert np.array_equal(np.sort(found["time"]), TIMES[kept] - TIMES[kept][0])
    for channel, code in ((7, 0), (2, 1)):
        ours = found["time"][(found["channel"] == code) & (found["marker"] == 0)]
        assert np.array_equal(ours, TIMES[channel == CHANNELS] - TIMES[kept][0])
    markers = found["time"][found["marker"] == 1]
    assert np.array_equal(markers, TIMES[CHANNELS == 8] - TIMES[kept][0])
    assert stamps.write(tmp_path / "all.ptu", 8) == (2, 5, 7)


def test_what_tells_no_events_is_one_line(tmp_path):
    photon_hdf5(tmp_path / "bare.h5", unit=None)
    photon_hdf5(tmp_path / "short.h5", times=TIMES[1:])
    with h5py.File(tmp_path / "other.h5", "w") as file:
        file["x"] = TIMES
    np.savetxt(tmp_path / "three.txt", np.ones((4, 3)))
    np.savetxt(tmp_path / "half.txt", [[0.5, 1]])
    np.savetxt(tmp_path / "swapped.txt", np.stack([CHANNELS, TIMES], axis=1), "%d")
    np.save(tmp_path / "rounded.npy", np.stack([TIMES + 2.0**54, CHANNELS], axis=1))
    (tmp_path / "odd.csv").write_text("time_ns,channel\n1,2\n")
    (tmp_path / "three.csv").write_text("time,channel,time\n1,2,3\n".replace(",time", ",t"))
    (tmp_path / "run.ptu").write_bytes(b"PQTTTR\0\0" + bytes(100))
    (tmp_path / "run.ht3").write_bytes(b"HydraHarp" + bytes(100))
    np.savetxt(tmp_path / "tags.txt", np.stack([TIMES, CHANNELS], axis=1), "%d")
    for name, unit, said in (
        ("bare.h5", None, "no unit of its times: give `unit`"),
        ("short.h5", None, "499 times and 500 detectors"),
        ("other.h5", None, "it lacks photon_data/timestamps"),
        ("none.h5", None, "there is no file"),
        ("three.txt", 1e-12, "has 3 columns: give two, the time and the channel"),
        ("three.csv", 1e-12, r"has 3 columns \(time, channel, t\): give two"),
        ("half.txt", 1e-12, "holds 0.5: give whole numbers"),
        ("swapped.txt", UNIT, "different numbers in its column of channels, and few in that of"),
        ("rounded.npy", UNIT, "rounds whole numbers above 2.53, here to the nearest 4"),
        ("odd.csv", 1e-12, "in units of 1e-09 s, and `unit` is 1e-12 s"),
        ("run.ptu", None, "is a PTU file already"),
        ("run.ht3", None, "older format"),
        ("tags.txt", None, "no unit of its times"),
        ("tags.txt", 5.0, "units of 5 s"),
    ):
        with pytest.raises(InputError, match=said) as error:
            read_timestamps(tmp_path / name, unit)
        assert "\n" not in str(error.value)
    stamps = read_timestamps(tmp_path / "tags.txt", 1e-12)
    for marker, inputs, said in (
        (3, None, "channel 3 has no events; there are some on 2, 5, 7, 8"),
        (8, (2, 9), "channel 9 has no events"),
        (8, (8, 2), "each once"),
        (8, (2, 2), "each once"),
    ):
        with pytest.raises(InputError, match=said):
            stamps.write(tmp_path / "p.ptu", marker, inputs)
    assert not (tmp_path / "p.ptu").exists()


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
    np.savetxt(tmp_path / "tags.txt", np.stack([TIMES + start, CHANNELS], axis=1), "%d")
    read_timestamps(tmp_path / "tags.txt", UNIT).write(tmp_path / "p.ptu", 8)
    with ptufile.PtuFile(tmp_path / "p.ptu") as file:
        found = np.sort(file.decode_records()["time"])
    assert np.array_equal(found, TIMES - TIMES[0])


def clocked(times, channels=CHANNELS):
    return Timestamps(times, channels, 1e-12)


FAR = TIMES * 1000  # 1 ms with ticks of 1 ps, whose order within 1 us is free
CLOCKS = {
    "overflows": clocked(FAR % 2**29),
    "begins anew": clocked(np.where(np.arange(500) < 250, FAR, FAR - FAR[250])),
    "two recordings": clocked(np.tile(FAR, 2), np.tile(CHANNELS, 2)),
    "shuffled": clocked(RNG.permutation(FAR)),
}


@pytest.mark.parametrize("case", CLOCKS)
def test_a_clock_that_runs_back_is_refused(tmp_path, case):
    """Sorted by time, parts of a recording would lie over each other."""
    with pytest.raises(InputError, match=r"time runs back on channel 8, event \d+: from"):
        CLOCKS[case].write(tmp_path / "p.ptu", 8)
    assert not (tmp_path / "p.ptu").exists()


def test_events_that_stand_twice_are_refused(tmp_path):
    for times, channels, said in (
        (np.repeat(FAR, 2), np.repeat(CHANNELS, 2), "channel 8 of the trigger has .* once"),
        (np.r_[0, np.repeat(FAR, 2)], np.r_[8, np.full(1000, 1)], "channel 1 has 50. of its 1000"),
    ):
        with pytest.raises(InputError, match=said):
            clocked(times, channels).write(tmp_path / "p.ptu", 8)


# Becker & Hickl -----------------------------------------------------------------------------------

SPC = Path(os.environ.get("DEEPFSI_DATA") or ".") / "bh" / "test_noise.spc"


def decoded(path: Path) -> np.ndarray:
    """Macro times of an SPC-150's photons: 12 bits, flags of overflow (30) and invalid (31)."""
    words = np.fromfile(path, "<u4")[1:]
    invalid, overflow = words >> 31 == 1, words >> 30 & 1 == 1
    wraps = np.where(invalid & overflow, words & 0xFFFFFFF, overflow).astype(np.int64)
    times = 4096 * np.cumsum(wraps) + (words & 0xFFF)
    return times[~invalid]


@pytest.mark.filterwarnings("ignore:Photon-HDF5")
@pytest.mark.skipif(not SPC.is_file(), reason="needs $DEEPFSI_DATA/bh")
def test_photons_are_those_of_phconvert_and_of_the_records(done, tmp_path, capsys):
    phconvert = pytest.importorskip("phconvert")
    for end in (".spc", ".set"):
        shutil.copyfile(SPC.with_suffix(end), tmp_path / f"run{end}")
    data, _ = phconvert.loader.nsalex_bh(str(tmp_path / "run.spc"))
    data["description"] = "a run"
    phconvert.hdf5.save_photon_hdf5(data, h5_fname=str(tmp_path / "run.h5"))
    capsys.readouterr()  # phconvert prints
    found = json.loads(
        done("camera", "import", tmp_path / "run.h5", "-o", tmp_path / "run.ptu", "--json")
    )
    photons = data["photon_data"]
    channels, counts = np.unique(photons["detectors"], return_counts=True)
    assert found["channels"] == channels.tolist()
    assert list(found["photons"].values()) == counts.tolist() == [6114]
    assert (found["markers"], found["left_out"]) == (0, 0)
    times = photons["timestamps"].astype(np.int64)
    assert np.array_equal(times, decoded(SPC))
    seconds, _ = read_photons(tmp_path / "run.ptu")
    unit = float(photons["timestamps_specs"]["timestamps_unit"])
    assert np.array_equal(np.rint(seconds / unit).astype(np.int64), times - times[0])
