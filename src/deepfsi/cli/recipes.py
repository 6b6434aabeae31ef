"""Recipes: by the name of one that comes with the package, or a TOML file of one's own."""

from importlib.resources import files
from pathlib import Path
from typing import Any

from deepfsi.cli import common
from deepfsi.errors import InputError, closest

SHIPPED = files("deepfsi") / "experiments" / "recipes"
"""Folder of the recipes that come with the package."""


def read_recipe(source: str) -> dict[str, Any]:
    """Settings of a recipe with that name, or of a file; ``./mnist`` is a file of that name."""
    names = sorted(Path(each.name).stem for each in SHIPPED.iterdir())
    shipped, path = SHIPPED / f"{source}.toml", Path(source)
    if source not in names and not path.exists():
        raise InputError(f"no recipe at {source}: {closest(source, names)}; or give a TOML file")
    file = common.read_toml(source, shipped if source in names else path)
    if not file:
        raise InputError(f"{source} is empty: give a recipe at least one setting, such as designs")
    if "patch" in file:
        raise InputError(f"{source} is a recipe of patches: run it by `deepfsi reproduce ovit`")
    return file
