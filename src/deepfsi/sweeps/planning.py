"""Photons that a target accuracy needs, from a few trainings and what lies between them.

Every design is trained at a few budgets, then again where its curve meets the target, so that the
interpolation spans little. The answer is an interval: all budgets at which the curve's own 95 %
interval holds the target.
"""

from collections import defaultdict
from collections.abc import Sequence
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any, Literal

import numpy as np

from deepfsi.datasets import Dataset
from deepfsi.errors import InputError
from deepfsi.progress import SILENT, Report
from deepfsi.sweeps.context import SweepContext
from deepfsi.sweeps.queue import run_trials
from deepfsi.sweeps.recipe import Recipe
from deepfsi.sweeps.results import Point, Results
from deepfsi.sweeps.summary import summarise
from deepfsi.sweeps.trial import plan as trials_of
from deepfsi.sweeps.workers import HERE, Workers

CURVE_BUDGETS = 1000
"""Budgets at which a curve is computed, between the lowest and the highest tried."""

ROUNDS = 2
"""Budgets that may be added to each curve, one after another where it meets the target, with the
mask counts that are best beside it."""

LEAST_DECADES = 0.2
"""Decades between two budgets that are worth a training each."""

CURVE_AXES = ("light", "rails", "detectors", "readout", "design")
"""Fields that tell two curves apart."""

Curve = dict[float, Point]
"""Point of a summary at the best mask count, by budget, rising."""


@dataclass(frozen=True)
class Crossing:
    """Where a curve of accuracy over photons meets a target."""

    # Best estimate; None if the curve does not meet the target within the tried budgets
    photons: float | None
    # Its 95 % interval. An end beyond the tried budgets is None; where all of the interval is, the
    # other end is the budget that it lies beyond
    low: float | None
    high: float | None
    # Whether the estimate is within the tried budgets, the target is reached at the lowest already,
    # or not even at the highest
    found: Literal["within", "below", "beyond"]


def crossing(
    photons: Sequence[float], accuracies: Sequence[Sequence[float]], images: int, target: float
) -> Crossing:
    """Photons at which the accuracy reaches a target."""
    # Accuracy does not fall with more photons, so that the tried ones are brought to order
    # (isotonic regression) and joined by a monotone cubic over the logarithm of the budget. The
    # interval holds all budgets at which the curve's own one holds the target: that of the test
    # images (Wilson) and of training seeds (Student, with one variance for all budgets; none where
    # each has one trial), added in squares, about any shape that the curve may plausibly have
    # between tried budgets
    from scipy.interpolate import PchipInterpolator
    from sklearn.isotonic import IsotonicRegression

    tried = np.log10(photons)
    means = [float(np.mean(trials)) for trials in accuracies]
    fitted = IsotonicRegression().fit_transform(tried, means)
    below, above = _half_widths(fitted, accuracies, images)
    budgets = np.union1d(np.linspace(tried[0], tried[-1], CURVE_BUDGETS), tried)
    curve = PchipInterpolator(tried, fitted)(budgets)
    least, most = _shapes(tried, fitted, budgets)
    lower = least - np.interp(budgets, tried, below)
    upper = np.maximum.accumulate(most + np.interp(budgets, tried, above))

    def reached(accuracy: np.ndarray) -> int:
        """From which budget on the target is reached; the number of budgets if at none."""
        short = np.flatnonzero(accuracy < target)
        return int(short[-1]) + 1 if len(short) else 0

    place, low, high = reached(curve), reached(upper), reached(lower)
    budgets, last = 10**budgets, len(budgets) - 1
    return Crossing(
        photons=float(budgets[place]) if 0 < place <= last else None,
        low=float(budgets[min(low, last)]) if low else None,
        high=float(budgets[high]) if high <= last else None,
        found="below" if place == 0 else "beyond" if place > last else "within",
    )


def _shapes(x: np.ndarray, y: np.ndarray, at: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Least and most that a rising curve through points may plausibly be between them."""
    # The hull of three straight lines: the one that joins two points, and those of the gaps beside
    # it, continued into this one (flat where there is none); never below the lower point nor above
    # the upper one, and at a point its own value
    slopes = np.diff(y) / np.diff(x)
    gap = np.clip(np.searchsorted(x, at, side="right") - 1, 0, len(slopes) - 1)
    before, after = np.append(0.0, slopes)[gap], np.append(slopes, 0.0)[gap + 1]
    lines = np.stack(
        [
            y[gap] + slopes[gap] * (at - x[gap]),
            y[gap] + before * (at - x[gap]),
            y[gap + 1] - after * (x[gap + 1] - at),
        ]
    )
    lines = np.where(np.isin(at, x), lines[0], np.clip(lines, y[gap], y[gap + 1]))
    return lines.min(axis=0), lines.max(axis=0)


def _half_widths(
    fitted: np.ndarray, accuracies: Sequence[Sequence[float]], images: int
) -> tuple[np.ndarray, np.ndarray]:
    """Distance of accuracies to the lower and the upper end of their 95 % interval."""
    from scipy import stats

    z = stats.norm.ppf(0.975)
    shrunk = 1 / (1 + z**2 / images)  # Wilson's interval, for rates that are no counts
    middle = shrunk * (fitted + z**2 / (2 * images))
    half = shrunk * z * np.sqrt(fitted * (1 - fitted) / images + z**2 / (4 * images**2))
    freedom = sum(len(trials) - 1 for trials in accuracies)
    seeds = np.zeros(len(fitted))
    if freedom:
        squares = sum(float(np.var(trials)) * len(trials) for trials in accuracies)
        counts = np.array([len(trials) for trials in accuracies])
        seeds = stats.t.ppf(0.975, freedom) * np.sqrt(squares / freedom / counts)
    return np.hypot(fitted - middle + half, seeds), np.hypot(middle + half - fitted, seeds)


def next_budget(
    photons: Sequence[float], accuracies: Sequence[float], target: float
) -> float | None:
    """Budget where one more training tells most: the crossing, but `LEAST_DECADES` from others."""
    found = crossing(photons, [[accuracy] for accuracy in accuracies], 1, target).photons
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
    device: str = "auto",
    workers: Workers = HERE,
    report: Report = SILENT,
) -> tuple[dict[str, Any], Results]:
    """Photons and masks that a target accuracy needs, for each design, its light and detectors."""
    # Mask counts and the budgets that are added are chosen on validation data, and the crossings
    # found on test data
    check_plan(recipe, data, target)
    context = SweepContext(data, recipe.held_out(data), device)
    records, asked = list[dict[str, Any]](), [recipe]
    for number in range(ROUNDS + 1):
        trials = {trial.key: trial for each in asked for trial in trials_of(each, data)}
        part = report.part(number / (ROUNDS + 1), (number + 1) / (ROUNDS + 1))
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
    found = crossing(tried, [point.accuracies for point in curve.values()], images, target)
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
