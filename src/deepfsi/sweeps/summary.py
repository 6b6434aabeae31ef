"""Results of records: folds put together, trials averaged, mask counts chosen."""

import math
import platform
from collections import defaultdict
from collections.abc import Mapping, Sequence
from dataclasses import asdict, replace
from datetime import UTC, datetime
from importlib.metadata import version
from typing import Any

import numpy as np

from deepfsi.base.errors import InputError
from deepfsi.base.intervals import find_crossing, pack_values, unpack_values, worst_class
from deepfsi.base.quantities import Table, budget_text
from deepfsi.camera.detectors import DetectorMap
from deepfsi.camera.names import noise_text
from deepfsi.datasets.dataset import Dataset
from deepfsi.designfile.provenance import new_scenes, training_hashes
from deepfsi.evaluation.measures import MEASURES, main_measure
from deepfsi.jobs.designs import DESIGNS
from deepfsi.jobs.exposures import find_exposure
from deepfsi.sweeps.recipe import Recipe
from deepfsi.sweeps.records import Record
from deepfsi.sweeps.results import RESULTS_SCHEMA, Data, Point, Provenance, Results

_AXES = (
    "trained_under",
    "light",
    "rails",
    "design",
    "trained_at",
    "variant",
    "detectors",
    "readout",
    "noise",
    "photons",
    "levels",
    "masks",
)
"""Fields that tell the points of a summary apart."""

_CURVES = tuple(axis for axis in _AXES if axis not in ("design", "trained_at", "photons", "masks"))
"""Fields that tell two curves of a design apart: a table has those that differ."""

_Member = tuple[Record, int]
"""Record of a trial, and the place of a setting among its tests."""


def summarise_records(
    recipe: Recipe,
    data: Dataset,
    folds: Sequence[Dataset],
    records: Sequence[Sequence[Record]],
    *,
    command: str,
    seconds: float,
) -> Results:
    """Results of a recipe: trials averaged, mask counts chosen on validation data.

    `records` are of the same trials in the same order on each fold. Folds count as if one test had
    seen all scenes.
    """
    held_out = recipe.held_out(folds[0])
    scenes = _pooled(data, folds)
    labels = np.concatenate([_tested_labels(held_out, fold) for fold in folds])
    trials = [_of_all_folds(trial) for trial in zip(*records, strict=True)]
    groups: dict[tuple[Any, ...], list[_Member]] = defaultdict(list)
    for record in trials:
        trial = record["trial"]
        job = trial["job"]
        camera = job["camera"]
        settings = {
            **trial,
            **camera,
            **job,
            "detectors": trial["detectors"],  # their name
            "readout": camera["readout"] if camera["rails"] == "dual" else "",
            "trained_at": job["photons"],
        }
        for index, test in enumerate(record["test"]):
            at = {**settings, **{name: test[name] for name in ("noise", "photons", "levels")}}
            groups[tuple(at[axis] for axis in _AXES)].append((record, index))
    balances = True in recipe.training.get("balance", ())
    measure = "balanced" if balances else main_measure(scenes.measure).key
    points = [
        _point(dict(zip(_AXES, key, strict=True)), members, labels, scenes, measure)
        for key, members in groups.items()
    ]
    return Results(
        revision=RESULTS_SCHEMA,
        title=f"{scenes.name} under {' and '.join(map(noise_text, recipe.noises))}",
        command=command,
        recipe=recipe.model_dump(mode="json"),
        data=_facts(data, scenes, held_out, len(folds)),
        provenance=provenance_of(trials, seconds),
        chosen_on="validation" if held_out else "nothing",
        chosen_by=measure,
        points=tuple(_chosen(points) if held_out else points),
    )


def provenance_of(records: Sequence[Record], seconds: float) -> Provenance:
    """Versions and devices behind records, finished now."""
    return Provenance(
        **{name: version(name) for name in ("deepfsi", "torch", "numpy")},
        python=platform.python_version(),
        device=", ".join(sorted({record["info"]["device"] for record in records})),
        finished=datetime.now(UTC).isoformat(timespec="seconds"),
        seconds=round(seconds, 1),
        training_seconds=round(sum(record["info"]["seconds"] for record in records), 1),
    )


def _facts(data: Dataset, scenes: Dataset, held_out: int, folds: int) -> Data:
    """Facts of a data set; `scenes` is its first fold with the test parts of all."""
    train = len(scenes.x_train) - held_out
    return Data(
        name=scenes.name,
        hash=data.hash,
        image_shape=scenes.image_shape,
        classes=scenes.classes,
        values=scenes.values,
        measure=scenes.measure,
        train=train,
        validation=held_out,
        test=len(scenes.x_test),
        chance=scenes.chance,
        preprocessing=scenes.preprocessing,
        mean_reflectance=float(scenes.x_train[:train].mean(dtype=np.float64)),
        **({"folds": folds} if folds > 1 else {}),
    )


def _chosen(points: Sequence[Point]) -> list[Point]:
    """Points; those at the best mask count alone keep answers to single scenes."""
    rivals: dict[tuple[Any, ...], list[Point]] = defaultdict(list)
    for point in points:
        rivals[_without_masks(point)].append(point)
    best = {
        setting: max(several, key=lambda point: point.validation or 0).masks
        for setting, several in rivals.items()
    }
    left_out = {"best": False, "confusion": (), "terms": ()}
    return [
        point if point.masks == best[_without_masks(point)] else point.model_copy(update=left_out)
        for point in points
    ]


def _without_masks(point: Point) -> tuple[Any, ...]:
    return tuple(getattr(point, axis) for axis in _AXES if axis != "masks")


def _pooled(data: Dataset, folds: Sequence[Dataset]) -> Dataset:
    """The data with the folds' test parts."""
    if len(folds) == 1:
        return folds[0]
    return replace(
        folds[0],
        name=data.name,
        x_test=np.concatenate([fold.x_test for fold in folds]),
        y_test=np.concatenate([fold.y_test for fold in folds]),
    )


def _tested_labels(held_out: int, data: Dataset) -> np.ndarray:
    """Classes or values of the tested scenes: test scenes of the training were left out."""
    training = data.hold_out(held_out) if held_out else data
    return new_scenes(training_hashes(training), data)[0].y_test


def _of_all_folds(folds: Sequence[Record]) -> Record:
    """Record of a trial over its folds."""
    if len(folds) == 1:
        return folds[0]
    info = {
        "device": ", ".join(sorted({fold["info"]["device"] for fold in folds})),
        "seconds": sum(fold["info"]["seconds"] for fold in folds),
    }
    tests = {
        name: [*map(_test_of_all_folds, zip(*(fold[name] for fold in folds), strict=True))]
        for name in ("validation", "test")
    }
    return {**folds[0], "designs": [fold["design"] for fold in folds], **tests, "info": info}


def _test_of_all_folds(tests: Sequence[Record]) -> Record:
    """Tests of one setting on all folds as one: numbers are means over their scenes."""
    images = [test["images"] for test in tests]
    covers = f"{tests[0]['covers']} of each of {len(tests)} folds"
    pooled: Record = {**tests[0], "images": sum(images), "covers": covers}
    alike = {"noise", "photons", "levels", "values"}
    for name in tests[0].keys() - {*alike, "images", "covers", "terms", "rates"}:
        values: list[Any] = [test.get(name) for test in tests]  # older records may have more
        if name in ("rmse", "bound") and None not in values:
            pooled[name] = np.sqrt(np.average(np.square(values), axis=0, weights=images)).tolist()
        elif None not in values:
            pooled[name] = np.average(values, axis=0, weights=images).tolist()
    pooled["terms"] = {
        name: pack_values(np.concatenate([unpack_values(test["terms"][name]) for test in tests]))
        for name in tests[0]["terms"]
    }
    if "confusion" in pooled:
        counts = np.sum([test["confusion"] for test in tests], axis=0)
        pooled["confusion"] = counts.tolist()
        rates = [float(row[k] / row.sum()) if row.any() else None for k, row in enumerate(counts)]
        pooled["rates"] = rates
        pooled["balanced"] = float(np.mean([rate for rate in rates if rate is not None]))
    return pooled


def _point(
    axes: Mapping[str, Any],
    members: Sequence[_Member],
    labels: np.ndarray,
    data: Dataset,
    chosen_by: str,
) -> Point:
    """Trials of a setting averaged; `labels` (images,) are classes or values of the scenes."""
    tests = [record["test"][place] for record, place in members]
    terms = {
        name: np.stack([unpack_values(test["terms"][name]) for test in tests])
        for name in tests[0]["terms"]
    }
    main = main_measure(data.measure)
    validated = [record["validation"][place] for record, place in members if record["validation"]]
    job = members[0][0]["trial"]["job"]
    scene = find_exposure(job["exposure"]).scene(data)
    detectors = DetectorMap.of(job["camera"]["detectors"], scene.image_shape).count
    code = DESIGNS[axes["design"]]
    lit = [test.get("photons_per_mask", ()) for test in tests]
    means: dict[str, float] = {}
    for key, measure in MEASURES.items():
        measured = all(test.get(key) is not None for test in tests)
        if measure is main or (measure.averaged and measured):
            means["accuracy" if measure is main else key] = _mean(tests, key)
            if measure.interval:
                _, *ends = measure.interval(terms[measure.terms], labels)
                means |= zip(measure.ends, ends, strict=True)
    further = {key: means.pop(key) for key in [*means] if key not in Point.model_fields}
    covers = tests[0]["covers"]
    if len(tests) > 1:
        trainings = f"{len(tests)} trainings{covers.partition('of one training')[2]}"
        covers = f"test images, noise draws and training seeds ({trainings})"
    return Point(
        **axes,
        label=code.label,
        title=code.title,
        specific=code.specific,
        learned=code.learned,
        lit=float(np.mean([*map(np.count_nonzero, lit)])) if all(lit) else None,
        ratio=axes["masks"] / (scene.pixels / detectors),
        trials=len(tests),
        validation=_mean(validated, chosen_by) if validated else None,
        covers=covers,
        **(_of_values(tests) if data.values else _of_classes(tests)),
        **means,
        **({"further": further} if further else {}),
        **{name: _mean(tests, name) for name in ("counts", "arriving", "throughput")},
        seconds=_mean([record["info"] for record, _ in members], "seconds"),
        accuracies=tuple(float(test[main.key]) for test in tests),
        terms=tuple(pack_values(row) for row in terms[main.terms]),
        keys=tuple(
            key for record, _ in members for key in record.get("designs", [record["design"]])
        ),
        best=True,
    )


def _mean(records: Sequence[Record], name: str) -> float:
    return float(np.mean([record[name] for record in records]))


def _of_classes(tests: Sequence[Record]) -> dict[str, Any]:
    """Fields of a point whose answers are classes."""
    rates = [  # of each class, in the mean over trials; None where the test has no scene of it
        None if None in trials else float(np.mean(trials))
        for trials in zip(*(test["rates"] for test in tests), strict=True)
    ]
    worst = worst_class(rates)
    return {
        "worst": rates[worst] or 0.0,
        "worst_class": worst,
        "confusion": np.sum([test["confusion"] for test in tests], axis=0).tolist(),
        "one_class": all(np.any(test["confusion"], axis=0).sum() == 1 for test in tests),
    }


def _of_values(tests: Sequence[Record]) -> dict[str, Any]:
    """Fields of a point whose answers are values."""
    scores = np.mean([test["r2_each"] for test in tests], axis=0).tolist()
    bounds = [test["bound"] for test in tests if test["bound"] is not None]
    return {
        "worst": min(scores),
        "worst_class": scores.index(min(scores)),
        "rmse": np.mean([test["rmse"] for test in tests], axis=0).tolist(),
        "bound": np.mean(bounds, axis=0).tolist() if bounds else (),
    }


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
    """Photons and masks with which each design reaches a target accuracy, fewest photons first.

    JSON types only: `photons`, `low` and `high` are `Crossing`'s, `masks` belong to the tried
    budget next to it. The comparison has two budgets or more.
    """
    apart = ("masks",) if results.chosen_on == "nothing" else ()
    curves: dict[tuple[Any, ...], list[Point]] = defaultdict(list)
    for point in sorted(results.points, key=lambda point: point.photons):
        if point.best:
            curves[tuple(getattr(point, axis) for axis in ("design", *_CURVES, *apart))].append(
                point
            )
    needs = [_need(curve, results.data.test, target) for curve in curves.values() if len(curve) > 1]
    return sorted(needs, key=lambda need: need["photons"] or math.inf)


def _need(curve: Sequence[Point], images: int, target: float) -> dict[str, Any]:
    tried = [point.photons for point in curve]
    crossing = find_crossing(tried, [point.accuracies for point in curve], images, target)
    at = crossing.photons or tried[0 if crossing.found == "below" else -1]
    nearest = min(curve, key=lambda point: abs(math.log(point.photons / at)))
    return {
        **{axis: getattr(nearest, axis) for axis in ("design", "title", *_CURVES)},
        **asdict(crossing),
        "masks": nearest.masks,
        "tried": tried,
    }


def needs_table(target: float, needs: Sequence[Mapping[str, Any]]) -> Table:
    """Table with a line for each design."""
    several = [axis for axis in _CURVES if len({need[axis] for need in needs}) > 1]
    return Table(
        f"accuracy {target:g} needs",
        ("design", "photons (95 % interval)", "masks", *several),
        [
            (
                need["title"],
                _photons(need),
                str(need["masks"]),
                *(str(need[axis] or "–") for axis in several),
            )
            for need in needs
        ],
    )


def _photons(need: Mapping[str, Any]) -> str:
    """Photons that a design needs, with the interval: 1.2e3 (900 to 2e3)."""
    lowest, *_, highest = map(budget_text, need["tried"])
    if need["photons"] is None:
        return f"{lowest} or fewer" if need["found"] == "below" else f"above {highest}"
    low, best, high = (
        end and budget_text(float(f"{end:.1e}"))
        for end in (need["low"], need["photons"], need["high"])
    )
    return f"{best} ({low or f'below {lowest}'} to {high or f'above {highest}'})"
