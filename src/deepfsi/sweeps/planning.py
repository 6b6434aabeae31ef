"""Photons that a target accuracy needs, from a few trainings and what lies between them.

Every design is trained at a few budgets, then again where its curve meets the target, so that the
interpolation spans little (`statistics.crossings`).
"""

from collections import defaultdict
from collections.abc import Sequence
from dataclasses import asdict
from pathlib import Path
from typing import Any

import numpy as np
import torch

from deepfsi.base import SILENT, InputError, Progress
from deepfsi.base.numeric import find_crossing
from deepfsi.datasets import Dataset
from deepfsi.sweeps.context import SweepContext
from deepfsi.sweeps.queue import run_trials
from deepfsi.sweeps.recipe import Recipe
from deepfsi.sweeps.results import Point, Results
from deepfsi.sweeps.summary import summarise
from deepfsi.sweeps.trial import plan as trials_of
from deepfsi.sweeps.workers import HERE, Workers

ROUNDS = 2
"""Budgets that may be added to each curve, one after another where it meets the target, with the
mask counts that are best beside it."""

LEAST_DECADES = 0.2
"""Decades between two budgets that are worth a training each."""

CURVE_AXES = ("light", "rails", "detectors", "readout", "design")
"""Fields that tell two curves apart."""

Curve = dict[float, Point]
"""Point of a summary at the best mask count, by budget, rising."""


def next_budget(
    photons: Sequence[float], accuracies: Sequence[float], target: float
) -> float | None:
    """Budget where one more training tells most: the crossing, but `LEAST_DECADES` from others."""
    found = find_crossing(photons, [[accuracy] for accuracy in accuracies], 1, target).photons
    if found is None:
        return None
    tried, place = np.log10(photons), int(np.searchsorted(photons, found))
    low, high = tried[place - 1] + LEAST_DECADES, tried[place] - LEAST_DECADES
    return float(f"{10 ** np.clip(np.log10(found), low, high):.3g}") if low <= high else None


def photons_needed(
    recipe: Recipe,
    data: Dataset,
    target: float,
    folder: Path,
    *,
    command: str,
    device: str | torch.device = "auto",
    workers: Workers = HERE,
    report: Progress = SILENT,
) -> tuple[dict[str, Any], Results]:
    """Photons and masks that a target accuracy needs, for each design, its light and detectors."""
    # Mask counts and the budgets that are added are chosen on validation data, and the crossings
    # found on test data
    check_plan(recipe, data, target)
    context = SweepContext(data, recipe.held_out(data), device)
    records, asked = list[dict[str, Any]](), [recipe]
    for number in range(ROUNDS + 1):
        trials = {trial.key: trial for each in asked for trial in trials_of(each, data)}
        part = report.between(number / (ROUNDS + 1), (number + 1) / (ROUNDS + 1))
        records += run_trials(list(trials.values()), context, folder, workers, part)
        seconds = sum(record["info"]["seconds"] for record in records)
        results = summarise(recipe, data, records, command=command, seconds=seconds)
        curves = _curves(results)
        asked = [more for kind in curves if (more := _more(recipe, kind, curves[kind], target))]
        if not asked:
            break
    report(1.0, "done")
    return _plan(recipe, results, target), results


def _plan(recipe: Recipe, results: Results, target: float) -> dict[str, Any]:
    covers = "test images" + " and training seeds" * (recipe.trials > 1)
    return {
        "target": target,
        "command": results.command,
        "data": results.data.as_dict(),
        "covers": f"{covers}, and what lies between tried budgets",
        "needs": [
            _need(kind, curve, results.data.test, target)
            for kind, curve in _curves(results).items()
        ],
    }


def check_plan(recipe: Recipe, data: Dataset, target: float) -> None:
    """Raise `InputError` for what cannot be planned."""
    if data.measure != "accuracy":
        raise InputError(
            f"a plan is of accuracies, and answers to {data.name} are measured by {data.measure}: "
            "use compare"
        )
    if not data.chance < target < 1:
        raise InputError(
            f"target {target:g} is not allowed: give an accuracy below 1 and above "
            f"{data.chance:.3g}, "
            f"that of guessing the commonest class of {data.name}"
        )
    if len(set(recipe.photons)) < 3 or not recipe.held_out(data):
        raise InputError("a plan needs three budgets or more, and scenes held out to choose on")
    shown = {"light", "rails", "detectors", "readout"}
    axes = (recipe.test_levels, *recipe.exposure.values(), *recipe.training.values())
    axes += tuple(values for name, values in recipe.camera.items() if name not in shown)
    axes += tuple(values for own in recipe.tuned.values() for values in own.values())
    if any(len(values) > 1 for values in axes) or recipe.test_photons or recipe.test_noise:
        raise InputError(
            "a plan has one noise, one training of each design, and tests at the budget of the "
            "training: leave other axes than designs, photons, masks, ratios, light, rails, "
            "detectors and readout out"
        )


def _curves(results: Results) -> dict[tuple[str, ...], Curve]:
    curves: dict[tuple[str, ...], Curve] = defaultdict(dict)
    for point in sorted(results.points, key=lambda point: point.photons):
        if point.best:
            curves[tuple(getattr(point, axis) for axis in CURVE_AXES)][point.photons] = point
    return curves


def _more(recipe: Recipe, kind: tuple[str, ...], curve: Curve, target: float) -> Recipe | None:
    """One more budget of a curve, with the mask counts that are best at its neighbours."""
    tried = list(curve)
    budget = next_budget(tried, [point.validation or 0.0 for point in curve.values()], target)
    if budget is None:
        return None
    above = next(place for place, each in enumerate(tried) if each > budget)
    masks = {curve[tried[place]].masks for place in (above - 1, above)}
    light, rails, detectors, readout, design = kind
    one = {
        "designs": (design,),
        "camera": {
            **recipe.camera,
            **{"light": (light,), "rails": (rails,), "detectors": (detectors,)},
            **({"readout": (readout,)} if readout else {}),
        },
        "photons": (budget,),
    }
    counts = {"masks": tuple(sorted(masks)), "ratios": (), "gaussian_photons": ()}
    return recipe.model_copy(update={**one, **counts})


def _need(kind: tuple[str, ...], curve: Curve, images: int, target: float) -> dict[str, Any]:
    tried = list(curve)
    found = find_crossing(tried, [point.accuracies for point in curve.values()], images, target)
    at = found.photons or (tried[0] if found.found == "below" else tried[-1])
    nearest = min(tried, key=lambda budget: abs(np.log(budget / at)))
    kept = {"photons", "masks", "accuracy", "low", "high", "validation", "keys"}
    return {
        **dict(zip(CURVE_AXES, kind, strict=True)),
        "title": curve[nearest].title,
        **asdict(found),
        "masks": curve[nearest].masks,
        "tried": [point.model_dump(mode="json", include=kept) for point in curve.values()],
    }
