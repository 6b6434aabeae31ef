"""Tables of numbers in ``.csv``, ``.parquet``, ``.npy``, ``.mat`` and HDF5 files."""

from collections.abc import Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from deepfsi.errors import InputError
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
    if not path.is_file():
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
        frame, named = _read_text(path) if text else (pl.read_parquet(path), True)
    except (Exception, pl.exceptions.PanicException) as error:  # what polars cannot parse
        said = str(error).splitlines()[0] if str(error) else type(error).__name__
        raise InputError(f"cannot read {path} as a table ({said}): save it again") from error
    if not (frame.width and frame.height):
        raise InputError(f"{path} holds no numbers: give a row or column for each exposure")
    said_words = {
        name: tuple("" if each is None else str(each).strip() for each in frame[name].to_list())
        for name in words
        if named and name in frame.columns
    }
    numbers = frame.drop(said_words)
    first = 2 if named else 1
    columns = [_numbers(numbers[name], path, first) for name in numbers.columns]
    names = tuple(numbers.columns) if named else ()
    return Table(np.stack(columns, axis=1) if columns else np.empty((0, 0)), names, said_words)


def _read_text(path: Path) -> tuple["pl.DataFrame", bool]:
    """Columns of words from a text file, and whether its first line names them."""
    import polars as pl

    content = path.read_bytes().rstrip()
    lines = (line.strip() for line in content.splitlines())
    first = next((line for line in lines if line and not line.startswith(b"#")), b"").decode()
    separator = next((each for each in SEPARATORS if each in first), ",")
    if separator == " ":  # as wide as MATLAB's -ascii and others make them
        content = b"\n".join(b" ".join(line.split()) for line in content.splitlines())
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
        return frame, False
    heads = [str(head or "").strip() for head in frame.row(0)]
    if all(_is_number(head) for head in heads):
        return frame, False
    if len(set(heads)) < len(heads) or "" in heads:
        raise InputError("its first line must give each column a name of its own, or hold numbers")
    return frame.slice(1).rename(dict(zip(frame.columns, heads, strict=True))), True


def _is_number(text: str) -> bool:
    try:
        float(text)
    except ValueError:
        return False
    return True


def _numbers(column: "pl.Series", path: Path, first: int) -> np.ndarray:
    """Finite numbers of a column, or `InputError` naming the first line that has none."""
    import polars as pl

    texts = column.dtype == pl.String
    cast = (column.str.strip_chars() if texts else column).cast(pl.Float64, strict=False)
    values: np.ndarray = cast.fill_null(np.nan).to_numpy()
    wrong = np.flatnonzero(~np.isfinite(values))
    if wrong.size:
        held: Any = column[int(wrong[0])]
        said = "nothing" if held is None else repr(held)
        raise InputError(
            f"{path}: row {wrong[0] + first} of column {column.name} holds {said}: give numbers"
        )
    return values


def _finite(values: np.ndarray, path: Path) -> np.ndarray:
    """Values (rows, columns), or `InputError` naming the first that is not finite."""
    wrong = np.argwhere(~np.isfinite(values))
    if len(wrong):
        row, column = wrong[0] + 1
        raise InputError(f"{path}: row {row}, column {column} is not finite: give numbers")
    return values
