"""Tables of numbers: the same table from every kind of file, and one line for what is none."""

import os
from pathlib import Path

import h5py
import numpy as np
import polars as pl
import pytest
from scipy.io import savemat

from deepfsi.errors import InputError
from deepfsi.tables import table_files
from deepfsi.tables.table_files import is_table, read_table

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


def test_columns_of_words_stand_apart(tmp_path):
    path = tmp_path / "t.csv"
    path.write_text("scene,a,b\none,1,2\n two ,3,4\n")
    table = read_table(path, ("scene", "label"))
    assert table.words == {"scene": ("one", "two")}
    assert table.names == ("a", "b")
    assert np.array_equal(table.values, [[1, 2], [3, 4]])


@pytest.mark.parametrize(
    "text",
    [
        "   1.0000000e+00   2.0000000e+00\n   3.0000000e+00   4.0000000e+00\n",  # MATLAB -ascii
        "1,2,\r\n3,4,\r\n",
        "1\t2\n3\t4",
        "\ufeffa;b\n1;2\n3;4\n",
        "# by a counter\n1 2\n3  4\n",
        '"a","b"\n"1","2"\n"3","4"\n\n',
    ],
)
def test_text_is_read_as_other_programs_write_it(tmp_path, text):
    path = tmp_path / "t.txt"
    path.write_bytes(text.encode())
    assert np.array_equal(read_table(path).values, [[1, 2], [3, 4]])


@pytest.mark.parametrize(
    ("text", "said"),
    [
        ("a,b\n1,2\n3,x\n", r"row 3 of column b holds 'x'"),
        ("1,2\n3\n", "row 2 of column .* holds nothing"),
        ("1,2\n3,4,5\n", "as a table"),
        ("a,a\n1,2\n", "a name of its own"),
        ("1,nan\n", "holds 'nan'"),
        ("a,b\n", "holds no numbers"),
        ("", "as a table"),
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


def test_hdf5_without_its_package_says_what_to_install(tmp_path, monkeypatch):
    matlab_73(tmp_path / "new.mat", counts=VALUES)
    monkeypatch.setitem(__import__("sys").modules, "h5py", None)
    with pytest.raises(InputError, match=r"pip install h5py, or save it .* '-v7'"):
        read_table(tmp_path / "new.mat")


def test_a_vector_is_one_row(tmp_path):
    np.save(tmp_path / "one.npy", VALUES[0])
    assert read_table(tmp_path / "one.npy").values.shape == (1, 5)
    assert table_files.SUFFIXES[0] == ".csv"
