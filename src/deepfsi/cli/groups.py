"""Help of a group of commands: under headings, each with its whole sentence."""

import inspect
from typing import Any

from typer.core import TyperGroup

UNNAMED = "Commands"
"""Heading of commands that name none."""


class Group(TyperGroup):
    """Commands under the headings given as `rich_help_panel`, in plain text, none of it cut."""

    def format_commands(self, ctx: Any, formatter: Any) -> None:
        """Write the commands in the order in which they were added."""
        headings: dict[str, list[tuple[str, str]]] = {}
        for name in self.list_commands(ctx):
            command: Any = self.get_command(ctx, name)
            summary = inspect.cleandoc(command.help or "").partition("\n\n")[0]
            rows = headings.setdefault(command.rich_help_panel or UNNAMED, [])
            rows.append((name, " ".join(summary.split())))
        width = max(len(name) for rows in headings.values() for name, _ in rows)
        for heading, rows in headings.items():
            with formatter.section(heading):
                formatter.write_dl([(name.ljust(width), summary) for name, summary in rows])
