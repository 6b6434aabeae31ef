"""Columns of text and Parquet files, whose cells are words or numbers."""

import csv
import io
import os
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import polars as pl

from deepfsi.base.errors import InputError
from deepfsi.base.files import WINDOWS, check_unpacked, open_regular, read_text
from deepfsi.base.text_files import WITHOUT_VALUE, has_decimal_commas, number_of, separated

LARGEST = 2**27
"""Numbers of a table at most."""

LARGEST_FILE = 2**31
"""Bytes of a text or Parquet file at most."""

MOST_COLUMNS = 2**18
"""Columns of a text file at most."""

MOST_PARQUET_COLUMNS = 2**15
"""Columns of a Parquet file at most: each takes 8 kB of memory, however few its rows are."""

SEPARATORS = ";\t, "
"""Characters that may stand between the numbers of a line of text."""


@dataclass(frozen=True)
class TextColumns:
    """Cells of a text file, row by row: a series for each of many columns would take far more."""

    names: tuple[str, ...]
    width: int
    flat: pl.Series

    @property
    def rows(self) -> int:
        """Rows of numbers or words."""
        return len(self.flat) // self.width

    def cells(self, place: int) -> pl.Series:
        """Cells of a column."""
        return self.flat.gather_every(self.width, place)

    def numbers(self, kept: Sequence[int]) -> np.ndarray:
        """Numbers of some columns, (rows, columns); not finite where a cell holds none."""
        flat = self.cells(kept[0]) if len(kept) == 1 else self.flat
        values = flat.cast(pl.Float64, strict=False).to_numpy().reshape(self.rows, -1)
        return values if values.shape[1] == len(kept) else values[:, list(kept)]

    def whole(self, place: int) -> pl.Series:
        """Whole numbers of a column as its file has them, exact; null where it has others."""
        return self.cells(place).cast(pl.Int64, strict=False)


@dataclass(frozen=True)
class ParquetColumns:
    """Columns of a Parquet file."""

    names: tuple[str, ...]
    frame: pl.DataFrame

    @property
    def width(self) -> int:
        """Number of columns."""
        return self.frame.width

    @property
    def rows(self) -> int:
        """Rows of numbers or words."""
        return self.frame.height

    def cells(self, place: int) -> pl.Series:
        """Cells of a column."""
        return self.frame.to_series(place)

    def numbers(self, kept: Sequence[int]) -> np.ndarray:
        """Numbers of some columns, (rows, columns); not finite where a cell holds none."""
        columns = [self.cells(place) for place in kept]
        return np.stack([one.cast(pl.Float64, strict=False).to_numpy() for one in columns], axis=1)

    def whole(self, place: int) -> pl.Series:
        """Whole numbers of a column as its file has them, exact; null where it has others."""
        cells = self.cells(place)
        found = cells.cast(pl.Int64, strict=False)
        return found.clear(len(found)) if cells.dtype.is_float() else found


Columns = TextColumns | ParquetColumns


@contextmanager
def as_table(path: Path) -> Iterator[None]:
    """Turn what polars raises on what it cannot parse into one line."""
    try:
        with _without_reports():
            yield
    except InputError:
        raise
    except (Exception, pl.exceptions.PanicException) as error:
        said = str(error).splitlines()[0] if str(error) else type(error).__name__
        raise InputError(f"cannot read {path} as a table ({said}): save it again") from error


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


def read_parquet_columns(path: Path) -> ParquetColumns:
    """Columns of a Parquet file."""
    with open_regular(path, LARGEST_FILE, "give a .parquet file"):
        lazy = pl.scan_parquet(path)
        schema = lazy.collect_schema()
        rows = int(lazy.select(pl.len()).collect().item())
        _check_size(rows, len(schema), MOST_PARQUET_COLUMNS)
        size = path.stat().st_size
        check_unpacked(rows * len(schema), size, str(path), "save it as a .npy file")
        for name, kind in schema.items():
            if kind.is_temporal() or kind.is_nested():
                raise InputError(f"{path}: column {name} holds {kind}: give numbers")
        return ParquetColumns(tuple(schema.names()), pl.read_parquet(path))


def _check_size(rows: int, columns: int, most: int = MOST_COLUMNS) -> None:
    """Raise `InputError` for a table that is larger than any is read."""
    if columns > most or rows * columns > LARGEST:
        raise InputError(
            f"it has {rows} rows of {columns} columns: give {most} columns and {LARGEST} "
            "numbers or fewer"
        )


def read_text_columns(path: Path) -> TextColumns:
    """Cells of a text file, and the names of its columns if its first line has some."""
    text = read_text(path, LARGEST_FILE, "give a table of text", WINDOWS)
    text, separator, _ = separated(text, SEPARATORS)
    written = separator
    if '"' in text:
        cells = csv.reader(io.StringIO(text), delimiter=separator, skipinitialspace=True)
        text = "\n".join("\x1f".join(row).replace("\n", " ") for row in cells)
        separator = "\x1f"
    lines = pl.Series([text]).str.split("\n").explode().str.strip_chars(" ")
    del text
    lines = lines.filter((lines != "") & ~lines.str.starts_with("#"))
    if separator == " ":  # as wide as MATLAB's -ascii and others make them
        lines = lines.str.replace_all(r"\s+", " ")
    while (
        len(lines)
        and lines[-1]
        and lines[1 if len(lines) > 1 else 0 :].str.ends_with(separator).all()
    ):
        lines = lines.str.strip_suffix(separator)  # a separator at the end of every line
    rows = lines.str.split(separator)
    widths = rows.list.len()
    if not len(rows):
        return TextColumns((), 0, pl.Series([], dtype=pl.String))
    width = int(widths[0])
    _check_size(len(rows), max(width, int(widths.max())))  # type: ignore[arg-type]
    if other := (widths != width).arg_max() if (widths != width).any() else None:
        raise InputError(
            f"{path}: row {other + 1} has {widths[other]} cells and row 1 has {width}: give each "
            "row as many"
        )
    flat = rows.explode().str.strip_chars()
    with_comma = flat.filter(flat.str.contains(",", literal=True))
    comma = has_decimal_commas(with_comma.head(MOST_COLUMNS), written)
    if comma:
        flat = flat.str.replace(r"^([^,.]*),([^,.]*)$", "${1}.${2}")
    heads = flat[:width].to_list()
    numbers = [number_of(head) for head in heads]
    if any(number is not None for number in numbers) or not set(heads).isdisjoint(WITHOUT_VALUE):
        _check_heading(numbers, len(rows), path)
        return TextColumns((), width, flat)
    if len(set(heads)) < len(heads) or "" in heads:
        raise InputError(
            f"{path}: its first line must give each column a name of its own, or hold numbers"
        )
    return TextColumns(tuple(heads), width, flat[width:])


def _check_heading(numbers: list[float | None], rows: int, path: Path) -> None:
    """Raise `InputError` for a first line that numbers the columns, as pandas writes it."""
    count = list(range(len(numbers)))
    if rows > 1 and len(count) > 3 and numbers in (count, [number + 1 for number in count]):
        raise InputError(
            f"{path}: its first line numbers the columns ({numbers[0]:g} to {numbers[-1]:g}) and "
            "would be read as values: leave it out, or give names"
        )
