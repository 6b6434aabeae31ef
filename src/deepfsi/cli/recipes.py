"""Recipes: by the name of one that comes with the package, or a TOML file of one's own."""

from collections.abc import Mapping
from contextlib import nullcontext
from importlib.resources import as_file, files
from pathlib import Path
from typing import TYPE_CHECKING, Any

from deepfsi.base import InputError, closest_choice, read_toml
from deepfsi.cli import common, paper

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
        known = closest_choice(source, sorted(named))
        raise InputError(f"no recipe at {source}: {known}; or give a TOML file")
    with as_file(named[source]) if source in named else nullcontext(path) as there:
        file = read_toml(there)
    if not file:
        raise InputError(f"{source} is empty: give a recipe at least one setting, such as designs")
    return file


def check_recipe(
    settings: Mapping[str, Any], matrix: "np.ndarray | None" = None
) -> "tuple[Recipe, Dataset]":
    """Recipe of settings and its data, or `InputError` that names every mistake."""
    from deepfsi.sweeps import recipe_check

    def load(recipe: "Recipe") -> "Dataset":
        told = {name: getattr(recipe, name) for name in ("split", "images", "skip_bad", "normal")}
        return common.load(recipe.data, recipe.size, **told)

    return recipe_check.check_recipe(settings, load, matrix)
