"""A study of several experiments, as one HTML page that needs nothing else."""

import math
import os
from collections.abc import Iterable, Sequence
from pathlib import Path

from deepfsi.base.files import write_atomically
from deepfsi.report.rendering import render
from deepfsi.report.style import Figures
from deepfsi_paper.report.section import Cell, Claim, Section, Table

WIDE = 5.5
"""Inches; wider pictures have a line of the page for themselves."""

ANSWERS = {True: ("yes", "✓"), False: ("no", "✗"), None: ("open", "?")}
"""Word and mark of an answer."""


def write_study(folder: str | os.PathLike[str], title: str, sections: Sequence[Section]) -> Path:
    """Write `report.html` and its figures into a folder."""
    home, figures = Path(folder), Figures()
    text = render(
        "study.html.jinja",
        Path(__file__).parent,
        title=title,
        opened=opened(sections),
        lead=lead(sections),
        sections=[
            {
                "section": section,
                "tally": _tally(section.claims),
                "pictures": [
                    (
                        picture,
                        figures.add(f"{section.name}-{number}", picture.figure, picture.words),
                        picture.figure.get_figwidth() > WIDE,
                    )
                    for number, picture in enumerate(section.pictures, start=1)
                ],
                "tables": [(table, *_columns(table)) for table in section.tables],
            }
            for section in sections
        ],
        answers=ANSWERS,
    )
    figures.write(home)
    return write_atomically(home / "report.html", text.encode())


def _tally(claims: Iterable[Claim]) -> str:
    """Say how many claims hold, do not and are open; empty where there are none."""
    answers = [claim.holds for claim in claims]
    yes, no, still = (answers.count(answer) for answer in ANSWERS)
    parts = [
        (yes, "holds" if yes == 1 else "hold"),
        (no, "does not" if no == 1 else "do not"),
        (still, "open"),
    ]
    return ", ".join(f"{count} {words}" for count, words in parts if count)


def opened(sections: Sequence[Section]) -> str:
    """Say in three sentences what is tested, what the light is, and what intervals cover."""
    data = f" of {', '.join(dict.fromkeys(section.data for section in sections))}"
    return (
        f"This page tests how well the class of a scene{data} can be read from few photons, with "
        "masks and a network that were learned together and with others. A photon budget Φ is the "
        "mean number of photons that reach the coding device in one exposure; masks share them "
        "under a light law, and the photons of a mask are counted on one rail or, where it has "
        "negative entries, on two. Intervals are of 95 % and cover what their caption says; "
        "impulse imaging, which loses no photon, is no option, because it needs a detector for "
        "each pixel."
    )


def lead(sections: Sequence[Section]) -> str:
    """Write the paragraph under the title."""
    many = len(sections)
    claims = [claim for section in sections for claim in section.claims]
    text = f"{many} experiment{'s' if many > 1 else ''}. "
    if claims:
        text += f"Claims tested: {len(claims)}; {_tally(claims)}. "
        text += "A claim is open where these data do not decide it. "
    return text + (
        "Each experiment says what the paper found and what we find, and gives its figures, the "
        "numbers behind them and the command that repeats it."
    )


def _columns(table: Table) -> tuple[list[bool], list[list[str]]]:
    """Tell which columns of a table hold words, and write its cells, row by row."""
    columns = zip(*table.rows, strict=True)
    words = [any(isinstance(cell, str) for cell in cells) for cells in columns]
    shown = [[_cell_text(cell) for cell in row] for row in table.rows]
    return words or [True] * len(table.heads), shown


def _cell_text(cell: Cell) -> str:
    """Write a cell, numbers with three digits; a dash where there is no value."""
    if isinstance(cell, str):
        return cell
    if cell is None or math.isnan(cell):
        return "–"
    text = f"{cell:.3g}" if isinstance(cell, float) else str(cell)
    return text.replace("-", "−")
