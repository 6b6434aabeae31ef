"""Error messages of the package, read from its source.

The directive `messages` lists those of the modules and folders that it names, those of `deepfsi`
without its name: every `InputError`, and every `ValueError` of a model's field. What a message
fills in stands in ‹brackets›.
"""

import ast
import re
from pathlib import Path

from markdown import Made

import deepfsi
import deepfsi_paper

SOURCES = [Path(package.__file__).parent for package in (deepfsi, deepfsi_paper)]
LISTED = re.compile(r"^```\{messages\} (.+)$", re.M)
ERRORS = ("InputError", "ValueError")


def modules():
    """Files of the packages, each with the folder of its package."""
    return [(source, path) for source in SOURCES for path in sorted(source.rglob("*.py"))]


def assigned(page):
    """Files that each name of a page stands for: of two that hold a file the closer one."""
    named = [name for line in LISTED.findall(page) for name in line.split()]
    found = {name: [] for name in named}
    for source, path in modules():
        dotted = ".".join(path.relative_to(source.parent).with_suffix("").parts)
        dotted = dotted.removeprefix("deepfsi.")
        holders = [name for name in named if f"{dotted}.".startswith(f"{name}.")]
        if holders:
            found[max(holders, key=len)].append(path)
    return found


def of_module(path):
    """Messages of a file, each once, in their order; those without words of their own left out."""
    tree = ast.parse(path.read_text())
    constants = {
        node.targets[0].id: node.value
        for node in tree.body
        if isinstance(node, ast.Assign) and isinstance(node.targets[0], ast.Name)
    }
    found = [
        of_call(node, constants)
        for node in ast.walk(tree)
        if isinstance(node, ast.Call)
        and isinstance(node.func, ast.Name)
        and node.func.id in ERRORS
        and node.args
    ]
    return [text for text in dict.fromkeys(found) if re.search(r"\w", re.sub("‹.*?›", "", text))]


def of_call(node, constants):
    """Text of the message of a call; of a template with its settings in backticks."""
    text = filled(node.args[0], constants)
    values = {keyword.arg: keyword.value for keyword in node.keywords}
    if not values:
        return text
    named = ast.unparse(values.pop("setting", ast.Constant(())))

    def field(match):
        name, value = match.groups()
        if name in values:
            return filled(values[name], constants).replace("…", name)
        if repr(name) not in named:  # one of several settings
            return f"‹{name}›"
        if not value:
            return f"`{name}`"
        if value.startswith("{"):
            return f"`{name}=‹{value[1:-1]}›`"
        return f"`{name}={value}`" if value.isdecimal() else f'`{name}="{value}"`'

    return re.sub(r"\{(\w+)(?:![rs])?(?::((?:[^{}]|\{\w+\})*))?\}", field, text)


def filled(node, constants):
    """Text of a message, with ‹name› for what is filled in."""
    if isinstance(node, ast.Constant):
        return str(node.value)
    if isinstance(node, ast.JoinedStr):
        return "".join(filled(each, constants) for each in node.values)
    if isinstance(node, ast.BinOp) and isinstance(node.op, ast.Add):
        return filled(node.left, constants) + filled(node.right, constants)
    if isinstance(node, ast.BinOp) and isinstance(node.op, ast.Mult):  # what only some cases say
        return filled(node.left, constants)
    if isinstance(node, ast.FormattedValue):
        return filled(node.value, constants)
    if isinstance(node, ast.Name) and isinstance(constants.get(node.id), ast.Constant):
        return str(constants[node.id].value)
    if isinstance(node, ast.Name | ast.Attribute):
        return f"‹{node.id if isinstance(node, ast.Name) else node.attr}›"
    return "‹…›"


def listed(files):
    """List of the messages of files."""
    texts = [text for path in files for text in of_module(path)]
    return "\n".join(f"- {shown(text)}" for text in texts)


def shown(text):
    """Message as an item of a list, on one line."""
    return re.sub(r"([\\*_<>\[\]#`|$])", r"\\\1", " ".join(text.split()))


class Messages(Made):
    """The directive; its arguments are modules or folders."""

    required_arguments = 1
    final_argument_whitespace = True

    def text(self):
        """Markdown of the list."""
        files = assigned(Path(self.env.doc2path(self.env.docname)).read_text())
        own = [path for name in self.arguments[0].split() for path in files[name]]
        return f":::{{div}} messages\n{listed(own)}\n:::"


def setup(app):
    """Add the directive."""
    app.add_directive("messages", Messages)
    return {"parallel_read_safe": True, "parallel_write_safe": True}
