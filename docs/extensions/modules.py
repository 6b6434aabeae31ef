"""Reference of the modules of a folder of the package, from their docstrings.

The directive `modules` lists each module that has public names; each has a page of its own, which
is written before Sphinx reads pages. Names that the package itself gives stand on pages of their
own, and are left out. Fields of a model become its attributes, from their descriptions.
"""

import pkgutil
import re
from importlib import import_module
from inspect import getdoc, isclass, isfunction
from pathlib import Path

from formats import rows, typed
from links import MADE, words
from markdown import Made, table
from pydantic import BaseModel

import deepfsi

HOME = "generated/api"


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


def folders(text):
    """Folders whose modules a page lists."""
    lines = [line for kind, line in MADE.findall(text) if kind == "Modules"]
    return " ".join(map(words, lines)).split()


def listed(parts):
    """Modules of some folders that have public names."""
    paths = [path for folder in parts for path in under(folder)]
    return [path for path in paths if names(import_module(path))]


def page(path):
    """Page of a module."""
    module = import_module(path)
    lines = [f".. automodule:: {path}", "   :no-members:", "", f".. currentmodule:: {path}", ""]
    for name in names(module):
        kind = "class" if isclass(vars(module)[name]) else "function"
        lines += [f".. auto{kind}:: {name}"]
        members = ["   :members:", "   :exclude-members: model_config"]  # pydantic's own
        lines += [*(members if kind == "class" else []), ""]
    text = "\n".join(lines)
    return f"# `{path}`\n\n```{{eval-rst}}\n{text}\n```\n"


def write_pages(app):
    """Write the pages of all modules that are listed; none in a quick build."""
    home = Path(app.srcdir) / HOME
    pages = {}
    if not app.config.quick:
        for path in (Path(app.srcdir) / "lookup/api").glob("*.md"):
            found = listed(folders(path.read_text()))
            pages |= {home / f"{each}.md": page(each) for each in found}
    for old in set(home.glob("*.md")) - set(pages):
        old.unlink()
    home.mkdir(parents=True, exist_ok=True)
    for path, text in pages.items():
        if not path.exists() or path.read_text() != text:
            path.write_text(text)


def summary(thing):
    """First paragraph of the docstring of a module, a class or a function."""
    return getdoc(thing).partition("\n\n")[0]


def fields(model):
    """Lines of a section of attributes, from the fields of a model."""
    lines = ["Attributes", "----------"]
    for name, meaning, kind, default in rows(model):
        words = re.sub(r"\[(.+?)\]\(.+?\)", r"\1", typed(kind, default))
        lines += [f"{name.strip('`')} : {re.sub('[`*]', '', words)}", f"    {meaning}"]
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


def short(app, what, name, thing, options, signature, returns):
    """Signature of a class or a function, its defaults that are objects cut to their names."""
    if signature:
        return re.sub(r"(=\w+)\((?:[^()]|\([^()]*\))+\)", r"\1(...)", signature), returns
    return None


class Modules(Made):
    """The directive; its arguments are folders of the package."""

    required_arguments = 1
    final_argument_whitespace = True

    def text(self):
        """List of the modules, which lead to their pages; none in a quick build."""
        if self.config.quick:
            return ""
        found = listed(self.arguments[0].split())
        rows = [(f"[`{each}`](/{HOME}/{each}.md)", summary(import_module(each))) for each in found]
        tree = "\n".join(f"{each.removeprefix('deepfsi.')} </{HOME}/{each}>" for each in found)
        hidden = f"```{{toctree}}\n:hidden:\n\n{tree}\n```"
        return f"{hidden}\n\n{table(['module', 'what it holds'], rows)}"


def setup(app):
    """Add the directives, write pages, and read docstrings before numpydoc does."""
    app.connect("builder-inited", write_pages)
    app.connect("autodoc-process-docstring", with_fields, priority=390)
    app.connect("autodoc-process-docstring", as_text, priority=400)
    app.connect("autodoc-process-signature", short)
    app.add_directive("modules", Modules)
    return {"parallel_read_safe": True, "parallel_write_safe": True}
