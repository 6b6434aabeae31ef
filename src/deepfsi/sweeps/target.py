"""Photons and masks that a target accuracy needs, read off the curves of a comparison."""

import math
from collections import defaultdict
from collections.abc import Mapping, Sequence
from dataclasses import asdict
from typing import Any

from deepfsi.base.errors import InputError
from deepfsi.base.numeric.intervals import find_crossing
from deepfsi.base.quantities import Table, budget_text
from deepfsi.datasets.dataset import Dataset
from deepfsi.sweeps.recipe import Recipe
from deepfsi.sweeps.results import Point, Results

AXES = ("noise", "light", "rails", "detectors", "readout", "variant", "levels", "trained_under")
"""Fields that tell two curves of a design apart: a table has those that differ."""


def check_target(target: float, recipe: Recipe, data: Dataset) -> None:
    """Raise `InputError` where no curve can meet a target accuracy."""
    if data.measure != "accuracy":
        raise InputError(
            f"`target` is an accuracy, and answers to {data.name} are measured by {data.measure}: "
            "leave it out"
        )
    if not data.chance < target < 1:
        raise InputError(
            f"`target` {target:g} is not allowed: give an accuracy below 1 and above "
            f"{data.chance:.3g}, that of guessing the commonest class of {data.name}"
        )
    if len(recipe.photons) < 2 or recipe.test_photons:
        raise InputError(
            "`target` is read off curves of designs, each trained for its budget: give two budgets "
            "of `photons` or more"
        )


def needs_of(results: Results, target: float) -> list[dict[str, Any]]:
    """Photons and masks with which each design reaches a target, the fewest photons first.

    Parameters
    ----------
    results : Results
        Of a comparison of two budgets or more.
    target : float
        Accuracy.

    Returns
    -------
    list of dict
        JSON types only. `photons`, `low` and `high` are those of `Crossing`; `masks` those of the
        tried budget next to it.
    """
    apart = ("masks",) if results.chosen_on == "nothing" else ()
    curves: dict[tuple[Any, ...], list[Point]] = defaultdict(list)
    for point in sorted(results.points, key=lambda point: point.photons):
        if point.best:
            curves[tuple(getattr(point, axis) for axis in ("design", *AXES, *apart))].append(point)
    needs = [_need(curve, results.data.test, target) for curve in curves.values() if len(curve) > 1]
    return sorted(needs, key=lambda need: need["photons"] or math.inf)


def _need(curve: Sequence[Point], images: int, target: float) -> dict[str, Any]:
    tried = [point.photons for point in curve]
    crossing = find_crossing(tried, [point.accuracies for point in curve], images, target)
    at = crossing.photons or tried[0 if crossing.found == "below" else -1]
    nearest = min(curve, key=lambda point: abs(math.log(point.photons / at)))
    return {
        **{axis: getattr(nearest, axis) for axis in ("design", "title", *AXES)},
        **asdict(crossing),
        "masks": nearest.masks,
        "tried": tried,
    }


def needs_table(target: float, needs: Sequence[Mapping[str, Any]]) -> Table:
    """Table with a line for each design."""
    several = [axis for axis in AXES if len({need[axis] for need in needs}) > 1]
    return Table(
        f"accuracy {target:g} needs",
        ("design", "photons", "95 % interval", "masks", *several),
        [
            (
                need["title"],
                _photons(need),
                _interval(need),
                str(need["masks"]),
                *(str(need[axis] or "–") for axis in several),
            )
            for need in needs
        ],
    )


def _photons(need: Mapping[str, Any]) -> str:
    if need["photons"]:
        return _two_digits(need["photons"])
    lowest, *_, highest = map(budget_text, need["tried"])
    return f"{lowest} or fewer" if need["found"] == "below" else f"above {highest}"


def _interval(need: Mapping[str, Any]) -> str:
    low, high = (end and _two_digits(end) for end in (need["low"], need["high"]))
    if low is None:
        return "any" if high is None else f"{high} or fewer"
    return f"{low} or more" if high is None else f"{low} to {high}"


def _two_digits(photons: float) -> str:
    return budget_text(float(f"{photons:.1e}"))
