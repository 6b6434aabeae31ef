"""The ceilings of the house: lines of each room, modules of a room, commands, options.

`lint-imports` checks which room may import from which, by the contracts in `pyproject.toml`.
"""

import ast
import inspect
import re
from pathlib import Path

import deepfsi
from deepfsi.cli.app import Group, app

ROOT = Path(__file__).parents[1]
SOURCE = ROOT / "src/deepfsi"

LINES = {
    "adaptive": 1386,
    "base": 1604,
    "camera": 1109,
    "cli": 1838,
    "counting": 3166,
    "datasets": 1859,
    "design": 1036,
    "designfile": 1140,
    "evaluation": 1297,
    "exposure": 1041,
    "jobs": 1189,
    "lab": 3140,
    "patterns": 1143,
    "physics": 1689,
    "report": 939,
    "sweeps": 1950,
    "training": 1403,
}
"""Lines of each room, which may only fall: lower the number with them."""

COMMANDS, OPTIONS = 24, 29
"""Commands, and options of `design`: they may only leave."""

DOORS = ("cli",)
"""Rooms whose names are imported from their ``__init__``."""

DESCRIBED = re.compile(
    r"^\s*(Parameters|Attributes)\n\s*---|[Pp]arameters? (as|of)\b|[Ss]hapes as\b", re.M
)
"""What a docstring has that says what the parameters are."""


def test_no_room_grows():
    """Within 40 lines below its ceiling, so that what was won stays won."""
    rooms = {}
    for door in SOURCE.glob("*/**/__init__.py"):
        modules = list(door.parent.glob("*.py"))
        rooms[".".join(door.parent.relative_to(SOURCE).parts)] = modules
        assert len(modules) <= 13, door
    assert set(rooms) == set(LINES)
    for room, ceiling in LINES.items():
        lines = sum(len(path.read_text().splitlines()) for path in rooms[room])
        assert ceiling - 40 <= lines <= ceiling, f"{room}: {lines} lines, {ceiling} allowed"
        *_, door = sorted(rooms[room], key=lambda path: path.name == "__init__.py")
        assert len(ast.parse(door.read_text()).body) == 1 or room in DOORS, f"{door}: no docstring"


def test_no_command_comes_and_no_option():
    groups, commands = [app], []
    for group in groups:
        entries = [group.get_command(None, name) for name in group.list_commands(None)]
        groups += [entry for entry in entries if isinstance(entry, Group)]
        commands += [entry for entry in entries if not isinstance(entry, Group)]
    assert len(commands) == COMMANDS
    [design] = (one for one in commands if one.name == "design")
    assert sum(one.opts[0].startswith("-") for one in design.params) == OPTIONS


def test_the_page_of_the_architecture_has_each_room_and_no_other():
    text = (ROOT / "docs/develop/architecture.md").read_text()
    rooms = re.findall(r"^- \*\*`([\w.]+)`\*\* ", text, re.M)
    assert sorted(rooms) == sorted(LINES)


def test_no_module_takes_a_private_name_of_another():
    for path in [*ROOT.glob("src/**/*.py"), *ROOT.glob("tests/**/*.py")]:
        for node in ast.walk(ast.parse(path.read_text())):
            if isinstance(node, ast.ImportFrom) and (node.module or "").startswith("deepfsi"):
                names = [alias.name for alias in node.names]
                assert not [name for name in names if re.match(r"_(?!_)", name)], path


def test_the_names_of_the_reference_describe_their_parameters():
    """Also their public methods, of three parameters or more."""
    for name in deepfsi.__all__:
        public = getattr(deepfsi, name)
        for each in [public] if inspect.isfunction(public) else [public, *vars(public).values()]:
            own = inspect.isfunction(each) and each.__module__.partition(".")[0] == "deepfsi"
            if own and not each.__name__.startswith("_"):
                few = len({*inspect.signature(each).parameters} - {"self", "cls"}) < 3
                assert few or DESCRIBED.search(each.__doc__ or ""), f"{name}.{each.__name__}"
