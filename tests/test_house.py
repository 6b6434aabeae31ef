"""The rules of the house that a program can check: sizes, names, words and the way of imports.

`lint-imports` checks the layers; what may be larger than the rule is in a table of CONTRIBUTING.md.
"""

import ast
import inspect
import re
from pathlib import Path

import pytest

import deepfsi

pytestmark = pytest.mark.core

ROOT = Path(__file__).parents[1]
SOURCE = ROOT / "src"
TREES = {path: ast.parse(path.read_text()) for path in sorted(SOURCE.rglob("*.py"))}
MODULE_LINES, FUNCTION_LINES, PARAMETERS = 500, 60, 8
LARGER = set(re.findall(r"^\| `([\w/.]+:\w+)` \|", (ROOT / "CONTRIBUTING.md").read_text(), re.M))

Function = ast.FunctionDef | ast.AsyncFunctionDef


def functions(tree: ast.AST) -> list[Function]:
    return [node for node in ast.walk(tree) if isinstance(node, Function)]


def name_of(path: Path, function: Function) -> str:
    return f"{path.relative_to(SOURCE)}:{function.name}".removeprefix("deepfsi/")


def parameters(function: Function) -> list[str]:
    given = function.args
    names = [each.arg for each in (*given.posonlyargs, *given.args, *given.kwonlyargs)]
    return [name for name in names if name not in ("self", "cls")]


def large(path: Path, function: Function) -> bool:
    lines = (function.end_lineno or 0) - function.lineno + 1
    return lines > FUNCTION_LINES or len(parameters(function)) > PARAMETERS


def documented(tree: ast.AST) -> list[tuple[str, str]]:
    kinds = (ast.Module, ast.ClassDef, ast.FunctionDef, ast.AsyncFunctionDef)
    nodes = [node for node in ast.walk(tree) if isinstance(node, kinds)]
    found = [(getattr(node, "name", "module"), ast.get_docstring(node)) for node in nodes]
    return [(name, text) for name, text in found if text]


@pytest.mark.parametrize("folder", [SOURCE, ROOT / "tests"], ids=["src", "tests"])
def test_modules_are_small(folder):
    lines = {path: len(path.read_text().splitlines()) for path in folder.rglob("*.py")}
    assert not {str(path.relative_to(ROOT)): n for path, n in lines.items() if n > MODULE_LINES}


def test_functions_are_small_but_for_those_listed_with_a_reason():
    found = {
        name_of(path, each)
        for path, tree in TREES.items()
        for each in functions(tree)
        if large(path, each)
    }
    assert found == LARGER


def test_no_module_takes_a_private_name_of_another():
    every = {**TREES, **{p: ast.parse(p.read_text()) for p in (ROOT / "tests").rglob("*.py")}}
    found = [
        f"{path.relative_to(ROOT)}: {alias.name} of {node.module}"
        for path, tree in every.items()
        for node in ast.walk(tree)
        if isinstance(node, ast.ImportFrom) and (node.module or "").startswith("deepfsi")
        for alias in node.names
        if re.match(r"_(?!_)", alias.name)
    ]
    assert not found


def test_no_public_function_shares_its_name_with_a_module_beside_it():
    found = [
        name_of(path, node)
        for path, tree in TREES.items()
        for node in tree.body
        if isinstance(node, Function)
        and node.name in {path.parent.name, *(each.stem for each in path.parent.iterdir())}
        and path.parent.name != "cli"  # there a function is named as its command
    ]
    assert not found


def test_summaries_name_the_thing():
    found = [
        f"{path.relative_to(SOURCE)}:{name}"
        for path, tree in TREES.items()
        for name, text in documented(tree)
        if re.match(r"(What|How|Whether|The same)\b", text)
    ]
    assert not found


def test_the_names_of_the_reference_describe_their_parameters():
    """Other docstrings are one precise line; shapes stand in it, or at the field."""
    described = []
    for name in deepfsi.__all__:
        found = getattr(deepfsi, name)
        kept = [found] if inspect.isfunction(found) else [found, *vars(found).values()]
        functions = [each for each in kept if inspect.isfunction(each)]
        for each in functions:
            few = len({*inspect.signature(each).parameters} - {"self", "cls"}) < 3
            private = (
                each.__name__.startswith("_") or each.__module__.partition(".")[0] != "deepfsi"
            )
            told = re.search(
                r"^\s*(Parameters\n\s*---|.*[Pp]arameters? (as|of)|.*[Ss]hapes as)",
                each.__doc__ or "",
                re.M,
            )
            described.append((f"{name}.{each.__name__}", few or private or told))
    assert not [name for name, told in described if not told]
    assert len(described) > len(deepfsi.__all__)


def test_constants_say_what_they_are():
    """A public constant of a module that is a number has a docstring with its unit."""
    found = []
    for path, tree in TREES.items():
        for place, node in enumerate(tree.body):
            number = (
                isinstance(node, ast.Assign)
                and isinstance(node.targets[0], ast.Name)
                and re.fullmatch(r"[A-Z][A-Z_0-9]*", node.targets[0].id)
                and isinstance(node.value, ast.Constant)
                and isinstance(node.value.value, int | float)
            )
            after = tree.body[place + 1] if place + 1 < len(tree.body) else None
            said = isinstance(after, ast.Expr) and isinstance(after.value, ast.Constant)
            if number and not said:
                found.append(f"{path.relative_to(SOURCE)}:{node.targets[0].id}")
    assert not found
