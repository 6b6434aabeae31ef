"""The file of counts: read as it was written, or refused."""

import json

import numpy as np
import pytest
import recording_samples

from deepfsi.base.errors import InputError
from deepfsi.hardware.calibration.scans import reconstruct
from deepfsi.hardware.counting.counts import read_counts

run, whole = recording_samples.run, recording_samples.whole


def refuse(folder, match: str) -> None:
    for read in (read_counts, reconstruct):
        with pytest.raises(InputError, match=match):
            read(folder)


def test_counts_are_of_the_acquisition_and_the_photons_beside_them(run):
    photons, wanted = run.folder / "photons.ptu", read_counts(run.folder).counts
    run.edit(settle_s=1e-5)
    refuse(run.folder, r"counts\.npz is of another acquisition")
    run.edit(settle_s=2e-5)
    content = bytearray(photons.read_bytes())
    content[-1] ^= 1
    photons.write_bytes(content)
    refuse(run.folder, r"counts\.npz is of another photons\.ptu")
    photons.unlink()  # kept elsewhere
    assert (read_counts(run.folder).counts == wanted).all()


EDITS = {
    "scenes swapped": lambda held, about: held.update(counts=held["counts"][[1, 0, 2]]),
    "brighter": lambda held, about: held.update(on_rate=10 * held["on_rate"]),
    "exposure": lambda held, about: about.update(exposure_s=2 * about["exposure_s"]),
}


@pytest.mark.parametrize("change", EDITS.values(), ids=EDITS)
def test_edited_counts_are_refused(run, change):
    path = run.folder / "counts.npz"
    with np.load(path) as file:
        held = dict(file)
    about = json.loads(held["about"].tobytes())
    change(held, about)
    np.savez(path, **held | {"about": np.frombuffer(json.dumps(about).encode(), np.uint8)})
    refuse(run.folder, r"counts\.npz was changed after it was written")


def test_compressed_cut_or_missing_counts_are_refused(run):
    path = run.folder / "counts.npz"
    whole = path.read_bytes()
    with np.load(path) as held:
        np.savez_compressed(path, **dict(held))
    refuse(run.folder, r"counts\.npz is not a whole file")
    path.write_bytes(whole[:-100])
    refuse(run.folder, r"counts\.npz is not a whole file")
    path.unlink()
    refuse(run.folder, r"counts\.npz is missing.* camera count")
