"""Reference of the command line, made from the commands themselves.

The directive `commands` lists those under one heading of ``deepfsi --help``, with every command of
their groups and every option.
"""

import inspect
import re

import typer
from markdown import Made, table

from deepfsi.cli import app

NOTES = re.compile(r"\s*\[([^\[]*(?:default: |required|<=|>=)[^\[]*)\]$")


def headings():
    """Commands of ``deepfsi`` by their heading, in its order: heading → names."""
    found = {}
    for name, command in typer.main.get_command(app).commands.items():
        found.setdefault(command.rich_help_panel, []).append(name)
    return found


def reference(heading):
    """Sections of the commands under a heading."""
    whole = typer.main.get_command(app)
    top = whole.context_class(whole, info_name="deepfsi")
    named = headings()[heading]
    return "\n\n".join(part for name in named for part in sections(whole.commands[name], name, top))


def sections(command, name, above):
    """Section of a command, then those of the commands in its group."""
    context = command.context_class(command, info_name=name, parent=above)
    yield section(command, context)
    for own, each in getattr(command, "commands", {}).items():
        yield from sections(each, own, context)


def section(command, context):
    """Heading, usage, help text, and a table of arguments and options."""
    words, level = context.command_path, context.command_path.count(" ") + 1
    usage = " ".join([words, *command.collect_usage_pieces(context)])
    parts = [f"{'#' * level} `{words}`", f"```text\n{usage}\n```", said(command.help or "")]
    if not hasattr(command, "commands"):
        parameters = [each.get_help_record(context) for each in command.get_params(context)]
        rows = [row(*record) for record in parameters if record and "--help" not in record[0]]
        parts.append(table(["option", "meaning", "default"], rows, "options"))
    return "\n\n".join(parts)


def row(declaration, text):
    """Option, its meaning with the numbers allowed, and its default."""
    notes = NOTES.search(text)
    told = notes[1].split("; ") if notes else []
    default = next((f"`{each[9:]}`" for each in told if each.startswith("default: ")), "")
    allowed = next((f" (`{each}`)" for each in told if "=" in each and each[:8] != "default:"), "")
    meaning = escaped(NOTES.sub("", text)) + allowed
    return f"`{declaration}`", meaning, "required" if "required" in told else default


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


def setup(app):
    """Add the directive."""
    app.add_directive("commands", Commands)
    return {"parallel_read_safe": True, "parallel_write_safe": True}
