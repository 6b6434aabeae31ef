"""Random faults by the operators of cosmic-ray, wing by wing, and those that no test notices.

    pip install cosmic-ray
    python tests/mutants/sample.py physics training --number 40 --seed 1

    python tests/mutants/sample.py counting --near --trust      in a hurry

A fault is drawn among all that the operators have for the modules of a wing, the same for the same
seed and code. The fast tests of the wing run against it, first those that import its module. A copy
of the tree is changed, never the tree itself. Survivors are missing laws, or change nothing.
"""

import os
import random
import re
import shutil
import subprocess
import sys
import tempfile
from collections.abc import Iterator
from difflib import unified_diff
from pathlib import Path
from typing import Annotated, NamedTuple

import typer

LONGEST_S = 900.0
"""Seconds after which tests that hang count as failed."""

OPERATORS = re.compile(
    "core/(AddNot|ReplaceTrueWithFalse|ReplaceFalseWithTrue|ReplaceAndWithOr|ReplaceOrWithAnd|"
    "ReplaceBreakWithContinue|ReplaceContinueWithBreak|ExceptionReplacer|NumberReplacer|"
    "ZeroIterationForLoop|ReplaceUnaryOperator_(USub_UAdd|Delete_Not|Delete_Invert)|"
    "ReplaceComparisonOperator_(Lt_LtE|LtE_Lt|Gt_GtE|GtE_Gt|Eq_NotEq|NotEq_Eq|Is_IsNot|IsNot_Is)|"
    "ReplaceBinaryOperator_(Add_Sub|Sub_Add|Mul_Div|Div_Mul|FloorDiv_Mul|Mod_FloorDiv|Pow_Mul|"
    "BitAnd_BitOr))"
)
"""One change of each kind: others of the same place are found by what finds it, or are no code."""


class Fault(NamedTuple):
    """Place of one operator in a module."""

    module: Path  # below src/deepfsi
    operator: str
    occurrence: int


def faults(package: Path, wing: str) -> Iterator[Fault]:
    """All faults of the modules of a wing, a folder of the package or of one of its folders."""
    from cosmic_ray.ast import ast_nodes, get_ast
    from cosmic_ray.plugins import get_operator, operator_names

    operators = {name: get_operator(name)() for name in operator_names() if OPERATORS.match(name)}
    for path in sorted((package / wing).rglob("*.py")):
        nodes = list(ast_nodes(get_ast(path.read_text())))
        for name, operator in sorted(operators.items()):
            count = sum(len(list(operator.mutation_positions(node))) for node in nodes)
            for occurrence in range(count):
                yield Fault(path.relative_to(package), name, occurrence)


def stages(tests: Path, module: Path, near_only: bool) -> list[tuple[str, ...]]:
    """Tests of the wing of a module: those that import it, then the others unless left out."""
    name = ".".join(("deepfsi", *module.with_suffix("").parts)).removesuffix(".__init__")
    every = sorted((tests / module.parts[0]).rglob("test_*.py"))
    near = [each for each in every if re.search(rf"{name}\b", each.read_text())]
    near.sort(key=lambda each: each.stem != f"test_{module.stem}")
    groups = [group for group in (near, [each for each in every if each not in near]) if group]
    kept = groups[: 1 if near_only else 2]
    return [tuple(str(each.relative_to(tests)) for each in group) for group in kept]


def first_failure(tree: Path, tests: tuple[str, ...]) -> str | None:
    """Fast test below ``tests`` that fails first in a copy of the tree, or None."""
    environment = {**os.environ, "PYTHONPATH": str(tree / "src"), "OMP_NUM_THREADS": "1"}
    environment["PYTHONDONTWRITEBYTECODE"] = "1"  # a change of equal length may look unchanged
    command = [sys.executable, "-m", "pytest", "-q", "-x", "-p", "no:cacheprovider", "-rfE"]
    command += ["-m", "not slow", *(f"tests/{each}" for each in tests)]
    try:
        done = subprocess.run(
            command, cwd=tree, env=environment, capture_output=True, text=True, timeout=LONGEST_S
        )
    except subprocess.TimeoutExpired:
        return f"no answer after {LONGEST_S:g} s"
    failed = re.search(r"^(?:FAILED|ERROR) .*?(?= - |$)", done.stdout, re.M)
    said = failed[0] if failed else done.stdout[-300:] + done.stderr[-300:]
    return said if done.returncode else None


def try_fault(tree: Path, fault: Fault, near: bool) -> tuple[bool, str]:
    """True and the test that fails of a fault, or False and the difference that it makes."""
    from cosmic_ray.mutating import mutate_code
    from cosmic_ray.plugins import get_operator

    path = tree / "src/deepfsi" / fault.module
    source = path.read_text()
    wrong = mutate_code(source, get_operator(fault.operator)(), fault.occurrence)
    path.write_text(wrong)
    try:
        for tests in stages(tree / "tests", fault.module, near):
            if killer := first_failure(tree, tests):
                return True, killer
    finally:
        path.write_text(source)
    lines = unified_diff(source.splitlines(), wrong.splitlines(), lineterm="", n=1)
    return False, "\n".join(line for line in lines if not line.startswith(("---", "+++")))


def main(
    wings: Annotated[list[str], typer.Argument(help="folders of src/deepfsi")],
    number: Annotated[int, typer.Option(min=1, help="faults drawn of each wing")] = 40,
    seed: int = 1,
    first: Annotated[int, typer.Option(min=1, help="number of the first fault tried")] = 1,
    trust: Annotated[bool, typer.Option(help="the tests are known to pass")] = False,
    near: Annotated[bool, typer.Option(help="only tests that import the changed module")] = False,
) -> None:
    """Draw faults of wings, list the survivors, and give the share that was found."""
    from scipy.stats import binomtest

    left_out = shutil.ignore_patterns(".*", "runs", "__pycache__")
    with tempfile.TemporaryDirectory() as folder:
        tree = shutil.copytree(
            Path(__file__).parents[2], Path(folder) / "tree", symlinks=True, ignore=left_out
        )
        for wing in wings:
            if not trust and (failure := first_failure(tree, (wing,))):
                raise SystemExit(f"fails without any fault: {failure}")
            every, dead = list(faults(tree / "src/deepfsi", wing)), 0
            drawn = random.Random(seed).sample(every, min(number, len(every)))[first - 1 :]
            for index, fault in enumerate(drawn, start=first):
                killed, said = try_fault(tree, fault, near)
                dead += killed
                print(f"{wing} {index:3} {' '.join(map(str, fault))}\n{said}", flush=True)
            low, high = binomtest(dead, len(drawn)).proportion_ci(0.95, method="wilson")
            print(
                f"{wing}: {dead} of {len(drawn)} drawn of {len(every)} found, "
                f"{dead / len(drawn):.2f} ({low:.2f} to {high:.2f})",
                flush=True,
            )


if __name__ == "__main__":
    typer.run(main)
