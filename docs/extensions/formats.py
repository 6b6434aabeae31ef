"""Tables of what files hold, made from the models that read and write them.

The directive `fields` makes the section of one model: each field with its type, the values allowed,
its default, and its meaning from the field's description or the docstring.
"""

import ast
import inspect
import itertools
import json
import re
from importlib import import_module

from markdown import Made, table
from numpydoc.docscrape import NumpyDocString
from pydantic import TypeAdapter

NAMES = {
    "integer": "whole number",
    "number": "number",
    "string": "text",
    "boolean": "true or false",
}
BOUNDS = {"minimum": "≥", "exclusiveMinimum": ">", "maximum": "≤", "exclusiveMaximum": "<"}
EXACT = 2**53
"""Largest whole number that JSON gives exactly everywhere: a limit that no reader needs."""
CONSTANTS = {"schema": "version of the format", "schema_version": "version of the format"}
REQUIRED, DEFAULTS, FOLLOWS = WORDS = ("*required*", "its defaults", "follows from the others")
CONSTANTS["kind"] = "which of several kinds the table is of"


def model(path):
    """Class of a dotted path."""
    module, _, name = path.rpartition(".")
    return getattr(import_module(module), name)


def section(path):
    """Heading, summary and table of a model."""
    found = model(path)
    summary = inspect.cleandoc(found.__doc__).partition("\n\n")[0]
    lines = [(name, meaning, typed(kind, default)) for name, meaning, kind, default in rows(found)]
    told = table(HEADS, lines)
    return f"### {found.__name__}\n\n{summary}\n\n{told}"


HEADS = ["field", "meaning", "type"]


def typed(kind, default):
    """Type and default of a field in one cell."""
    if not default:
        return kind
    return f"{kind}; {default}" if default in WORDS else f"{kind}; default {default}"


def rows(found):
    """Name, meaning, type and default of each field of a model."""
    schema = TypeAdapter(found).json_schema()
    described = meanings(found)
    for name, field in schema["properties"].items():
        meaning = field.get("description") or described.get(name) or CONSTANTS.get(name)
        if not meaning:
            raise LookupError(f"{found.__name__}.{name} has no description: give its field one")
        required = name in schema.get("required", ())
        default = REQUIRED if required else usual(found, name, field)
        yield f"`{name}`", meaning, kind(field), default


def usual(found, name, field):
    """Default of a field in words."""
    if "default" in field:
        if "$ref" in field:
            return DEFAULTS
        return f"`{json.dumps(field['default'], ensure_ascii=False)}`".replace("`null`", "none")
    declared = getattr(found, "model_fields", {}).get(name)
    follows = declared is not None and declared.default_factory_takes_validated_data
    return FOLLOWS if follows else ""


def meanings(found):
    """Meaning of each field that the comments or docstrings of a model and its bases tell."""
    told = {}
    for base in reversed(found.__mro__):
        parts = NumpyDocString(inspect.cleandoc(base.__doc__ or ""))
        for each in (*parts["Parameters"], *parts["Attributes"]):
            names = each.name or each.type
            told |= {name.strip(): " ".join(each.desc) for name in names.split(",") if each.desc}
        if base.__module__.startswith("deepfsi"):
            told |= comments(base)
    return told


def comments(found):
    """Comments on the fields of a class: behind a field, or in the lines above it."""
    source = inspect.getsource(found)
    lines, told = source.splitlines(), {}
    for field in ast.parse(source).body[0].body:
        if not isinstance(field, ast.AnnAssign):
            continue
        above = itertools.takewhile(re.compile(r" *# ").match, reversed(lines[: field.lineno - 1]))
        said = [line.strip()[2:] for line in above][::-1]
        said += lines[field.end_lineno - 1].encode()[field.end_col_offset :].decode().split("  # ")
        text = " ".join(each for each in said if each.strip() != "fmt: skip").strip()
        if text:
            told[field.target.id] = text if text.endswith(".") else f"{text}."
    return told


def kind(field):
    """Type of a field in words, with a link to the table of another model."""
    if "$ref" in field:
        name = field["$ref"].rpartition("/")[2]
        return f"[{name}](#{name.lower()})"
    if "const" in field:
        return f"`{json.dumps(field['const'])}`"
    if "enum" in field:
        return " or ".join(f"`{each}`" for each in field["enum"])
    choices = field.get("anyOf") or field.get("oneOf")
    if choices:
        return " or ".join(kind(each) for each in choices)
    return plain(field)


def plain(field):
    """Type of a number, text, list or table."""
    name = field.get("type")
    if field.get("maximum") == EXACT:
        field = {key: value for key, value in field.items() if key != "maximum"}
    if name == "null":
        return "none"
    if name == "array":
        items = field.get("prefixItems")
        if items:
            kinds = [kind(each) for each in items]
            told = f"each {kinds[0]}" if len(set(kinds)) == 1 else ", ".join(kinds)
            return f"list of {len(items)}: {told}"
        return f"list of {kind(field['items'])}"
    if name == "object":
        return "table"
    if "minimum" in field and "maximum" in field:
        return f"{NAMES[name]}, {number(field['minimum'])} to {number(field['maximum'])}"
    bounds = [f"{sign} {number(field[key])}" for key, sign in BOUNDS.items() if key in field]
    return ", ".join([NAMES[name], *bounds])


def number(value):
    """Number as one would write it: 1e15, 65536."""
    return str(value) if isinstance(value, int) else f"{value:g}".replace("e+", "e")


class Fields(Made):
    """The directive; its argument is the dotted path of a model."""

    required_arguments = 1

    def text(self):
        """Markdown of the section."""
        return section(self.arguments[0])


def setup(app):
    """Add the directive."""
    app.add_directive("fields", Fields)
    return {"parallel_read_safe": True, "parallel_write_safe": True}
