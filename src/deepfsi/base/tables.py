"""Tables of numbers, and lists of names, labels and numbers that a person or a program wrote.

Tables are text, ``.parquet``, ``.npy`` and ``.mat`` files (`read_table`); lists are text alone,
a row of cells for each line (`read_cells`). A table is refused where it may be misread: a whole
number that floating point rounded, a first line that numbers the columns.
"""

import re
import unicodedata
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from deepfsi.base.arrays import read_array, split_variable
from deepfsi.base.errors import InputError
from deepfsi.base.files import check_unpacked, open_regular, read_text

if TYPE_CHECKING:
    import polars as pl

TEXT_ENDINGS = (".csv", ".txt", ".tsv", ".dat")
TABLE_ENDINGS = (*TEXT_ENDINGS, ".parquet", ".npy", ".mat")
"""Ends of the names of files that hold tables."""

LARGEST_TABLE_FILE = 2**31
"""Bytes of a text or Parquet file at most."""

MOST_COLUMNS = 2**15
"""Columns of a file at most: polars would take minutes for three million."""

SEPARATORS = ";\t,"
"""Characters that may stand between the cells of a line of text."""


@dataclass(frozen=True)
class NumberTable:
    """Numbers in rows and columns, and columns of words beside them."""

    values: np.ndarray  # (rows, columns)
    names: tuple[str, ...] = ()
    words: dict[str, tuple[str, ...]] = field(default_factory=dict)


def read_table(source: str | Path, words: Sequence[str] = ()) -> NumberTable:
    """Read a table; columns named in `words` are kept as text."""
    import polars as pl

    path, names, frame = _read(source)
    beside = [name for name in names if name in words]
    word_columns = {
        name: tuple(normal_name(cell or "") for cell in frame[name].cast(pl.String))
        for name in beside
    }
    numeric = frame.drop(beside)
    values = numeric.select(pl.all().cast(pl.Float64, strict=False)).to_numpy()
    _check_numbers(path, numeric, values)
    return NumberTable(values, tuple(n for n in names if n not in beside), word_columns)


def read_whole_numbers(
    source: str | Path, choose: Callable[[tuple[str, ...], int], Sequence[int]]
) -> np.ndarray:
    """Whole numbers (rows, columns) int64 of the chosen columns, exact to 64 bits."""
    import polars as pl

    path, names, frame = _read(source)
    chosen = frame.select(frame.columns[index] for index in choose(names, frame.width))
    out = np.empty(chosen.shape, np.int64)
    for index, column in enumerate(chosen):
        floats = column.cast(pl.Float64, strict=False).to_numpy()
        _check_numbers(path, column.to_frame(), floats[:, None])
        integers = None if column.dtype.is_float() else column.cast(pl.Int64, strict=False)
        if integers is None or integers.null_count():
            # Floats above `exact` may have been rounded. So has a text such as 1.2e12, which gives
            # fewer digits than its number has
            exact = 2.0**24 if column.dtype == pl.Float32 else 2.0**53
            wrong = (floats != np.rint(floats)) | (np.abs(floats) > exact)
            if column.dtype == pl.String:
                digits = column.str.extract(r"^[+-]?([\d.]*)[eE]", 1).str.count_matches(r"\d")
                wrong |= np.abs(floats) >= 10.0 ** digits.fill_null(99).to_numpy()
            if wrong.any():
                raise InputError(
                    f"{path}, column {column.name}, holds {column[int(wrong.argmax())]}: give "
                    "whole numbers such as times counted in ps with all their digits, in floating "
                    "point up to 2^53 (of 32 bits 2^24), else as integers of 64 bits"
                )
            integers = pl.Series(floats.astype(np.int64))
        out[:, index] = integers.to_numpy()
    return out


def _read(source: str | Path) -> "tuple[Path, tuple[str, ...], pl.DataFrame]":
    """Path of a table, names of its columns (empty if it has none), and its cells."""
    import polars as pl

    path, variable = split_variable(str(source))
    suffix = path.suffix.lower()
    if suffix not in TABLE_ENDINGS:
        raise InputError(f"{path} is no table: give a file ending in {', '.join(TABLE_ENDINGS)}")
    names: tuple[str, ...] = ()
    if suffix in TEXT_ENDINGS:
        names, frame = _read_text(path)
    elif suffix == ".parquet":
        advice = "give a .parquet file of numbers and names"
        with _as_table(path), open_regular(path, LARGEST_TABLE_FILE, advice):
            table = pl.scan_parquet(path)
            kinds = table.collect_schema().dtypes()
            if any(kind.is_nested() or kind.is_temporal() or kind == pl.Binary for kind in kinds):
                raise InputError(f"{path} has cells that are no numbers and no names: {advice}")
            cells = table.select(pl.len()).collect().item() * len(kinds)
            check_unpacked(cells, path.stat().st_size, str(path), advice)
            named = pl.col(pl.Categorical, pl.Enum).cast(pl.String)
            frame = table.with_columns(named).collect()
        names = tuple(frame.columns)
    else:
        # A vector is one exposure; MATLAB's arrays have two dimensions or more
        dimensions = (2,) if suffix == ".mat" else (1, 2)
        values = read_array(path, dimensions, variable, usual="counts")
        if values.ndim not in dimensions:
            raise InputError(
                f"{path} holds an array of shape {values.shape}: give rows and columns"
            )
        values = np.atleast_2d(values)
        frame = pl.from_numpy(
            values, [f"column_{number}" for number in range(1, values.shape[1] + 1)]
        )
    if not (frame.width and frame.height):
        raise InputError(f"{path} holds no numbers: give a row for each exposure")
    return path, names, frame


def _check_numbers(path: Path, frame: "pl.DataFrame", values: np.ndarray) -> None:
    """Raise `InputError` for the first cell whose value (rows, columns) is no finite number."""
    wrong = np.argwhere(~np.isfinite(values))
    if wrong.size:
        row, column = wrong[0].tolist()
        raise InputError(
            f"{path}: row {row + 1} of column {frame.columns[column]} holds "
            f"{frame[row, column]!r}: give numbers"
        )


@contextmanager
def _as_table(path: Path) -> Iterator[None]:
    """Turn the errors of polars on a damaged file into one line."""
    import polars as pl

    try:
        yield
    except InputError:
        raise
    except (Exception, pl.exceptions.PanicException) as error:
        reason = next(iter(str(error).splitlines()), type(error).__name__)
        raise InputError(f"cannot read {path} as a table ({reason}): save it again") from error


def _read_text(path: Path) -> "tuple[tuple[str, ...], pl.DataFrame]":
    """Names of the columns of a text file (empty without a heading), and its cells."""
    import polars as pl

    frame = read_cells(path, "give a table of text", spaces=True)
    if frame.is_empty():
        return (), frame
    heads = [head or "" for head in frame.row(0)]
    numbers = pl.Series(heads).cast(pl.Float64, strict=False)
    if numbers.null_count() < len(heads):
        # pandas numbers columns without names so
        if frame.height > 1 and len(heads) > 3 and numbers.to_list() == list(range(len(heads))):
            raise InputError(
                f"{path}: its first line numbers the columns from 0 and would be read as values: "
                "leave it out, or give names"
            )
        return (), frame
    if len(set(heads)) < len(heads) or "" in heads:
        raise InputError(
            f"{path}: its first line must give each column a name of its own, or hold numbers"
        )
    return tuple(heads), frame[1:].rename(dict(zip(frame.columns, heads, strict=True)))


def read_cells(path: Path, advice: str, spaces: bool = False) -> "pl.DataFrame":
    """Cells of a text file, a heading among them, without blank lines and comments.

    Cells are separated by the first of `SEPARATORS` in the first line, or by spaces where it has
    none and `spaces` says so.
    """
    import polars as pl

    text = read_text(path, LARGEST_TABLE_FILE, advice)
    first = next((line for line in text.split("\n") if line.strip() and line[0] != "#"), "")
    separator = next((mark for mark in SEPARATORS if mark in first), ",")
    if spaces and separator not in first:  # as NumPy writes tables
        text = re.sub("^ | $", "", re.sub(" +", " ", text), flags=re.M).replace(" ", ",")
        first = re.sub(" +", ",", first.strip())
    if not first:
        return pl.DataFrame()
    if first.count(separator) >= MOST_COLUMNS:
        raise InputError(f"{path} has too many columns: give {MOST_COLUMNS} columns or fewer")
    with _as_table(path):
        cells = pl.read_csv(
            text.encode(),
            separator=separator,
            has_header=False,
            infer_schema=False,
            comment_prefix="#",
        ).select(pl.all().str.strip_chars())
    cells.columns = [f"column_{number}" for number in range(1, cells.width + 1)]
    return cells.filter(~pl.all_horizontal(pl.all().is_null()))


def normal_name(name: str) -> str:
    """A name in one spelling of Unicode (NFC), without blanks around it."""
    return unicodedata.normalize("NFC", name).strip()
