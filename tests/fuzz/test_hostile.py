"""Files made to do harm, one by one: each was once a traceback, a hang or gigabytes."""

import io
import json
import os
import struct
import subprocess
import sys
import zipfile
import zlib
from datetime import date
from pathlib import Path

import numpy as np
import polars
import pytest
import torch
from PIL import Image, PngImagePlugin
from scipy.io import savemat
from scipy.linalg import hadamard

from deepfsi import InputError, load_dataset
from deepfsi.base.files import read_toml
from deepfsi.base.quantities import Table
from deepfsi.base.tables import read_table
from deepfsi.cli.terminal import Terminal
from deepfsi.jobs.designs import read_matrix
from fuzz.readers import READERS, copied
from fuzz.worker import MOST_BYTES, fault_of
from shared.design_files import rewrite

NAN, INF = float("nan"), float("inf")


def refused(name: str, path: Path, match: str, most_bytes: float = MOST_BYTES) -> None:
    """Assert that a reader refuses a file with one line, in time and memory."""
    assert not fault_of(name, path, most_bytes)
    with pytest.raises(InputError, match=match):
        READERS[name].read(path)


@pytest.fixture
def sample(samples, tmp_path):
    """Path of a copy of a reader's sample."""
    return lambda name: copied(samples, READERS[name], tmp_path / name.replace(" ", "-"))


# ---------------------------------------------------------------- what is no regular file


@pytest.mark.parametrize("kind", ["pipe", "endless", "folder"])
@pytest.mark.parametrize("name", sorted(READERS.keys() - {"report's design"}))  # none is shown
def test_readers_take_regular_files_alone(name, kind, sample):
    path = sample(name)
    path.unlink()
    if kind == "pipe":
        os.mkfifo(path)
    elif kind == "folder":
        path.mkdir()
    else:
        path.symlink_to("/dev/zero")
    match = r"cannot be read|no results|holds no images|no images in|needs a sub-folder"
    refused(name, path, match)


# ---------------------------------------------------------------- designs


def classifier(**fields):
    return lambda header, tensors: header["classifier"].update(fields)


def in_double(name):
    return lambda header, tensors: tensors.update({name: tensors[name].double()})


def reflectance(value):
    return lambda header, tensors: header.update(summed_reflectance=value)


def bright(light):
    def change(header, tensors):
        header["light"] = light
        tensors["rails"][:] = 3e38  # more than float32 counts

    return change


def spread_below_0(header, tensors):
    tensors["misfit.budgets"] = torch.tensor([1.0, 10.0, 100.0]).double()
    tensors["misfit.logarithms"] = -torch.ones(2, 3, 1).double()


@pytest.mark.parametrize(
    ("reader", "change"),
    [
        ("design", classifier(hidden=[50_000, 50_000])),
        ("design", classifier(hidden=[1] * 100_000)),
        *(("patches", classifier(**{size: 10**9})) for size in ("width", "depth", "hidden")),
        *(("design", in_double(name)) for name in ("rails", "mean", "std", "shares")),
        *(("design", reflectance(value)) for value in (0, -1, 1e-300, None, "x")),
        *(("design", reflectance(value)) for value in (float("nan"), float("inf"))),
        *(("design", bright(light)) for light in ("column", "equal-dwell")),
        ("design", spread_below_0),
    ],
)
def test_a_design_that_no_training_gives(reader, change, sample):
    path = sample(reader)
    rewrite(path, change)
    refused(reader, path, "not a whole deepfsi design file")


# ---------------------------------------------------------------- arrays


X = np.random.default_rng(0).integers(0, 255, (20, 4, 4), dtype=np.uint8)
Y = np.arange(20) % 2


def zipped(path: Path, method: int = zipfile.ZIP_STORED, **entries: bytes | np.ndarray) -> Path:
    """An .npz file of arrays, or of bytes as they are."""
    with zipfile.ZipFile(path, "w", method) as archive:
        for name, content in entries.items():
            out = io.BytesIO()
            if isinstance(content, bytes):
                out.write(content)
            else:
                np.save(out, content)
            archive.writestr(f"{name}.npy", out.getvalue())
    return path


@pytest.mark.parametrize(
    ("offset", "mark", "match"),
    [(8, b"\1\0", "cannot read"), (10, b"\x63\0", "cannot read"),
     (24, b"\xff\xff\xff\x7f", "unpack"),
     (42, b"\xff\xff\xff\x00", "cannot read"), (16, b"\0\0\0\0", "cannot read")],
)  # fmt: skip
def test_arrays_whose_directory_lies(offset, mark, match, tmp_path):
    path = zipped(tmp_path / "x.npz", x=X, y=Y)
    content = bytearray(path.read_bytes())
    last = content.rfind(b"PK\1\2")
    content[last + offset : last + offset + len(mark)] = mark
    path.write_bytes(content)
    refused("npz", path, match)


def header(text: str, version: bytes = b"\1\0") -> bytes:
    return b"\x93NUMPY" + version + struct.pack("<H", len(text)) + text.encode()


def described(kind: str, shape: str) -> bytes:
    return header(f"{{'descr': '{kind}', 'fortran_order': False, 'shape': {shape}}}\n")


HEADERS = {
    "huge": described("<f8", "(1000000000000,)"),
    "negative": described("<f8", "(-1,)"),
    "code": header("__import__('os').system('false')\n"),
    "nested": header("(" * 5000 + ")" * 5000 + "\n"),
    "objects": described("|O", "(2,)") + bytes(16),
    "version": header("{}", b"\3\0"),
    "characters": described("<U1", "(20,)") + b"\x7f" * 80,
    "empty": b"",
    "not": b"x" * 100,
}


@pytest.mark.parametrize("kind", HEADERS)
def test_arrays_whose_header_lies(kind, tmp_path):
    refused("npz", zipped(tmp_path / "x.npz", x=X, y=HEADERS[kind]), "cannot read")
    if kind != "characters":
        (tmp_path / "x.npy").write_bytes(HEADERS[kind])
        refused("npy masks", tmp_path / "x.npy", "cannot read")


def test_a_bomb(tmp_path):
    zeros = np.zeros((100, 1000, 1000), np.uint8)
    path = zipped(tmp_path / "x.npz", zipfile.ZIP_DEFLATED, x=zeros)
    assert path.stat().st_size < 1e6
    refused("npz", path, "would unpack")


def test_bombs_of_matlab_and_of_tables(tmp_path):
    """Twice as many zeros as are read, of one variable, of twenty, of rows: it took 7 GB."""
    zeros = np.zeros((2**12, 2**13))
    savemat(tmp_path / "one.mat", {"x": zeros}, do_compression=True)
    few = {f"x{k}": zeros[: 2**12 // 10] for k in range(20)}
    savemat(tmp_path / "many.mat", few, do_compression=True)
    for name in ("one", "many"):
        refused("mat masks", tmp_path / f"{name}.mat", "unpacks to far more")
    polars.DataFrame({"x": zeros[0]}).write_parquet(tmp_path / "x.parquet")
    assert not fault_of("parquet", tmp_path / "x.parquet")
    rows = polars.repeat(0, 2**25, dtype=polars.Int8, eager=True)
    polars.DataFrame({"x": rows}).write_parquet(tmp_path / "x.parquet")
    refused("parquet", tmp_path / "x.parquet", "would unpack", 300e6)


def test_a_million_spaces(tmp_path):
    """They took the square of their number."""
    (tmp_path / "x.csv").write_text(" 1" + (" " * 10**6 + "2") * 3 + " " * 10**6)
    assert not fault_of("csv", tmp_path / "x.csv")
    assert np.array_equal(read_table(tmp_path / "x.csv").values, [[1, 2, 2, 2]])


@pytest.mark.parametrize("cell", [b"x", [1], {"x": 1}, date(2000, 1, 1)])
def test_cells_that_are_no_numbers_and_no_names(cell, tmp_path):
    polars.DataFrame({"scene": [cell], "x": [1]}).write_parquet(tmp_path / "x.parquet")
    refused("parquet", tmp_path / "x.parquet", "no numbers and no names")


@pytest.mark.parametrize("values", [(7, 7), (-1e308, 1e308), (1e38, 3e38), (0, 1e-320), (0, NAN)])
def test_spectra_whose_range_is_none(values, sample):
    path = sample("npy cube")
    np.save(path, np.resize(values, np.load(path).shape))
    refused("npy cube", path, "different finite numbers")


def huge_png() -> bytes:
    """The head of a PNG file of 3.6 billion pixels, and a little of its data."""
    out = io.BytesIO(b"\x89PNG\r\n\x1a\n")
    out.seek(0, io.SEEK_END)
    PngImagePlugin.putchunk(out, b"IHDR", struct.pack(">2I5B", 60_000, 60_000, 8, 0, 0, 0, 0))
    PngImagePlugin.putchunk(out, b"IDAT", zlib.compress(bytes(10_000)))
    PngImagePlugin.putchunk(out, b"IEND", b"")
    return out.getvalue()


def test_a_picture_of_very_many_pixels_costs_no_memory(sample):
    path = sample("png")
    assert not fault_of("png", path)
    path.write_bytes(huge_png())
    refused("png", path, "bomb", 40e6)


def test_a_picture_whose_tags_are_cut(tmp_path, recwarn):
    for label in "ab":
        (tmp_path / label).mkdir()
        (tmp_path / label / "0.tif").write_bytes(b"II*\0\x08\0\0\0\xff\xff" + bytes(90))
    with pytest.raises(InputError, match=r"0\.tif"):
        load_dataset(tmp_path)
    assert not recwarn.list


def test_a_picture_of_few_bytes_and_many_pixels(tmp_path):
    for label in "ab":
        (tmp_path / label).mkdir()
        Image.new("L", (9000, 9000)).save(tmp_path / label / "0.png")
    refused("png", tmp_path / "a" / "0.png", "would unpack")


@pytest.mark.parametrize("deflated", [False, True])
def test_numbers_of_a_type_that_is_none_in_matlabs_format(tmp_path, deflated):
    """They ended the process: scipy's reader follows a pointer that is not there."""
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
    matrix = hadamard(2048).astype(float)
    savemat(tmp_path / "x.mat", {"x": matrix}, do_compression=True)
    assert np.array_equal(read_matrix(str(tmp_path / "x.mat")), matrix)


# ---------------------------------------------------------------- settings and runs


@pytest.mark.parametrize(
    "content", ["[" * 100_000, "a." * 100_000 + "b = 1", "x = " + "9" * 10_000]
)
@pytest.mark.parametrize("name", ["camera", "virtual camera", "recipe"])
def test_settings_nested_or_long_without_an_end(name, content, tmp_path):
    (tmp_path / "camera.toml").write_text(content)
    refused(name, tmp_path / "camera.toml", "TOML|dots")


def test_settings_that_are_longer_than_any(tmp_path):
    (tmp_path / "x.toml").write_text("#" * 2**20)
    with pytest.raises(InputError, match="more than 262144 bytes: give a TOML file"):
        read_toml(tmp_path / "x.toml")


@pytest.mark.parametrize("field", ["device", "detectors", "flux", "levels"])
@pytest.mark.parametrize("digits", ["0x" + "f" * 5000, "0o" + "7" * 5000, "0b" + "1" * 20_000])
def test_numbers_that_python_does_not_write(field, digits, sample):
    path = sample("camera")
    path.write_text(f"{field} = {digits}")
    refused("camera", path, field)


def test_a_command_line_says_nothing_of_numpys(samples, tmp_path):
    """Counts beyond float32 were a warning of two lines before the refusal."""
    np.save(tmp_path / "x.npy", np.full((1, 4), 1e308))
    design, table = samples / "fixed.safetensors", tmp_path / "x.npy"
    words = ["camera", "classify", design, table, "--photons", "1e4", "--background", "0"]
    words = [sys.executable, "-m", "deepfsi", *words]
    ended = subprocess.run(words, capture_output=True, text=True)
    assert (ended.returncode, ended.stdout, ended.stderr.count("\n")) == (2, "", 1), ended.stderr
    assert ended.stderr.startswith("deepfsi: counts must be finite")


def test_the_name_of_a_scene_that_a_person_shows_is_no_command(monkeypatch, capsys):
    monkeypatch.setattr(sys, "stdin", io.StringIO("\n"))
    Terminal(as_json=False).ask("show \x1b[31ma\x9b\u202eb")
    assert capsys.readouterr().err == "show  [31ma  b, then press Enter\n"
    Terminal(as_json=False).say(Table("a\x1b", ["b\x9b"], [["c\u202e"]]))
    assert not set(capsys.readouterr().out) & {"\x1b", "\x9b", "\u202e"}


def test_a_damaged_design_is_no_camera(refuse, tmp_path):
    """It was described as the preset `dmd`."""
    design = tmp_path / "x.safetensors"
    design.write_bytes(b"x" * 99)
    assert "x.safetensors is not a whole" in refuse("camera", "describe", design)


FIRST = ("points", 0)
RERUN = "run the comparison again"


@pytest.mark.parametrize(
    ("reader", "changes", "match"),
    [
        *(("manifest", {("detectors",): {"count": count}}, "detectors|mirrors|frames")
          for count in (10**9, 2**16 + 1, 10**30)),
        ("manifest", {("masks",): 2**20}, "would unpack"),  # that no file holds
        ("manifest", {("device", "columns"): 2**14, ("device", "rows"): 2**14}, "mirrors"),
        ("report", {(*FIRST, "accuracy"): NAN}, RERUN),
        ("report", {(*FIRST, "accuracies"): [2]}, RERUN),
        ("report", {(*FIRST, "photons"): INF}, RERUN),
        ("report", {(*FIRST, "masks"): 10**30}, RERUN),
        ("report", {(*FIRST, "keys"): ["../../../x"]}, RERUN),
        ("report", {(*FIRST, "worst_class"): 99}, RERUN),
        ("report", {("data", "classes"): []}, RERUN),
        ("report", {("points",): []}, RERUN),
    ],
)  # fmt: skip
def test_manifests_and_results_that_are_never_written(reader, changes, match, sample):
    path = sample(reader)
    content = json.loads(path.read_text())
    content.pop("sha256", None)
    for (*keys, last), value in changes.items():
        inner = content
        for key in keys:
            inner = inner[key]
        inner[last] = value
    path.write_text(json.dumps(content))
    refused(reader, path, match)
