"""Results of a comparison: averaged points, data and provenance, as `results.json` holds them."""

import json
from collections.abc import Iterable
from pathlib import Path
from typing import Annotated, Any

from pydantic import AfterValidator, BaseModel, ConfigDict, Field

from deepfsi.errors import as_input_error
from deepfsi.files import write_atomically

SCHEMA = 2
"""Schema of results and of records, the only one; tests of records of another are run anew."""


def _readable(schema: int) -> int:
    if schema != SCHEMA:
        newer = ": upgrade deepfsi" if schema > SCHEMA else ""
        raise ValueError(f"schema {schema} is not the {SCHEMA} of this version{newer}")
    return schema


def _some(points: tuple["Point", ...]) -> tuple["Point", ...]:
    if not points:
        raise ValueError("no finished point")
    return points


class Frozen(BaseModel):
    """Part of a results file."""

    model_config = ConfigDict(frozen=True, extra="forbid", populate_by_name=True)

    def as_dict(self) -> dict[str, Any]:
        """JSON types only: fields that were given."""
        return self.model_dump(mode="json", by_alias=True, exclude_unset=True)


class Point(Frozen):
    """Trials of one setting, averaged.

    Attributes
    ----------
    recipe : str
        Name of the recipe, in an experiment that has several.
    data, split : str
        Data set and its split, in an experiment that has several.
    trained_under, noise : str
        Noise of the training and of the test.
    trained_at, photons : float
        Budget of the training and of the test.
    levels : int
        Grey levels of the masks in the test; 0 for continuous ones.
    detectors : str
        Detectors on parts of the device: ROWSxCOLUMNS, bands of a spectrum, or a map's name.
    readout : {"difference", "both", ""}
        What the network reads of two rails; empty of a single one.
    light, rails : str
        Light law, and signed or non-negative masks.
    design, variant : str
        Name of the design, and which of several training settings, in words.
    masks : int
        Number of masks, m.
    trials : int
        Trainings with different seeds that are averaged.
    label, title : str
        Short and long name of the design.
    specific, learned : bool
        Whether the design depends on the task, and whether its masks are trained.
    ratio : float
        m · D / N, readouts of a rail over pixels.
    validation : float or None
        Mean accuracy on validation data, if any was held out; balanced accuracy where a recipe
        balances its training.
    accuracy, low, high : float
        Mean over trials, and its 95 % interval.
    covers : str
        What the interval covers.
    balanced, balanced_low, balanced_high : float
        Mean of the classes' accuracies, and its 95 % interval, which covers the same.
    worst : float
        Lowest accuracy of a class, in the mean over trials.
    worst_class : int
        Place of that class among those of the data.
    counts : float
        Photons that the detectors count, in the mean over test scenes and trials.
    throughput : float
        Share of the budget that the detectors count, in the training mean; of masks that are
        quantised for a test only, that of the masks before.
    seconds : float
        Mean time of a training.
    accuracies : tuple of float
        Of each trial.
    keys : tuple of str
        Design file of each trial.
    best : bool
        Whether its mask count was chosen on validation data, or nothing was chosen.
    one_class : bool
        Whether each trial gives one class as the answer to every test scene.
    """

    recipe: str = ""
    data: str = ""
    split: str = ""
    trained_under: str
    light: str
    rails: str
    detectors: str
    readout: str
    design: str
    trained_at: float
    variant: str
    noise: str
    photons: float
    levels: int
    masks: int
    label: str
    title: str
    specific: bool
    learned: bool
    ratio: float
    trials: int
    validation: float | None
    accuracy: float
    low: float
    high: float
    covers: str
    balanced: float
    balanced_low: float
    balanced_high: float
    worst: float
    worst_class: int
    counts: float
    throughput: float
    seconds: float
    accuracies: tuple[float, ...]
    keys: tuple[str, ...]
    best: bool
    one_class: bool = False


class Data(Frozen):
    """Data set of a comparison and the sizes of its parts.

    Attributes
    ----------
    name, hash : str
        Name, and content hash of scenes and labels.
    image_shape : tuple of int
        Rows and columns of a scene, or bands of a spectrum.
    classes : tuple of str
        Names of the classes.
    train, validation, test : int
        Number of scenes trained on, held out, and tested on.
    preprocessing : str
        Steps from the data's own values to reflectance.
    mean_reflectance : float
        Of a pixel of the training scenes.
    commonest : float
        Share of the test scenes that are of their commonest class: the accuracy of guessing it.
    """

    name: str
    hash: str
    image_shape: tuple[int, ...]
    classes: tuple[str, ...]
    train: int
    validation: int
    test: int
    commonest: float
    preprocessing: str
    mean_reflectance: float


class Provenance(Frozen):
    """Versions, device and times behind a comparison.

    Attributes
    ----------
    deepfsi, torch, numpy, python : str
        Versions.
    device : str
        That trained: a processor or a GPU.
    finished : str
        Date and time.
    seconds, training_seconds : float
        Time of the comparison, and of its trainings together.
    """

    deepfsi: str
    torch: str
    numpy: str
    python: str
    device: str
    finished: str
    seconds: float
    training_seconds: float


class Results(Frozen):
    """Results of a comparison.

    Attributes
    ----------
    title : str
        Of the report.
    command : str
        That made it.
    data : Data
        Data set.
    provenance : Provenance
        Versions, device and times.
    points : tuple of Point
        One for each setting.
    recipe : dict
        Its settings.
    chosen_on : {"validation", "nothing"}
        Data that mask counts were chosen on.
    chosen_by : {"accuracy", "balanced"}
        Accuracy that they were chosen by.
    extra : dict
        Further numbers of an experiment.
    """

    revision: Annotated[int, AfterValidator(_readable)] = Field(SCHEMA, alias="schema")
    title: str
    command: str
    recipe: dict[str, Any]
    data: Data
    provenance: Provenance
    chosen_on: str
    chosen_by: str = "accuracy"
    points: Annotated[tuple[Point, ...], AfterValidator(_some)]
    extra: dict[str, Any] = {}

    @property
    def had_choice(self) -> bool:
        """True if mask counts were chosen, and some design had several to choose from."""
        return self.chosen_on != "nothing" and not all(point.best for point in self.points)

    def with_points(self, points: Iterable[Point]) -> "Results":
        """Results of this comparison with other points."""
        return self.model_copy(update={"points": tuple(points)})


def write_results(path: Path, results: Results) -> Path:
    """Write results as JSON, all or nothing."""
    return write_atomically(path, json.dumps(results.as_dict(), indent=1).encode())


def read_results(path: Path) -> Results:
    """Results that `write_results` wrote, or `InputError`."""
    with as_input_error(str(path), "run the comparison again"):
        return Results.model_validate_json(path.read_bytes())
