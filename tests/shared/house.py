"""The house as its text has it: rooms, doors, imports and names, and the rules that they keep.

A room is a folder with an ``__init__``, its door. Nothing is imported here: everything is read from
the source, so the rules can be tried on a small package that was made up for them.
"""

import ast
import re
from collections import defaultdict
from collections.abc import Iterator
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path

BELOW_THE_WALL = ("base", "datasets", "camera", "jobs", "designfile", "measures", "hardware")
"""Rooms that need no torch, with the rooms in them."""

MODULES = 12
"""Modules that a room has at most, its door not counted."""

EXPORTS_OF_HARDWARE = 16
"""Names that a room of the hardware exports at most."""

POSITIONS = 4
"""Values that a call passes by position at most."""

HEAVY = frozenset(
    {
        "PIL",
        "h5py",
        "hashlib",
        "importlib",
        "inspect",
        "matplotlib",
        "numpy",
        "onnx",
        "onnxruntime",
        "platform",
        "polars",
        "pooch",
        "psutil",
        "pydantic",
        "pywt",
    }
    | {
        "ray",
        "rich",
        "scipy",
        "shutil",
        "skimage",
        "sklearn",
        "spectral",
        "tensorly",
        "threadpoolctl",
        "tomllib",
        "torch",
    }
)
"""Libraries that a function may import, since they are slow to load or optional. Python's own among
them add a fifth to the time of ``from deepfsi import InputError``."""

PARTICIPLES = frozenset(
    {"found", "known", "told", "held", "seen", "own", "given", "shown"}
    | {"place", "each", "part", "whole"}
)
"""Words that say what happened to a thing, or which one it is, and not what it is."""

Function = ast.FunctionDef | ast.AsyncFunctionDef


@dataclass(frozen=True)
class Module:
    """One file.

    Parameters
    ----------
    name
        Dotted, with the package.
    room
        Folder that it is in, dotted, without the package: ``hardware.counting``. Empty for files
        of the package itself.
    path
        File.
    tree
        Syntax tree of it.
    lines
        Number of its lines.
    """

    name: str
    room: str
    path: Path
    tree: ast.Module
    lines: int

    @property
    def is_door(self) -> bool:
        """True for an ``__init__``."""
        return self.path.name == "__init__.py"


@dataclass(frozen=True)
class Import:
    """One name that a module imports.

    Parameters
    ----------
    source, target
        Modules, dotted; of a target outside the packages only the first word.
    name
        Name that is taken from the target; None if the target itself is imported.
    inside
        True if the import stands in a function.
    typed
        True if it is for type checkers only.
    """

    source: str
    target: str
    name: str | None
    inside: bool
    typed: bool


class House:
    """A package with those that use it.

    Parameters
    ----------
    source
        Folder that holds the package, and other packages that use it.
    package
        Name of the package.
    users
        Files or folders outside `source` that use the package: pages and scripts.
    """

    def __init__(
        self, source: Path, package: str = "deepfsi", users: tuple[Path, ...] = ()
    ) -> None:
        self.package = package
        self.users = users
        found = [_module(path, source) for path in sorted(source.rglob("*.py"))]
        self.everything = {module.name: module for module in found}
        self.modules = {
            name: module
            for name, module in self.everything.items()
            if name.partition(".")[0] == package
        }

    @cached_property
    def rooms(self) -> dict[str, list[Module]]:
        """Modules of each room, without its door."""
        doors = [m.room for m in self.modules.values() if m.is_door and m.name != self.package]
        return {
            room: [m for m in self.modules.values() if m.room == room and not m.is_door]
            for room in doors
        }

    @cached_property
    def imports(self) -> list[Import]:
        """Every import of every module, in its order."""
        return [
            each for module in self.everything.values() for each in imports(module, self.everything)
        ]

    @cached_property
    def exports(self) -> dict[str, dict[str, str]]:
        """Names that the door of each room exports, each with the module that it comes from."""
        return {
            room: {
                name: each.target
                for each in self.imports
                if each.source == f"{self.package}.{room}"
                and each.target in self.modules
                and (name := each.name)
            }
            for room in self.rooms
        }

    def room(self, module: str) -> str | None:
        """Room of a module; None outside the package and for the package itself."""
        found = self.modules.get(module)
        return found.room or None if found else None

    def home(self, target: str, name: str | None) -> str:
        """Module that a name comes from, which may be taken through one or two doors."""
        room = self.room(target)
        if name and room and self.modules[target].is_door:
            behind = self.exports[room].get(name)
            if behind and behind != target:
                return self.home(behind, name)
        return target

    @cached_property
    def importers(self) -> dict[str, set[str]]:
        """Modules that use each module, also through a door; doors are not counted."""
        out: dict[str, set[str]] = defaultdict(set)
        for each in self.imports:
            home = self.home(each.target, each.name)
            source = self.everything[each.source]
            is_door = source.is_door and source.name in self.modules and source.room
            if home in self.modules and home != each.source and not is_door:
                out[home].add(each.source)
        return out

    @cached_property
    def edges(self) -> dict[str, set[str]]:
        """Modules that each module imports, in functions too, but not for types only."""
        out: dict[str, set[str]] = defaultdict(set)
        for each in self.imports:
            if not each.typed and each.target in self.modules and each.target != each.source:
                out[each.source].add(each.target)
        return out

    @cached_property
    def neighbours(self) -> dict[str, dict[str, int]]:
        """How many imports each room makes of each other room, those for types too."""
        out: dict[str, dict[str, int]] = {room: defaultdict(int) for room in self.rooms}
        for each in self.imports:
            ours, theirs = self.room(each.source), self.room(each.target)
            if ours and theirs and ours != theirs:
                out[ours][theirs] += 1
        return out

    @cached_property
    def public(self) -> dict[str, list[str]]:
        """Modules that define each public name: functions, classes and constants."""
        out = defaultdict(list)
        for module in self.modules.values():
            for name in public_names(module.tree):
                out[name].append(module.name)
        return out

    @cached_property
    def users_text(self) -> str:
        """Text of the pages and scripts that use the package."""
        files = [
            file
            for user in self.users
            for file in ([user] if user.is_file() else sorted(user.rglob("*")))
            if file.suffix in {".py", ".md"} and "_build" not in file.parts
        ]
        return "\n".join(file.read_text() for file in files)

    # --- the rules; each gives what breaks it, in words

    def too_many_modules(self, rooms: set[str]) -> list[str]:
        """Rooms of more than `MODULES` modules."""
        sizes = {room: len(self.rooms[room]) for room in sorted(rooms)}
        return [f"{room} has {size} modules" for room, size in sizes.items() if size > MODULES]

    def lonely_modules(self, rooms: set[str], reasons: dict[str, str]) -> list[str]:
        """Modules with one importer and no reason, and reasons of modules that have several."""
        counts = {
            m.name: len(self.importers[m.name]) for room in sorted(rooms) for m in self.rooms[room]
        }
        lonely = {name for name, count in counts.items() if count < 2}
        return [
            *(f"{name} has one importer or none" for name in sorted(lonely - set(reasons))),
            *(f"{name} needs no reason any more" for name in sorted(set(reasons) - lonely)),
        ]

    def past_doors(self, rooms: set[str]) -> list[str]:
        """Imports from outside a room, by code or by pages, that are not from its door."""
        lines = set(re.findall(r"(?:from|import) ([\w.]+)", self.users_text))
        return [
            *(
                f"{each.source} imports {each.name or each.target} past the door of {theirs}"
                for each in self.imports
                if (theirs := self.room(each.target)) in rooms
                and self.room(each.source) != theirs
                and not self.modules[each.target].is_door
            ),
            *(
                f"a page or script imports {module.name}"
                for module in self._of(rooms)
                if module.name in lines and not module.is_door
            ),
        ]

    def doors_with_code(self, rooms: set[str]) -> list[str]:
        """Doors that hold more than a docstring, imports and a sorted list of what they import."""
        out = []
        for room in sorted(rooms):
            door = self.modules[f"{self.package}.{room}"]
            body = [node for node in door.tree.body if not isinstance(node, ast.ImportFrom)]
            listed = all_names(door.tree)
            if not ast.get_docstring(door.tree) or len(body) != 2 or listed is None:
                out.append(f"the door of {room} is not a docstring, imports and __all__")
            elif set(listed) != set(self.exports[room]):
                odd = sorted(set(listed) ^ set(self.exports[room]))
                out.append(f"the door of {room} imports or lists alone: {', '.join(odd)}")
            elif listed != sorted(listed, key=_order):
                out.append(f"__all__ of {room} is not sorted")
        return out

    def unused_exports(self, rooms: set[str]) -> list[str]:
        """Names that a door exports and nobody outside takes."""
        taken = defaultdict(set)
        for each in self.imports:
            room = self.room(each.target)
            if room in rooms and self.room(each.source) != room:
                taken[room].add(each.name)
        for room in rooms:
            dotted = re.escape(f"{self.package}.{room}")
            found = rf"from {dotted} import (\([^)]*\)|[^\n]*)|{dotted}\.(\w+)"
            for lists, name in re.findall(found, self.users_text):
                taken[room] |= {name, *re.findall(r"\w+", lists)}
        top = self.modules[self.package].tree
        for node in ast.walk(top):  # names of the package itself, loaded when they are first used
            if isinstance(node, ast.Dict):
                for key, value in zip(node.keys, node.values, strict=True):
                    if isinstance(key, ast.Constant) and isinstance(value, ast.Constant):
                        taken[str(value.value)].add(key.value)
        return [
            f"{name} of {room} is used by nobody outside"
            for room in sorted(rooms)
            for name in self.exports[room]
            if name not in taken[room]
        ]

    def wide_doors(self, rooms: set[str]) -> list[str]:
        """Rooms of the hardware that export more than `EXPORTS_OF_HARDWARE` names."""
        return [
            f"{room} exports {len(self.exports[room])} names"
            for room in sorted(rooms)
            if room.startswith("hardware.") and len(self.exports[room]) > EXPORTS_OF_HARDWARE
        ]

    def names_with_two_meanings(self, rooms: set[str]) -> list[str]:
        """Public names that two modules define."""
        counted = {
            name: [module for module in modules if self.room(module) in rooms]
            for name, modules in self.public.items()
        }
        return [
            f"{name}: {' and '.join(modules)}"
            for name, modules in sorted(counted.items())
            if len(modules) > 1
        ]

    def circles(self, rooms: set[str]) -> list[str]:
        """Circles of imports that a module of the rooms is in."""
        return [
            " ".join(circle)
            for circle in circles(self.edges)
            if any(self.room(module) in rooms for module in circle)
        ]

    def late_imports(self, rooms: set[str]) -> list[str]:
        """Imports in functions of what is neither heavy nor a room that needs torch."""
        return [
            f"{each.source} imports {each.target} in a function"
            for each in self.imports
            if each.inside
            and not each.typed
            and self.room(each.source) in rooms
            and each.target.partition(".")[0] not in HEAVY
            and not self._above_the_wall(each.target)
        ]

    def through_the_wall(self, rooms: set[str]) -> list[str]:
        """Imports of torch, or of a room that needs it, by a room that needs none."""
        return [
            f"{each.source} imports {each.target}"
            for each in self.imports
            if (room := self.room(each.source)) in rooms
            and _below_the_wall(room)
            and (each.target.partition(".")[0] == "torch" or self._above_the_wall(each.target))
        ]

    def _above_the_wall(self, target: str) -> bool:
        room = self.room(target)
        return room is not None and not _below_the_wall(room)

    def participles(self, rooms: set[str], files: set[str]) -> list[str]:
        """Public names and fields that are a bare participle; `files` are those that files have."""
        return [
            name
            for module in self._of(rooms)
            for name in _fields_and_names(module)
            if name.rpartition(".")[2] in PARTICIPLES and name not in files
        ]

    def undescribed(self, rooms: set[str]) -> list[str]:
        """Exported functions and classes with two parameters or more that are not described."""
        out = []
        for room in sorted(rooms):
            for name, home in self.exports[room].items():
                module = self.modules.get(self.home(home, name))
                nodes = module.tree.body if module else []
                out += [
                    f"{room}.{name} has no section of parameters"
                    for node in nodes
                    if isinstance(node, Function | ast.ClassDef)
                    and node.name == name
                    and not _described(node)
                ]
        return out

    def positional_calls(self, rooms: set[str]) -> list[str]:
        """Calls of the package's own functions with more than `POSITIONS` values by position."""
        out = []
        for module in self._of(rooms):
            imported = {
                each.name for each in self.imports if each.source == module.name and each.name
            }
            ours = imported | {n.name for n in ast.walk(module.tree) if hasattr(n, "name")}
            for node in ast.walk(module.tree):
                if isinstance(node, ast.Call) and len(node.args) > POSITIONS:
                    called = node.func
                    name = called.attr if isinstance(called, ast.Attribute) else None
                    name = called.id if isinstance(called, ast.Name) else name
                    own_method = isinstance(called, ast.Attribute) and name in self._methods
                    if (isinstance(called, ast.Name) and name in ours) or own_method:
                        out.append(f"{module.name}:{node.lineno} {name} of {len(node.args)} values")
        return out

    @cached_property
    def _methods(self) -> set[str]:
        """Names of the methods of the package."""
        return {
            item.name
            for module in self.modules.values()
            for node in ast.walk(module.tree)
            if isinstance(node, ast.ClassDef)
            for item in node.body
            if isinstance(item, Function)
        }

    def packed_tuples(self, rooms: set[str], reasons: dict[str, str]) -> list[str]:
        """Values packed into a tuple and unpacked at once, except swaps and those with a reason."""
        found = {
            f"{module.name}: {ast.unparse(node)}"
            for module in self._of(rooms)
            for node in ast.walk(module.tree)
            if isinstance(node, ast.Assign)
            and isinstance(node.targets[0], ast.Tuple)
            and isinstance(node.value, ast.Tuple)
            and not _swaps(node.targets[0], node.value)
        }
        return [
            *sorted(found - set(reasons)),
            *(f"{each} needs no reason any more" for each in sorted(set(reasons) - found)),
        ]

    def _of(self, rooms: set[str]) -> Iterator[Module]:
        return (module for module in self.modules.values() if module.room in rooms)


def _module(path: Path, source: Path) -> Module:
    words = path.relative_to(source).with_suffix("").parts
    words = words[:-1] if words[-1] == "__init__" else words
    text = path.read_text()
    room = ".".join(path.relative_to(source).parts[1:-1])
    return Module(".".join(words), room, path, ast.parse(text), len(text.splitlines()))


def _below_the_wall(room: str) -> bool:
    return room.partition(".")[0] in BELOW_THE_WALL


def imports(module: Module, modules: dict[str, Module]) -> Iterator[Import]:
    """Imports of one module, absolute and relative."""

    def walk(node: ast.AST, inside: bool, typed: bool) -> Iterator[Import]:
        for child in ast.iter_child_nodes(node):
            if isinstance(child, ast.Import):
                for alias in child.names:
                    yield Import(module.name, _target(alias.name), None, inside, typed)
            elif isinstance(child, ast.ImportFrom):
                origin = _origin(module, child)
                for alias in child.names:
                    deeper = f"{origin}.{alias.name}"
                    if deeper in modules:
                        yield Import(module.name, deeper, None, inside, typed)
                    else:
                        yield Import(module.name, _target(origin), alias.name, inside, typed)
            else:
                within = inside or isinstance(child, Function | ast.Lambda)
                checked = isinstance(child, ast.If) and "TYPE_CHECKING" in ast.dump(child.test)
                yield from walk(child, within, typed or checked)

    def _target(name: str) -> str:
        return name if name in modules else name.partition(".")[0]

    return walk(module.tree, False, False)


def _origin(module: Module, node: ast.ImportFrom) -> str:
    if not node.level:
        return node.module or ""
    words = module.name.split(".")
    words = words[: len(words) - node.level + module.is_door]
    return ".".join([*words, *([node.module] if node.module else [])])


def all_names(tree: ast.Module) -> list[str] | None:
    """Names of ``__all__``; None if there is none."""
    for node in tree.body:
        if isinstance(node, ast.Assign) and ast.unparse(node.targets[0]) == "__all__":
            return list(ast.literal_eval(node.value))
    return None


def _order(name: str) -> tuple[int, list[str | int]]:
    """Constants, then classes, then functions, numbers in them by their size: as ruff sorts."""
    kind = 0 if name.isupper() and len(name) > 1 else 1 if name[0].isupper() else 2
    return kind, [int(w) if w.isdigit() else w for w in re.findall(r"\d+|\D+", name)]


def public_names(tree: ast.Module) -> set[str]:
    """Functions, classes and constants that a module defines without an underscore."""
    out = set()
    for node in tree.body:
        if isinstance(node, Function | ast.ClassDef):
            out.add(node.name)
        elif isinstance(node, ast.Assign | ast.AnnAssign):
            targets = node.targets if isinstance(node, ast.Assign) else [node.target]
            out |= {t.id for t in targets if isinstance(t, ast.Name)}
    return {name for name in out if not name.startswith("_")}


def circles(edges: dict[str, set[str]]) -> list[list[str]]:
    """Groups of modules that import each other in a circle, each sorted (Tarjan)."""
    index: dict[str, int] = {}
    low: dict[str, int] = {}
    stack: list[str] = []
    out: list[list[str]] = []

    def visit(node: str) -> None:
        index[node] = low[node] = len(index)
        stack.append(node)
        for after in sorted(edges.get(node, ())):
            if after not in index:
                visit(after)
            if after in stack:
                low[node] = min(low[node], low[after])
        if low[node] == index[node]:
            group = stack[stack.index(node) :]
            del stack[stack.index(node) :]
            if len(group) > 1:
                out.append(sorted(group))

    for node in sorted(edges):
        if node not in index:
            visit(node)
    return out


def _fields_and_names(module: Module) -> Iterator[str]:
    """Public names of a module, and fields and methods of its public classes, dotted."""
    for name in sorted(public_names(module.tree)):
        yield f"{module.name}.{name}"
    for node in module.tree.body:
        if isinstance(node, ast.ClassDef) and not node.name.startswith("_"):
            for item in node.body:
                if isinstance(item, Function):
                    yield f"{module.name}.{node.name}.{item.name}"
                elif isinstance(item, ast.AnnAssign) and isinstance(item.target, ast.Name):
                    yield f"{module.name}.{node.name}.{item.target.id}"


def _described(node: Function | ast.ClassDef) -> bool:
    """True if a function or class says what its parameters are, where they are two or more."""
    docs = ast.get_docstring(node) or ""
    makers: list[Function] = [node] if isinstance(node, Function) else []
    if isinstance(node, ast.ClassDef):
        makers = [n for n in node.body if isinstance(n, Function) and n.name == "__init__"]
        docs += "\n" + "\n".join(ast.get_docstring(maker) or "" for maker in makers)
        fields = [n for n in node.body if isinstance(n, ast.AnnAssign)]
        if not makers and _is_record(node) and len(fields) > 1:
            return bool(_SECTION.search(docs)) or all(_field_described(node, f) for f in fields)
    count = sum(len(_parameters(maker)) for maker in makers)
    return count < 2 or bool(_SECTION.search(docs))


_SECTION = re.compile(
    r"^\s*(Parameters|Attributes)\n\s*---|[Pp]arameters? (as|of)\b|[Ss]hapes as\b", re.M
)


def _is_record(node: ast.ClassDef) -> bool:
    """True for a dataclass or a named tuple; models describe each field in its declaration."""
    marks = [ast.unparse(each) for each in (*node.decorator_list, *node.bases)]
    return any("dataclass" in mark or "NamedTuple" in mark for mark in marks)


def _field_described(node: ast.ClassDef, field: ast.AnnAssign) -> bool:
    """True if a docstring stands below a field."""
    after = node.body[node.body.index(field) + 1 :][:1]
    return any(isinstance(n, ast.Expr) and isinstance(n.value, ast.Constant) for n in after)


def _parameters(function: Function) -> list[str]:
    args = function.args
    names = [arg.arg for arg in (*args.posonlyargs, *args.args, *args.kwonlyargs)]
    return [name for name in names if name not in ("self", "cls")]


def _swaps(targets: ast.Tuple, values: ast.Tuple) -> bool:
    """True if the same values only change their places."""
    return sorted(map(ast.unparse, targets.elts)) == sorted(map(ast.unparse, values.elts))
