"""Reference of the command line, made from the commands themselves.

The directive `commands` lists those under one heading of ``deepfsi --help``, with every command of
their groups and every option; the directive `overview` makes a table of these commands.
"""

import inspect
import re

import typer
from markdown import Made, table

from deepfsi.cli import app
from deepfsi.cli.settings import AXES, FIRST

NOTES = re.compile(r"\s*\[([^\[]*(?:default: |required|<=|>=)[^\[]*)\]$")
LIST, RANGE = re.compile(r"list\[(\w+)\]"), re.compile(r"(?<=int|oat) range(?=>)")
REQUIRED = "*required*"


def headings():
    """Commands of ``deepfsi`` by their heading, in its order: heading → names."""
    found = {}
    for name, command in typer.main.get_command(app).commands.items():
        found.setdefault(command.rich_help_panel, []).append(name)
    return found


def named(heading):
    """Commands and groups under a heading, each with its context."""
    whole = typer.main.get_command(app)
    top = whole.context_class(whole, info_name="deepfsi")
    return [pair for name in headings()[heading] for pair in below(whole.commands[name], name, top)]


def reference(heading):
    """Sections of the commands under a heading."""
    return "\n\n".join(section(*pair) for pair in named(heading))


def overview(heading):
    """Table of the commands under a heading, each with its first sentence."""
    rows = [
        (f"[`{context.command_path}`](#{anchor(context)})", said(command.help).partition("\n\n")[0])
        for command, context in named(heading)
        if not hasattr(command, "commands")
    ]
    return table(["command", "what it does"], rows, "options")


def below(command, name, above):
    """A command and those of its group, each with its context."""
    context = command.context_class(command, info_name=name, parent=above)
    yield command, context
    for own, each in getattr(command, "commands", {}).items():
        yield from below(each, own, context)


def anchor(context):
    """Anchor of the heading of a command."""
    return context.command_path.replace(" ", "-")


def section(command, context):
    """Heading, usage, help text, and a table of options for each of their headings."""
    words, level = context.command_path, context.command_path.count(" ") + 1
    usage = " ".join([words, *command.collect_usage_pieces(context)])
    parts = [f"{'#' * level} `{words}`", f"```text\n{usage}\n```", said(command.help or "")]
    if not hasattr(command, "commands"):
        parts += tables(command, context)
    return "\n\n".join(parts)


def tables(command, context):
    """Tables of arguments and options, each after the first below the heading of its options."""
    panels = {}
    for each in command.get_params(context):
        record = each.get_help_record(context)
        if record and "--help" not in record[0]:
            panel = getattr(each, "rich_help_panel", None) or FIRST
            panels.setdefault(panel, []).append(row(*record))
    for name, rows in panels.items():
        if name != FIRST:
            yield f"**{name}**"
        rows.sort(key=lambda each: each[2] != REQUIRED)
        yield table(["option", "meaning", "default"], rows, "options")


def row(declaration, text):
    """Option, its meaning with the numbers allowed, and its default.

    ``<str,…>`` stands for several values between commas, ``<int …>`` for an option given often.
    """
    notes = NOTES.search(text)
    told = notes[1].split("; ") if notes else []
    default = next((f"`{each[9:]}`" for each in told if each.startswith("default: ")), "")
    allowed = next((f" (`{each}`)" for each in told if "=" in each and each[:8] != "default:"), "")
    meaning = escaped(NOTES.sub("", text)) + allowed
    words = RANGE.sub("", LIST.sub(r"\1 …", declaration))
    if meaning.endswith(AXES):
        meaning, words = meaning.removesuffix(AXES), words.replace(">", ",…>")
    return f"`{words}`", meaning, REQUIRED if "required" in told else default


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
