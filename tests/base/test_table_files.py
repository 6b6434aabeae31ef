"""Tables of numbers: the same table from every kind of file, and one line for what is none."""

import struct
import zlib
from contextlib import nullcontext

import numpy as np
import polars as pl
import pytest
from scipy import sparse
from scipy.io import savemat

from deepfsi.base.errors import InputError
from deepfsi.base.tables import read_table, read_whole_numbers

VALUES = np.random.default_rng(2).integers(0, 1000, (3, 5))
NAMES = tuple("abcde")


def parquet(path, values):
    pl.DataFrame(values, schema=[*NAMES[: values.shape[1]]]).write_parquet(path)


WRITERS = {
    "npy": np.save,
    "parquet": parquet,
    "mat": lambda path, values: savemat(path, {"counts": values.astype(float), "gain": 2.0}),
    "csv named": lambda path, values: np.savetxt(
        path, values, "%d", ",", header=",".join(NAMES), comments=""
    ),
    "csv ;": lambda path, values: np.savetxt(path, values, "%g", ";"),
    "csv": lambda path, values: np.savetxt(path, values, "%d", ",", header="as numpy writes it"),
    "txt": lambda path, values: np.savetxt(path, values, "%9.1f"),
}


def write(folder, kind, values=VALUES):
    path = folder / f"counts.{kind.split()[0]}"
    WRITERS[kind](path, values)
    return path


@pytest.mark.parametrize("kind", WRITERS)
def test_every_kind_of_file_holds_the_same_table(tmp_path, kind):
    source = write(tmp_path, kind)
    table = read_table(source)
    assert table.values.dtype == np.float64
    assert np.array_equal(table.values, VALUES)
    assert table.names == (NAMES if kind in ("csv named", "parquet") else ())


@pytest.mark.parametrize(
    "text",
    [
        "1,2\r\n\r\n3,4\r\n",
        "1\t2\n3\t4",
        "\ufeffa;b\n1;2\n3;4\n",
        "# by a counter\n1, 2\n3 ,4\n",
        '"a","b"\n"1","2"\n"3","4"\n\n',
        "a\tb\n1.0\t2e0\n3.\t4\n",
        '"a, b";c\n"1";" 2"\n3;4\n',
    ],
)
def test_text_is_read_as_other_programs_write_it(tmp_path, text):
    path = tmp_path / "t.csv"
    for encoding in ("utf-8", "utf-16"):
        path.write_bytes(text.encode(encoding))
        assert np.array_equal(read_table(path).values, [[1, 2], [3, 4]])


@pytest.mark.parametrize("kind", ["csv", "npy", "parquet"])
def test_whole_numbers_are_exact_to_64_bits(tmp_path, kind):
    values = np.array([[2**62 + 1, 1], [2**53 + 1, -(2**60) - 1]])
    path = write(tmp_path, kind, values)
    whole = read_whole_numbers(path, lambda names, width: range(width))
    assert whole.dtype == np.int64
    assert np.array_equal(whole, values)


@pytest.mark.parametrize(
    ("values", "said"),
    [
        (np.array([[2.0**53 + 2, 1]]), "in floating point up to 2.53"),
        (np.array([[0.5, 1]]), "holds 0.5: give whole numbers"),
        (np.array([[np.inf, 1]]), "holds inf: give numbers"),
        (np.array([[2**63, 1]], np.uint64), "holds 9223372036854775808"),
        (np.array([[2**24 + 2, 1]], np.float32), "of 32 bits 2.24"),
    ],
)
def test_whole_numbers_that_may_be_rounded_are_refused(tmp_path, values, said):
    np.save(tmp_path / "t.npy", values)
    with pytest.raises(InputError, match=said):
        read_whole_numbers(tmp_path / "t.npy", lambda names, width: range(width))


@pytest.mark.parametrize(
    ("number", "exact"), [("1.2345e+07", False), ("1.2345E+07", False), ("1.2345678e+07", True)]
)
def test_whole_numbers_of_too_few_digits_are_refused(tmp_path, number, exact):
    """As MATLAB's dlmwrite and "%g" write them."""
    (tmp_path / "t.txt").write_text(f"1 2\n{number} 2\n")
    with nullcontext() if exact else pytest.raises(InputError, match="with all their digits"):
        found = read_whole_numbers(tmp_path / "t.txt", lambda names, width: range(width))
        assert found.tolist() == [[1, 2], [12345678, 2]]


@pytest.mark.parametrize(
    ("text", "said"),
    [
        ("a,b\n1,2\n3,x\n", r"row 2 of column b holds 'x'"),
        ("1,2\n3,4,5\n", "more fields"),
        ("a,a\n1,2\n", "a name of its own"),
        ("a,b\n", "holds no numbers"),
        ("nan\n1\n2\n", "row 1 of column column_1 holds 'nan'"),
        ("0,1,2,3\n5,6,7,8\n", "its first line numbers the columns"),
        (3_000_000 * ",", "too many columns"),
        ("1;2\n1,5;2\n", "row 2 of column column_1 holds '1,5'"),
    ],
)
def test_text_that_is_no_table_is_one_line(tmp_path, text, said):
    (tmp_path / "t.csv").write_text(text)
    one_line(tmp_path / "t.csv", said)


def one_line(source, said):
    """Expect that a file is refused so, in one line."""
    with pytest.raises(InputError, match=said) as error:
        read_table(source)
    assert "\n" not in str(error.value)


CELLS = {"m": sparse.csc_matrix(VALUES), "c": np.array(["a", 1], object), "s": {"x": 1.0}}


@pytest.mark.parametrize(
    ("name", "content", "said"),
    [
        ("cube.npy", np.zeros((2, 2, 2)), r"shape \(2, 2, 2\)"),
        ("nan.npy", [[0, np.nan]], "row 1 of column column_2 holds nan"),
        ("two.mat", {"a": VALUES, "b": VALUES}, r"no variable 'counts' .* a, b: name one as"),
        ("two.mat:c", {"a": VALUES, "b": VALUES}, r"no variable 'c'"),
        ("s.mat", CELLS, "but none"),
        ("z.mat", {"counts": VALUES * 1j}, "but none"),
        ("cut.parquet", b"PAR1", "as a table"),
        ("none.csv", None, "none.csv is missing"),
        ("run.ptu", None, "is no table: give a file ending in .csv"),
    ],
)
def test_files_that_are_no_table_are_one_line(tmp_path, name, content, said):
    path = tmp_path / name.split(":")[0]
    if isinstance(content, dict):
        savemat(path, content)
    elif isinstance(content, bytes):
        path.write_bytes(content)
    elif content is not None:
        np.save(path, content)
    one_line(tmp_path / name, said)


def element(kind, *parts):
    data = b"".join(parts)
    return struct.pack("<II", kind, len(data)) + data + bytes(-len(data) % 8)


def flags(*numbers):
    return element(6, struct.pack(f"<{len(numbers)}I", *numbers))


def mat_numbers(name, values):
    """A variable of doubles as MATLAB writes it."""
    values = np.asarray(values, float)
    shape = element(5, struct.pack("<ii", *values.shape))
    return element(14, flags(6, 0), shape, element(1, name), element(9, values.tobytes("F")))


def mat_string(name):
    """A string, table or datetime: MATLAB hides its values behind a reference."""
    reference = flags(0xDD000000, 2, 1, 1, 1, 1)
    shape = element(5, struct.pack("<ii", 6, 1))
    inner = element(14, flags(13, 0), shape, element(1, b""), reference)
    words = (element(1, word) for word in (name, b"MCOS", b"string"))
    return element(14, flags(17, 0), *words, inner)


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
