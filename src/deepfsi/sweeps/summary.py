"""Results of records: folds put together, trials averaged, mask counts chosen."""

import platform
from collections import defaultdict
from collections.abc import Mapping, Sequence
from dataclasses import replace
from datetime import UTC, datetime
from importlib.metadata import version
from typing import Any

import numpy as np

from deepfsi.base.intervals import pack_values, unpack_values, worst_class
from deepfsi.camera.detectors import DetectorMap
from deepfsi.camera.names import noise_text
from deepfsi.datasets.dataset import Dataset
from deepfsi.designfile.provenance import TrainingScenes, new_scenes
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

_Member = tuple[Record, int]
"""Record of a trial, and the index of a setting among its tests."""


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
            fields = {**settings, **{name: test[name] for name in ("noise", "photons", "levels")}}
            groups[tuple(fields[axis] for axis in _AXES)].append((record, index))
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
    """Points; only those at the best mask count keep answers to single scenes."""
    rivals: dict[tuple[Any, ...], list[Point]] = defaultdict(list)
    for point in points:
        rivals[_without_masks(point)].append(point)
    best = {
        setting: max(group, key=lambda point: point.validation or 0).masks
        for setting, group in rivals.items()
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
    return new_scenes(TrainingScenes.of(training), data)[0].y_test


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
        # Squared errors have a mean over scenes, their roots have not
        if name == "rmse":
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
    tests = [record["test"][index] for record, index in members]
    terms = {
        name: np.stack([unpack_values(test["terms"][name]) for test in tests])
        for name in tests[0]["terms"]
    }
    main = main_measure(data.measure)
    validated = [record["validation"][index] for record, index in members if record["validation"]]
    job = members[0][0]["trial"]["job"]
    scene = find_exposure(job["exposure"]).scene(data)
    detectors = DetectorMap.of(job["camera"]["detectors"], scene.image_shape).count
    facts = DESIGNS[axes["design"]]
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
        label=facts.label,
        title=facts.title,
        specific=facts.specific,
        learned=facts.learned,
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
    return {
        "worst": min(scores),
        "worst_class": scores.index(min(scores)),
        "rmse": np.mean([test["rmse"] for test in tests], axis=0).tolist(),
    }
