"""Masks of one's own, from everything that holds them."""

import numpy as np
import pytest
from scipy.io import savemat

from deepfsi.base.errors import InputError
from deepfsi.jobs.designs import read_matrix

SIGNED = np.linspace(-0.1, 0.2, 24).reshape(3, 8)
GREY = np.random.default_rng(0).integers(0, 256, (3, 2, 4), dtype=np.uint8)
WIDE = np.random.default_rng(1).integers(0, 2**16, (3, 2, 4)).astype(np.uint16)
AS_GREY = GREY.reshape(3, 8) / 255 / 3
AS_WIDE = WIDE.reshape(3, 8) / 65535 / 3


ARRAYS = {
    "signed": (SIGNED, SIGNED),
    "stack": (SIGNED.reshape(3, 2, 4), SIGNED),
    "float32": (SIGNED.astype(np.float32), SIGNED.astype(np.float32)),
    "integers": (np.arange(8).reshape(2, 4), np.arange(8).reshape(2, 4)),
    "uint32": (WIDE.astype(np.uint32), WIDE.reshape(3, 8)),
    "grey": (GREY, AS_GREY),
    "rows": (GREY.reshape(3, 8), AS_GREY),
    "wide": (WIDE, AS_WIDE),
    "bool": (GREY > 127, (GREY > 127).reshape(3, 8) / 3),
    "binary": ((GREY > 127).astype(np.uint8), (GREY > 127).reshape(3, 8) / 3),
}


@pytest.mark.parametrize(("given", "wanted"), ARRAYS.values(), ids=ARRAYS)
@pytest.mark.parametrize("end", ["npy", "mat", "mat:own"])
def test_arrays(tmp_path, given, wanted, end):
    if end == "npy":
        np.save(tmp_path / "m.npy", given)
    else:
        more = {"note": "of ours", "own": given} | ({"other": np.eye(2)} if ":" in end else {})
        savemat(tmp_path / "m.mat", more)
    np.testing.assert_allclose(read_matrix(f"{tmp_path}/m.{end}"), wanted, rtol=1e-12)


def save(path, content):
    {".npy": np.save, ".npz": np.savez, ".mat": savemat}[path.suffix](path, content)


def save_cut(path, content, length):
    save(path, content)
    path.write_bytes(path.read_bytes()[:length])


TWO = {"a": np.eye(2), "b": np.eye(2)}
NEW = b"MATLAB 7.3 MAT-file".ljust(124) + b"\x00\x02IM" + bytes(99)
BAD = {
    "nowhere.npy": (None, "no matrix at"),
    "words.npy": (lambda path: save(path, np.array(["a"])), "real numbers"),
    "flat.npy": (lambda path: save(path, np.ones(4)), r"shape \(4,\)"),
    "cut.npy": (lambda path: save_cut(path, np.ones(4), 100), "real numbers"),
    "complex.mat": (lambda path: save(path, {"a": np.eye(2) * 1j}), "complex"),
    "cut.mat": (lambda path: save_cut(path, TWO, 150), "save it again"),
    "new.mat": (lambda path: path.write_bytes(NEW), "-v7"),
}


@pytest.mark.parametrize("source", BAD)
def test_what_holds_no_masks_is_refused_in_one_line(tmp_path, source):
    write, words = BAD[source]
    if write:
        write(tmp_path / source.partition(":")[0])
    with pytest.raises(InputError, match=words) as refused:
        read_matrix(f"{tmp_path}/{source}")
    assert "\n" not in str(refused.value)


def test_a_small_file_of_a_large_matrix_is_refused(tmp_path, monkeypatch):
    monkeypatch.setattr("deepfsi.base.arrays.free_memory", lambda: 20.0)
    savemat(tmp_path / "m.mat", {"own": SIGNED})
    with pytest.raises(InputError, match="GB of memory"):
        read_matrix(f"{tmp_path}/m.mat")
