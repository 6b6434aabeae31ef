"""Recipes: by the name of one that comes with the package, or a TOML file of one's own."""

from collections.abc import Mapping
from importlib.resources import files
from pathlib import Path
from typing import TYPE_CHECKING, Any

from deepfsi.cli import common
from deepfsi.errors import InputError, closest

if TYPE_CHECKING:
    import numpy as np

    from deepfsi.datasets import Dataset
    from deepfsi.sweeps.recipe import Recipe

SHIPPED = files("deepfsi_paper") / "recipes"
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


def check_recipe(
    settings: Mapping[str, Any], matrix: "np.ndarray | None" = None
) -> "tuple[Recipe, Dataset]":
    """Recipe of settings and its data, or `InputError` that names every mistake."""
    from deepfsi.sweeps import recipe_check

    def load(recipe: "Recipe") -> "Dataset":
        return common.load(recipe.data, recipe.size, split=recipe.split)

    return recipe_check.check_recipe(settings, load, matrix)
