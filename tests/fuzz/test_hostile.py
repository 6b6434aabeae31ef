"""Files made to do harm, one by one: each was once a traceback, a hang or gigabytes."""

import io
import json
import os
import struct
import zipfile
import zlib
from pathlib import Path

import numpy as np
import pytest
from PIL import Image
from safetensors.numpy import load_file, save_file

from deepfsi.base import InputError, check_unpacked, open_regular, read_regular, read_toml
from deepfsi.base.files import UNPACKED_SPARE
from fuzz.readers import READERS, copied
from fuzz.worker import fault_of, watching
from shared.design_files import header_of


@pytest.fixture
def refused():
    """Assert that a reader refuses a file with one line, in time and memory."""

    def check(name: str, path: Path, match: str) -> None:
        with watching():
            assert not fault_of(name, path)
        with pytest.raises(InputError, match=match):
            READERS[name].read(path)

    return check


@pytest.fixture
def sample(samples, tmp_path):
    """Path of a copy of a reader's sample."""
    return lambda name: copied(samples, READERS[name], tmp_path / name.replace(" ", "-"))


def zipped(path: Path, method: int = zipfile.ZIP_STORED, **entries: bytes) -> Path:
    with zipfile.ZipFile(path, "w", method) as archive:
        for name, content in entries.items():
            archive.writestr(f"{name}.npy", content)
    return path


def npy(values) -> bytes:
    out = io.BytesIO()
    np.save(out, values)
    return out.getvalue()


# ---------------------------------------------------------------- what is no regular file


NO_FILES = ["pipe", "endless", "folder"]


def replace(path: Path, kind: str) -> None:
    path.unlink()
    if kind == "pipe":
        os.mkfifo(path)
    elif kind == "folder":
        path.mkdir()
    else:
        path.symlink_to("/dev/zero")


@pytest.mark.parametrize("kind", NO_FILES)
@pytest.mark.parametrize("name", sorted(READERS.keys() - {"report's design"}))  # none is shown
def test_readers_take_regular_files_alone(name, kind, sample, refused):
    path = sample(name)
    replace(path, kind)
    refused(
        name, path, r"cannot be read|no results|holds no images|no images in|has no sub-folders"
    )


def test_one_limit_of_bytes(tmp_path):
    path = tmp_path / "x"
    path.write_bytes(b"12345")
    assert read_regular(path, 5, "give less") == b"12345"
    with pytest.raises(InputError, match="more than 4 bytes: give less"):
        read_regular(path, 4, "give less")
    with pytest.raises(InputError, match="is missing: give"), open_regular(tmp_path / "none"):
        pass
    with pytest.raises(InputError, match="null"), open_regular("\0"):
        pass


def test_one_rule_of_what_unpacks():
    check_unpacked(UNPACKED_SPARE + 32 * 100, 100, "x", "")
    with pytest.raises(InputError, match="would unpack 100 bytes"):
        check_unpacked(UNPACKED_SPARE + 32 * 100 + 1, 100, "x", "")


# ---------------------------------------------------------------- designs


def changed(path: Path, change) -> Path:
    header, tensors = header_of(path), load_file(path)
    change(header, tensors)
    save_file(tensors, path, {"deepfsi": json.dumps(header)})
    return path


def test_a_design_whose_settings_ask_for_gigabytes(sample, refused):
    path = changed(sample("design"), lambda h, t: h["classifier"].update(hidden=[50_000, 50_000]))
    refused("design", path, "not a whole deepfsi design file")


def test_a_design_of_a_hundred_thousand_layers(sample, refused):
    path = changed(sample("design"), lambda h, t: h["classifier"].update(hidden=[1] * 100_000))
    refused("design", path, "not a whole deepfsi design file")


@pytest.mark.parametrize("size", ["width", "depth", "hidden", "heads", "patches"])
def test_a_transformer_of_any_size_that_its_file_has_not(size, sample, refused):
    path = changed(sample("patches"), lambda h, t: h["classifier"].update({size: 10**9}))
    refused("patches", path, "not a whole deepfsi design file")


@pytest.mark.parametrize("name", ["rails", "mean", "std", "shares", "classifier.layers.0.weight"])
def test_a_design_of_numbers_of_another_type(name, sample, refused):
    path = changed(sample("design"), lambda h, t: t.update({name: t[name].astype(np.float64)}))
    refused("design", path, "not a whole deepfsi design file")


@pytest.mark.parametrize("given", [0, -1, 1e-300, float("nan"), float("inf"), None, "x"])
def test_a_design_of_no_summed_reflectance(given, sample, refused):
    path = changed(sample("design"), lambda h, t: h.update(summed_reflectance=given))
    refused("design", path, "not a whole deepfsi design file")


@pytest.mark.parametrize("light", ["column", "equal-dwell", "free-dwell", "two-arm"])
def test_a_design_brighter_than_float32_counts(light, sample, refused):
    def brighten(header, tensors):
        header["light"] = light
        tensors["rails"][:] = 3e38

    refused("design", changed(sample("design"), brighten), "not a whole deepfsi design file")


def test_a_design_whose_readouts_are_beyond_all_light(sample, refused):
    def brighten(header, tensors):
        tensors["distribution.directions"][:] = 1e30

    refused("design", changed(sample("design"), brighten), "not a whole deepfsi design file")


# ---------------------------------------------------------------- arrays


X = np.random.default_rng(0).integers(0, 255, (20, 4, 4), dtype=np.uint8)
Y = np.arange(20) % 2


@pytest.mark.parametrize("method", [zipfile.ZIP_LZMA, zipfile.ZIP_BZIP2])
def test_arrays_compressed_in_unusual_ways(method, tmp_path, refused):
    path = zipped(tmp_path / "x.npz", method, x=npy(X), y=npy(Y))
    refused("npz", path, "unusual way")


def marked(path: Path, offset: int, mark: bytes) -> Path:
    """Zip file whose last entry's mark is another, in the directory and before its content."""
    content = bytearray(path.read_bytes())
    last = content.rfind(b"PK\1\2")
    content[last + offset : last + offset + len(mark)] = mark
    path.write_bytes(content)
    return path


@pytest.mark.parametrize(
    ("offset", "mark", "match"),
    [(8, b"\1\0", "encrypted"), (10, b"\x63\0", "unusual"), (24, b"\xff\xff\xff\x7f", "unpack"),
     (42, b"\xff\xff\xff\x00", "cannot read"), (16, b"\0\0\0\0", "cannot read")],
)  # fmt: skip
def test_arrays_whose_directory_lies(offset, mark, match, tmp_path, refused):
    path = marked(zipped(tmp_path / "x.npz", x=npy(X), y=npy(Y)), offset, mark)
    refused("npz", path, match)


def header(text: str, version: bytes = b"\1\0") -> bytes:
    return b"\x93NUMPY" + version + struct.pack("<H", len(text)) + text.encode()


HEADERS = {
    "huge": header("{'descr': '<f8', 'fortran_order': False, 'shape': (1000000000000,)}\n"),
    "negative": header("{'descr': '<f8', 'fortran_order': False, 'shape': (-1,)}\n"),
    "code": header("__import__('os').system('false')\n"),
    "nested": header("(" * 5000 + ")" * 5000 + "\n"),
    "objects": header("{'descr': '|O', 'fortran_order': False, 'shape': (2,)}\n") + bytes(16),
    "nothing": header("{'descr': '<U0', 'fortran_order': False, 'shape': (99999999999,)}\n"),
    "version": header("{}", b"\3\0"),
    "characters": header("{'descr': '<U1', 'fortran_order': False, 'shape': (20,)}\n")
    + b"\x7f" * 80,
    "empty": b"",
    "not": b"x" * 100,
}


@pytest.mark.parametrize("kind", HEADERS)
def test_arrays_whose_header_lies(kind, tmp_path, refused):
    refused("npz", zipped(tmp_path / "x.npz", x=npy(X), y=HEADERS[kind]), "cannot read")
    if kind != "characters":
        (tmp_path / "x.npy").write_bytes(HEADERS[kind])
        refused("npy masks", tmp_path / "x.npy", "cannot read")


@pytest.mark.parametrize("reader", ["npz", "zip"])
def test_a_bomb(reader, tmp_path, refused):
    path = tmp_path / ("x." + reader)
    path = zipped(path, zipfile.ZIP_DEFLATED, x=npy(np.zeros((100, 1000, 1000), np.uint8)))
    assert path.stat().st_size < 1e6
    refused(reader, path, "would unpack")


def test_a_picture_of_few_bytes_and_many_pixels(tmp_path, refused):
    for label in "ab":
        (tmp_path / label).mkdir()
        Image.new("L", (9000, 9000)).save(tmp_path / label / "0.png")
    refused("png", tmp_path / "a" / "0.png", "would unpack")
    refused("tiff masks", tmp_path / "a" / "0.png", "would unpack")


@pytest.mark.slow
def test_a_bomb_in_matlabs_format(tmp_path, refused):
    from scipy.io import savemat

    path = tmp_path / "x.mat"
    savemat(path, {"x": np.zeros((6000, 6000))}, do_compression=True)
    assert path.stat().st_size < 1e6
    refused("mat masks", path, "would unpack")


@pytest.mark.parametrize("deflated", [False, True])
def test_numbers_of_a_type_that_is_none_in_matlabs_format(tmp_path, refused, deflated):
    """They ended the process: scipy's reader follows a pointer that is not there."""
    from scipy.io import savemat

    path = tmp_path / "x.mat"
    savemat(path, {"x": np.random.default_rng(0).random((9, 9))})
    content = path.read_bytes()
    numbers = struct.pack("<II", 9, 9 * 9 * 8)
    assert content.count(numbers) == 1
    content = content.replace(numbers, struct.pack("<II", 0, 9 * 9 * 8))
    if deflated:
        part = zlib.compress(content[128:])
        content = content[:128] + struct.pack("<II", 15, len(part)) + part
    path.write_bytes(content)
    refused("mat masks", path, "type 0")


def test_a_matrix_of_usual_size_is_no_bomb(tmp_path):
    """All of a Hadamard matrix of 64 x 64 pixels, as MATLAB saves it."""
    from scipy.io import savemat
    from scipy.linalg import hadamard

    from deepfsi.jobs import read_matrix

    matrix = hadamard(2048).astype(float)
    savemat(tmp_path / "x.mat", {"x": matrix}, do_compression=True)
    assert np.array_equal(read_matrix(str(tmp_path / "x.mat")), matrix)


def test_a_bomb_in_hdf5_and_numbers_of_other_files(tmp_path, refused):
    import h5py

    path = tmp_path / "x.h5"
    with h5py.File(path, "w") as file:
        file.create_dataset("x", (10_000, 20_000), "f8", chunks=True)
    refused("hdf5 masks", path, "would unpack")
    (tmp_path / "secret").write_bytes(bytes(128))
    with h5py.File(path, "w") as file:
        file.create_dataset("x", (4, 4), "f8", external=[(str(tmp_path / "secret"), 0, 128)])
    refused("hdf5 masks", path, "not one variable")


def test_a_bomb_in_parquet(tmp_path, refused):
    import polars

    path = tmp_path / "x.parquet"
    polars.DataFrame({"a": np.zeros(100_000_000)}).write_parquet(path, compression="zstd")
    assert path.stat().st_size < 1e6
    refused("parquet", path, "would unpack")


@pytest.mark.slow
def test_a_table_of_two_hundred_thousand_columns_is_read(tmp_path):
    wide = 200_000
    lines = (",".join(f"c{k}" for k in range(wide)), ",".join(map(str, range(wide))))
    (tmp_path / "x.csv").write_text("\n".join(lines))
    with watching():
        assert not fault_of("csv", tmp_path / "x.csv")


def test_a_table_of_more_columns_is_refused(tmp_path, refused):
    (tmp_path / "x.csv").write_text(",".join(["1"] * 300_000))
    refused("csv", tmp_path / "x.csv", "262144 columns")


# ---------------------------------------------------------------- settings and runs


@pytest.mark.parametrize(
    "content", ["[" * 100_000, "a." * 100_000 + "b = 1", "x = " + "9" * 10_000]
)
def test_settings_nested_or_long_without_an_end(content, tmp_path, refused):
    for name in ("camera", "virtual camera", "recipe"):
        (tmp_path / "x.toml").write_text(content)
        refused(name, tmp_path / "x.toml", "TOML|dots")


def test_settings_that_are_longer_than_any(tmp_path):
    (tmp_path / "x.toml").write_text("#" * 2**20)
    with pytest.raises(InputError, match="more than 262144 bytes: give a TOML file"):
        read_toml(tmp_path / "x.toml")


def rewritten(path: Path, *keys, value) -> Path:
    content = json.loads(path.read_text())
    content.pop("sha256", None)
    inner = content
    for key in keys[:-1]:
        inner = inner[key]
    inner[keys[-1]] = value
    path.write_text(json.dumps(content))
    return path


@pytest.mark.parametrize("count", [10**9, 2**16 + 1, 10**30])
def test_a_manifest_of_a_billion_detectors(count, sample, refused):
    path = rewritten(sample("manifest"), "detectors", value={"count": count})
    refused("manifest", path, "detectors|mirrors|frames")


def test_a_manifest_of_masks_that_no_file_holds(sample, refused):
    refused("manifest", rewritten(sample("manifest"), "masks", value=2**20), "would unpack")


def test_a_manifest_of_a_device_larger_than_any(sample, refused):
    path = rewritten(sample("manifest"), "device", "columns", value=2**14)
    refused("manifest", rewritten(path, "device", "rows", value=2**14), "mirrors")


@pytest.mark.parametrize(
    ("keys", "value"),
    [(("points", 0, "accuracy"), float("nan")), (("points", 0, "photons"), float("inf")),
     (("points", 0, "low"), -float("inf")), (("points", 0, "masks"), 10**30),
     (("points", 0, "keys"), []), (("points", 0, "photons"), 0), (("points", 0, "accuracies"), [2]),
     (("points", 0, "worst_class"), 99), (("points", 0, "keys"), ["../../../x"]),
     (("data", "classes"), []), (("data", "image_shape"), []), (("points",), []),
     (("points", 0, "design"), 1), (("points", 0, "accuracy"), None),
     (("provenance", "seconds"), float("nan"))],
)  # fmt: skip
def test_results_that_no_comparison_gives(keys, value, sample, refused):
    refused("report", rewritten(sample("report"), *keys, value=value), "run the comparison again")
