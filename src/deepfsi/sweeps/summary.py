"""Points of a comparison: trials averaged, mask counts chosen on validation data."""

import platform
from collections import defaultdict
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from datetime import UTC, datetime
from importlib.metadata import version
from typing import Any

import numpy as np

from deepfsi.base.numeric import (
    pack_values,
    student,
    unpack_values,
    worst_class,
)
from deepfsi.camera import DetectorMap, noise_text
from deepfsi.datasets import Dataset
from deepfsi.designfile import TrainingScenes, new_scenes
from deepfsi.jobs import DESIGNS, find_exposure
from deepfsi.measures import MEASURES, Measure, main_measure
from deepfsi.sweeps.recipe import Recipe
from deepfsi.sweeps.results import SCHEMA, Data, Point, Provenance, Results

AXES = (
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

ONE = "of one training"
"""Words of a test for what its interval covers, before those of folds or of values."""


def summarise(
    recipe: Recipe,
    data: Dataset,
    records: Sequence[Mapping[str, Any]],
    *,
    command: str,
    seconds: float,
    tested: Dataset | None = None,
) -> Results:
    """Points of a comparison: trials averaged, mask counts chosen on validation data."""
    # What was tested of the data is found from the records, unless these are of several folds
    held_out = recipe.held_out(data)
    tested = tested_scenes(data, held_out, records) if tested is None else tested
    groups = defaultdict(list)
    for record in records:
        for index, test in enumerate(record["test"]):
            trial, job = record["trial"], record["trial"]["job"]
            camera, rails = job["camera"], job["camera"]["rails"]
            readout = camera["readout"] if rails == "dual" else ""
            trained = (
                *(trial["trained_under"], camera["light"], rails, job["design"], job["photons"]),
                *(trial["variant"], trial["detectors"], readout),
            )
            key = (*trained, test["noise"], test["photons"], test["levels"], job["masks"])
            groups[key].append((record, index))
    measure = "balanced" if recipe.balances else main_measure(data.measure).key
    points = [
        point(
            dict(zip(AXES, key, strict=True)),
            members,
            _pixels_seen(members[0][0], data),
            measure,
            tested,
        )
        for key, members in groups.items()
    ]
    chosen = defaultdict(list)
    for place, each in enumerate(points):
        chosen[tuple(getattr(each, axis) for axis in AXES if axis != "masks")].append(place)
    for rivals in chosen.values():
        for place in rivals:
            best = not held_out or place == max(rivals, key=lambda p: points[p].validation or 0)
            kept = {} if best else {"confusion": (), "terms": ()}
            points[place] = points[place].model_copy(update={"best": best, **kept})
    return Results(
        revision=SCHEMA,
        title=f"{data.name} under {' and '.join(map(noise_text, recipe.noises))}",
        command=command,
        recipe=recipe.model_dump(mode="json"),
        data=facts_of(data, held_out),
        provenance=provenance_of(records, seconds),
        chosen_on="validation" if held_out else "nothing",
        chosen_by=measure,
        points=tuple(points),
    )


def tested_scenes(data: Dataset, held_out: int, records: Sequence[Mapping[str, Any]]) -> Dataset:
    """The data with the test scenes that were tested: those of the training were left out."""
    sizes = {
        len(unpack_values(text))
        for each in records[:1]
        for text in each["test"][0].get("terms", {}).values()
    }
    if not sizes or sizes == {len(data.x_test)}:
        return data
    training = data.hold_out(held_out) if held_out else data
    return new_scenes(TrainingScenes.of(training), data)[0]


def _pixels_seen(record: Mapping[str, Any], data: Dataset) -> float:
    """Pixels that each detector of a trial sees, in the mean."""
    job = record["trial"]["job"]
    scene = find_exposure(job["exposure"]).scene(data)
    return scene.pixels / DetectorMap.of(job["camera"]["detectors"], scene.image_shape).count


def facts_of(data: Dataset, held_out: int) -> Data:
    """Facts of a data set of which some training scenes are held out for validation."""
    train = len(data.x_train) - held_out
    return Data(
        name=data.name,
        hash=data.hash,
        image_shape=data.image_shape,
        classes=data.classes,
        values=data.values,
        measure=data.measure,
        train=train,
        validation=held_out,
        test=len(data.x_test),
        chance=data.chance,
        preprocessing=data.preprocessing,
        mean_reflectance=float(data.x_train[:train].mean(dtype=np.float64)),
    )


def provenance_of(records: Sequence[Mapping[str, Any]], seconds: float) -> Provenance:
    """Versions and devices behind records, finished now after that many seconds."""
    return Provenance(
        **{name: version(name) for name in ("deepfsi", "torch", "numpy")},
        python=platform.python_version(),
        device=", ".join(sorted({record["info"]["device"] for record in records})),
        finished=datetime.now(UTC).isoformat(timespec="seconds"),
        seconds=round(seconds, 1),
        training_seconds=round(sum(record["info"]["seconds"] for record in records), 1),
    )


def point(
    axes: Mapping[str, Any],
    members: Sequence[tuple[Mapping[str, Any], int]],
    pixels: float,
    chosen_by: str,
    data: Dataset,
) -> Point:
    """One point of a summary: trials averaged."""
    tests = [record["test"][index] for record, index in members]
    trials, measure = _Trials.of(tests, data), main_measure(data.measure)
    validated = [record["validation"][index] for record, index in members if record["validation"]]
    code = DESIGNS[axes["design"]]
    return Point(
        **axes,
        label=code.label,
        title=code.title,
        specific=code.specific,
        learned=code.learned,
        lit=mean_lit_masks(tests),
        ratio=axes["masks"] / pixels,
        trials=len(tests),
        validation=float(np.mean([v[chosen_by] for v in validated])) if validated else None,
        **dict(zip(("accuracy", "low", "high"), trials.measured(measure), strict=True)),
        covers=trials.covers,
        **(_of_values(tests) if data.values else _of_classes(tests)),
        **trials.averages(),
        counts=float(np.mean([test["counts"] for test in tests])),
        arriving=float(np.mean([test["arriving"] for test in tests])),
        throughput=float(np.mean([test["throughput"] for test in tests])),
        seconds=float(np.mean([record["info"]["seconds"] for record, _ in members])),
        accuracies=tuple(float(test[measure.key]) for test in tests),
        terms=tuple(pack_values(row) for row in trials.terms.get(measure.terms, ())),
        keys=tuple(
            key for record, _ in members for key in record.get("designs", [record["design"]])
        ),
        best=True,
    )


def mean_lit_masks(tests: Sequence[Mapping[str, Any]]) -> float | None:
    """Masks that have light, in the mean over trials; None where a record does not say."""
    light = [test.get("photons_per_mask", ()) for test in tests]
    return float(np.mean([np.count_nonzero(each) for each in light])) if all(light) else None


@dataclass(frozen=True)
class _Trials:
    """Tests of one setting, with terms (S, n) of its images by measure where records keep them."""

    tests: Sequence[Mapping[str, Any]]
    terms: Mapping[str, np.ndarray]
    labels: np.ndarray  # (n,) classes of the images

    @classmethod
    def of(cls, tests: Sequence[Mapping[str, Any]], data: Dataset) -> "_Trials":
        kept = [test.get("terms", {}) for test in tests]
        shared = [name for name in kept[0] if all(name in each for each in kept)]
        terms = {name: np.stack([unpack_values(each[name]) for each in kept]) for name in shared}
        return cls(tests, terms, data.y_test)

    @property
    def covers(self) -> str:
        """Sources of chance in the intervals."""
        if len(self.tests) == 1:
            return str(self.tests[0]["covers"])
        if self.terms:
            said = str(self.tests[0]["covers"]).partition(ONE)[2]  # of each fold
            trainings = f"{len(self.tests)} trainings{said}"
            return f"test images, noise draws and training seeds ({trainings})"
        return (
            f"training seeds alone (Student's t over {len(self.tests)} trials, whose records of an "
            "earlier version keep no images)"
        )

    def measured(self, measure: Measure) -> tuple[float, ...]:
        """Mean of a measure, with both ends of its interval where it has one."""
        values = [float(test[measure.key]) for test in self.tests]
        mean = float(np.mean(values))
        if measure.interval is None:
            return (mean,)
        terms = self.terms.get(measure.terms)
        if terms is None and len(self.tests) == 1:
            low, high = (float(self.tests[0][end]) for end in measure.ends)
        elif terms is None:
            low, high = student(values)
            least = min(0.0, *values)  # R² is below 0 where guessing the mean is better
            low = max(low, least)
        else:
            _, low, high = measure.interval(terms, self.labels)
        return mean, low, min(high, 1.0)

    def averages(self) -> dict[str, Any]:
        """Fields of a point: measures that are averaged over trials, where these have them."""
        means: dict[str, float] = {}
        for key, measure in MEASURES.items():
            if measure.averaged and all(test.get(key) is not None for test in self.tests):
                means |= zip(measure.keys, self.measured(measure), strict=True)
        further = {key: means.pop(key) for key in [*means] if key not in Point.model_fields}
        return means | ({"further": further} if further else {})


def _of_classes(tests: Sequence[Mapping[str, Any]]) -> dict[str, Any]:
    """Fields of a point whose answers are classes."""
    rates = _mean_rates(tests)
    return {
        "worst": rates[worst_class(rates)] or 0.0,
        "worst_class": worst_class(rates),
        "confusion": np.sum([test["confusion"] for test in tests], axis=0).tolist(),
        "one_class": all(np.any(test["confusion"], axis=0).sum() == 1 for test in tests),
    }


def _of_values(tests: Sequence[Mapping[str, Any]]) -> dict[str, Any]:
    """Fields of a point whose answers are values."""
    each = np.mean([test["r2_each"] for test in tests], axis=0).tolist()
    known = [test["bound"] for test in tests if test["bound"] is not None]
    return {
        "worst": min(each),
        "worst_class": each.index(min(each)),
        "rmse": np.mean([test["rmse"] for test in tests], axis=0).tolist(),
        "bound": np.mean(known, axis=0).tolist() if known else (),
    }


def _mean_rates(tests: Sequence[Mapping[str, Any]]) -> list[float | None]:
    """Accuracy of each class, in the mean over trials; None where the test has no scene of it."""
    each = zip(*(test["rates"] for test in tests), strict=True)
    return [None if None in rates else float(np.mean(rates)) for rates in each]
