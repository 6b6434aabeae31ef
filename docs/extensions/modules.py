"""Reference of the modules of a folder of the package, from their docstrings.

The directive `modules` makes a section of each module that has public names; names that the
package itself gives have a section of their own, and are left out. Fields of a model become its
attributes, from their descriptions.
"""

import pkgutil
import re
from importlib import import_module
from inspect import isclass, isfunction

from formats import rows
from markdown import Made
from pydantic import BaseModel

import deepfsi


def names(module):
    """Public classes and functions that a module defines, but for those of the package itself."""
    return [
        name
        for name, value in vars(module).items()
        if not name.startswith("_")
        and (isclass(value) or isfunction(value))
        and value.__module__ == module.__name__
        and getattr(deepfsi, name, None) is not value
    ]


def under(folder):
    """Modules of a folder of the package, and of the folders in it."""
    package = import_module(f"deepfsi.{folder}")
    yield package.__name__
    for each in pkgutil.walk_packages(getattr(package, "__path__", []), f"{package.__name__}."):
        yield each.name


def section(path):
    """Section of a module."""
    module = import_module(path)
    found = names(module)
    if not found:
        return ""
    lines = [f".. automodule:: {path}", "   :no-members:", ""]
    for name in found:
        lines += [f".. auto{'class' if isclass(vars(module)[name]) else 'function'}:: {name}"]
        members = ["   :members:", "   :exclude-members: model_config", ""]  # pydantic's own
        lines += members if isclass(vars(module)[name]) else [""]
    lines.insert(3, f".. currentmodule:: {path}\n")
    text = "\n".join(lines)
    return f"## `{path}`\n\n```{{eval-rst}}\n{text}\n```"


def fields(model):
    """Lines of a section of attributes, from the fields of a model."""
    lines = ["Attributes", "----------"]
    for name, meaning, kind, default in rows(model):
        words = re.sub(r"\[(.+?)\]\(.+?\)", r"\1", kind).replace("`", "")
        usual = f"; {default.replace('`', '')}" if default else ""
        lines += [f"{name.strip('`')} : {words}{usual}", f"    {meaning}"]
    return [*lines, ""]


def with_fields(app, what, name, thing, options, lines):
    """Put the fields of a model before the sections of its docstring, or after all."""
    told = isclass(thing) and issubclass(thing, BaseModel) and thing.model_fields
    if what == "class" and told and "Attributes" not in lines:
        try:
            table = fields(thing)
        except LookupError:  # of the package itself: its fields have comments
            return
        below = [place - 1 for place, line in enumerate(lines) if re.fullmatch("-{4,}", line)]
        place = below[0] if below else len(lines)
        lines[place:place] = [*([] if below else [""]), *table]


def as_text(app, what, name, thing, options, lines):
    """Mark what reStructuredText would read as its own: ``|M|``, ``(*lead, m)``, and tables."""
    code, out = False, []
    for line in lines:
        begins, code = line.startswith("    ") and not code, line.startswith("    ")
        if what == "module" and begins:
            out += ["::", ""]
        if not (line.lstrip().startswith((">>>", "...")) or (what == "module" and code)):
            line = re.sub(r"\||(?<=\()\*(?=\w)|(?<=, )\*(?=\w)", r"\\\g<0>", line)
        out.append(line)
    lines[:] = out


class Modules(Made):
    """The directive; its arguments are folders of the package."""

    required_arguments = 1
    final_argument_whitespace = True

    def text(self):
        """Markdown of the sections; none where they are left out, for a quick build."""
        if self.config.quick:
            return ""
        paths = [path for folder in self.arguments[0].split() for path in under(folder)]
        return "\n\n".join(filter(None, map(section, paths)))


def setup(app):
    """Add the directive, and read docstrings before numpydoc does."""
    app.connect("autodoc-process-docstring", with_fields, priority=390)
    app.connect("autodoc-process-docstring", as_text, priority=400)
    app.add_directive("modules", Modules)
    return {"parallel_read_safe": True, "parallel_write_safe": True}
