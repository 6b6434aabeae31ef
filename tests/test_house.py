"""The rules of the house that a program can check: rooms, doors, names, words and ways of imports.

`lint-imports` checks which room may import from which. The rules themselves are in
`shared/house.py`; here is which rooms keep them, and each exception with its reason.
"""

import ast
import inspect
import re
from collections.abc import Callable
from pathlib import Path

import pytest

import deepfsi
from shared.house import Function, House

ROOT = Path(__file__).parents[1]
SOURCE = ROOT / "src"
TREES = {path: ast.parse(path.read_text()) for path in sorted(SOURCE.rglob("*.py"))}
HOUSE = House(SOURCE, users=(ROOT / "README.md", ROOT / "docs", ROOT / "benchmarks"))

ROOMS_DONE: set[str] = {
    "base",
    "base.models",
    "base.numeric",
    "camera",
    "cli",
    "datasets",
    "design",
    "designfile",
    "evaluation",
    "exposure",
    "hardware.calibration",
    "hardware.counting",
    "hardware.drivers",
    "hardware.light",
    "hardware.live",
    "hardware.patterns",
    "hardware.photons",
    "hardware.pictures",
    "hardware.virtual",
    "jobs",
    "lab",
    "measures",
    "networks",
    "physics",
    "report",
    "report.playground",
    "report.style",
    "sweeps",
    "training",
}
"""Rooms that keep every rule. A finished room is added here, and never goes again."""

LONELY: dict[str, str] = {
    "deepfsi.cli.app": "the table of the commands, which loads each when it is called",
    "deepfsi.cli.camera": "commands are loaded by their names in commands.toml",
    "deepfsi.cli.data": "commands are loaded by their names in commands.toml",
    "deepfsi.cli.design": "commands are loaded by their names in commands.toml",
    "deepfsi.cli.dmd": "commands are loaded by their names in commands.toml",
    "deepfsi.cli.recording": "commands are loaded by their names in commands.toml",
    "deepfsi.cli.runs": "commands are loaded by their names in commands.toml",
    "deepfsi.cli.studies": "commands are loaded by their names in commands.toml",
    "deepfsi.datasets.variants": "data sets made of another one, apart from what makes those",
    "deepfsi.evaluation.bounds": "formulas of how well values can be estimated, by any network",
    "deepfsi.design.check_counts": "counts that do not fit, apart from what reads those that do",
    "deepfsi.design.file": "what a file keeps of a design, apart from what a design does",
    "deepfsi.design.judgement": "answers and tests of a run at once, which the lab asks for",
    "deepfsi.design.onnx": "a graph is an export, which needs another package",
    "deepfsi.evaluation.distribution_fit": "the fit of a test of counts, which a training makes",
    "deepfsi.exposure.conditioned": "a kind of exposure is its file and a line of the table",
    "deepfsi.exposure.patches": "a kind of exposure is its file and a line of the table",
    "deepfsi.evaluation.page_data": "a design as a page needs it, which one command writes",
    "deepfsi.hardware.drivers.catalogue": "the devices by name, apart from what each of them does",
    "deepfsi.hardware.drivers.dlpc900": "a device is its driver and a line of the catalogue",
    "deepfsi.hardware.drivers.picoquant": "a device is its driver and a line of the catalogue",
    "deepfsi.hardware.drivers.swabian": "a device is its driver and a line of the catalogue",
    "deepfsi.hardware.drivers.vialux": "a device is its driver and a line of the catalogue",
    "deepfsi.hardware.live.run": "devices show and count; what decides and what replays has none",
    "deepfsi.hardware.pictures.rail_sums": "a test of the light, which needs no pictures",
    "deepfsi.hardware.virtual.setup": "virtual devices, apart from the camera that records at once",
    "deepfsi.lab.scenes": "what a camera is shown, by pictures or by a list, before it runs",
    "deepfsi.lab.adaptive_looks": "it loads torch, which only adaptive masks need",
    "deepfsi.lab.transits": "scenes that pass a pattern are no run, and have their own command",
    "deepfsi.hardware.patterns.photomask": "one pattern that no device shows, and needs no frames",
    "deepfsi.hardware.pictures.tables": "tables of counts without a run, which one command reads",
    "deepfsi.hardware.photons.scan": "a microscope's scan is no run, and has markers of its own",
    "deepfsi.hardware.photons.timestamps": "a new make's file is a class and a line in it",
    "deepfsi.report.pictures": "pictures from counts, of which no comparison has any",
    "deepfsi.physics.transit": "scenes that pass a pattern, which one kind of exposure needs",
    "deepfsi.report.comparison_page": "a page is its file, which is given the results",
    "deepfsi.report.playground.page": "one page, with its template and scripts beside it",
    "deepfsi.sweeps.forecast": "what is asked before a sweep, and keeps no record of its own",
    "deepfsi.sweeps.model_cards": "published designs are made of a list, by a command of theirs",
    "deepfsi.sweeps.ray_cluster": "a cluster needs another package, and scripts may use it alone",
    "deepfsi.training.readouts": "networks of measured readouts, which need no masks",
}
"""Modules with one importer, each with the reason why it is a module: ``deepfsi.base.html``."""

PACKED: dict[str, str] = {}
"""Pairs that a loop carries: ``deepfsi.base.intervals: low, high = next_low, next_high``."""

WORDS_OF_FILES: set[str] = {
    "deepfsi.base.numeric.intervals.Crossing.found",
    "deepfsi.designfile.distribution.ConsistencyResult.whole",
    "deepfsi.evaluation.stopping.Stopped.whole",
    "deepfsi.hardware.counting.acquisition.Calibration.shown",
    "deepfsi.hardware.patterns.manifest.Manifest.shown",
    "deepfsi.hardware.pictures.rail_sums.RailSums.own",
}
"""Public names and fields that a file, a key or an option has: ``deepfsi.jobs.job.Job.shown``."""

RULES: dict[str, Callable[[House, set[str]], list[str]]] = {
    "a room has at most 12 modules": House.too_many_modules,
    "a module with one importer has a reason": lambda h, r: h.lonely_modules(
        r, LONELY if h is HOUSE else {}
    ),
    "a room is imported through its door": House.past_doors,
    "a door is a docstring, imports and a sorted list": House.doors_with_code,
    "what a door exports is used outside": House.unused_exports,
    "a door of the hardware exports at most 16 names": House.wide_doors,
    "a public name has one meaning": House.names_with_two_meanings,
    "no imports go in a circle": House.circles,
    "functions import what is heavy or needs torch, no more": House.late_imports,
    "nothing below the wall needs torch": House.through_the_wall,
    "no public name is a bare participle": lambda h, r: h.participles(r, WORDS_OF_FILES),
    "what a door exports describes its parameters": House.undescribed,
    "at most four values are passed by position": House.positional_calls,
    "no tuple is packed to be unpacked": lambda h, r: h.packed_tuples(r, PACKED),
}


@pytest.mark.parametrize("rule", RULES)
def test_finished_rooms_keep_the_rules(rule):
    assert set(HOUSE.rooms) >= ROOMS_DONE
    assert not RULES[rule](HOUSE, ROOMS_DONE)


BASE = '''"""What both rooms need."""

from deepfsi.base.errors import InputError
from deepfsi.base.tables import read_table, write_table

__all__ = ["InputError", "read_table", "write_table"]
'''
TABLES = '''from deepfsi.base.errors import InputError


def read_table(path: str, sheet: str) -> str:
    """Table of a file.

    Parameters
    ----------
    path, sheet
        Where it is.
    """
    import polars

    return write_table(path, sheet=sheet)


def write_table(path: str, sheet: str) -> str:
    """Write; parameters as of `read_table`."""
    path, sheet = sheet, path
    return path
'''
SOUND = {
    "deepfsi/__init__.py": "",
    "deepfsi/base/__init__.py": BASE,
    "deepfsi/base/errors.py": "class InputError(ValueError):\n    pass\n",
    "deepfsi/base/tables.py": TABLES,
    "deepfsi/design/__init__.py": "",
    "deepfsi/design/learn.py": "import torch\n\nfrom deepfsi.base import InputError, read_table\n",
    "deepfsi/hardware/__init__.py": "",
    "deepfsi/hardware/light/__init__.py": '"""Light."""\n\n__all__ = []\n',
    "deepfsi_paper/a.py": "from deepfsi.base import read_table, write_table\n",
}
"""A house of three rooms, of which ``base`` and ``hardware.light`` keep every rule."""


def names(number: int) -> str:
    return ", ".join(f"f{each}" for each in range(number))


LIGHT = "deepfsi/hardware/light"
WRONG: dict[str, list[dict[str, str]]] = {
    "a room has at most 12 modules": [{f"{LIGHT}/m{n}.py": "" for n in range(13)}],
    "a module with one importer has a reason": [
        {f"{LIGHT}/alone.py": ""},
        {"deepfsi/base/once.py": "", "deepfsi_paper/b.py": "import deepfsi.base.once\n"},
    ],
    "a room is imported through its door": [
        {"deepfsi/design/b.py": "from deepfsi.base.errors import InputError\n"},
        {"deepfsi_paper/b.py": "from deepfsi.base import tables\n"},
        {"deepfsi/design/b.py": "def f():\n    from ..base.tables import read_table\n"},
    ],
    "a door is a docstring, imports and a sorted list": [
        {"deepfsi/base/__init__.py": BASE + "print()\n"},
        {"deepfsi/base/__init__.py": BASE.partition('"""\n')[2]},
        {"deepfsi/base/__init__.py": BASE.replace('"InputError", "read_table"', '"InputError"')},
        {"deepfsi/base/__init__.py": BASE.replace('"read_table", "write', '"write_table", "read')},
    ],
    "what a door exports is used outside": [{"deepfsi_paper/a.py": ""}],
    "a door of the hardware exports at most 16 names": [
        {f"{LIGHT}/__init__.py": f"from deepfsi.hardware.light.a import {names(17)}\n"}
    ],
    "a public name has one meaning": [
        {f"{LIGHT}/a.py": "def read_table(): ...\n"},
        {f"{LIGHT}/a.py": "InputError = 3\n"},
    ],
    "no imports go in a circle": [
        {
            "deepfsi/base/errors.py": "class InputError(ValueError):\n"
            "    def f(self):\n        from deepfsi.base.tables import read_table\n"
        }
    ],
    "functions import what is heavy or needs torch, no more": [
        {f"{LIGHT}/a.py": "def f():\n    import json\n"},
        {f"{LIGHT}/a.py": "def f():\n    from deepfsi.base import read_table\n"},
    ],
    "nothing below the wall needs torch": [
        {f"{LIGHT}/a.py": "def f():\n    import torch.nn\n"},
        {f"{LIGHT}/a.py": "from torch import Tensor\n"},
        {f"{LIGHT}/a.py": "def f():\n    from deepfsi.design.learn import g\n"},
    ],
    "no public name is a bare participle": [
        {f"{LIGHT}/a.py": "class Run:\n    shown: int\n"},
        {f"{LIGHT}/a.py": "def found(): ...\n"},
        {f"{LIGHT}/a.py": "class Run:\n    def own(self): ...\n"},
    ],
    "what a door exports describes its parameters": [
        {"deepfsi/base/tables.py": TABLES.replace("Parameters\n", "Values\n")},
        {
            "deepfsi/base/errors.py": "class InputError(ValueError):\n"
            "    def __init__(self, message, setting): ...\n"
        },
        {"deepfsi/base/errors.py": "@dataclass\nclass InputError:\n    a: int\n    b: int\n"},
    ],
    "at most four values are passed by position": [
        {f"{LIGHT}/a.py": "def f(*a): ...\n\n\nf(1, 2, 3, 4, 5)\n"},
        {f"{LIGHT}/a.py": "from deepfsi.base import read_table\n\n\nread_table(1, 2, 3, 4, 5)\n"},
    ],
    "no tuple is packed to be unpacked": [{f"{LIGHT}/a.py": "a, b = 1, 2\n"}],
}


def made_up(folder: Path, files: dict[str, str]) -> House:
    for name, text in files.items():
        path = folder / name
        path.parent.mkdir(parents=True, exist_ok=True)
        path.write_text(text)
    return House(folder)


@pytest.mark.parametrize("rule", RULES)
def test_a_sound_house_keeps_every_rule_and_a_wrong_one_breaks_it(rule, tmp_path):
    done = {"base", "hardware.light"}
    assert not RULES[rule](made_up(tmp_path / "sound", SOUND), done)
    for number, wrong in enumerate(WRONG[rule]):
        house = made_up(tmp_path / str(number), SOUND | wrong)
        assert RULES[rule](house, done), wrong


def test_a_reason_that_is_not_needed_any_more_is_named(tmp_path):
    house = made_up(tmp_path, SOUND)
    assert house.lonely_modules({"base"}, {"deepfsi.base.errors": "why"})
    assert house.packed_tuples({"base"}, {"deepfsi.base.tables: a, b = 1, 2": "why"})


def name_of(path: Path, function: Function) -> str:
    return f"{path.relative_to(SOURCE)}:{function.name}".removeprefix("deepfsi/")


def documented(tree: ast.AST) -> list[tuple[str, str]]:
    kinds = (ast.Module, ast.ClassDef, ast.FunctionDef, ast.AsyncFunctionDef)
    nodes = [node for node in ast.walk(tree) if isinstance(node, kinds)]
    found = [(getattr(node, "name", "module"), ast.get_docstring(node)) for node in nodes]
    return [(name, text) for name, text in found if text]


@pytest.mark.parametrize(
    ("page", "named"),
    [
        ("docs/develop/architecture.md", r"^- \*\*`([\w.]+)`\*\* "),
        ("CONTRIBUTING.md", r"^\| `([\w/]+)/` \|"),
    ],
)
def test_the_pages_have_each_room_and_no_other(page, named):
    text = (ROOT / page).read_text().partition("`src/deepfsi_paper/` has")[0]
    rooms = [name.replace("/", ".") for name in re.findall(named, text, re.M)]
    assert sorted(rooms) == sorted(room for room, modules in HOUSE.rooms.items() if modules)


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
    ]
    assert not found


def test_summaries_name_the_thing():
    """Those of doors may also say what a room is for."""
    found = [
        f"{path.relative_to(SOURCE)}:{name}"
        for path, tree in TREES.items()
        for name, text in documented(tree)
        if name != "module" or path.name != "__init__.py"
        if re.match(r"(What|How|Whether|The same)\b", text)
    ]
    assert not found


def test_the_names_of_the_reference_describe_their_parameters():
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
