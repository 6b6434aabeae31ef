"""Recipes: by the name of one that comes with the package, or a TOML file of one's own."""

from collections.abc import Mapping
from importlib.resources import files
from pathlib import Path
from typing import TYPE_CHECKING, Any

from deepfsi.cli import common, paper
from deepfsi.errors import InputError, closest

if TYPE_CHECKING:
    from importlib.resources.abc import Traversable

    import numpy as np

    from deepfsi.datasets import Dataset
    from deepfsi.sweeps.recipe import Recipe


def shipped() -> "dict[str, Traversable]":
    """Recipes that come with the package and with the paper's experiments, by name."""
    own = (files("deepfsi") / "sweeps" / "recipes").iterdir()
    return {Path(each.name).stem: each for each in (*own, *paper.recipes())}


def read_recipe(source: str) -> dict[str, Any]:
    """Settings of a recipe with that name, or of a file; ``./mnist`` is a file of that name."""
    named, path = shipped(), Path(source)
    if source not in named and not path.exists():
        known = closest(source, sorted(named))
        raise InputError(f"no recipe at {source}: {known}; or give a TOML file")
    file = common.read_toml(source, named.get(source, path))
    if not file:
        raise InputError(f"{source} is empty: give a recipe at least one setting, such as designs")
    return file


def check_recipe(
    settings: Mapping[str, Any], matrix: "np.ndarray | None" = None
) -> "tuple[Recipe, Dataset]":
    """Recipe of settings and its data, or `InputError` that names every mistake."""
    from deepfsi.sweeps import recipe_check

    def load(recipe: "Recipe") -> "Dataset":
        return common.load(recipe.data, recipe.size, split=recipe.split, images=recipe.images)

    return recipe_check.check_recipe(settings, load, matrix)
