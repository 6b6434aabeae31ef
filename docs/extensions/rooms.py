"""Rooms of the package, counted in its source while the site is built.

The directive `rooms` makes a table of all rooms: their modules, lines, and names that their doors
export, and the rooms that they import from. Nothing in it is written by hand.
"""

import sys
from pathlib import Path

from markdown import Made, table

import deepfsi

ROOT = Path(deepfsi.__file__).parents[2]
sys.path.append(str(ROOT / "tests"))

from shared.house import House, all_names  # noqa: E402


def counted(house):
    """Text and table of a house."""
    rows = []
    for room, modules in sorted(house.rooms.items()):
        door = house.modules[f"{house.package}.{room}"]
        if not modules and not all_names(door.tree):
            continue  # a folder of rooms
        lines = door.lines + sum(module.lines for module in modules)
        exports = len(all_names(door.tree) or ())
        counts = sorted(house.neighbours[room].items(), key=lambda item: -item[1])
        others = ", ".join(f"{name} {count}" for name, count in counts)
        numbers = [str(number) for number in (len(modules), lines, exports)]
        rows.append([f"`{room}`", *numbers, others or "none"])
    modules = sum(not module.is_door for module in house.modules.values())
    lines = sum(module.lines for module in house.modules.values())
    text = f"The package has {len(rows)} rooms, {modules} modules and {lines} lines."
    heads = ["room", "modules", "lines", "exports", "imports from, how many names"]
    return f"{text}\n\n{table(heads, rows, 'stacked')}"


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
