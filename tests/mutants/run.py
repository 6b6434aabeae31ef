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
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import Annotated

import typer

ROOT = Path(__file__).parents[2]

LONGEST_S = 600.0
"""Seconds after which tests that hang count as failed."""


@dataclass(frozen=True)
class Mutant:
    """One deliberate fault, found by function and code, not by file and text.

    Parameters
    ----------
    wrong
        What is wrong, in one sentence.
    at
        Module and qualified name of the function, class or constant in it that is changed,
        ``deepfsi.physics.noise:poisson``.
    old
        An expression or statements that stand there once, formatted in any way.
    new
        What stands there instead.
    tests
        Paths below ``tests``, one of which must fail.
    """

    wrong: str
    at: str
    old: str
    new: str
    tests: list[str]

    def file(self, tree: Path) -> Path:
        """File of the changed module in a copy of the repository."""
        module = tree.joinpath("src", *self.at.partition(":")[0].split("."))
        return module / "__init__.py" if module.is_dir() else module.with_suffix(".py")

    def apply(self, source: str) -> str:
        """Source of the module with the fault.

        Raises
        ------
        ValueError
            If the name is not there, or `old` does not stand in it exactly once.
        """
        tree = ast.parse(source)
        scopes = named(tree, self.at.partition(":")[2])
        if not scopes:
            raise ValueError(f"{self.at} is not there")
        old, new = ast.parse(self.old).body, ast.parse(self.new).body
        search = expressions if is_expression(old) and is_expression(new) else statements
        replacements = [each for scope in scopes for each in search(scope, old, new)]
        if len(replacements) != 1:
            raise ValueError(f"{self.at} holds {len(replacements)} times: {self.old}")
        replacements[0]()
        return ast.unparse(tree)


def named(tree: ast.Module, name: str) -> list[ast.stmt]:
    """Definitions of a qualified name: a property and its setter are two."""
    bodies, last = [tree.body], []
    for part in name.split("."):
        last = [node for body in bodies for node in body if part in _names(node)]
        bodies = [getattr(node, "body", []) for node in last]
    return last


def _names(node: ast.stmt) -> set[str]:
    """Names that a statement defines."""
    if isinstance(node, ast.FunctionDef | ast.AsyncFunctionDef | ast.ClassDef):
        return {node.name}
    targets = node.targets if isinstance(node, ast.Assign) else [getattr(node, "target", None)]
    stored = [name for target in targets if target for name in ast.walk(target)]
    return {name.id for name in stored if isinstance(name, ast.Name)}


def is_expression(body: list[ast.stmt]) -> bool:
    """True if the code is one expression."""
    return len(body) == 1 and isinstance(body[0], ast.Expr)


def same(node: ast.AST) -> str:
    """What two pieces of code share if they differ only in their formatting."""
    return re.sub(r",? ?ctx=\w+\(\)", "", ast.dump(node))


def expressions(
    scope: ast.stmt, old: list[ast.stmt], new: list[ast.stmt]
) -> Iterator[Callable[[], None]]:
    """Replacements of an expression by another, one for each place where it stands."""
    wanted, instead = same(old[0].value), new[0].value  # type: ignore[attr-defined]
    for parent in ast.walk(scope):
        for field, value in ast.iter_fields(parent):
            if isinstance(value, ast.expr) and same(value) == wanted:
                yield partial(setattr, parent, field, instead)
            elif isinstance(value, list):
                for index, item in enumerate(value):
                    if isinstance(item, ast.expr) and same(item) == wanted:
                        yield partial(value.__setitem__, index, instead)


def statements(
    scope: ast.stmt, old: list[ast.stmt], new: list[ast.stmt]
) -> Iterator[Callable[[], None]]:
    """Replacements of statements by others, one for each place where they stand."""
    wanted = [same(node) for node in old]
    for parent in ast.walk(scope):
        for field, body in ast.iter_fields(parent):
            if not isinstance(body, list) or not all(isinstance(n, ast.stmt) for n in body):
                continue
            dumps = [same(node) for node in body]
            for first in range(len(body) - len(old) + 1):
                if dumps[first : first + len(old)] == wanted:
                    changed = [*body[:first], *new, *body[first + len(old) :]]
                    # what is left of a block without statements is `pass`, but for an `else`
                    yield partial(
                        setattr, parent, field, changed or ([ast.Pass()] * (field == "body"))
                    )


def read_mutants() -> list[Mutant]:
    """Mutants of the list, in its order."""
    listed = tomllib.loads(Path(__file__).with_name("mutants.toml").read_text())
    return [Mutant(**each) for each in listed["mutant"]]


def first_failure(tree: Path, tests: list[str]) -> str | None:
    """Test that fails first in a copy of the tree, or None."""
    environment = {**os.environ, "PYTHONPATH": str(tree / "src"), "OMP_NUM_THREADS": "1"}
    environment["PYTHONDONTWRITEBYTECODE"] = "1"  # a change of equal length may look unchanged
    options = ["-q", "-x", "-p", "no:cacheprovider", "--no-header", "-rfE"]
    command = [sys.executable, "-m", "pytest", *options, *(f"tests/{each}" for each in tests)]
    try:
        done = subprocess.run(
            command, cwd=tree, env=environment, capture_output=True, text=True, timeout=LONGEST_S
        )
    except subprocess.TimeoutExpired:
        return f"no answer after {LONGEST_S:g} s"
    if done.returncode == 0:
        return None
    lines = [line for line in done.stdout.splitlines() if line.startswith(("FAILED", "ERROR"))]
    return lines[0].split(" - ")[0] if lines else done.stdout[-300:] + done.stderr[-300:]


def run(
    only: Annotated[list[str] | None, typer.Option(help="words of what is wrong")] = None,
    first: Annotated[int, typer.Option(min=1, help="number of the first mutant tried")] = 1,
) -> None:
    """Run the tests of each mutant and exit 1 if one survives."""
    listed = read_mutants()[first - 1 :]
    chosen = [m for m in listed if not only or any(word in m.wrong for word in only)]
    survivors: list[Mutant] = []
    sound: dict[tuple[str, ...], str | None] = {}
    with tempfile.TemporaryDirectory() as folder:
        tree = Path(folder) / "tree"
        left_out = shutil.ignore_patterns(".*", "runs", "__pycache__")
        shutil.copytree(ROOT, tree, symlinks=True, ignore=left_out)
        for number, mutant in enumerate(chosen, start=first):
            tests = tuple(mutant.tests)
            if tests not in sound:
                sound[tests] = first_failure(tree, mutant.tests)
            if sound[tests]:
                raise SystemExit(f"fails without any fault: {sound[tests]}")
            path = mutant.file(tree)
            source = path.read_text()
            path.write_text(mutant.apply(source))
            killer = first_failure(tree, mutant.tests)
            path.write_text(source)
            if killer is None:
                survivors.append(mutant)
            print(f"{number:3} {killer or 'SURVIVES'}\n    {mutant.wrong}", flush=True)
    print(f"{len(chosen)} mutants, {len(survivors)} survive")
    raise SystemExit(bool(survivors))


if __name__ == "__main__":
    typer.run(run)
