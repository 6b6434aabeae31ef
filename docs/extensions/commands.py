"""Reference of the command line, made from the commands themselves.

The directive `commands` lists those under one heading of ``deepfsi --help``, with every command of
their groups and every option; the directive `overview` makes a table of these commands.
"""

import inspect
import re

import click
from markdown import Made, table

from deepfsi.cli import app


def headings():
    """Commands of ``deepfsi`` by their heading; the first has those of packages beside the core."""
    found = {heading: list(entries) for heading, entries in app.headings.items()}
    found["Design"] += found.pop("Beside the core", [])
    return found


def named(heading):
    """Commands and groups under a heading, each with its context."""
    top = click.Context(app, info_name="deepfsi")
    return [pair for name in headings()[heading] for pair in below(app, name, top)]


def reference(heading):
    """Sections of the commands under a heading."""
    return "\n\n".join(section(*pair) for pair in named(heading))


def overview(heading):
    """Table of the commands under a heading, each with its first sentence."""
    rows = [
        (f"[`{context.command_path}`](#{anchor(context)})", said(command.help).partition("\n\n")[0])
        for command, context in named(heading)
        if not isinstance(command, click.Group)
    ]
    return table(["command", "what it does"], rows)


def below(group, name, above):
    """A command of a group and those of its own group, each with its context."""
    command = group.get_command(above, name)
    context = click.Context(command, info_name=name, parent=above)
    yield command, context
    if isinstance(command, click.Group):
        for each in command.list_commands(context):
            yield from below(command, each, context)


def anchor(context):
    """Anchor of the heading of a command."""
    return context.command_path.replace(" ", "-")


def section(command, context):
    """Heading, usage, help text, and a table of options for each of their headings."""
    words, level = context.command_path, context.command_path.count(" ") + 1
    usage = " ".join([words, *command.collect_usage_pieces(context)])
    parts = [f"{'#' * level} `{words}`", f"```text\n{usage}\n```", said(command.help or "")]
    if not isinstance(command, click.Group):
        parts += tables(command)
    return "\n\n".join(parts)


def tables(command):
    """Tables of arguments and options, each after the first below the heading of its options.

    ``<number,…>`` stands for several values between commas, ``<int …>`` for an option given often.
    """
    context = click.Context(command)
    for name, group in command.headings.items():
        rows = [each.get_help_record(context) for each in group]
        if rows and name not in ("Arguments", "Options"):
            yield f"**{name}**"
        if rows:
            listed = [[f"`{words}`", escaped(meaning)] for words, meaning in rows]
            yield table(["option", "meaning"], listed)


def said(text):
    """Paragraphs of a help text; examples as code."""
    parts = []
    for each in inspect.cleandoc(text).split("\n\n"):
        example, colon, line = " ".join(each.split()).partition("xample: ")
        code = f"```console\n$ {line}\n```" if colon else ""
        parts.append(code or escaped(example))
    return "\n\n".join(parts)


def escaped(text):
    """Help text with what Markdown reads as its own marked as text."""
    return re.sub(r"([*_<>\[\]])", r"\\\1", text)


class Commands(Made):
    """The directive; its argument is a heading."""

    required_arguments = 1

    def text(self):
        """Markdown of the commands."""
        return reference(self.arguments[0])


class Overview(Made):
    """The directive of the table; its argument is a heading."""

    required_arguments = 1

    def text(self):
        """Markdown of the table."""
        return overview(self.arguments[0])


def setup(app):
    """Add the directives."""
    app.add_directive("commands", Commands)
    app.add_directive("overview", Overview)
    return {"parallel_read_safe": True, "parallel_write_safe": True}
