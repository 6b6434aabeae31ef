"""The file of counts: read as it was written, or refused."""

import json
import zipfile

import numpy as np
import pytest
import recording_samples
from recording_samples import Run

from deepfsi.base import InputError
from deepfsi.hardware.counting import count_run, read_counts
from deepfsi.hardware.pictures import reconstruct

run, whole = recording_samples.run, recording_samples.whole


def test_counts_of_another_acquisition_are_refused(run):
    run.edit(settle_s=1e-5)
    with pytest.raises(InputError, match=r"counts\.npz is of another acquisition"):
        read_counts(run.folder)
    count_run(run.folder)
    read_counts(run.folder)


def rewrite(run: Run, compression: int = zipfile.ZIP_STORED, **arrays: np.ndarray) -> None:
    path = run.folder / "counts.npz"
    with np.load(path) as held:
        content = dict(held) | arrays
    write = np.savez if compression == zipfile.ZIP_STORED else np.savez_compressed
    write(path, **content)


@pytest.mark.parametrize("name", ["swapped", "large", "bright", "valid", "exposure", "faults"])
def test_edited_counts_are_refused(run, name):
    """Every one of these was read, and classified, as it stood."""
    with np.load(run.folder / "counts.npz") as file:
        held = dict(file)
    about = json.loads(held["about"].tobytes())
    if name == "swapped":
        held["counts"] = held["counts"][[1, 0, 2]]
    elif name == "large":
        held["counts"][1, 0, 0, 3] = 10**9
    elif name == "bright":
        held["on_rate"] = held["on_rate"] * 10
    elif name == "valid":
        held["valid"][0] = False
    elif name == "exposure":
        about["exposure_s"] *= 2
    else:
        about["faults"] = [{"kind": "lost", "scene": 0, "frame": None, "detail": ""}]
    rewrite(run, **held | {"about": np.frombuffer(json.dumps(about).encode(), np.uint8)})
    for read in (read_counts, reconstruct):
        with pytest.raises(InputError, match=r"counts\.npz was changed after it was written"):
            read(run.folder)


def test_counts_are_of_the_photons_beside_them(run):
    path = run.folder / "photons.ptu"
    wanted = read_counts(run.folder).counts
    content = bytearray(path.read_bytes())
    content[-1] ^= 1
    path.write_bytes(content)
    with pytest.raises(InputError, match=r"counts\.npz is of another photons\.ptu"):
        read_counts(run.folder)
    path.unlink()  # kept elsewhere
    assert (read_counts(run.folder).counts == wanted).all()


def test_compressed_or_cut_counts_are_refused(run):
    rewrite(run, zipfile.ZIP_DEFLATED)
    with pytest.raises(InputError, match=r"counts\.npz is not a whole file"):
        read_counts(run.folder)
    count_run(run.folder)
    path = run.folder / "counts.npz"
    path.write_bytes(path.read_bytes()[:-100])
    with pytest.raises(InputError, match=r"counts\.npz is not a whole file"):
        reconstruct(run.folder)
    path.unlink()
    with pytest.raises(InputError, match=r"counts\.npz is missing.* camera count"):
        read_counts(run.folder)
