"""Results of a comparison: averaged points, data and provenance, as `results.json` holds them."""

import json
import math
from collections.abc import Iterable
from pathlib import Path
from typing import Annotated, Any, Literal

import numpy as np
from pydantic import (
    AfterValidator,
    ConfigDict,
    Field,
    FiniteFloat,
    model_validator,
)

from deepfsi.base.errors import as_input_error
from deepfsi.base.files import read_text, write_atomically
from deepfsi.base.intervals import (
    Z_95,
    Difference,
    mean_of_trials,
    paired_difference,
    unpack_values,
)
from deepfsi.base.models import Positive, Share, StrictModel
from deepfsi.datasets.dataset import MeasureTitle
from deepfsi.jobs.designs import EVERY_PIXEL

RESULTS_SCHEMA: Literal[5] = 5
"""Schema of results and of records, the only one; tests of records of another are run anew."""

_Score = Annotated[float, Field(le=1, allow_inf_nan=False)]
"""Accuracy, area under a ROC curve, or R², which a bad guess takes below 0."""

_StoredCount = Annotated[int, Field(ge=0, le=2**53)]
"""Number of things that JSON and floats hold exactly."""

_Key = Annotated[str, Field(pattern=r"^[^/\\\x00.][^/\\\x00]*$")]
"""Name of a design's file, in the folder of designs and no other."""


def _packed(text: str) -> str:
    unpack_values(text)
    return text


_PackedValues = Annotated[str, AfterValidator(_packed)]
"""Values of test images, as `pack_values` packs them."""


class _Stored(StrictModel):
    """Part of a results file."""

    model_config = ConfigDict(populate_by_name=True)

    def as_dict(self) -> dict[str, Any]:
        """JSON types only: fields that were given."""
        return self.model_dump(mode="json", by_alias=True, exclude_unset=True)


class Point(_Stored):
    """Trials of a setting, averaged."""

    recipe: str = Field("", description="recipe, in an experiment of several")
    data: str = Field("", description="data set, in an experiment of several")
    split: str = Field("", description="its split, in an experiment of several")
    trained_under: str = Field(description="noise of the training")
    light: str = Field(description="light law")
    rails: str = Field(description="dual: signed masks; single: non-negative ones")
    detectors: str = Field(description="ROWSxCOLUMNS, bands of a spectrum, or a map's name")
    readout: str = Field(description="what the network reads of two rails: difference or both")
    design: str = Field(description="name of the design")
    trained_at: Positive = Field(description="budget of the training")
    variant: str = Field(description="settings of the training that differ, in words")
    noise: str = Field(description="noise of the test")
    photons: Positive = Field(description="budget of the test")
    levels: _StoredCount = Field(description="grey levels of the masks in the test; 0: continuous")
    masks: _StoredCount = Field(description="number of masks, m")
    lit: FiniteFloat | None = Field(None, description="masks with light, mean over trials")
    label: str = Field(description="short name of the design")
    title: str = Field(description="long name of the design")
    specific: bool = Field(description="whether the design depends on the task")
    learned: bool = Field(description="whether its masks are trained")
    ratio: FiniteFloat = Field(description="m · D / N, readouts of a rail over pixels")
    trials: _StoredCount = Field(description="trainings with different seeds, averaged")
    validation: _Score | None = Field(
        description="the measure on validation data, by which masks are chosen"
    )
    accuracy: _Score = Field(description="mean over trials: accuracy, or R² of values")
    low: FiniteFloat = Field(description="lower end of its 95 % interval")
    high: FiniteFloat = Field(description="upper end of its 95 % interval")
    covers: str = Field(description="what the intervals cover")
    balanced: Share | None = Field(None, description="mean of the classes' accuracies")
    balanced_low: FiniteFloat | None = Field(None, description="lower end of its 95 % interval")
    balanced_high: FiniteFloat | None = Field(None, description="upper end of its interval")
    worst: _Score = Field(description="lowest accuracy of a class, or R² of a value")
    worst_class: _StoredCount = Field(description="place of that class or value in the data")
    rmse: tuple[FiniteFloat, ...] = Field((), description="root mean squared error of each value")
    log_loss: FiniteFloat | None = Field(
        None, description="mean of −ln p of the true class, in nats"
    )
    further: dict[str, FiniteFloat] = Field({}, description="other measures, by name")
    counts: FiniteFloat = Field(
        description="photons that the detectors count, or clicks, mean over test scenes"
    )
    arriving: FiniteFloat | None = Field(
        None, description="photons that reach the detectors, mean over test scenes"
    )
    throughput: FiniteFloat = Field(
        description="share of the budget that the detectors count, mean over training scenes, "
        "before masks are quantised"
    )
    seconds: FiniteFloat = Field(description="mean time of a training")
    accuracies: tuple[_Score, ...] = Field(description="measure of each trial")
    terms: tuple[_PackedValues, ...] = Field(
        (),
        description="at the chosen number of masks: of each trial, values of the test scenes whose "
        "mean is its measure; 32-bit floats, zlib, base64",
    )
    keys: tuple[_Key, ...] = Field(
        min_length=1, description="design file of each trial, or of each of its folds"
    )
    best: bool = Field(
        description="whether its number of masks was chosen on validation data, or nothing was"
    )
    confusion: tuple[tuple[_StoredCount, ...], ...] = Field(
        (),
        description="at the chosen number of masks: rows true classes, columns answers, over all "
        "trials and noise draws",
    )
    one_class: bool = Field(False, description="whether each trial answers one class only")

    @property
    def every_pixel(self) -> bool:
        """True of a design that has a detector for each pixel."""
        return self.design in EVERY_PIXEL


def accuracy_difference(first: Point, second: Point) -> Difference:
    """Difference of two accuracies, paired on the images that both were tested with.

    Trials without values of images are paired by seed, and their differences give the error. Of a
    single such trial the two intervals over images are combined as if they were independent.
    """
    if first.terms and second.terms:
        rows = [
            np.stack([unpack_values(text) for text in point.terms]) for point in (first, second)
        ]
        if rows[0].shape[1] == rows[1].shape[1]:
            return paired_difference(*rows)
    one, other = (np.asarray(point.accuracies) for point in (first, second))
    if len(one) == len(other) > 1:
        return mean_of_trials((one - other).tolist())
    half = math.hypot(*((point.high - point.low) / 2 for point in (first, second)))
    return Difference(float(one.mean() - other.mean()), half / Z_95)


class Data(_Stored):
    """Data set of a comparison and the sizes of its parts."""

    name: str = Field(description="name")
    hash: str = Field(description="content hash of scenes and labels")
    image_shape: tuple[_StoredCount, ...] = Field(
        min_length=1, description="rows and columns of a scene, or bands of a spectrum"
    )
    classes: tuple[str, ...] = Field(description="names of the classes; none where it has values")
    values: tuple[str, ...] = Field((), description="names of its values")
    measure: MeasureTitle = Field("accuracy", description="accuracy or R²")
    train: _StoredCount = Field(description="scenes trained on")
    validation: _StoredCount = Field(description="scenes held out")
    test: _StoredCount = Field(description="scenes tested on")
    folds: _StoredCount = Field(
        1, description="parts of the scenes, each tested by designs trained on the others"
    )
    chance: FiniteFloat = Field(
        description="measure of guessing: the share of the commonest class, or R² 0"
    )
    preprocessing: str = Field(description="steps from the data's own values to reflectance")
    mean_reflectance: FiniteFloat = Field(description="of a pixel of the training scenes")


class Provenance(_Stored):
    """Versions, device and times behind a comparison."""

    deepfsi: str = Field(description="version")
    torch: str = Field(description="version")
    numpy: str = Field(description="version")
    python: str = Field(description="version")
    device: str = Field(description="that trained: a processor or a GPU")
    finished: str = Field(description="date and time")
    seconds: FiniteFloat = Field(description="time of the comparison")
    training_seconds: FiniteFloat = Field(description="time of its trainings together")


class Results(_Stored):
    """Results of a comparison."""

    revision: Literal[5] = Field(5, alias="schema", description="version of the format")
    title: str = Field(description="of the report")
    command: str = Field(description="that made it")
    recipe: dict[str, Any] = Field(description="its settings")
    data: Data = Field(description="data set")
    provenance: Provenance = Field(description="versions, device and times")
    chosen_on: str = Field(description="data that masks were chosen on: validation or nothing")
    chosen_by: str = Field("accuracy", description="by which measure: accuracy, balanced or r2")
    points: tuple[Point, ...] = Field(min_length=1, description="one for each setting")
    extra: dict[str, Any] = Field({}, description="further numbers of an experiment")

    @model_validator(mode="after")
    def _of_one_comparison(self) -> "Results":
        names = self.data.classes or self.data.values
        if any(point.worst_class >= len(names) for point in self.points):
            raise ValueError("the worst class of a point is none of the data's")
        sizes = {len(row) for point in self.points for row in (point.confusion, *point.confusion)}
        if sizes - {0, len(self.data.classes)}:
            raise ValueError("a confusion matrix is not of the data's classes")
        return self

    def with_points(self, points: Iterable[Point]) -> "Results":
        """Results of this comparison with other points."""
        return self.model_copy(update={"points": tuple(points)})


def write_results(path: Path, results: Results) -> Path:
    """Write results as JSON, whole or not at all."""
    return write_atomically(path, json.dumps(results.as_dict(), indent=1).encode())


def read_results(path: Path) -> Results:
    """Results that `write_results` wrote, or `InputError`."""
    again = "run the comparison again"
    content = read_text(path, 2**28, again)
    with as_input_error(str(path), again):
        return Results.model_validate_json(content)
