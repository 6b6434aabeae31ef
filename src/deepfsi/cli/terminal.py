"""Output of commands: lines and tables for a reader, JSON for a script."""

import json
import shlex
import sys
from collections.abc import Iterable, Mapping
from contextlib import AbstractContextManager
from dataclasses import dataclass
from typing import Any

from deepfsi.base.errors import InputError, one_line
from deepfsi.base.files import readable_name
from deepfsi.base.progress import SILENT, Progress, progress_bar
from deepfsi.base.quantities import Table


@dataclass(frozen=True)
class Outcome:
    """Result of a command: as a dict for scripts, and in lines for a reader."""

    content: Mapping[str, Any]  # JSON types
    lines: Iterable[str | Table] = ()  # without any, the content is printed
    failed: bool = False  # True if a check failed: exit code 1
    refusal: str = ""  # an error to end with after the content: exit code 2


class Terminal:
    """Where a command runs: it shows progress, says and asks."""

    def __init__(self, as_json: bool) -> None:
        self.as_json = as_json

    @property
    def command_line(self) -> str:
        """The command as it was typed."""
        return shlex.join(["deepfsi", *map(readable_name, sys.argv[1:])])

    def progress(self, what: str) -> AbstractContextManager[Progress]:
        """Progress bar on standard error with the time left."""
        return progress_bar(SILENT if self.as_json else None, what)

    def say(self, *lines: str | Table) -> None:
        """Print lines of a result at once; JSON has them at the end."""
        for line in () if self.as_json else lines:
            if isinstance(line, Table):
                print_table(line)
            else:
                print(*map(one_line, line.split("\n")), sep="\n", flush=True)

    def ask(self, what: str) -> None:
        """Ask someone to do something, and wait until it is done."""
        print(f"{one_line(what)}, then press Enter", file=sys.stderr, flush=True)
        if not sys.stdin.readline():
            raise InputError("nobody is there to show the scenes: run this in a terminal")

    def write(self, outcome: Outcome, command: str) -> None:
        """Print an outcome; JSON has its schema first, such as "deepfsi.camera.count/1"."""
        self.say(
            *outcome.lines
            or (
                f"{name.replace('_', ' ')}: {value}"
                for name, value in outcome.content.items()
                if isinstance(value, str | int | float)
            )
        )
        if self.as_json:
            # The number rises when a field changes or goes
            first = {"schema": f"deepfsi.{command}/1"}
            # Letters beyond ASCII are escaped: bytes of a path may be no UTF-8
            print(json.dumps({**first, **outcome.content, **first}, indent=1))


def print_table(content: Table) -> None:
    """Print a table, one line a row where the width allows it."""
    from rich import box
    from rich.console import Console
    from rich.table import Table as Grid

    # names of files, classes and values may hold terminal commands
    title, *heads = map(one_line, (content.title, *content.heads))
    grid = Grid(title=title, title_justify="left", box=box.SIMPLE_HEAD, pad_edge=False)
    grid.padding = (0, 1, 0, 0)
    grid.min_width = len(title)
    for number, head in enumerate(heads):
        grid.add_column(head, justify="right" if number else "left", overflow="fold")
    for row in content.rows:
        grid.add_row(*map(one_line, row))
    console = Console(markup=False, emoji=False, highlight=False)
    if not console.is_terminal:  # a file or a pipe has no width
        unbounded = console.options.update(max_width=sys.maxsize)
        console.width = max(console.width, console.measure(grid, options=unbounded).maximum)
    console.print(grid)
