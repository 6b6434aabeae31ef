"""The house as its text has it, and the rules of rooms, imports and names.

A room is a folder of modules. Nothing is imported here: everything is read from the source, so the
rules can be tried on a small package that was made up for them.
"""

import ast
import re
from collections import defaultdict, deque
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from functools import cache, cached_property
from graphlib import CycleError, TopologicalSorter
from pathlib import Path

BELOW_THE_WALL = ("base", "datasets", "camera", "jobs", "designfile", "measures", "hardware")
"""Rooms that need no torch, with the rooms in them."""

HEAVY = """
    PIL h5py hashlib importlib inspect matplotlib numpy onnx onnxruntime platform polars pooch
    psutil pydantic ray rich scipy shutil skimage sklearn spectral tensorly threadpoolctl
    tomllib torch
"""
"""Libraries that a function may import, since they are slow to load or optional. Python's own among
them add a fifth to the time of ``from deepfsi import InputError``."""

PARTICIPLES = "found known told held seen own given shown place each part whole"
"""Words that say what happened to a thing, or which one it is, and not what it is."""

DESCRIBED = re.compile(
    r"^\s*(Parameters|Attributes)\n\s*---|[Pp]arameters? (as|of)\b|[Ss]hapes as\b", re.M
)
"""What a docstring has that says what the parameters are."""

DOORS = ("cli", "report.style")
"""Rooms whose names are imported from their ``__init__``."""

ROOMS_OF_WORK = ("hardware", "designfile")
"""Rooms that no option needs: the help of a command takes two thirds of the time without."""

Function = ast.FunctionDef | ast.AsyncFunctionDef


@cache
def trees(source: Path) -> dict[Path, ast.Module]:
    """Modules of a folder by their files, read when they are asked for, and once."""
    return {path: ast.parse(path.read_text()) for path in sorted(source.rglob("*.py"))}


@dataclass(frozen=True)
class Module:
    """One file: its dotted name with the package, the dotted folder without it, and its text."""

    name: str
    room: str
    path: Path
    tree: ast.Module

    @property
    def is_door(self) -> bool:
        return self.path.name == "__init__.py"

    @cached_property
    def nodes(self) -> list[ast.AST]:
        return list(ast.walk(self.tree))

    def all(self, *kinds: type[ast.AST]) -> Iterator:
        """Nodes of some kinds."""
        return (node for node in self.nodes if isinstance(node, kinds))


@dataclass(frozen=True)
class Import:
    """What a module imports: a name of a target, or with None the target itself.

    Of a target outside the packages only the first word is kept. `late` are those of functions,
    `typed` those for type checkers only.
    """

    source: Module
    target: str
    name: str | None
    late: bool
    typed: bool


def import_statements(tree: ast.Module) -> Iterator[tuple[ast.Import | ast.ImportFrom, bool, bool]]:
    """Imports of a module, the outer ones first, whether in a function, and for checkers only.

    Blocks of statements alone are looked through, which takes a tenth of the time of all nodes.
    """
    blocks = deque([(tree, False, False)])
    while blocks:
        node, late, typed = blocks.popleft()
        if isinstance(node, ast.Import | ast.ImportFrom):
            yield node, late, typed
        late = late or isinstance(node, Function)
        typed = typed or (isinstance(node, ast.If) and "TYPE_CHECKING" in ast.dump(node.test))
        for field in ("body", "handlers", "orelse", "finalbody", "cases"):
            inside = getattr(node, field, ())
            blocks.extend((each, late, typed) for each in inside if isinstance(inside, list))


class House:
    """The packages of a folder; `words` are those of files."""

    def __init__(self, source: Path, words=()) -> None:
        every = (_module(source, path, tree) for path, tree in trees(source).items())
        self.everything = {each.name: each for each in every}
        own = (each for each in self.everything.values() if each.name.split(".")[0] == "deepfsi")
        self.modules = {each.name: each for each in sorted(own, key=lambda each: each.name)}
        self.rooms = defaultdict(list)
        for module in self.modules.values():
            if module.room and not module.is_door:
                self.rooms[module.room].append(module)
        self.words = set(words)
        self.imports = [one for module in self.everything.values() for one in self._imports(module)]

    def _imports(self, module: Module) -> Iterator[Import]:
        package = module.name.split(".")
        for node, late, typed in import_statements(module.tree):
            origin = getattr(node, "module", None) or ""
            if getattr(node, "level", 0):
                above = package[: len(package) - node.level + module.is_door]
                origin = ".".join([*above, *filter(None, [origin])])
            for alias in node.names:
                target, name = f"{origin}.{alias.name}".lstrip("."), None
                if isinstance(node, ast.ImportFrom) and target not in self.everything:
                    target, name = origin, alias.name
                target = target if target in self.everything else target.partition(".")[0]
                yield Import(module, target, name, late, typed)

    def room(self, module: str) -> str | None:
        """Room of a module; None outside the package and for the package itself."""
        return self.modules[module].room or None if module in self.modules else None

    def needs_torch(self, target: str) -> bool:
        room = self.room(target)
        return room is not None and room.partition(".")[0] not in BELOW_THE_WALL

    def each(self, *kinds: type[ast.AST]) -> Iterator[tuple[Module, ast.AST]]:
        """Nodes of some kinds in all rooms, with their modules."""
        return ((m, node) for m in self.modules.values() if m.room for node in m.all(*kinds))


def _module(source: Path, path: Path, tree: ast.Module) -> Module:
    words = path.relative_to(source).with_suffix("").parts
    room = ".".join(words[1:-1]) if words[0] == "deepfsi" else ""
    return Module(".".join(words).removesuffix(".__init__"), room, path, tree)


RULES: dict[str, Callable[[House], list[str] | Iterator[str]]] = {}
"""What breaks each rule, in words."""


def rule(check):
    RULES[check.__name__] = check
    return check


@rule
def few_modules(house):
    """A room has at most 12 modules, its ``__init__`` not counted."""
    sizes = {room: len(modules) for room, modules in house.rooms.items()}
    return [f"{room} has {size} modules" for room, size in sizes.items() if size > 12]


@rule
def bare_rooms(house):
    """The ``__init__`` of a room is its docstring, and of `DOORS` imports and ``__all__``, too."""
    for room in house.rooms:
        tree = house.modules[f"deepfsi.{room}"].tree
        if not ast.get_docstring(tree) or (len(tree.body) > 1 and room not in DOORS):
            yield f"the __init__ of {room} is no docstring alone"


@rule
def one_meaning(house):
    """A public name is defined by one module."""
    homes = defaultdict(list)
    for module in house.modules.values():
        for name in _names(module.tree) if module.room else ():
            homes[name].append(module.name)
    return [f"{name}: {' and '.join(held)}" for name, held in homes.items() if len(held) > 1]


def _names(tree: ast.Module | ast.ClassDef) -> set[str]:
    """Functions, classes and constants of a module, or methods and fields of a class."""
    named = {node.name for node in tree.body if isinstance(node, Function | ast.ClassDef)}
    for node in tree.body:
        if isinstance(node, ast.Assign | ast.AnnAssign):
            targets = node.targets if isinstance(node, ast.Assign) else [node.target]
            named |= {target.id for target in targets if isinstance(target, ast.Name)}
    return {name for name in named if not name.startswith("_")}


@rule
def no_circles(house):
    """No imports go in a circle, those of functions among them, but not those for types."""
    edges = defaultdict(set)
    for each in house.imports:
        if not each.typed and each.target in house.modules and each.target != each.source.name:
            edges[each.source.name].add(each.target)
    try:
        TopologicalSorter(edges).prepare()
    except CycleError as error:
        return error.args[1]
    return []


@rule
def early_imports(house):
    """Functions import what is heavy or needs torch, and commands the rooms of their work."""
    return [
        f"{each.source.name} imports {each.target} in a function"
        for each in house.imports
        if each.late and not each.typed and (room := house.room(each.source.name))
        if each.target.partition(".")[0] not in HEAVY.split() and not house.needs_torch(each.target)
        if room != "cli" or not (house.room(each.target) or "").startswith(ROOMS_OF_WORK)
    ]


@rule
def the_wall(house):
    """Nothing below the wall imports torch, or a room that needs it."""
    return [
        f"{each.source.name} imports {each.target}"
        for each in house.imports
        if house.room(each.source.name) and not house.needs_torch(each.source.name)
        if each.target == "torch" or house.needs_torch(each.target)
    ]


@rule
def no_participles(house):
    """No public name or field is a bare participle, but for those that files have."""
    holders = house.each(ast.Module, ast.ClassDef)
    public = [(m, n) for m, n in holders if not getattr(n, "name", "").startswith("_")]
    dotted = {
        ".".join(filter(None, [module.name, getattr(node, "name", None), name]))
        for module, node in public
        for name in _names(node) & set(PARTICIPLES.split())
    }
    return sorted(dotted ^ house.words)


@rule
def named_values(house):
    """At most four values are passed by position to what is the package's own."""
    methods = {
        item.name
        for _, node in house.each(ast.ClassDef)
        for item in node.body
        if isinstance(item, Function)
    }
    ours = defaultdict(set)
    for each in house.imports:
        ours[each.source.name].add(each.name)
    for module, node in house.each(*Function.__args__, ast.ClassDef):
        ours[module.name].add(node.name)
    for module, call in house.each(ast.Call):
        if len(call.args) > 4:
            name = ast.unparse(call.func).rpartition(".")
            if name[2] in (methods if name[1] else ours[module.name]):
                yield f"{module.name}:{call.lineno} {name[2]} of {len(call.args)} values"


@rule
def no_packing(house):
    """No tuple is packed to be unpacked at once, unless values change their places."""
    for module, node in house.each(ast.Assign):
        pair = (node.targets[0], node.value)
        if all(isinstance(each, ast.Tuple) for each in pair):
            names, values = (sorted(map(ast.unparse, each.elts)) for each in pair)
            if names != values:
                yield f"{module.name}: {ast.unparse(node)}"
