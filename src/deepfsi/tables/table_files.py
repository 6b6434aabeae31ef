"""Tables of numbers in ``.csv``, ``.parquet``, ``.npy``, ``.mat`` and HDF5 files."""

import os
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from deepfsi.errors import InputError
from deepfsi.files import check_unpacked, open_regular, read_regular
from deepfsi.tables.array_files import VARIABLES, read_array, split_variable

if TYPE_CHECKING:
    import polars as pl

TEXTS = (".csv", ".txt", ".tsv", ".dat")
"""Ends of the names of text files."""

SUFFIXES = (*TEXTS, ".parquet", ".npy", *VARIABLES)
"""Ends of the names of files that hold tables."""

USUAL_VARIABLE = "counts"
"""Name of the table of a file that holds several."""

LARGEST = 2**27
"""Numbers of a table at most."""

LARGEST_FILE = 2**31
"""Bytes of a text or Parquet file at most."""

MOST_COLUMNS = 2**18
"""Columns of a text or Parquet file at most."""

SEPARATORS = ",;\t "
"""Characters that may stand between the numbers of a line of text."""


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
    path, variable = split_variable(str(source))
    suffix = path.suffix.lower()
    if suffix not in SUFFIXES:
        raise InputError(f"{path} is no table: give a file ending in {', '.join(SUFFIXES)}")
    if not path.exists():
        raise InputError(f"there is no file {path}: give one ending in {', '.join(SUFFIXES)}")
    if suffix in (*TEXTS, ".parquet"):
        return _of_columns(path, words)
    dimensions = (2,) if suffix == ".mat" else (1, 2)
    values = read_array(path, dimensions, variable, largest=LARGEST, usual=USUAL_VARIABLE)
    if values.ndim == 1:
        values = values[None]
    if values.ndim != 2 or not values.size:
        raise InputError(f"{path} holds an array of shape {values.shape}: give rows and columns")
    return Table(_finite(values.astype(np.float64), path))


def _of_columns(path: Path, words: Sequence[str]) -> Table:
    """Table of a file of columns, which may have names and hold words."""
    import polars as pl

    try:
        text = path.suffix.lower() in TEXTS
        with _without_reports():
            frame, names = _read_text(path) if text else _read_parquet(path)
    except InputError:
        raise
    except (Exception, pl.exceptions.PanicException) as error:  # what polars cannot parse
        said = str(error).splitlines()[0] if str(error) else type(error).__name__
        raise InputError(f"cannot read {path} as a table ({said}): save it again") from error
    if not (frame.width and frame.height):
        raise InputError(f"{path} holds no numbers: give a row or column for each exposure")
    columns = frame.get_columns()
    said_words = {
        name: tuple("" if each is None else str(each).strip() for each in column.to_list())
        for name, column in zip(names, columns, strict=False)
        if name in words
    }
    kept = [place for place in range(len(columns)) if not names or names[place] not in said_words]
    heads = tuple(names[place] for place in kept) if names else ()
    if not kept:
        return Table(np.empty((0, 0)), heads, said_words)
    numbers = [columns[place] for place in kept]
    return Table(_numbers(numbers, heads, path), heads, said_words)


@contextmanager
def _without_reports() -> Iterator[None]:
    """Drop what is written to file descriptor 2.

    A thread of polars that panics prints so, and its exception says the same.
    """
    try:
        kept = os.dup(2)
    except OSError:  # a program without a terminal may have closed it
        yield
        return
    nowhere = os.open(os.devnull, os.O_WRONLY)
    try:
        os.dup2(nowhere, 2)
        yield
    finally:
        os.dup2(kept, 2)
        os.close(kept)
        os.close(nowhere)


def _read_parquet(path: Path) -> tuple["pl.DataFrame", list[str]]:
    """Columns of a Parquet file, and their names."""
    import polars as pl

    with open_regular(path, LARGEST_FILE, "give a .parquet file"):
        lazy = pl.scan_parquet(path)
        names = lazy.collect_schema().names()
        rows = int(lazy.select(pl.len()).collect().item())
        _check_size(rows, len(names))
        size = path.stat().st_size
        check_unpacked(rows * len(names), size, str(path), "save it as a .npy file")
        return pl.read_parquet(path), names


def _check_size(rows: int, columns: int) -> None:
    """Raise `InputError` for a table that is larger than any is read."""
    if columns > MOST_COLUMNS or rows * columns > LARGEST:
        raise InputError(
            f"it has {rows} rows of {columns} columns: give {MOST_COLUMNS} columns and {LARGEST} "
            "numbers or fewer"
        )


def _read_text(path: Path) -> tuple["pl.DataFrame", list[str]]:
    """Columns of words from a text file, and their names if its first line has some."""
    import polars as pl

    content = read_regular(path, LARGEST_FILE, "give a table of text").rstrip()
    lines = (line.strip() for line in content.splitlines())
    first = next((line for line in lines if line and not line.startswith(b"#")), b"").decode()
    separator = next((each for each in SEPARATORS if each in first), ",")
    if separator == " ":  # as wide as MATLAB's -ascii and others make them
        content = b"\n".join(b" ".join(line.split()) for line in content.splitlines())
    _check_size(1, first.count(separator))
    frame = pl.read_csv(
        content,
        has_header=False,
        infer_schema=False,
        comment_prefix="#",
        separator=separator,
    )
    if frame.width > 1 and frame.to_series(-1).is_null().all():
        frame = frame[:, :-1]  # a separator at the end of every line
    if not frame.height:
        return frame, []
    heads = [str(head or "").strip() for head in frame.row(0)]
    if all(_is_number(head) for head in heads):
        return frame, []
    if len(set(heads)) < len(heads) or "" in heads:
        raise InputError(
            f"{path}: its first line must give each column a name of its own, or hold numbers"
        )
    return frame.slice(1), heads


def _is_number(text: str) -> bool:
    try:
        float(text)
    except ValueError:
        return False
    return True


def _numbers(columns: "list[pl.Series]", names: Sequence[str], path: Path) -> np.ndarray:
    """Finite numbers of columns, or `InputError` naming the first line that has none."""
    import polars as pl

    if all(column.dtype == pl.String for column in columns):  # many expressions would take long
        texts = pl.concat(columns, rechunk=True).str.strip_chars()
        every = texts.cast(pl.Float64, strict=False).to_numpy()
        values: np.ndarray = every.reshape(len(columns), -1).T
    else:
        cast = [column.cast(pl.Float64, strict=False).to_numpy() for column in columns]
        values = np.stack(cast, axis=1)
    wrong = np.argwhere(~np.isfinite(values.T))
    if wrong.size:
        place, row = wrong[0].tolist()
        held: Any = columns[place][row]
        said = "nothing" if held is None else repr(held)
        name, first = (names[place], 2) if names else (f"column_{place + 1}", 1)
        raise InputError(f"{path}: row {row + first} of column {name} holds {said}: give numbers")
    return values


def _finite(values: np.ndarray, path: Path) -> np.ndarray:
    """Values (rows, columns), or `InputError` naming the first that is not finite."""
    wrong = np.argwhere(~np.isfinite(values))
    if len(wrong):
        row, column = wrong[0] + 1
        raise InputError(f"{path}: row {row}, column {column} is not finite: give numbers")
    return values
