"""Parts of a study's page: sections of pictures, claims and tables."""

from dataclasses import dataclass

from matplotlib.figure import Figure

Cell = str | float | int | None

UNDECIDED = (
    "An interval contains the limit, and none lies wholly beyond it: these trainings and test "
    "scenes do not decide."
)
"""Why a claim is open that says nothing else."""


@dataclass(frozen=True)
class Picture:
    """A figure, its caption, and what a reader who cannot see it is told."""

    figure: Figure
    caption: str
    words: str


@dataclass(frozen=True)
class Claim:
    """A statement that the study tests."""

    text: str
    holds: bool | None  # none where these data do not decide it
    measured: str  # what was measured, with its interval
    why: str = ""  # how the answer follows from it

    @property
    def reason(self) -> str:
        """Why the answer is what it is; of an open claim in any case."""
        return self.why or (UNDECIDED if self.holds is None else "")


@dataclass(frozen=True)
class Table:
    """Numbers and words; None or NaN where there is no value."""

    caption: str
    heads: tuple[str, ...]
    rows: tuple[tuple[Cell, ...], ...]


@dataclass(frozen=True)
class Section:
    """One experiment."""

    name: str  # its address on the page: letters, digits, `-`, `_` and `.`
    title: str
    found: str  # A paragraph each: what we find, and what the paper found
    paper: str
    pictures: tuple[Picture, ...]
    claims: tuple[Claim, ...]
    tables: tuple[Table, ...]
    files: tuple[str, ...]  # CSV files behind the figures, relative to the page
    command: str  # what repeats the experiment
    data: str  # name of its data set


def english_list(words: list[str]) -> str:
    """Words as an English list."""
    return " and ".join(filter(None, [", ".join(words[:-1]), words[-1]]))
