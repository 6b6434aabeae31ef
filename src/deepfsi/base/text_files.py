"""Lists as text: the one reader of names, labels and numbers that a person or a program wrote."""

import csv
import io
import re
import unicodedata
from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path

from deepfsi.base.errors import InputError
from deepfsi.base.files import WINDOWS, read_text

NUMBER = re.compile(r"[+-]?([0-9]+\.?[0-9]*|\.[0-9]+)([eE][+-]?[0-9]+)?")
"""A number as programs write it: no underscores, no digits of other scripts, no words."""

THOUSANDS = re.compile(r"[+-]?[1-9][0-9]{0,2}(,[0-9]{3})+")
"""A number that a comma may part into thousands as well as from its fraction."""

WITHOUT_VALUE = ("nan", "inf", "-inf", "+inf", "na", "n/a", "#n/a", "#num!", "#div/0!", "null")
"""Words that stand for a number that is none, in lower case."""

LABEL_HEADS = ("label", "labels", "class", "classes", "category", "target", "y", "class name")
"""Words over a column of labels, in lower case."""

SEPARATOR_LINE = re.compile(r"sep=(.)\n")
"""First line of a table by which Excel is told the separator."""


SEPARATOR_LINES = 1000
"""Lines by which the separator is found, at most."""


@dataclass(frozen=True)
class Rows:
    """Cells of a text file, without blank lines and comments."""

    cells: tuple[tuple[str, ...], ...]
    lines: tuple[int, ...]  # number of the line of each row
    separator: str


def number_of(text: str, comma: bool = False) -> float | None:
    """Finite number that a text is, or None; `comma` allows a decimal comma."""
    text = text.strip()
    if comma and "." not in text:
        text = text.replace(",", ".", 1)
    value = float(text) if NUMBER.fullmatch(text) else float("inf")
    return value if abs(value) < float("inf") else None


def is_whole(text: str) -> bool:
    """True for a number that is written without point and exponent."""
    return re.fullmatch(r"[+-]?[0-9]+", text.strip()) is not None


def has_decimal_commas(cells: Iterable[str], separator: str) -> bool:
    """True if the commas of a table's cells part fractions: not those of a list with commas."""
    # Where each may part thousands, none is believed: 1,234 would be wrong by 1000
    if separator not in (";", "\t"):
        return False
    with_comma = [cell.strip() for cell in cells if "," in cell]
    return any(
        not THOUSANDS.fullmatch(cell) and number_of(cell, comma=True) is not None
        for cell in with_comma
    )


def spelling(name: str) -> str:
    """A name in the one spelling of Unicode that is kept (NFC), without blanks around it."""
    return unicodedata.normalize("NFC", name).strip()


def read_rows(path: Path, largest: int, advice: str) -> Rows:
    """Rows of a list. The separator is that of `separator_of`; a line `# …` is a comment."""
    text = read_text(path, largest, advice, WINDOWS)
    text, separator, skipped = separated(text, ";\t,")
    lines = ["" if re.match(r"#($|\s)", line) else line for line in text.split("\n")]
    source = io.StringIO("\n".join(lines), newline="")
    reader = csv.reader(source, delimiter=separator, skipinitialspace=True, strict=True)
    cells, places = [], []
    try:
        for row in reader:
            if any(cell.strip() for cell in row):
                cells.append([cell.strip().replace("\n", " ") for cell in row])
                places.append(reader.line_num + skipped)
    except csv.Error as error:
        raise InputError(f"{path}, line {reader.line_num + skipped}: {error}; {advice}") from None
    while cells and all(len(row) > 1 and not row[-1] for row in cells):
        cells = [row[:-1] for row in cells]  # a separator at the end of every line
    return Rows(tuple(map(tuple, cells)), tuple(places), separator)


def separated(text: str, separators: Sequence[str]) -> tuple[str, str, int]:
    """Text, its separator, and how many lines were taken off: one, if it names the separator."""
    # Otherwise it is the first of `separators` that is in every line; then one in the first line
    if found := SEPARATOR_LINE.match(text.replace('"', "", 2) if text[:1] == '"' else text):
        return text.split("\n", 1)[1], found[1], 1
    lines = list(_first_lines(text))
    every = (each for each in separators if lines and all(each in line for line in lines))
    some = (each for each in separators if lines and each in lines[0])
    return text, next(every, next(some, separators[-1])), 0


def _first_lines(text: str) -> Iterator[str]:
    """The first lines that are neither empty nor comments."""
    at, count = 0, 0
    while at < len(text) and count < SEPARATOR_LINES:
        end = text.find("\n", at)
        end = len(text) if end < 0 else end
        line = text[at:end]
        if line.strip() and not line.startswith("#"):
            yield line
            count += 1
        at = end + 1
