"""Change the package in the ways of mutants.toml, one at a time, and list those no test notices.

    python tests/mutants/run.py            all, an hour or so on one core
    python tests/mutants/run.py --only rail --only noise
    python tests/mutants/run.py --first 40

A copy of the tree is changed, never the tree itself. A mutant is killed where its tests pass on the
sound copy and fail on the changed one. The list names the function and the code in it, so a mutant
stays as it is when its function is moved or formatted; only the name of its module follows.
"""

import ast
import os
import re
import shutil
import subprocess
import sys
import tempfile
import tomllib
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from functools import cache
from pathlib import Path
from typing import Annotated

import typer

ROOT = Path(__file__).parents[2]

LONGEST_S = 900.0
"""Seconds after which tests that hang count as failed."""


@dataclass(frozen=True)
class Mutant:
    """One deliberate fault, found by function and code, not by file and text."""

    wrong: str
    """What is wrong, in one sentence."""
    at: str
    """Module and qualified name of the function, class or constant in it that is changed."""
    old: str
    """An expression or statements that stand there once, formatted in any way."""
    new: str
    """What stands there instead."""
    tests: tuple[str, ...]
    """Paths below ``tests``, one of which must fail."""

    def file(self, tree: Path) -> Path:
        """File of the changed module in a copy of the repository."""
        module = tree.joinpath("src", *self.at.partition(":")[0].split("."))
        return module / "__init__.py" if module.is_dir() else module.with_suffix(".py")

    def apply(self, source: str) -> str:
        """Source of the module with the fault, which must fit at exactly one place."""
        tree, kind, places = ast.parse(source), ast.stmt, []
        old, new = ast.parse(self.old).body, ast.parse(self.new).body
        if all(len(code) == 1 and isinstance(code[0], ast.Expr) for code in (old, new)):
            kind, old, new = ast.expr, [old[0].value], [new[0].value]
        wanted = [same(node) for node in old]
        for parent in named(tree, self.at.partition(":")[2]):
            for field, value in ast.iter_fields(parent):
                nodes = value if isinstance(value, list) else [value]
                codes = [isinstance(node, kind) and same(node) for node in nodes]
                for first in range(len(codes) - len(old) + 1):
                    last = first + len(old)
                    if codes[first:last] == wanted:
                        changed = [*nodes[:first], *new, *nodes[last:]]
                        # what is left of a block without statements is `pass`, but for an `else`
                        rest = [ast.Pass()] if field == "body" else []
                        changed = (changed or rest) if isinstance(value, list) else changed[0]
                        places.append((parent, field, changed))
        if len(places) != 1:
            raise ValueError(f"{self.at} holds {len(places)} times: {self.old}")
        setattr(*places[0])
        return ast.unparse(tree)


def named(tree: ast.Module, name: str) -> Iterator[ast.AST]:
    """Definitions of a qualified name with all in them: a property and its setter are two."""
    nodes: list[ast.AST] = [tree]
    for part in name.split("."):
        bodies = [node for outer in nodes for node in getattr(outer, "body", [])]
        nodes = [node for node in bodies if part in _names(node)]
    return (inner for node in nodes for inner in ast.walk(node))


def _names(node: ast.stmt) -> set[str]:
    """Names that a statement defines."""
    targets = node.targets if isinstance(node, ast.Assign) else [getattr(node, "target", None)]
    stored = [name for target in targets if target for name in ast.walk(target)]
    return {getattr(node, "name", None), *(getattr(name, "id", None) for name in stored)}


def same(node: ast.AST) -> str:
    """What two pieces of code share if they differ only in their formatting."""
    return re.sub(r",? ?ctx=\w+\(\)", "", ast.dump(node))


def read_mutants() -> list[Mutant]:
    """Mutants of the list, in its order."""
    listed = tomllib.loads(Path(__file__).with_name("mutants.toml").read_text())["mutant"]
    return [Mutant(**{**each, "tests": tuple(each["tests"])}) for each in listed]


@contextmanager
def copied_tree() -> Iterator[Path]:
    """Copy of the repository, for as long as it is needed."""
    with tempfile.TemporaryDirectory() as folder:
        left_out = shutil.ignore_patterns(".*", "runs", "__pycache__")
        yield shutil.copytree(ROOT, Path(folder) / "tree", symlinks=True, ignore=left_out)


def first_failure(tree: Path, tests: tuple[str, ...], *options: str) -> str | None:
    """Test below ``tests`` that fails first in a copy of the tree, or None."""
    environment = {**os.environ, "PYTHONPATH": str(tree / "src"), "OMP_NUM_THREADS": "1"}
    environment["PYTHONDONTWRITEBYTECODE"] = "1"  # a change of equal length may look unchanged
    command = [sys.executable, "-m", "pytest", "-q", "-x", "-p", "no:cacheprovider", "-rfE"]
    command += [*options, *(f"tests/{each}" for each in tests)]
    try:
        done = subprocess.run(
            command, cwd=tree, env=environment, capture_output=True, text=True, timeout=LONGEST_S
        )
    except subprocess.TimeoutExpired:
        return f"no answer after {LONGEST_S:g} s"
    failed = re.search(r"^(?:FAILED|ERROR) .*?(?= - |$)", done.stdout, re.M)
    said = failed[0] if failed else done.stdout[-300:] + done.stderr[-300:]
    return said if done.returncode else None


def run(
    only: Annotated[list[str] | None, typer.Option(help="words of what is wrong")] = None,
    first: Annotated[int, typer.Option(min=1, help="number of the first mutant tried")] = 1,
) -> None:
    """Run the tests of each mutant and exit 1 if one survives."""
    listed = read_mutants()[first - 1 :]
    chosen = [m for m in listed if not only or any(word in m.wrong for word in only)]
    survivors, on_sound_code = 0, cache(first_failure)
    with copied_tree() as tree:
        for number, mutant in enumerate(chosen, start=first):
            if failure := on_sound_code(tree, mutant.tests):
                raise SystemExit(f"fails without any fault: {failure}")
            path = mutant.file(tree)
            source = path.read_text()
            path.write_text(mutant.apply(source))
            killer = first_failure(tree, mutant.tests)
            path.write_text(source)
            survivors += killer is None
            print(f"{number:3} {killer or 'SURVIVES'}\n    {mutant.wrong}", flush=True)
    print(f"{len(chosen)} mutants, {survivors} survive")
    raise SystemExit(bool(survivors))


if __name__ == "__main__":
    typer.run(run)
