"""Tables of numbers: the same table from every kind of file, and one line for what is none."""

import os
import struct
import subprocess
import sys
import zlib
from pathlib import Path

import h5py
import numpy as np
import polars as pl
import pytest
from scipy import sparse
from scipy.io import savemat

from deepfsi.base import InputError
from deepfsi.base.numeric import (
    is_table,
    read_table,
    read_whole_numbers,
)

VALUES = np.random.default_rng(2).integers(0, 1000, (3, 5))
NAMES = tuple("abcde")


def matlab_73(path, **variables) -> None:
    """Write what MATLAB's save(..., '-v7.3') does: its header, and axes turned around."""
    with h5py.File(path, "w", userblock_size=512) as file:
        for name, values in variables.items():
            held = file.create_dataset(name, data=np.asarray(values, float).T)
            held.attrs["MATLAB_class"] = np.bytes_("double")
        letters = file.create_dataset("note", data=np.zeros((4, 1), np.uint16))
        letters.attrs["MATLAB_class"] = np.bytes_("char")
        file.create_dataset("#refs#/a", data=np.zeros((2, 2)))
    with path.open("r+b") as file:
        file.write(b"MATLAB 7.3 MAT-file, Platform: GLNXA64".ljust(124) + b"\x00\x02IM")


def write(path, kind) -> str:
    """The table in a file of a kind."""
    file = path / f"counts.{kind.split()[0]}"
    if kind == "npy":
        np.save(file, VALUES)
    elif kind == "parquet":
        pl.DataFrame(dict(zip(NAMES, VALUES.T, strict=True))).write_parquet(file)
    elif kind == "mat":
        savemat(file, {"counts": VALUES.astype(float), "gain": 2.0})
    elif kind == "mat 7.3":
        matlab_73(file, counts=VALUES)
    elif kind == "h5":
        with h5py.File(file, "w") as held:
            held["run/counts"] = VALUES
            held["run/times"] = VALUES
        return f"{file}:run/counts"
    elif kind == "csv named":
        np.savetxt(file, VALUES, "%d", ",", header=",".join(NAMES), comments="")
    elif kind == "csv ;":
        np.savetxt(file, VALUES, "%g", ";")
    elif kind == "txt":
        np.savetxt(file, VALUES, header="as numpy writes it")
    return str(file)


@pytest.mark.parametrize(
    "kind", ["npy", "parquet", "mat", "mat 7.3", "h5", "csv named", "csv ;", "txt"]
)
def test_every_kind_of_file_holds_the_same_table(tmp_path, kind):
    source = write(tmp_path, kind)
    assert is_table(source)
    table = read_table(source)
    assert table.values.dtype == np.float64
    assert np.array_equal(table.values, VALUES)
    assert table.names == (NAMES if kind in ("csv named", "parquet") else ())


@pytest.mark.parametrize(
    "text",
    [
        "   1.0000000e+00   2.0000000e+00\n   3.0000000e+00   4.0000000e+00\n",  # MATLAB -ascii
        "1,2,\r\n3,4,\r\n",
        "1\t2\n3\t4",
        "\ufeffa;b\n1;2\n3;4\n",
        "# by a counter\n1 2\n3  4\n",
        '"a","b"\n"1","2"\n"3","4"\n\n',
        "sep=;\na;b;;\n1;2;;\n3;4;;\n",
        "a;b\n1,0;2,0\n3,0;4,0\n",  # Excel where a comma is the point
        "a\tb\t\r1,0\t2e0\t\r3.\t+4\t\r",  # of an old Mac
        '"a, b";c\n"1";" 2"\n3;4\n',
        '"1,0";"2,0"\n"3,0";"4,0"\n',
        "a,b\n1,2,\n3,4,\n",
    ],
)
def test_text_is_read_as_other_programs_write_it(tmp_path, text):
    path = tmp_path / "t.txt"
    for encoding in ("utf-8", "utf-16"):
        path.write_bytes(text.encode(encoding))
        assert np.array_equal(read_table(path).values, [[1, 2], [3, 4]])


def test_a_wide_table_costs_little_more_than_its_numbers(tmp_path):
    """A series of polars for each of many columns took 150 times the file."""
    path, columns = tmp_path / "wide.csv", 20_000
    path.write_text("\n".join([",".join(["123"] * columns)] * 6))
    read_table(path)  # what is imported once
    code = (
        "import resource, sys; from deepfsi.base.numeric.tables import read_table\n"
        "import polars\n"
        "def peak(): return resource.getrusage(resource.RUSAGE_SELF).ru_maxrss\n"
        "before = peak(); print(read_table(sys.argv[1]).values.shape, peak() - before)"
    )
    run = [sys.executable, "-c", code, str(path)]
    said = subprocess.run(run, capture_output=True, text=True, check=True).stdout
    assert said.startswith("(6, 20000)")
    assert int(said.split()[-1]) * 1024 < 40 * path.stat().st_size + 2**24


@pytest.mark.parametrize("kind", ["txt", "npy", "parquet", "mat 7.3"])
def test_whole_numbers_are_exact_to_64_bits(tmp_path, kind):
    values = np.array([[2**62 + 1, 1], [2**53 + 1, -(2**60) - 1]])
    path = tmp_path / f"t.{kind.split()[0]}"
    if kind == "txt":
        np.savetxt(path, values, "%d")
    elif kind == "npy":
        np.save(path, values)
    elif kind == "parquet":
        pl.DataFrame(values, schema=["a", "b"]).write_parquet(path)
    else:
        with h5py.File(path, "w", userblock_size=512) as file:
            file["counts"] = values.T
        with path.open("r+b") as file:
            file.write(b"MATLAB 7.3 MAT-file".ljust(124) + b"\x00\x02IM")
    whole = read_whole_numbers(path, lambda names, width: range(width))
    assert whole.dtype == np.int64
    assert np.array_equal(whole, values)


@pytest.mark.parametrize(
    ("values", "said"),
    [
        (np.array([[2.0**53 + 2, 1]]), "in floating point, .* here to the nearest 2: save"),
        (np.array([[0.5, 1]]), "holds 0.5: give whole numbers"),
        (np.array([[np.inf, 1]]), "holds inf: give whole numbers"),
        (np.array([[2**63, 1]], np.uint64), "9223372036854775808"),
    ],
)
def test_whole_numbers_that_may_be_rounded_are_refused(tmp_path, values, said):
    np.save(tmp_path / "t.npy", values)
    with pytest.raises(InputError, match=said):
        read_whole_numbers(tmp_path / "t.npy", lambda names, width: range(width))


@pytest.mark.parametrize(
    ("text", "said"),
    [
        ("a,b\n1,2\n3,x\n", r"row 3 of column b holds 'x'"),
        ("1,2\n3\n", "row 2 has 1 cells and row 1 has 2: give each row as many"),
        ("1,2\n3,4,5\n", "row 2 has 3 cells"),
        ("a,a\n1,2\n", "a name of its own"),
        ("1,nan\n", "holds 'nan'"),
        ("a,b\n", "holds no numbers"),
        ("", "holds no numbers"),
        ("nan\n1\n2\n", "row 1 of column column_1 holds 'nan'"),
        ("one,1,2\ntwo,3,4\n", "row 1 of column column_1 holds 'one'"),
        ("0,1,2,3\n5,6,7,8\n", "its first line numbers the columns"),
        ("1;2\n1_0;2\n", "row 2 of column column_1 holds '1_0'"),
        ("1.5;2,5\n1,5;1.234,5\n", "holds '1.234,5'"),
        ("1,234;2,345\n3,456;4,567\n", "holds '3,456'"),  # 3.456 or 3456
    ],
)
def test_text_that_is_no_table_is_one_line(tmp_path, text, said):
    path = tmp_path / "t.csv"
    path.write_text(text)
    with pytest.raises(InputError, match=said) as error:
        read_table(path)
    assert "\n" not in str(error.value)


def test_files_that_are_no_table_are_one_line(tmp_path):
    np.save(tmp_path / "cube.npy", np.zeros((2, 2, 2)))
    np.save(tmp_path / "nan.npy", [[0, np.nan]])
    savemat(tmp_path / "two.mat", {"a": VALUES, "b": VALUES})
    (tmp_path / "cut.h5").write_bytes(b"\x89HDF")
    (tmp_path / "cut.parquet").write_bytes(b"PAR1")
    for name, said in {
        "cube.npy": r"shape \(2, 2, 2\)",
        "nan.npy": "row 1, column 2 is not finite",
        "two.mat": r"no variable 'counts' .* a, b: name one as .*two\.mat:VARIABLE",
        "two.mat:c": r"no variable 'c'",
        "cut.h5": "cannot read .* as an HDF5 file",
        "cut.parquet": "as a table",
        "none.csv": "there is no file",
        "run.ptu": "is no table: give a file ending in .csv",
    }.items():
        with pytest.raises(InputError, match=said) as error:
            read_table(tmp_path / name)
        assert "\n" not in str(error.value)
    assert np.array_equal(read_table(f"{tmp_path}/two.mat:b").values, VALUES)


def test_damage_that_a_library_does_not_expect_is_one_line(tmp_path, monkeypatch, capfd):
    """Found by random damage: numpy tokenises a header, polars panics outside of `Exception`."""
    header = b"\x93NUMPY\x01\x00" + (118).to_bytes(2, "little") + b"{'descr'5[r".ljust(118)
    (tmp_path / "a.npy").write_bytes(header)
    with pytest.raises(InputError, match="cannot read an array"):
        read_table(tmp_path / "a.npy")

    def panic(path):
        os.write(2, b"thread 'async-executor-1' panicked at unpack.rs\nstack backtrace:\n")
        raise pl.exceptions.PanicException("assertion failed\n  left: 0")

    source = write(tmp_path, "parquet")
    monkeypatch.setattr(pl, "read_parquet", panic)
    with pytest.raises(InputError, match=r"as a table \(assertion failed\)"):
        read_table(source)
    os.write(2, b"later")
    assert capfd.readouterr().err == "later"


def test_no_damage_of_a_parquet_file_prints_more_than_a_line(tmp_path, capfd):
    """polars panics where a data page gives a width of 191 bits."""
    path = Path(write(tmp_path, "parquet"))
    sound = path.read_bytes()
    refused = []
    for place in range(len(sound)):
        path.write_bytes(sound[:place] + b"\xbf" + sound[place + 1 :])
        try:
            read_table(path)
        except InputError as error:
            refused.append(str(error))
    assert refused
    assert not any("\n" in said for said in refused)
    assert capfd.readouterr().err == ""


def mat_element(kind, data) -> bytes:
    return struct.pack("<II", kind, len(data)) + data + bytes(-len(data) % 8)


def mat_numbers(name, values) -> bytes:
    """A variable of doubles as MATLAB writes it."""
    values = np.asarray(values, float)
    parts = (
        mat_element(6, struct.pack("<II", 6, 0)),
        mat_element(5, struct.pack("<ii", *values.shape)),
    )
    return mat_element(
        14, b"".join([*parts, mat_element(1, name), mat_element(9, values.tobytes("F"))])
    )


def mat_string(name) -> bytes:
    """A string, table or datetime: MATLAB hides its values behind a reference."""
    reference = mat_element(6, struct.pack("<6I", 0xDD000000, 2, 1, 1, 1, 1))
    parts = mat_element(6, struct.pack("<II", 13, 0)), mat_element(5, struct.pack("<ii", 6, 1))
    inner = mat_element(14, b"".join([*parts, mat_element(1, b""), reference]))
    words = mat_element(1, name), mat_element(1, b"MCOS"), mat_element(1, b"string")
    return mat_element(14, b"".join([mat_element(6, struct.pack("<II", 17, 0)), *words, inner]))


@pytest.mark.parametrize("packed", [False, True])
@pytest.mark.parametrize("order", [(0, 1), (1, 0), (1, 0, 1)])
def test_strings_of_matlab_stand_beside_numbers(tmp_path, packed, order):
    made = mat_numbers(b"counts", VALUES), mat_string(b"operator")
    workspace = mat_numbers(b"", [[1.0, 2.0]])  # where MATLAB keeps what strings refer to
    parts = [*(made[place] for place in order), workspace]
    if packed:
        parts = [struct.pack("<II", 15, len(z := zlib.compress(part))) + z for part in parts]
    path = tmp_path / "c.mat"
    path.write_bytes(b"MATLAB 5.0 MAT-file".ljust(124) + b"\x00\x01IM" + b"".join(parts))
    for source in (path, f"{path}:counts"):
        assert np.array_equal(read_table(source).values, VALUES)


@pytest.mark.parametrize(
    ("version", "kind"),
    [
        *((version, kind) for version in "45" for kind in ("u1", "i2", "u2", "i4", "f4")),
        ("5", bool),
    ],
)
def test_every_type_of_matlab_is_read(tmp_path, version, kind):
    values = (VALUES % 100 > 50) if kind is bool else (VALUES % 100).astype(kind)
    savemat(tmp_path / "C.MAT", {"counts": values}, format=version)
    for source in (tmp_path / "C.MAT", f"{tmp_path}/C.MAT:counts"):
        assert np.array_equal(read_table(source).values, values)


def test_what_matlab_has_besides_full_numbers_is_named(tmp_path):
    savemat(
        tmp_path / "s.mat",
        {"m": sparse.csc_matrix(VALUES), "c": np.array(["a", 1], object), "s": {"x": 1.0}},
    )
    with pytest.raises(InputError, match=r"none \(and m \(sparse\), c \(cell\), s .* full\(\)"):
        read_table(tmp_path / "s.mat")
    savemat(tmp_path / "z.mat", {"counts": VALUES * 1j})
    with pytest.raises(InputError, match="complex numbers: give real ones"):
        read_table(tmp_path / "z.mat")
