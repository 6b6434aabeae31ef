"""Figures of a page: drawn on it, and as files in a folder beside it."""

import io
from pathlib import Path
from typing import Any

from markupsafe import Markup
from matplotlib.figure import Figure

from deepfsi.base import write_atomically
from deepfsi.report.style import drawing, svg

FOLDER = "figures"

KINDS: dict[str, Any] = {"svg": {"Date": None}, "pdf": {"CreationDate": None}, "png": {}}
"""Formats of the files, and what they leave out so that the same figure gives the same file."""


class Figures:
    """Figures of one page by their names, which are those of their files."""

    def __init__(self) -> None:
        self.drawn: dict[str, Figure] = {}

    def add(self, name: str, figure: Figure, words: str) -> Markup:
        """Part of the page with a figure, and what it shows in words."""
        drawing = svg(figure, name, words)
        figure.set_layout_engine("none")  # laid out once, for the files too
        self.drawn[name] = figure
        return Markup(drawing)

    def write(self, home: Path) -> None:
        """Write the files of all figures into the folder `figures` of a page's folder."""
        (home / FOLDER).mkdir(parents=True, exist_ok=True)
        with drawing(**{"svg.fonttype": "path"}):
            for name, figure in self.drawn.items():
                for kind, left_out in KINDS.items():
                    file = io.BytesIO()
                    figure.savefig(file, format=kind, dpi=160, metadata=left_out)
                    write_atomically(home / FOLDER / f"{name}.{kind}", file.getvalue())
