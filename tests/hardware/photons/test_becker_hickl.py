"""A real `.spc` file of Becker & Hickl, through phconvert and `camera import`, photon by photon."""

import json
import os
import shutil
from pathlib import Path

import numpy as np
import pytest

from deepfsi.hardware.photons.reader import read_photons

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
