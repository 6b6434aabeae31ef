"""Recipes: axes over a training and its tests. Each point is a trial.

A recipe is a TOML file or `Recipe(...)`: axes over `jobs.Job`. Every list in it is an axis, also in
its tables `camera`, `exposure` and `training`; `plan_trials` gives the trials of their product.

A file may hold several parts of a study, and a coarse version of each. Settings at its top hold for
every part. `[parts.NAME]` overrides them in one part, `[quick]` in the coarse version, and
`[parts.NAME.quick]` in the coarse version of one part. Tables are merged.
"""

from collections.abc import Callable, Collection, Iterator, Mapping
from functools import partial, reduce
from itertools import product
from typing import Annotated, Any, Literal, NamedTuple, TypeVar

from pydantic import AfterValidator, BeforeValidator, Field, model_validator

from deepfsi.base.errors import InputError, as_input_error
from deepfsi.base.models import Count, UserModel
from deepfsi.camera.camera import Camera, Levels
from deepfsi.camera.light import PhotonBudget
from deepfsi.camera.names import check_noise
from deepfsi.datasets.dataset import Dataset
from deepfsi.evaluation.measures import MOST_DRAWS
from deepfsi.jobs.designs import DESIGNS, check_design
from deepfsi.jobs.exposures import Exposure, find_exposure
from deepfsi.jobs.training import Training
from deepfsi.sweeps.workers import Resources

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
    except TypeError:  # tables and lists have no hash: the model refuses them one by one
        return tuple(value)


def _read_axes(table: Any, make: Callable[[Settings], Any]) -> _Axes:
    """Settings of a model, each an axis, all of whose values are allowed."""
    if not isinstance(table, Mapping):
        raise ValueError(f"{table!r} is no table of settings")
    axes: _Axes = {}
    for name, setting in table.items():
        is_axis = isinstance(setting, (list, tuple))
        if name == "hidden":  # widths of layers are a list themselves
            is_axis = is_axis and any(isinstance(widths, (list, tuple)) for widths in setting)
        if is_axis and not setting:
            raise InputError(f"{name} is empty: give one value or more")
        values = []
        for value in setting if is_axis else [setting]:
            with as_input_error():
                read = getattr(make({name: value}), name, value)
            # Numbers are kept as the model reads them, other settings as they are written
            numbers = read if isinstance(read, tuple) and not isinstance(value, str) else (read,)
            is_number = all(isinstance(number, int | float) for number in numbers)
            values.append(read if is_number else value)
        axes[name] = tuple(values)
    return axes


def _points(axes: _Axes, unnamed: Collection[str] = ()) -> Iterator[tuple[str, Settings]]:
    """Yield the points of a product of axes, each with a name by the axes that vary."""
    varied = [name for name in axes if len(axes[name]) > 1 and name not in unnamed]
    for values in product(*axes.values()):
        point = dict(zip(axes, values, strict=True))
        yield ", ".join(f"{name} {point[name]}" for name in varied), point


class CameraVariant(NamedTuple):
    """One camera of a recipe."""

    camera: Camera
    detectors: str  # as the recipe names them
    variant: str  # which of several, by the fields that no point of the results has as its own


def _cameras(axes: _Axes) -> list[CameraVariant]:
    """Possible cameras of a product of axes; `InputError` if there are none."""
    cameras: list[CameraVariant] = []
    faults: list[str] = []
    for variant, fields in _points(axes, _NAMED_FIELDS):
        try:
            camera = Camera.load(fields)
        except InputError as error:
            faults.append(str(error))
        else:
            detectors = str(fields.get("detectors", "1x1"))
            cameras.append(CameraVariant(camera, detectors, variant))
    if not cameras:
        raise InputError(faults[0])
    return cameras


def _read_camera(source: Any) -> _Axes:
    fields = source if isinstance(source, Mapping) else Camera.load(source).given_fields
    axes = _read_axes(fields, Camera.load)
    _cameras(axes)
    return axes


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
    designs: FilledAxis[Annotated[str, AfterValidator(check_design)]] = Field(
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
    exposure: Annotated[
        dict[str, Any], BeforeValidator(partial(_read_axes, make=find_exposure))
    ] = Field(
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
    training: Annotated[
        dict[str, Any], BeforeValidator(partial(_read_axes, make=Training.model_validate))
    ] = Field(default={}, description="settings of the training of every design, each an axis")
    resources: Resources = Field(
        default=Resources(), description="share of a Ray cluster that each batch of trials takes"
    )

    @model_validator(mode="after")
    def _one_or_the_other(self) -> "Recipe":
        if self.ratios and self.masks:
            raise ValueError("give ratios or masks, not both")
        return self

    def cameras(self) -> list[CameraVariant]:
        """Possible cameras of the product of its axes."""
        return _cameras(self.camera)

    def exposures(self, design: str) -> Iterator[tuple[str, Exposure]]:
        """Yield the exposures of a design, each with a name if there are several.

        A cap holds for adaptive masks alone, whose exposures may end early; their name says that
        the budget is a mean.
        """
        axes = dict(self.exposure)
        if not DESIGNS[design].adaptive:
            axes.pop("cap", None)
        for variant, point in _points(axes, ("cap",)):
            exposure = find_exposure(point)
            most = exposure.most_light
            mean = f"(mean light, at most {most:g} Φ)" if most > 1 else ""
            yield f"{variant} {mean}".strip(), exposure

    @property
    def noises(self) -> tuple[str, ...]:
        """Noises of the cameras."""
        return tuple(dict.fromkeys(named.camera.noise_name for named in self.cameras()))

    def trainings(self, design: str) -> Iterator[tuple[str, Settings]]:
        """Trainings of a design, each with a name if there are several."""
        axes = dict(self.training)
        if not DESIGNS[design].learns_masks:
            for name in ("start", "start_counts", "mask_lr"):
                axes.pop(name, None)
        return _points(axes)

    def parts(self, data: Dataset) -> list[Dataset]:
        """The data, or its folds, on each of which all designs are trained and tested."""
        count = self.folds
        if count is None:
            # An interval over 300 scenes is ± 0.04 wide at an accuracy of 0.85
            count = 5 if data.drawn and len(data.x_test) < 300 else 1
        return [data] if count == 1 else data.folds(count)

    def held_out(self, data: Dataset) -> int:
        """Number of training scenes that are kept for validation."""
        return len(data.x_train) // 6 if self.validation is None else self.validation


def parts(file: Mapping[str, Any], quick: bool = False) -> dict[str, Settings]:
    """Settings of each recipe of a file; its only one is named ""."""
    common = {name: value for name, value in file.items() if name not in ("parts", "quick")}
    coarse = _table(file, "quick")
    tables = _table(file, "parts") or {"": {}}
    recipes = {}
    for name in tables:
        changes = dict(_table(tables, name))
        coarse_part = _table(changes, "quick")
        changes.pop("quick", None)
        layers = [common, changes, coarse, coarse_part] if quick else [common, changes]
        if quick and not (coarse or coarse_part):
            raise InputError("this recipe has no [quick] table: run it whole")
        recipes[name] = reduce(_merged, layers)  # later layers override
    return recipes


def only(file: Mapping[str, Any], part: str | None = None, quick: bool = False) -> Settings:
    """Settings of a part of a recipe's file, or of the whole file if it has no parts."""
    recipes = parts(file, quick)
    if (part or "") not in recipes:
        there = "no parts" if "" in recipes else f"the parts {', '.join(recipes)}"
        raise InputError(
            f"the recipe has {there}, and {'none' if part is None else part} is asked for: change "
            "the option --part of deepfsi sweep"
        )
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
