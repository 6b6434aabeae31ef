"""A recipe checked with its data: every mistake in it is named at once, before any work."""

from collections import defaultdict
from collections.abc import Callable, Mapping
from typing import Any

import numpy as np
from pydantic import ValidationError

from deepfsi.base import InputError, field_errors, join_messages
from deepfsi.datasets import Dataset
from deepfsi.sweeps.recipe import RATIOS_OR_MASKS, Recipe, Settings, axis
from deepfsi.sweeps.trial import count_trials, mask_faults, trial_faults

SOURCE = {"data", "size", "skip_bad", "images", "split"}
"""Fields that say which data to load."""

TABLES = ("camera", "exposure", "training")
"""Fields that are tables of axes."""

ADAPTIVE_SCENES = 5000
"""Scenes with which adaptive masks are compared unasked, at most: each look takes a millisecond."""

OPTICS = {"designs", "camera"}
"""Fields whose defaults would make mistakes of their own in place of those that are lost."""


def check_recipe(
    settings: Mapping[str, Any],
    load: Callable[[Recipe], Dataset],
    matrix: np.ndarray | None = None,
) -> tuple[Recipe, Dataset]:
    """Recipe of settings, and its data."""
    # matrix (m, N)
    recipe, found, lost = _read(settings)
    if matrix is not None and "custom" not in recipe.designs:
        recipe = recipe.model_copy(update={"designs": (*recipe.designs, "custom")})
    data = None if lost & SOURCE else _loaded(recipe, load, found)
    if data is not None:
        found += _fold_faults(recipe, data)
        found += [] if lost & OPTICS else trial_faults(recipe, data, matrix)
    if found or data is None:
        raise InputError(join_messages(found))
    return recipe, data


def with_adaptive(recipe: Recipe, data: Dataset, matrix: np.ndarray | None = None) -> Recipe:
    """The recipe with adaptive masks too, where they can be had and do not take long.

    Parameters
    ----------
    recipe : Recipe
        As `check_recipe` gives it.
    data : Dataset
    matrix : array, shape (m, N), optional
    """
    more = recipe.model_copy(update={"designs": (*recipe.designs, "adaptive")})
    scenes = len(data.x_train) + len(data.x_test)
    if data.measure != "accuracy" or scenes > ADAPTIVE_SCENES or recipe.test_noise:
        return recipe
    had = count_trials(more, data, matrix) > count_trials(recipe, data, matrix)
    return more if had and not trial_faults(more, data, matrix) else recipe


def _fold_faults(recipe: Recipe, data: Dataset) -> list[str]:
    """Folds that the data cannot have, or what the first that has any lacks."""
    try:
        each = [mask_faults(recipe, part) for part in recipe.parts(data)]
    except InputError as error:
        return [error.message, *mask_faults(recipe, data)]
    return next((faults for faults in each if faults), [])


def _loaded(recipe: Recipe, load: Callable[[Recipe], Dataset], found: list[str]) -> Dataset | None:
    """Data of a recipe, if need be without size and split; what is wrong is added to `found`."""
    try:
        return load(recipe)
    except InputError as error:
        found.append(error.message)
    if recipe.size is None and recipe.split is None:
        return None
    try:
        return load(recipe.model_copy(update={"size": None, "split": None}))
    except InputError:
        return None


def _read(settings: Mapping[str, Any]) -> tuple[Recipe, list[str], set[str]]:
    """Recipe of what is sound of settings, what is wrong, and the fields that are lost."""
    try:
        return Recipe.model_validate(settings), [], set()
    except ValidationError as error:
        found = field_errors(error)
        sound = _sound(settings, error)
    if settings.get("ratios") and settings.get("masks"):
        found = list(dict.fromkeys([*found, RATIOS_OR_MASKS]))
        sound.pop("ratios", None)
    try:
        return Recipe.model_validate(sound), found, set(settings) - set(sound)
    except ValidationError as error:  # what a part of a field cannot be without the other
        left = {name: sound[name] for name in set(sound) - {e["loc"][0] for e in error.errors()}}
        return Recipe.model_validate(left), found, set(settings) - set(left)


def _sound(settings: Mapping[str, Any], error: ValidationError) -> Settings:
    """Settings without the wrong ones: of lists their wrong items, else the whole field."""
    wrong = defaultdict(list)
    for fault in error.errors():
        if fault["loc"]:
            wrong[fault["loc"][0]].append(fault["loc"][1:])
    sound = dict(settings)
    for name, places in wrong.items():
        value = sound.pop(str(name))
        if name in TABLES and isinstance(value, dict):
            sound[name] = _sound_axes(name, value)
        elif all(place and isinstance(place[0], int) for place in places):
            bad = {place[0] for place in places}
            left = [each for number, each in enumerate(axis(value)) if number not in bad]
            sound |= {str(name): left} if left else {}
    return sound


def _sound_axes(table: str, axes: Settings) -> Settings:
    """Axes of a table without the values that are wrong by themselves."""
    sound = {}
    for name, value in axes.items():
        if _reads(table, name, value):
            sound[name] = value
        elif left := [each for each in axis(value) if _reads(table, name, each)]:
            sound[name] = left
    return sound


def _reads(table: str, name: str, value: Any) -> bool:
    try:
        return bool(Recipe.model_validate({table: {name: value}}))
    except ValidationError:
        return False
