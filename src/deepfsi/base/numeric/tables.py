"""Tables of numbers, and lists of names, labels and numbers that a person or a program wrote.

Tables are ``.csv``, ``.parquet``, ``.npy`` and ``.mat`` files (`read_table`); lists are text alone,
a row of cells for each line (`read_rows`). A table is refused where it may be misread: a whole
number that floating point rounded, a first line that numbers the columns.
"""

import csv
import io
import os
import re
import unicodedata
from collections.abc import Callable, Iterable, Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from deepfsi.base.errors import InputError
from deepfsi.base.files import WINDOWS_ENCODING, check_unpacked, open_regular, read_text
from deepfsi.base.numeric.arrays import read_array, split_variable

if TYPE_CHECKING:
    import polars as pl

TEXT_ENDINGS = (".csv", ".txt", ".tsv", ".dat")
TABLE_ENDINGS = (*TEXT_ENDINGS, ".parquet", ".npy", ".mat")
"""Ends of the names of files that hold tables."""

USUAL_VARIABLE = "counts"
"""Name of the table of a file that holds several."""

LARGEST_TABLE = 2**27
"""Numbers of a table at most."""

LARGEST_TABLE_FILE = 2**31
"""Bytes of a text or Parquet file at most."""

MOST_COLUMNS = 2**15
"""Columns of a file at most: each takes 8 kB of memory, however few its rows are."""

LARGEST_WHOLE = 2.0**53
"""Numbers above which floating point leaves out whole ones."""

NUMBER = re.compile(r"[+-]?([0-9]+\.?[0-9]*|\.[0-9]+)([eE][+-]?[0-9]+)?")
"""A number as programs write it: no underscores, no digits of other scripts, no words."""

THOUSANDS = re.compile(r"[+-]?[1-9][0-9]{0,2}(,[0-9]{3})+")
"""A number that a comma may part into thousands as well as from its fraction."""

WITHOUT_VALUE = ("nan", "inf", "-inf", "+inf", "na", "n/a", "#n/a", "#num!", "#div/0!", "null")
"""Words that stand for a number that is none, in lower case."""

LABEL_HEADS = ("label", "labels", "class", "classes", "category", "target", "y", "class name")
"""Words over a column of labels, in lower case."""

LIST_SEPARATORS = ";\t,"
"""Characters that may stand between the cells of a line of text."""

SEPARATOR_LINE = re.compile(r"sep=(.)\n")
"""First line of a table by which Excel is told the separator."""

SEPARATOR_LINES = 1000
"""Lines by which the separator is found, at most."""


@dataclass(frozen=True)
class NumberTable:
    """Numbers in rows and columns, and columns of words beside them."""

    values: np.ndarray  # (rows, columns)
    names: tuple[str, ...] = ()
    words: dict[str, tuple[str, ...]] = field(default_factory=dict)


def is_table(source: str | Path) -> bool:
    """True if a path, or FILE:VARIABLE, ends like the name of a file that holds a table."""
    return split_variable(str(source))[0].suffix.lower() in TABLE_ENDINGS


def read_table(source: str | Path, words: Sequence[str] = ()) -> NumberTable:
    """Read a table."""
    path, columns = _read(source)
    if isinstance(columns, np.ndarray):
        return NumberTable(_finite(columns.astype(np.float64), path))
    word_columns = {
        name: tuple("" if cell is None else normal_name(str(cell)) for cell in columns.cells(index))
        for index, name in enumerate(columns.names)
        if name in words
    }
    numeric = [
        index
        for index in range(columns.width)
        if not columns.names or columns.names[index] not in word_columns
    ]
    heads = tuple(columns.names[index] for index in numeric) if columns.names else ()
    if not numeric:
        return NumberTable(np.empty((0, 0)), heads, word_columns)
    values = columns.numbers(numeric)
    wrong = np.argwhere(~np.isfinite(values))
    if wrong.size:
        row, column = wrong[0].tolist()
        raise InputError(_no_number(path, columns, row, numeric[column]))
    return NumberTable(values, heads, word_columns)


def read_whole_numbers(
    source: str | Path, choose: Callable[[tuple[str, ...], int], Sequence[int]]
) -> np.ndarray:
    """Whole numbers of some columns, exact to 64 bits, (rows, columns) int64."""
    path, columns = _read(source)
    if isinstance(columns, np.ndarray):
        return _whole_numbers(columns[:, list(choose((), columns.shape[1]))], str(path))
    chosen = list(choose(columns.names, columns.width))
    out = np.empty((columns.frame.height, len(chosen)), np.int64)
    for number, index in enumerate(chosen):
        values = columns.numbers([index])[:, 0]
        wrong = np.flatnonzero(~np.isfinite(values))
        if wrong.size:
            raise InputError(_no_number(path, columns, int(wrong[0]), index))
        exact = columns.exact(index)
        rest = exact.is_null().to_numpy()
        name = columns.names[index] if columns.names else f"column_{index + 1}"
        out[:, number] = exact.fill_null(0).to_numpy()
        out[rest, number] = _whole_numbers(values[rest], f"{path}, column {name},")
    return out


def _whole_numbers(values: np.ndarray, what: str) -> np.ndarray:
    """Numbers as int64, or `InputError` for one that is no whole number or may be rounded."""
    if values.dtype.kind == "b" or (values.dtype.kind in "iu" and values.dtype != np.uint64):
        return values.astype(np.int64)
    limit = 2**63 - 1 if values.dtype == np.uint64 else LARGEST_WHOLE
    wrong = values[(values != np.rint(values)) | ~(np.abs(values) <= limit)]
    if len(wrong):
        first = wrong[0]
        if values.dtype == np.uint64:
            raise InputError(f"{what} holds {first}: give whole numbers up to {limit}")
        if first != np.rint(first) or not np.isfinite(first):
            raise InputError(
                f"{what} holds {first!s}: give whole numbers, such as times counted in ps"
            )
        raise InputError(
            f"{what} holds {first:.17g} in floating point, which rounds whole numbers above "
            f"2^53, here to the nearest {np.spacing(first):.0f}: save them as whole numbers of 64 "
            "bits (int64)"
        )
    return values.astype(np.int64)


def _read(source: str | Path) -> "tuple[Path, np.ndarray | Columns]":
    """Path of a table, and its array or columns."""
    path, variable = split_variable(str(source))
    suffix = path.suffix.lower()
    if suffix not in TABLE_ENDINGS:
        raise InputError(f"{path} is no table: give a file ending in {', '.join(TABLE_ENDINGS)}")
    if not path.exists():
        raise InputError(f"there is no file {path}: give one ending in {', '.join(TABLE_ENDINGS)}")
    if suffix in (*TEXT_ENDINGS, ".parquet"):
        with _as_table(path):
            columns = _read_parquet(path) if suffix == ".parquet" else _read_text(path)
        if not (columns.width and columns.frame.height):
            raise InputError(f"{path} holds no numbers: give a row for each exposure")
        return path, columns
    dimensions = (2,) if suffix == ".mat" else (1, 2)
    values = read_array(path, dimensions, variable, largest=LARGEST_TABLE, usual=USUAL_VARIABLE)
    if values.ndim == 1:
        values = values[None]
    if values.ndim != 2 or not values.size:
        raise InputError(f"{path} holds an array of shape {values.shape}: give rows and columns")
    return path, values


def _no_number(path: Path, columns: "Columns", row: int, column: int) -> str:
    """Line that names a cell without a number."""
    cell: Any = columns.cells(column)[row]
    text = "nothing" if cell in (None, "") else repr(cell)
    name, first = (columns.names[column], 2) if columns.names else (f"column_{column + 1}", 1)
    return f"{path}: row {row + first} of column {name} holds {text}: give numbers"


def _finite(values: np.ndarray, path: Path) -> np.ndarray:
    """Values (rows, columns), or `InputError` naming the first that is not finite."""
    wrong = np.argwhere(~np.isfinite(values))
    if len(wrong):
        row, column = wrong[0] + 1
        raise InputError(f"{path}: row {row}, column {column} is not finite: give numbers")
    return values


@dataclass(frozen=True)
class Columns:
    """Columns of a text or Parquet file, and their names if its first line has some."""

    names: tuple[str, ...]
    frame: "pl.DataFrame"

    @property
    def width(self) -> int:
        """Number of columns."""
        return self.frame.width

    def cells(self, column: int) -> "pl.Series":
        """Cells of a column."""
        return self.frame.to_series(column)

    def numbers(self, chosen: Sequence[int]) -> np.ndarray:
        """Numbers of some columns, (rows, columns); not finite where a cell holds none."""
        import polars as pl

        columns = [self.cells(index) for index in chosen]
        return np.stack([one.cast(pl.Float64, strict=False).to_numpy() for one in columns], axis=1)

    def exact(self, column: int) -> "pl.Series":
        """Whole numbers of a column as its file has them, int64; null where it has others."""
        import polars as pl

        cells = self.cells(column)
        numbers = cells.cast(pl.Int64, strict=False)
        return numbers.clear(len(numbers)) if cells.dtype.is_float() else numbers


@contextmanager
def _as_table(path: Path) -> Iterator[None]:
    """Turn what polars raises on what it cannot parse into one line."""
    import polars as pl

    try:
        with _without_reports():
            yield
    except InputError:
        raise
    except (Exception, pl.exceptions.PanicException) as error:
        reason = str(error).splitlines()[0] if str(error) else type(error).__name__
        raise InputError(f"cannot read {path} as a table ({reason}): save it again") from error


@contextmanager
def _without_reports() -> Iterator[None]:
    """Drop what is written to file descriptor 2.

    A thread of polars that panics prints so, and its exception says the same.
    """
    try:
        usual = os.dup(2)
    except OSError:  # a program without a terminal may have closed it
        yield
        return
    nowhere = os.open(os.devnull, os.O_WRONLY)
    try:
        os.dup2(nowhere, 2)
        yield
    finally:
        os.dup2(usual, 2)
        os.close(usual)
        os.close(nowhere)


def _read_parquet(path: Path) -> Columns:
    import polars as pl

    with open_regular(path, LARGEST_TABLE_FILE, "give a .parquet file"):
        lazy = pl.scan_parquet(path)
        schema = lazy.collect_schema()
        rows = int(lazy.select(pl.len()).collect().item())
        _check_size(rows, len(schema))
        size = path.stat().st_size
        check_unpacked(rows * len(schema), size, str(path), "save it as a .npy file")
        for name, kind in schema.items():
            if kind.is_temporal() or kind.is_nested():
                raise InputError(f"{path}: column {name} holds {kind}: give numbers")
        return Columns(tuple(schema.names()), pl.read_parquet(path))


def _check_size(rows: int, columns: int) -> None:
    """Raise `InputError` for a table that is larger than any is read."""
    if columns > MOST_COLUMNS or rows * columns > LARGEST_TABLE:
        raise InputError(
            f"it has {rows} rows of {columns} columns: give {MOST_COLUMNS} columns and "
            f"{LARGEST_TABLE} numbers or fewer"
        )


def _read_text(path: Path) -> Columns:
    """Cells of a text file, and the names of its columns if its first line has some."""
    import polars as pl

    text = read_text(path, LARGEST_TABLE_FILE, "give a table of text", WINDOWS_ENCODING)
    first = next(_first_lines(text), None)
    if first is None:
        return Columns((), pl.DataFrame())
    separator = next((one for one in LIST_SEPARATORS if one in first), ",")
    if separator not in first:  # spaces, as NumPy writes them
        text = re.sub(" +", ",", re.sub("^ +| +$", "", text, flags=re.M))
        first = next(_first_lines(text))
    _check_size(1, first.count(separator) + 1)
    frame = pl.read_csv(
        text.encode(),
        separator=separator,
        has_header=False,
        infer_schema=False,
        comment_prefix="#",
    ).select(pl.all().str.strip_chars())
    frame = frame.filter(~pl.all_horizontal(pl.all().is_null()))
    _check_size(frame.height, frame.width)
    heads = [head or "" for head in frame.row(0)]
    numbers = [parse_number(head) for head in heads]
    if any(number is not None for number in numbers) or not set(heads).isdisjoint(WITHOUT_VALUE):
        _check_heading(numbers, frame.height, path)
        return Columns((), frame)
    if len(set(heads)) < len(heads) or "" in heads:
        raise InputError(
            f"{path}: its first line must give each column a name of its own, or hold numbers"
        )
    return Columns(tuple(heads), frame[1:])


def _check_heading(numbers: list[float | None], rows: int, path: Path) -> None:
    """Raise `InputError` for a first line that numbers the columns, as pandas writes it."""
    count = list(range(len(numbers)))
    if rows > 1 and len(count) > 3 and numbers in (count, [number + 1 for number in count]):
        raise InputError(
            f"{path}: its first line numbers the columns ({numbers[0]:g} to {numbers[-1]:g}) and "
            "would be read as values: leave it out, or give names"
        )


@dataclass(frozen=True)
class TextRows:
    """Cells of a text file, without blank lines and comments."""

    cells: tuple[tuple[str, ...], ...]
    lines: tuple[int, ...]  # number of the line of each row
    separator: str  # between the cells


def read_rows(path: Path, largest: int, advice: str) -> TextRows:
    """Rows of a list, in which a line `# …` is a comment."""
    text = read_text(path, largest, advice, WINDOWS_ENCODING)
    text, separator, skipped = _separated(text)
    lines = ["" if re.match(r"#($|\s)", line) else line for line in text.split("\n")]
    source = io.StringIO("\n".join(lines), newline="")
    reader = csv.reader(source, delimiter=separator, skipinitialspace=True, strict=True)
    cells: list[list[str]] = []
    numbers: list[int] = []
    try:
        for row in reader:
            if any(cell.strip() for cell in row):
                cells.append([cell.strip().replace("\n", " ") for cell in row])
                numbers.append(reader.line_num + skipped)
    except csv.Error as error:
        raise InputError(f"{path}, line {reader.line_num + skipped}: {error}; {advice}") from None
    while cells and all(len(row) > 1 and not row[-1] for row in cells):
        cells = [row[:-1] for row in cells]  # a separator at the end of every line
    return TextRows(tuple(map(tuple, cells)), tuple(numbers), separator)


def parse_number(text: str, comma: bool = False) -> float | None:
    """Finite number that a text is, or None."""
    text = text.strip()
    if comma and "." not in text:
        text = text.replace(",", ".", 1)
    value = float(text) if NUMBER.fullmatch(text) else float("inf")
    return value if abs(value) < float("inf") else None


def is_whole_number(text: str) -> bool:
    """True for a number that is written without point and exponent."""
    return re.fullmatch(r"[+-]?[0-9]+", text.strip()) is not None


def has_decimal_commas(cells: Iterable[str], separator: str) -> bool:
    """True if the commas of a table's cells part fractions: not those of a list with commas."""
    if separator not in (";", "\t"):
        return False
    with_comma = [cell.strip() for cell in cells if "," in cell]
    return any(
        not THOUSANDS.fullmatch(cell) and parse_number(cell, comma=True) is not None
        for cell in with_comma
    )


def normal_name(name: str) -> str:
    """A name in the one spelling of Unicode that is kept (NFC), without blanks around it."""
    return unicodedata.normalize("NFC", name).strip()


def _separated(text: str) -> tuple[str, str, int]:
    """Text, its separator, and how many lines were taken off: one, if it names the separator."""
    # Otherwise it is the first of `LIST_SEPARATORS` in every line; then one in the first line
    if match := SEPARATOR_LINE.match(text.replace('"', "", 2) if text[:1] == '"' else text):
        return text.split("\n", 1)[1], match[1], 1
    lines = list(_first_lines(text))
    every = (one for one in LIST_SEPARATORS if lines and all(one in line for line in lines))
    some = (one for one in LIST_SEPARATORS if lines and one in lines[0])
    return text, next(every, next(some, ",")), 0


def _first_lines(text: str) -> Iterator[str]:
    """The first lines that are neither empty nor comments."""
    start = 0
    count = 0
    while start < len(text) and count < SEPARATOR_LINES:
        end = text.find("\n", start)
        end = len(text) if end < 0 else end
        line = text[start:end]
        if line.strip() and not line.startswith("#"):
            yield line
            count += 1
        start = end + 1
