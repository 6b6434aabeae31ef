"""Time stamps of other counters: a PTU file with the same events, or one line."""

import h5py
import numpy as np
import ptufile
import pytest

from deepfsi.errors import InputError
from deepfsi.hardware.ptu.stamps import read_stamps, write_stamps

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
    mixed = RNG.permutation(500)  # time taggers may write the channels one after another
    table = np.stack([TIMES, CHANNELS], axis=1)[mixed]
    if name == "tags.h5":
        photon_hdf5(tmp_path / name)
    elif name == "tags.txt":
        np.savetxt(tmp_path / name, table, "%d", header="as a time tagger writes it")
    else:
        np.save(tmp_path / name, table)
    stamps = read_stamps(tmp_path / name, None if name == "tags.h5" else UNIT)
    assert write_stamps(stamps, tmp_path / "p.ptu", 8, (7, 2)) == (7, 2)
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
    assert write_stamps(stamps, tmp_path / "all.ptu", 8) == (2, 5, 7)


def test_what_tells_no_events_is_one_line(tmp_path):
    photon_hdf5(tmp_path / "bare.h5", unit=None)
    photon_hdf5(tmp_path / "short.h5", times=TIMES[1:])
    with h5py.File(tmp_path / "other.h5", "w") as file:
        file["x"] = TIMES
    np.savetxt(tmp_path / "three.txt", np.ones((4, 3)))
    np.savetxt(tmp_path / "half.txt", [[0.5, 1]])
    np.savetxt(tmp_path / "tags.txt", np.stack([TIMES, CHANNELS], axis=1), "%d")
    for name, unit, said in (
        ("bare.h5", None, "no unit of its times: give `unit`"),
        ("short.h5", None, "499 times and 500 detectors"),
        ("other.h5", None, "it lacks photon_data/timestamps"),
        ("none.h5", None, "there is no file"),
        ("three.txt", 1e-12, "two columns of whole numbers"),
        ("half.txt", 1e-12, "two columns of whole numbers"),
        ("tags.txt", None, "no unit of its times"),
        ("tags.txt", 5.0, "units of 5 s"),
    ):
        with pytest.raises(InputError, match=said) as error:
            read_stamps(tmp_path / name, unit)
        assert "\n" not in str(error.value)
    stamps = read_stamps(tmp_path / "tags.txt", 1e-12)
    for marker, inputs, said in (
        (3, None, "channel 3 has no events; there are some on 2, 5, 7, 8"),
        (8, (2, 9), "channel 9 has no events"),
        (8, (8, 2), "each once"),
        (8, (2, 2), "each once"),
    ):
        with pytest.raises(InputError, match=said):
            write_stamps(stamps, tmp_path / "p.ptu", marker, inputs)
    assert not (tmp_path / "p.ptu").exists()
