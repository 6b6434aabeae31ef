"""The rules of the house that a program can check: rooms, names, words and ways of imports.

`lint-imports` checks which room may import from which. The rules themselves are in
`shared/house.py`; here is each exception with its reason.
"""

import ast
import inspect
import re
from pathlib import Path

import pytest

import deepfsi
from deepfsi.cli.app import Group, app
from shared.house import DESCRIBED, RULES, Function, House, trees

ROOT = Path(__file__).parents[1]
SOURCE = ROOT / "src"

LINES = {
    "adaptive": 1769,
    "base": 1545,
    "base.models": 119,
    "base.numeric": 1530,
    "camera": 1580,
    "cli": 3109,
    "datasets": 3157,
    "design": 1184,
    "designfile": 1611,
    "evaluation": 1200,
    "exposure": 1287,
    "hardware.calibration": 1231,
    "hardware.counting": 3150,
    "hardware.drivers": 126,
    "hardware.light": 1355,
    "hardware.live": 1381,
    "hardware.patterns": 1886,
    "hardware.photons": 1372,
    "hardware.virtual": 1041,
    "jobs": 1873,
    "lab": 1348,
    "measures": 699,
    "networks": 501,
    "physics": 2113,
    "report": 1490,
    "report.playground": 207,
    "report.style": 276,
    "sweeps": 2828,
    "training": 1842,
}
"""Lines of each room, which may only fall: lower the number with them."""

WORDS_OF_FILES = (
    "deepfsi.base.numeric.intervals.Crossing.found",
    "deepfsi.designfile.distribution.ConsistencyResult.whole",
    "deepfsi.hardware.counting.acquisition.Calibration.shown",
    "deepfsi.hardware.patterns.manifest.Manifest.shown",
)
"""Public names and fields that a file, a key or an option has: ``deepfsi.jobs.job.Job.shown``."""


@pytest.fixture(scope="module")
def house():
    return House(SOURCE, WORDS_OF_FILES)


@pytest.mark.parametrize("rule", RULES)
def test_every_room_keeps_the_rules(rule, house):
    assert not list(RULES[rule](house))


def test_no_room_grows(house):
    """Within 40 lines below its ceiling, so that what was won stays won."""
    for room, ceiling in LINES.items():
        files = (SOURCE / "deepfsi" / room.replace(".", "/")).glob("*.py")
        lines = sum(len(path.read_text().splitlines()) for path in files)
        assert ceiling - 40 <= lines <= ceiling, f"{room}: {lines} lines, {ceiling} allowed"
    assert set(LINES) == set(house.rooms)


COMMANDS, OPTIONS = 29, 48
"""Commands, and options of `design`: they may only leave."""


def test_no_command_comes_and_no_option():
    groups, commands = [app], []
    for group in groups:
        entries = [group.get_command(None, name) for name in group.list_commands(None)]
        groups += [entry for entry in entries if isinstance(entry, Group)]
        commands += [entry for entry in entries if not isinstance(entry, Group)]
    assert len(commands) == COMMANDS
    [design] = (one for one in commands if one.name == "design")
    assert sum(one.opts[0].startswith("-") for one in design.params) == OPTIONS


TABLES = """from deepfsi.base.errors import InputError


def read_table(path: str, sheet: str) -> str:
    import polars

    return write_table(path, sheet=sheet)


def write_table(path: str, sheet: str) -> str:
    path, sheet = sheet, path
    return path
"""
DOOR = "deepfsi/base/__init__.py"
BASE = '"""What both rooms need."""\n'
ERRORS = "class InputError(ValueError):\n    "
SOUND = {
    "deepfsi/__init__.py": "",
    DOOR: BASE,
    "deepfsi/base/errors.py": ERRORS + "pass\n",
    "deepfsi/base/tables.py": TABLES,
    "deepfsi/design/__init__.py": '"""Designs."""\n',
    "deepfsi/design/learn.py": "import torch\n\nfrom deepfsi.base.errors import InputError\n"
    "from deepfsi.base.tables import read_table\n",
    "deepfsi/hardware/__init__.py": "",
    "deepfsi/hardware/light/__init__.py": '"""Light."""\n',
    "deepfsi/hardware/light/laws.py": "class Law:\n    own: int\n",
    "deepfsi_paper/a.py": "from deepfsi.base.tables import read_table, write_table\n",
}
"""A house of three rooms that keeps every rule, with an exception for a word."""

EXCEPTIONS = {
    "words": {"deepfsi.hardware.light.laws.Law.own"},
}
LIGHT = "deepfsi/hardware/light/a.py"
WRONG = [
    ("few_modules", {f"deepfsi/design/m{n}.py": "" for n in range(12)}),
    ("bare_rooms", {DOOR: BASE + "from deepfsi.base.errors import InputError\n"}),
    ("bare_rooms", {DOOR: "# nothing\n"}),
    ("one_meaning", {LIGHT: "def read_table(): ...\n"}),
    ("one_meaning", {LIGHT: "InputError = 3\n"}),
    (
        "no_circles",
        {
            "deepfsi/base/errors.py": f"{ERRORS}def f(self):\n"
            "        from deepfsi.base.tables import read_table\n"
        },
    ),
    ("early_imports", {LIGHT: "def f():\n    import json\n"}),
    ("early_imports", {LIGHT: "def f():\n    from deepfsi.base.tables import read_table\n"}),
    ("the_wall", {LIGHT: "def f():\n    import torch.nn\n"}),
    ("the_wall", {LIGHT: "from torch import Tensor\n"}),
    ("the_wall", {LIGHT: "def f():\n    from deepfsi.design.learn import g\n"}),
    ("no_participles", {LIGHT: "class Run:\n    shown: int\n"}),
    ("no_participles", {LIGHT: "def found(): ...\n"}),
    ("no_participles", {LIGHT: "class Run:\n    def own(self): ...\n"}),
    ("named_values", {LIGHT: "def f(*a): ...\n\n\nf(1, 2, 3, 4, 5)\n"}),
    (
        "named_values",
        {LIGHT: "from deepfsi.base.tables import read_table\n\n\nread_table(1, 2, 3, 4, 5)\n"},
    ),
    ("no_packing", {LIGHT: "a, b = 1, 2\n"}),
]


@pytest.mark.parametrize(("rule", "changes"), [*((rule, {}) for rule in RULES), *WRONG])
def test_a_sound_house_keeps_every_rule_and_a_wrong_one_breaks_it(rule, changes, tmp_path):
    for name, text in (SOUND | changes).items():
        if text is not None:
            (tmp_path / name).parent.mkdir(parents=True, exist_ok=True)
            (tmp_path / name).write_text(text)
    house = House(tmp_path, **EXCEPTIONS)
    assert bool(list(RULES[rule](house))) == bool(changes)


def test_the_page_of_the_architecture_has_each_room_and_no_other(house):
    text = (ROOT / "docs/develop/architecture.md").read_text()
    rooms = re.findall(r"^- \*\*`([\w.]+)`\*\* ", text, re.M)
    assert sorted(rooms) == sorted(house.rooms)


def test_no_module_takes_a_private_name_of_another():
    tests = [ast.parse(path.read_text()) for path in (ROOT / "tests").rglob("*.py")]
    taken = [
        (node.module, alias.name)
        for tree in (*trees(SOURCE).values(), *tests)
        for node in ast.walk(tree)
        if isinstance(node, ast.ImportFrom) and (node.module or "").startswith("deepfsi")
        for alias in node.names
    ]
    assert not [pair for pair in taken if re.match(r"_(?!_)", pair[1])]


def test_no_public_function_shares_its_name_with_a_module_beside_it():
    for path, tree in trees(SOURCE).items():
        beside = {path.parent.name, *(other.stem for other in path.parent.iterdir())}
        assert not beside & {node.name for node in tree.body if isinstance(node, Function)}, path


def test_summaries_name_the_thing():
    """Those of rooms may also say what a room is for."""
    for path, tree in trees(SOURCE).items():
        for node in ast.walk(tree):
            if isinstance(node, Function | ast.ClassDef | ast.Module):
                text = ast.get_docstring(node) or ""
                is_room = isinstance(node, ast.Module) and path.name == "__init__.py"
                assert is_room or not re.match(r"(What|How|Whether|The same)\b", text), path


def test_the_names_of_the_reference_describe_their_parameters():
    """Also their public methods, of three parameters or more."""
    for name in deepfsi.__all__:
        public = getattr(deepfsi, name)
        for each in [public] if inspect.isfunction(public) else [public, *vars(public).values()]:
            own = inspect.isfunction(each) and each.__module__.partition(".")[0] == "deepfsi"
            if own and not each.__name__.startswith("_"):
                few = len({*inspect.signature(each).parameters} - {"self", "cls"}) < 3
                assert few or DESCRIBED.search(each.__doc__ or ""), f"{name}.{each.__name__}"


def test_constants_say_what_they_are():
    """A public constant of a module that is a number has a docstring with its unit."""
    for path, tree in trees(SOURCE).items():
        for node, after in zip(tree.body, [*tree.body[1:], None], strict=True):
            match node:
                case ast.Assign([ast.Name(name)], ast.Constant(int() | float())):
                    said = isinstance(after, ast.Expr) and isinstance(after.value, ast.Constant)
                    assert said or not re.fullmatch(r"[A-Z][A-Z_0-9]*", name), f"{path}:{name}"
