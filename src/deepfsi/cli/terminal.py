"""Output of commands: lines and tables for a reader, JSON for a script."""

import json
import re
import sys
from collections.abc import Callable, Collection, Iterable, Mapping
from contextlib import AbstractContextManager
from dataclasses import dataclass
from typing import Any

from deepfsi.base.errors import InputError
from deepfsi.base.progress import SILENT, Progress, progress_bar
from deepfsi.base.quantities import Table


@dataclass(frozen=True)
class Outcome:
    """Result of a command: as a dict for scripts, and in lines for a reader."""

    content: Mapping[str, Any]  # JSON types
    lines: Iterable[str | Table] = ()
    failed: bool = False  # True if something that was checked is not as it should be: exit code 1
    refusal: str = ""


class Terminal:
    """Where a command runs: it shows progress, says and asks."""

    def __init__(self, as_json: bool, command_line: str, wording: Callable[[str], str]) -> None:
        self.as_json = as_json
        self.command_line = command_line
        self.wording = wording  # a text with its settings as options

    def progress(self, what: str) -> AbstractContextManager[Progress]:
        """Progress bar on standard error with the time left."""
        return progress_bar(SILENT if self.as_json else None, what)

    def say(self, line: str | Table) -> None:
        """Print a line of a result at once; JSON has it at the end."""
        if not self.as_json:
            self._print(line)

    def warn(self, text: str) -> None:
        """Say on standard error what a reader should know in any case."""
        print(self.wording(text), file=sys.stderr, flush=True)

    def ask(self, what: str) -> None:
        """Ask someone to do something, and wait until it is done."""
        print(f"{what}, then press Enter", file=sys.stderr, flush=True)
        if not sys.stdin.readline():
            raise InputError("nobody is there to show the scenes: run this in a terminal")

    def write(self, outcome: Outcome, command: str) -> None:
        """Print what a command found, as JSON with its schema first: "deepfsi.camera.count/1"."""
        if self.as_json:
            print_json(command, outcome.content)
            return
        for line in outcome.lines:
            self._print(line)

    def _print(self, line: str | Table) -> None:
        if isinstance(line, Table):
            print_table(line)
        else:
            print(self.wording(line), flush=True)


def as_options(text: str, settings: Collection[str]) -> str:
    """A message with the settings that it names as options: `size` is --size."""

    def option(named: re.Match[str]) -> str:
        setting, value = named.groups()
        if setting not in settings:
            return named[0]
        return f"{option_name(setting)} {(value or '').strip(chr(34))}".rstrip()

    return re.sub(r'`([a-z_]+)(?:=("[^"`]*"|\d+))?`', option, text)


def option_name(setting: str) -> str:
    """Name of the option of a setting: --shortest-dwell of `shortest_dwell`."""
    return f"--{setting.replace('_', '-')}"


def print_json(schema: str, content: Mapping[str, Any]) -> None:
    """Print what a command found for scripts."""
    first = {"schema": f"deepfsi.{schema}/1"}  # raised where a field changes or goes
    text = json.dumps({**first, **content, **first}, ensure_ascii=False)
    # bytes of a path that are no UTF-8, which no reader of JSON takes
    text = re.sub("[\udc80-\udcff]", lambda byte: f"\\\\x{ord(byte[0]) - 0xDC00:02x}", text)
    print(json.dumps(json.loads(text), indent=1))


def print_table(content: Table) -> None:
    """Print a table, one line a row where the width allows it."""
    from rich import box
    from rich.console import Console
    from rich.table import Table as Grid

    grid = Grid(title=content.title, title_justify="left", box=box.SIMPLE_HEAD, pad_edge=False)
    grid.padding = (0, 1, 0, 0)
    grid.min_width = len(content.title)
    grid.show_lines = content.sentences
    for number, head in enumerate(content.heads):
        right = number and not content.sentences
        grid.add_column(head, justify="right" if right else "left", overflow="fold")
    for row in content.rows:
        grid.add_row(*row)
    console = Console(markup=False, emoji=False, highlight=False)
    if not console.is_terminal and not content.sentences:  # a file or a pipe has no width
        unbounded = console.options.update(max_width=sys.maxsize)
        console.width = max(console.width, console.measure(grid, options=unbounded).maximum)
    console.print(grid)
