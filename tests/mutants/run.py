"""Change the package in the ways of mutants.toml, one at a time, and list those no test notices.

    python tests/mutants/run.py            all, an hour or so on one core
    python tests/mutants/run.py --only rail --only noise
    python tests/mutants/run.py --first 40

A copy of the tree is changed, never the tree itself. A mutant is killed where its tests pass on the
sound copy and fail on the changed one.
"""

import os
import shutil
import subprocess
import sys
import tempfile
import tomllib
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated

import typer

ROOT = Path(__file__).parents[2]

LONGEST_S = 600.0
"""Seconds after which tests that hang count as failed."""


@dataclass(frozen=True)
class Mutant:
    """One deliberate fault."""

    wrong: str
    file: str
    old: str
    new: str
    tests: list[str]

    def apply(self, source: str) -> str:
        """Source with the fault, which must fit at one place."""
        if source.count(self.old) != 1:
            raise ValueError(f"{self.file} holds {source.count(self.old)} times: {self.old}")
        return source.replace(self.old, self.new)


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
            path = tree / "src" / "deepfsi" / mutant.file
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
