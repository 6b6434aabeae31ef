"""Rooms of the package, counted in its source while the site is built.

The directive `rooms` makes a table of all rooms: their modules, lines, and the rooms that they
import from. Nothing in it is written by hand.
"""

import sys
from collections import Counter
from pathlib import Path

from markdown import Made, table

import deepfsi

ROOT = Path(deepfsi.__file__).parents[2]
sys.path.append(str(ROOT / "tests"))

from shared.house import House  # noqa: E402


def lines(modules):
    """Number of lines of modules."""
    return sum(len(module.path.read_text().splitlines()) for module in modules)


def counted(house):
    """Text and table of a house."""
    rows, every = [], house.modules.values()
    for room in sorted(house.rooms):
        inside = [module for module in every if module.room == room]
        used = [house.room(each.target) for each in house.imports if each.source in inside]
        counts = Counter(other for other in used if other not in (None, room)).most_common()
        others = ", ".join(f"{name} {count}" for name, count in counts)
        numbers = [str(number) for number in (len(inside) - 1, lines(inside))]
        rows.append([f"`{room}`", *numbers, others or "none"])
    modules = sum(not module.is_door for module in every)
    text = f"The package has {len(rows)} rooms, {modules} modules and {lines(every)} lines."
    heads = ["room", "modules", "lines", "imports from, how many names"]
    return f"{text}\n\n{table(heads, rows)}"


class Rooms(Made):
    """The directive; it has no arguments."""

    def text(self):
        """Text and table; the page is made again when a module changes."""
        house = House(ROOT / "src")
        for module in house.modules.values():
            self.env.note_dependency(str(module.path))
        return counted(house)


def setup(app):
    """Add the directive."""
    app.add_directive("rooms", Rooms)
    return {"parallel_read_safe": True, "parallel_write_safe": True}
