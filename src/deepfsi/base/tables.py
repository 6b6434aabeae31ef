"""Tables of numbers in ``.csv``, ``.parquet``, ``.npy``, ``.mat`` and HDF5 files."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from deepfsi.base.arrays import VARIABLES, read_array, split_variable
from deepfsi.base.errors import InputError
from deepfsi.base.text_files import spelling

if TYPE_CHECKING:
    from deepfsi.base.columns import Columns

TEXTS = (".csv", ".txt", ".tsv", ".dat")
"""Ends of the names of text files."""

SUFFIXES = (*TEXTS, ".parquet", ".npy", *VARIABLES)
"""Ends of the names of files that hold tables."""

USUAL_VARIABLE = "counts"
"""Name of the table of a file that holds several."""

LARGEST = 2**27
"""Numbers of an array at most."""

LARGEST_WHOLE = 2.0**53
"""Numbers above which floating point leaves out whole ones."""


@dataclass(frozen=True)
class Table:
    """Numbers in rows and columns, and columns of words beside them."""

    values: np.ndarray  # (rows, columns): float64
    names: tuple[str, ...] = ()  # of the columns; empty where they have none
    # From the name of a column of words to those of each row
    words: dict[str, tuple[str, ...]] = field(default_factory=dict)


def is_table(source: str | Path) -> bool:
    """True if a path, or FILE:VARIABLE, ends like the name of a file that holds a table."""
    return split_variable(str(source))[0].suffix.lower() in SUFFIXES


def read_table(source: str | Path, words: Sequence[str] = ()) -> Table:
    """Read a table."""
    path, columns = _read(source)
    if isinstance(columns, np.ndarray):
        return Table(_finite(columns.astype(np.float64), path))
    said_words = {
        name: tuple("" if one is None else spelling(str(one)) for one in columns.cells(place))
        for place, name in enumerate(columns.names)
        if name in words
    }
    kept = [
        place
        for place in range(columns.width)
        if not columns.names or columns.names[place] not in said_words
    ]
    heads = tuple(columns.names[place] for place in kept) if columns.names else ()
    if not kept:
        return Table(np.empty((0, 0)), heads, said_words)
    values = columns.numbers(kept)
    wrong = np.argwhere(~np.isfinite(values))
    if wrong.size:
        row, column = wrong[0].tolist()
        raise InputError(_no_number(path, columns, row, kept[column]))
    return Table(values, heads, said_words)


def read_whole(
    source: str | Path, choose: Callable[[tuple[str, ...], int], Sequence[int]]
) -> np.ndarray:
    """Whole numbers of some columns, exact to 64 bits, (rows, columns) int64.

    Parameters
    ----------
    source : str or path
        A file as of `read_table`.
    choose : callable
        Chooses columns by their names, of which there may be none, and their number.

    Raises
    ------
    InputError
        If a number is no whole one, or one that its file may have rounded.
    """
    path, columns = _read(source)
    if isinstance(columns, np.ndarray):
        return as_whole(columns[:, list(choose((), columns.shape[1]))], str(path))
    kept = list(choose(columns.names, columns.width))
    whole = np.empty((columns.rows, len(kept)), np.int64)
    for at, place in enumerate(kept):
        values, exact = columns.numbers([place])[:, 0], columns.whole(place)
        wrong = np.flatnonzero(~np.isfinite(values))
        if wrong.size:
            raise InputError(_no_number(path, columns, int(wrong[0]), place))
        rest = exact.is_null().to_numpy()
        name = columns.names[place] if columns.names else f"column_{place + 1}"
        whole[:, at] = exact.fill_null(0).to_numpy()
        whole[rest, at] = as_whole(values[rest], f"{path}, column {name},")
    return whole


def as_whole(values: np.ndarray, what: str) -> np.ndarray:
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
    if suffix not in SUFFIXES:
        raise InputError(f"{path} is no table: give a file ending in {', '.join(SUFFIXES)}")
    if not path.exists():
        raise InputError(f"there is no file {path}: give one ending in {', '.join(SUFFIXES)}")
    if suffix in (*TEXTS, ".parquet"):
        from deepfsi.base.columns import as_table, read_parquet_columns, read_text_columns

        with as_table(path):
            columns = read_text_columns(path) if suffix in TEXTS else read_parquet_columns(path)
        if not (columns.width and columns.rows):
            raise InputError(f"{path} holds no numbers: give a row or column for each exposure")
        return path, columns
    dimensions = (2,) if suffix == ".mat" else (1, 2)
    values = read_array(path, dimensions, variable, largest=LARGEST, usual=USUAL_VARIABLE)
    if values.ndim == 1:
        values = values[None]
    if values.ndim != 2 or not values.size:
        raise InputError(f"{path} holds an array of shape {values.shape}: give rows and columns")
    return path, values


def _no_number(path: Path, columns: "Columns", row: int, place: int) -> str:
    """Line that names a cell without a number."""
    held: Any = columns.cells(place)[row]
    said = "nothing" if held in (None, "") else repr(held)
    name, first = (columns.names[place], 2) if columns.names else (f"column_{place + 1}", 1)
    return f"{path}: row {row + first} of column {name} holds {said}: give numbers"


def _finite(values: np.ndarray, path: Path) -> np.ndarray:
    """Values (rows, columns), or `InputError` naming the first that is not finite."""
    wrong = np.argwhere(~np.isfinite(values))
    if len(wrong):
        row, column = wrong[0] + 1
        raise InputError(f"{path}: row {row}, column {column} is not finite: give numbers")
    return values
