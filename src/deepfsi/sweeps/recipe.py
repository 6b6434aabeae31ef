"""Recipes: axes over a training and its tests. Each point is a trial.

A recipe is a TOML file or `Recipe(...)`: axes over `jobs.Job`. Every list in it is an axis, also in
its tables `camera`, `exposure` and `training`; `plan_trials` gives the trials of their product.

A file may hold several parts of a study, and a coarse version of each. Settings at its top hold for
every part. `[parts.NAME]` overrides them in one part, `[quick]` in the coarse version, and
`[parts.NAME.quick]` in the coarse version of one part. Tables are merged.
"""

from collections.abc import Callable, Iterator, Mapping
from functools import partial
from itertools import product
from typing import Annotated, Any, Literal, NamedTuple, TypeVar

from pydantic import AfterValidator, BeforeValidator, Field, model_validator

from deepfsi.base.errors import InputError, as_input_error, closest_choice
from deepfsi.base.models import Count, UserModel
from deepfsi.camera.camera import Camera, Levels
from deepfsi.camera.detectors import ONE_DETECTOR, DetectorMap
from deepfsi.camera.light import PhotonBudget
from deepfsi.camera.names import check_noise, find_noise
from deepfsi.datasets.dataset import Dataset
from deepfsi.evaluation.measures import MOST_DRAWS
from deepfsi.jobs.designs import DESIGNS, check_design, count_allowed, mask_count
from deepfsi.jobs.exposures import Exposure, find_exposure
from deepfsi.jobs.training import MASK_SETTINGS, Training
from deepfsi.sweeps.workers import Resources

PAPER_RATIOS = tuple((k / 10) ** 2 for k in range(1, 11))
"""1, 4, 9, … 100 %."""

Settings = dict[str, Any]
"""Fields of a recipe, as TOML gives them."""

_Axes = dict[str, tuple[Any, ...]]
"""Values of each setting."""

_NAMED_FIELDS = ("light", "rails", "detectors", "readout", "noise")
"""Fields of the camera that a point of the results has as its own: no variant names them."""


def _axis(value: Any) -> Any:
    """Values of an axis, each once; a single value is an axis of one."""
    if not isinstance(value, (list, tuple)):
        return (value,)
    try:
        return tuple(dict.fromkeys(value))
    except TypeError:  # of tables or lists: they are refused one by one
        return tuple(value)


def _read_axes(table: Any, make: Callable[[Settings], Any]) -> _Axes:
    """Settings of a model, each an axis, all of whose values are allowed."""
    if not isinstance(table, Mapping):
        raise ValueError(f"{table!r} is no table of settings")
    axes: _Axes = {}
    for name, given in table.items():
        several = isinstance(given, (list, tuple))
        if name == "hidden":  # widths of layers are a list themselves
            several = several and any(isinstance(widths, (list, tuple)) for widths in given)
        if several and not given:
            raise InputError(f"{name} is empty: give one value or more")
        values = []
        for value in given if several else [given]:
            with as_input_error():
                read = getattr(make({name: value}), name, value)
            # numbers as the model reads them; other settings as they are given
            numbers = read if isinstance(read, tuple) and not isinstance(value, str) else (read,)
            is_number = all(isinstance(number, int | float) for number in numbers)
            values.append(read if is_number else value)
        axes[name] = tuple(values)
    return axes


def _points(axes: _Axes) -> Iterator[Settings]:
    """Yield the points of a product of axes."""
    for values in product(*axes.values()):
        yield dict(zip(axes, values, strict=True))


def _variant(point: Settings, axes: _Axes) -> str:
    """Name of a point: its values on axes of several."""
    return ", ".join(f"{name} {point[name]}" for name in point if len(axes[name]) > 1)


class CameraVariant(NamedTuple):
    """One camera of a recipe."""

    camera: Camera
    detectors: str  # as the recipe names them
    variant: str  # which of several, by the fields that no point of the results has as its own


def _cameras(axes: _Axes) -> list[CameraVariant]:
    """Cameras of a product of axes, but those that cannot be; `InputError` where none can."""
    cameras: list[CameraVariant] = []
    faults: list[str] = []
    for fields in _points(axes):
        unnamed = {name: fields[name] for name in fields if name not in _NAMED_FIELDS}
        detectors = str(fields.get("detectors", "1x1"))
        try:
            camera = Camera.load(fields)
        except InputError as error:
            faults.append(str(error))
        else:
            cameras.append(CameraVariant(camera, detectors, _variant(unnamed, axes)))
    if not cameras:
        raise InputError(faults[0])
    return cameras


def _read_camera(given: Any) -> _Axes:
    fields = given if isinstance(given, Mapping) else Camera.load(given).given_fields
    axes = _read_axes(fields, Camera.load)
    _cameras(axes)
    return axes


_read_exposure = partial(_read_axes, make=find_exposure)

_read_training = partial(_read_axes, make=Training.model_validate)


DesignKind = Annotated[str, AfterValidator(check_design)]
TestNoise = Annotated[str, AfterValidator(check_noise)]
Value = TypeVar("Value")
Axis = Annotated[tuple[Value, ...], BeforeValidator(_axis)]
FilledAxis = Annotated[Axis[Value], Field(min_length=1)]


class Recipe(UserModel):
    """A comparison: every list is an axis, and a single value stands for a list of one."""

    data: str = Field(default="digits", description="name, folder of images or .npz file")
    size: tuple[int, int] | None = Field(default=None, description="height, width of folder images")
    images: int | None = Field(
        default=None, ge=1, description="training images that are taken; default: all"
    )
    split: Literal["random", "blocks"] | None = Field(
        default=None,
        description="how a hyperspectral image is divided for testing; default: random",
    )
    designs: FilledAxis[DesignKind] = Field(
        default=(
            "impulse",
            "raster",
            "hadamard",
            "truncated-hadamard",
            "pca",
            "deepfsi",
            "control",
        ),
        description="names of designs",
    )
    photons: FilledAxis[PhotonBudget] = Field(
        default=(1e2, 1e3, 1e4, 1e5), description="budgets Φ: expected photons on the coding device"
    )
    gaussian_photons: Axis[PhotonBudget] = Field(
        default=(), description="budgets under gaussian noise, if others"
    )
    ratios: Axis[Annotated[float, Field(gt=0, le=1)]] = Field(
        default=(), description="readouts over pixels, m · D / N; default: the paper's"
    )
    masks: Axis[Count] = Field(default=(), description="mask counts, instead of ratios")
    camera: Annotated[dict[str, Any], BeforeValidator(_read_camera)] = Field(
        default={},
        description="fields of the camera, each an axis; or a preset's name, or a TOML file",
    )
    exposure: Annotated[dict[str, Any], BeforeValidator(_read_exposure)] = Field(
        default={}, description="settings of the exposure, each an axis, such as cap = [1, 2]"
    )
    trials: int = Field(default=1, ge=1, le=1000, description="seeds 0, 1, …")
    validation: int | None = Field(
        default=None,
        ge=0,
        description="training scenes held out to choose on; default: a sixth",
    )
    folds: int | None = Field(
        default=None,
        ge=1,
        le=100,
        description="parts of the scenes, each tested by designs trained on the others; 1 for "
        "none. Default: 5 where a test part was drawn and has fewer than 300 scenes",
    )
    draws: int = Field(default=3, ge=1, le=MOST_DRAWS, description="noise draws of each test scene")
    test_photons: Axis[PhotonBudget] = Field(
        default=(), description="budgets of the tests; default: that of the training"
    )
    test_noise: Axis[TestNoise] = Field(
        default=(), description="noises of the tests; default: that of the camera"
    )
    test_levels: FilledAxis[Levels] = Field(
        default=(0,),
        description="grey levels, dark included, of the masks shown in the tests; 0: as trained",
    )
    training: Annotated[dict[str, Any], BeforeValidator(_read_training)] = Field(
        default={}, description="settings of the training of every design, each an axis"
    )
    resources: Resources = Field(
        default=Resources(), description="share of a Ray cluster that each batch of trials takes"
    )

    @model_validator(mode="after")
    def _one_or_the_other(self) -> "Recipe":
        if self.ratios and self.masks:
            raise ValueError("give ratios or masks, not both")
        return self

    def cameras(self) -> list[CameraVariant]:
        """Cameras of the product of its axes, but those that cannot be."""
        return _cameras(self.camera)

    def exposures(self, design: str) -> list[tuple[str, Exposure]]:
        """Exposures of a design by name: the product of its axes.

        A cap holds for adaptive masks alone, whose exposures may end early; their name says that
        the budget is a mean.
        """
        axes = self.exposure
        others = {name: values for name, values in axes.items() if name != "cap"}
        exposures: dict[str, Exposure] = {}
        for point in _points(axes):
            plain = {name: point[name] for name in others}
            exposure = find_exposure(point if DESIGNS[design].adaptive else plain)
            names = [_variant(plain, others)]
            if exposure.most_light > 1:
                names.append(f"(mean light, at most {exposure.most_light:g} Φ)")
            exposures[" ".join(filter(None, names))] = exposure
        return [*exposures.items()]

    @property
    def noises(self) -> tuple[str, ...]:
        """Noises of the cameras."""
        return tuple(dict.fromkeys(named.camera.noise_name for named in self.cameras()))

    @property
    def balances(self) -> bool:
        """True if a training weighs its classes: validation then goes by balanced accuracy."""
        return True in self.training.get("balance", ())

    def trainings(self, design: str) -> Iterator[tuple[str, Settings]]:
        """Yield the trainings of a design, each with a name if there are several."""
        axes = self.training
        if not DESIGNS[design].learns_masks:
            axes = {name: axes[name] for name in axes if name not in MASK_SETTINGS}
        for point in _points(axes):
            yield _variant(point, axes), point

    def budgets(self, noise: str) -> tuple[float, ...]:
        """Budgets to train at under a noise."""
        alone = find_noise(noise).read_noise_alone
        return (self.gaussian_photons if alone else ()) or self.photons

    def mask_counts(
        self, design: str, data: Dataset, detectors: DetectorMap = ONE_DETECTOR
    ) -> list[int]:
        """Mask counts of a design that it can have, else the most it can have.

        A ratio counts readouts, m · D / N. Adaptive masks share the light among their looks, and
        more looks tell more: ratios ask for one count. `data` holds scenes as the masks see them.
        """
        low, high = count_allowed(design, data, detectors)
        asked = self.masks or [
            mask_count(ratio, data.pixels / detectors.count)
            for ratio in self.ratios or PAPER_RATIOS
        ]
        counts = sorted({count for count in asked if low <= count <= high}) or [high]
        if DESIGNS[design].adaptive and not self.masks:
            # more than 32 looks tell little and take their time
            return [max((c for c in counts if c <= 32), default=counts[0])]
        return counts

    def parts(self, data: Dataset) -> list[Dataset]:
        """The data, or its folds, on each of which all designs are trained and tested."""
        count = self.folds
        if count is None:
            # an interval over 300 scenes is ± 0.04 wide at an accuracy of 0.85
            count = 5 if data.drawn and len(data.x_test) < 300 else 1
        return [data] if count == 1 else data.folds(count)

    def held_out(self, data: Dataset) -> int:
        """Number of training scenes that are kept for validation."""
        return len(data.x_train) // 6 if self.validation is None else self.validation


def parts(file: Mapping[str, Any], quick: bool = False) -> dict[str, Settings]:
    """Settings of each recipe of a file."""
    common = {name: value for name, value in file.items() if name not in ("parts", "quick")}
    coarse = _table(file, "quick")
    tables = _table(file, "parts") or {"": {}}
    recipes = {}
    for name in tables:
        changes = _table(tables, name)
        coarse_changes = _table(changes, "quick")
        settings = _merged(common, {key: changes[key] for key in changes if key != "quick"})
        if quick:
            if not (coarse or coarse_changes):
                raise InputError("this recipe has no [quick] table: run it whole")
            settings = _merged(_merged(settings, coarse), coarse_changes)
        recipes[name] = settings
    return recipes


def only(file: Mapping[str, Any], part: str | None = None, quick: bool = False) -> Settings:
    """Settings of a recipe in a file."""
    recipes = parts(file, quick)
    if part is None and "" not in recipes:
        raise InputError(
            f"the recipe has several parts, {', '.join(recipes)}: name one by the option --part of "
            "deepfsi sweep"
        )
    if part is not None and "" in recipes:
        raise InputError(f"the recipe has no parts: leave --part {part} out")
    if (part or "") not in recipes:
        raise InputError(f"the recipe has no part {part!r}: {closest_choice(str(part), recipes)}")
    return recipes[part or ""]


def _table(file: Mapping[str, Any], name: str) -> Settings:
    table = file.get(name, {})
    if not isinstance(table, dict):
        raise InputError(f"{name} of a recipe is a table, not {table!r}: write [{name}]")
    return table


def _merged(settings: Settings, changes: Settings) -> Settings:
    merged = dict(settings)
    for name, value in changes.items():
        before = merged.get(name)
        if isinstance(before, dict) and isinstance(value, dict):
            value = _merged(before, value)
        merged[name] = value
    return merged
