"""Random faults by the operators of cosmic-ray, wing by wing, and those that no test notices.

    pip install cosmic-ray
    python tests/mutants/sample.py optics training --number 40 --seed 1

    python tests/mutants/sample.py hardware --near --trust      in a hurry

A fault is drawn among all that the operators have for the modules of a wing, the same for the same
seed and code. The fast tests of the wing run against it, first those that import its module. A copy
of the tree is changed, never the tree itself. Survivors are missing laws, or change nothing.
"""

import os
import random
import re
import shutil
import signal
import subprocess
import sys
import tempfile
import time
import traceback
from collections.abc import Iterator
from contextlib import suppress
from difflib import unified_diff
from importlib import import_module
from pathlib import Path
from typing import Annotated, NamedTuple

import typer

os.environ |= {"OMP_NUM_THREADS": "1", "MPLBACKEND": "Agg"}  # before numpy and torch
sys.dont_write_bytecode = True  # a change of equal length may look unchanged

ROOT = Path(__file__).parents[2]

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


def changed(source: str, fault: Fault) -> str:
    """Source with a fault."""
    from cosmic_ray.mutating import mutate_code
    from cosmic_ray.plugins import get_operator

    return mutate_code(source, get_operator(fault.operator)(), fault.occurrence)


def preload(tree: Path) -> None:
    """Import what the package imports from others, once for all children."""
    script = "import sys, deepfsi.cli, deepfsi.training.learning; print(*sys.modules)"
    environment = {**os.environ, "PYTHONPATH": str(tree / "src")}
    done = subprocess.run(
        [sys.executable, "-c", script], env=environment, check=True, capture_output=True, text=True
    )
    for name in done.stdout.split():
        if not name.startswith(("deepfsi", "_", "sitecustomize")):
            with suppress(ImportError):
                import_module(name)


def run_tests(tree: Path, tests: list[str], log: Path) -> int:
    """Exit status of pytest on tests of a tree, in a child that has torch already."""
    child = os.fork()
    if child == 0:
        status = 1
        try:
            status = _pytest(tree, tests, log)
        except BaseException:
            traceback.print_exc()
        finally:
            os._exit(status)
    due = time.monotonic() + LONGEST_S
    while not (done := os.waitpid(child, os.WNOHANG))[0]:
        if time.monotonic() > due:
            os.killpg(child, signal.SIGKILL)
            return os.waitpid(child, 0)[1] or 1
        time.sleep(0.05)
    return os.waitstatus_to_exitcode(done[1])


def _pytest(tree: Path, tests: list[str], log: Path) -> int:
    os.setsid()
    os.chdir(tree)
    handle = os.open(log, os.O_CREAT | os.O_WRONLY | os.O_TRUNC)
    os.dup2(handle, 1)
    os.dup2(handle, 2)
    os.environ["PYTHONPATH"] = f"{tree / 'src'}:{tree / 'tests'}"
    sys.path[:0] = [str(tree / "src"), str(tree / "tests")]
    import pytest

    options = ["-q", "-x", "-m", "not slow", "-p", "no:cacheprovider", "-rfE", "--tb=no"]
    return pytest.main([*options, *tests])


def stages(tree: Path, module: Path, near_only: bool) -> list[list[str]]:
    """Tests of the wing of a module: those that import it, then the others unless left out."""
    wing = module.parts[0]
    name = ".".join(("deepfsi", *module.with_suffix("").parts)).removesuffix(".__init__")
    found = sorted((tree / "tests" / wing).rglob("test_*.py"))
    near = [each for each in found if re.search(rf"{name}\b", each.read_text())]
    near.sort(key=lambda each: each.stem != f"test_{module.stem}")
    far = [each for each in found if each not in near]
    kept = [stage for stage in (near, far) if stage][: 1 if near_only else 2]
    return [[str(each.relative_to(tree)) for each in stage] for stage in kept]


def survives(tree: Path, fault: Fault, log: Path, near: bool) -> str | None:
    """Difference that a fault makes, if no test fails on it."""
    path = tree / "src" / "deepfsi" / fault.module
    source = path.read_text()
    wrong = changed(source, fault)
    path.write_text(wrong)
    try:
        if any(run_tests(tree, stage, log) for stage in stages(tree, fault.module, near)):
            return None
    finally:
        path.write_text(source)
    lines = unified_diff(source.splitlines(), wrong.splitlines(), lineterm="", n=1)
    return "\n".join(line for line in lines if not line.startswith(("---", "+++")))


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

    with tempfile.TemporaryDirectory() as folder:
        tree, log = Path(folder) / "tree", Path(folder) / "log"
        left_out = shutil.ignore_patterns(".*", "runs", "__pycache__")
        shutil.copytree(ROOT, tree, symlinks=True, ignore=left_out)
        preload(tree)
        for wing in wings:
            if not trust and run_tests(tree, [f"tests/{wing}"], log):
                raise SystemExit(f"fails without any fault: {log.read_text()[-300:]}")
            every = list(faults(tree / "src" / "deepfsi", wing))
            drawn = random.Random(seed).sample(every, min(number, len(every)))[first - 1 :]
            alive = 0
            for place, fault in enumerate(drawn, start=first):
                began = time.monotonic()
                found = survives(tree, fault, log, near)
                alive += found is not None
                said = f"{fault.module} {fault.operator} {fault.occurrence}"
                said += f" ({time.monotonic() - began:.0f} s)"
                print(f"{wing} {place:3} {said}\n{found or log.read_text()[-200:]}", flush=True)
            dead = len(drawn) - alive
            low, high = binomtest(dead, len(drawn)).proportion_ci(0.95, method="wilson")
            print(
                f"{wing}: {dead} of {len(drawn)} drawn of {len(every)} found, "
                f"{dead / len(drawn):.2f} ({low:.2f} to {high:.2f})",
                flush=True,
            )


if __name__ == "__main__":
    typer.run(main)
