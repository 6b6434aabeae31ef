"""Parts of a study's page: sections of pictures, claims and tables."""

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

from matplotlib.figure import Figure

Cell = str | float | int | None


@dataclass(frozen=True)
class Picture:
    """A figure, its caption, and what a reader who cannot see it is told."""

    figure: Figure
    caption: str
    words: str


@dataclass(frozen=True)
class Claim:
    """A statement that the study tests.

    Attributes
    ----------
    text : str
    holds : bool or None
        None where these data do not decide it.
    measured : str
        What was measured, with its interval.
    why : str
        How the answer follows from it.
    """

    text: str
    holds: bool | None
    measured: str
    why: str = ""


@dataclass(frozen=True)
class Table:
    """Numbers and words; None or NaN where there is no value."""

    caption: str
    heads: tuple[str, ...]
    rows: tuple[tuple[Cell, ...], ...]


@dataclass(frozen=True)
class Section:
    """One experiment.

    Attributes
    ----------
    name : str
        Its address on the page: letters, digits, `-`, `_` and `.`.
    title : str
    found, paper : str
        A paragraph each: what we find, and what the paper found.
    pictures, claims, tables
    files : tuple of str
        CSV files behind the figures, relative to the page.
    command : str
        What repeats the experiment.
    facts : mapping
        Provenance, nested as you like.
    """

    name: str
    title: str
    found: str
    paper: str
    pictures: tuple[Picture, ...]
    claims: tuple[Claim, ...]
    tables: tuple[Table, ...]
    files: tuple[str, ...]
    command: str
    facts: Mapping[str, Any]
