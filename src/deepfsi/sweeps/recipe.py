"""Recipes name axes; a trial is a point of them: one training and its tests.

A recipe is a TOML file or `Recipe(...)`: axes over `training.job.Job`. Every list in it is an axis,
also in its tables `camera`, `exposure` and `training`; `plan` gives the trials of their product.

A file may hold several parts of a study, and a coarse version of each. Settings at its top hold for
every part. `[parts.NAME]` overrides them in one part, `[quick]` in the coarse version, and
`[parts.NAME.quick]` in the coarse version of one part. Tables are merged.
"""

from collections.abc import Callable, Iterator, Mapping
from itertools import product
from typing import Annotated, Any, Literal, NamedTuple, TypeVar

from pydantic import AfterValidator, BeforeValidator, Field, model_validator

from deepfsi.base import InputError, Message, as_input_error, closest_choice, join_messages
from deepfsi.base.models import Count, UserModel
from deepfsi.camera import (
    ONE_DETECTOR,
    Camera,
    DetectorMap,
    Levels,
    PhotonBudget,
    check_noise,
    find_noise,
)
from deepfsi.datasets import Dataset
from deepfsi.jobs import (
    DESIGNS,
    MLP,
    Exposure,
    Training,
    check_design,
    count_allowed,
    find_exposure,
    mask_count,
)
from deepfsi.measures import MOST_DRAWS
from deepfsi.sweeps.workers import Resources

PAPER_RATIOS = tuple((k / 10) ** 2 for k in range(1, 11))
"""1, 4, 9, … 100 %."""

Settings = dict[str, Any]
"""Fields of a recipe, as TOML gives them."""

RATIOS_OR_MASKS = "give ratios or masks, not both"
"""Said where a recipe has both."""

MASK_SETTINGS = ("start", "mask_lr")
"""Settings of the training that only learned masks have."""

MLP_SETTINGS, OWN_SETTINGS = ("hidden", "dropout"), ("classifier_arguments",)
"""Settings of the training that only the usual classifier has, and those of one's own."""


MOST_LOOKS = 32
"""Looks of adaptive masks that ratios ask for, at most: more tell little and take their time."""

OWN_AXES = ("light", "rails", "detectors", "readout", "noise")
"""Fields of the camera that each point of a summary has as its own."""


FOLDS, FEW_IMAGES = 5, 300
"""Folds of data whose test part was drawn and has fewer scenes than that."""


def axis(value: Any) -> Any:
    """Values of an axis, each once; a single value is an axis of one."""
    if not isinstance(value, (list, tuple)):
        return (value,)
    try:
        return tuple(dict.fromkeys(value))
    except TypeError:  # of tables or lists: they are refused one by one
        return tuple(value)


def _is_one(name: str, value: Any) -> bool:
    """True of a single value of a setting: widths of layers are a list themselves."""
    if not isinstance(value, (list, tuple)):
        return True
    return name == "hidden" and not any(isinstance(part, (list, tuple)) for part in value)


def _table_of_axes(given: Any, make: Callable[[Settings], Any]) -> dict[str, tuple[Any, ...]]:
    """Settings of a model, each an axis, all of whose values are allowed."""
    if not isinstance(given, Mapping):
        raise ValueError(f"{given!r} is no table of settings")
    axes = {
        name: (value,) if _is_one(name, value) else tuple(value) for name, value in given.items()
    }
    faults = [f"{name} is empty: give one value or more" for name in axes if not axes[name]]
    for name, values in axes.items():
        read = []
        for value in values:
            try:
                with as_input_error():
                    read.append(_number(getattr(make({name: value}), name, value), value))
            except InputError as error:
                faults.append(error.message)
        axes[name] = tuple(read)
    if faults:
        raise InputError(join_messages(faults))
    return axes


def _number(read: Any, given: Any) -> Any:
    """Number, or several, that a model reads of a setting; of other settings the given value."""
    numbers = read if isinstance(read, tuple) and not isinstance(given, str) else (read,)
    return read if all(isinstance(each, int | float) for each in numbers) else given


def _camera(given: Any) -> dict[str, tuple[Any, ...]]:
    if not isinstance(given, Mapping):
        given = Camera.load(given).given_fields
    axes = _table_of_axes(given, lambda one: Camera.load(one))
    _cameras(axes)
    return axes


class NamedCamera(NamedTuple):
    """One camera of a recipe."""

    camera: Camera
    detectors: str  # as the recipe names them
    variant: str  # which of several, by the fields that no point of a summary has as its own


def _cameras(axes: Mapping[str, tuple[Any, ...]]) -> list[NamedCamera]:
    """Cameras of a product of axes, but those that cannot be; `InputError` where none can."""
    found, faults = list[NamedCamera](), list[str]()
    several = [name for name in axes if len(axes[name]) > 1 and name not in OWN_AXES]
    for _, fields in _product(axes):
        variant = ", ".join(f"{name} {fields[name]}" for name in several)
        try:
            camera, detectors = Camera.load(fields), str(fields.get("detectors", "1x1"))
            found.append(NamedCamera(camera, detectors, variant))
        except InputError as error:
            faults.append(error.message)
    if not found:
        raise InputError(faults[0])
    return found


def _training(given: Any) -> dict[str, tuple[Any, ...]]:
    return _table_of_axes(given, Training.model_validate)


def _tuned(given: Any) -> dict[str, dict[str, tuple[Any, ...]]]:
    axes, faults = {}, []
    for design, own in given.items() if isinstance(given, Mapping) else ():
        try:
            axes[check_design(design)] = _training(own)
        except (InputError, ValueError) as error:
            faults.append(Message("{design}: {error}", design=design, error=error))
    if faults:
        raise InputError(join_messages(faults))
    return axes


Name = Annotated[str, AfterValidator(check_design)]
Ratio = Annotated[float, Field(gt=0, le=1)]
TestNoise = Annotated[str, AfterValidator(check_noise)]
Axes = dict[str, Any]
Value = TypeVar("Value")
Axis = Annotated[tuple[Value, ...], BeforeValidator(axis)]
Filled = Annotated[Axis[Value], Field(min_length=1)]


class Recipe(UserModel):
    """A comparison: every list is an axis, and a single value stands for a list of one."""

    data: str = Field(default="digits", description="name, folder of images or .npz file")
    size: tuple[int, int] | None = Field(default=None, description="height, width of folder images")
    skip_bad: bool = Field(
        default=False, description="leave images that cannot be read out, and name them"
    )
    normal: str | None = Field(
        default=None,
        description="class to be told from anomalies; these are made from its own scenes",
    )
    images: int | None = Field(
        default=None, ge=1, description="training images that are taken; all unless given"
    )
    split: Literal["random", "blocks"] | None = Field(
        default=None,
        description="how a hyperspectral image is divided for testing; random unless given",
    )
    designs: Filled[Name] = Field(
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
    photons: Filled[PhotonBudget] = Field(
        default=(1e2, 1e3, 1e4, 1e5), description="budgets Φ: expected photons on the coding device"
    )
    gaussian_photons: Axis[PhotonBudget] = Field(
        default=(), description="budgets under gaussian noise, if others"
    )
    ratios: Axis[Ratio] = Field(
        default=(), description="readouts over pixels, m · D / N; the paper's unless given"
    )
    masks: Axis[Count] = Field(default=(), description="mask counts, instead of ratios")
    camera: Annotated[Axes, BeforeValidator(_camera)] = Field(
        default={},
        description="fields of the camera, each an axis; or a preset's name, or a TOML file",
    )
    exposure: Annotated[
        Axes, BeforeValidator(lambda given: _table_of_axes(given, find_exposure))
    ] = Field(
        default={}, description="settings of the exposure, each an axis, such as looks = [1, 4]"
    )
    trials: int = Field(default=1, ge=1, le=1000, description="seeds 0, 1, …")
    validation: int | None = Field(
        default=None,
        ge=0,
        description="training scenes held out to choose on; a sixth unless given",
    )
    folds: int | None = Field(
        default=None,
        ge=1,
        le=100,
        description="parts of the scenes, each tested by designs that are trained on the others; "
        f"1 for none. Unless given {FOLDS} where a test part was drawn and has fewer than "
        f"{FEW_IMAGES} scenes",
    )
    draws: int = Field(default=3, ge=1, le=MOST_DRAWS, description="noise draws of each test scene")
    test_photons: Axis[PhotonBudget] = Field(
        default=(), description="budgets of the tests; that of the training unless given"
    )
    test_noise: Axis[TestNoise] = Field(
        default=(), description="noises of the tests; that of the camera unless given"
    )
    test_levels: Filled[Levels] = Field(
        default=(0,),
        description="grey levels, dark included, of the masks shown in the tests; 0: as trained",
    )
    training: Annotated[Axes, BeforeValidator(_training)] = Field(
        default={}, description="settings of the training of every design, each an axis"
    )
    tuned: Annotated[dict[str, Any], BeforeValidator(_tuned)] = Field(
        default={}, description="the same for single designs"
    )
    resources: Resources = Field(
        default=Resources(), description="share of a Ray cluster that each batch of trials takes"
    )

    @model_validator(mode="after")
    def _one_or_the_other(self) -> "Recipe":
        if self.ratios and self.masks:
            raise ValueError(RATIOS_OR_MASKS)
        return self

    def cameras(self) -> list[NamedCamera]:
        """Cameras of the product of its axes, but those that cannot be."""
        return _cameras(self.camera)

    def exposures(self) -> list[tuple[str, Exposure]]:
        """Exposures of the product of its axes, with a name where there are several."""
        return [(variant, find_exposure(chosen)) for variant, chosen in _product(self.exposure)]

    @property
    def noises(self) -> tuple[str, ...]:
        """Noises of the cameras."""
        return tuple(dict.fromkeys(named.camera.noise_name for named in self.cameras()))

    def training_axes(self, design: str) -> dict[str, tuple[Any, ...]]:
        """Values of each setting of the training of a design."""
        axes = {**self.training, **self.tuned.get(design, {})}
        if not DESIGNS[design].learns_masks:
            axes = {name: axes[name] for name in axes if name not in MASK_SETTINGS}
        return axes

    @property
    def balances(self) -> bool:
        """True if any training weighs its classes: validation then goes by balanced accuracy."""
        return any(
            True in axes.get("balance", ()) for axes in (self.training, *self.tuned.values())
        )

    def trainings(self, design: str) -> Iterator[tuple[str, Settings]]:
        """Every setting of the training of a design, with a name where there are several."""
        axes = self.training_axes(design)
        both = len({value == MLP for value in axes.get("classifier", ())}) > 1
        for variant, chosen in _product(axes):
            if both:  # settings of the other kind of classifier are left out
                others = MLP_SETTINGS if chosen["classifier"] != MLP else OWN_SETTINGS
                chosen = {name: chosen[name] for name in chosen if name not in others}
                several = [name for name in chosen if len(axes[name]) > 1]
                variant = ", ".join(f"{name} {chosen[name]}" for name in several)
            yield variant, chosen

    def budgets(self, noise: str) -> tuple[float, ...]:
        """Budgets to train at under a noise."""
        alone = find_noise(noise).read_noise_alone
        return (self.gaussian_photons if alone else ()) or self.photons

    def mask_counts(
        self, design: str, data: Dataset, detectors: DetectorMap = ONE_DETECTOR
    ) -> list[int]:
        """Mask counts of one design: those asked for that it can have, else the most it can."""
        # a ratio is that of readouts, m · D / N, so that it means as much under several detectors.
        # Of adaptive masks, which share the light among their looks, ratios ask for one count: more
        # looks tell more
        low, high = count_allowed(design, data, detectors)
        asked = self.masks or [
            mask_count(ratio, data.pixels / detectors.count)
            for ratio in self.ratios or PAPER_RATIOS
        ]
        counts = sorted({count for count in asked if low <= count <= high}) or [high]
        if DESIGNS[design].adaptive and not self.masks:
            return [max((c for c in counts if c <= MOST_LOOKS), default=counts[0])]
        return counts

    def parts(self, data: Dataset) -> list[Dataset]:
        """The data, or its folds, on each of which all designs are trained and tested."""
        count = self.folds
        if count is None:
            count = FOLDS if data.drawn and len(data.x_test) < FEW_IMAGES else 1
        return [data] if count == 1 else data.folds(count)

    def held_out(self, data: Dataset) -> int:
        """Number of training scenes that are kept for validation."""
        return len(data.x_train) // 6 if self.validation is None else self.validation


def _product(axes: Mapping[str, tuple[Any, ...]]) -> Iterator[tuple[str, Settings]]:
    """Points of axes, with the values of those of several as a name."""
    several = [name for name, values in axes.items() if len(values) > 1]
    for values in product(*axes.values()):
        chosen = dict(zip(axes, values, strict=True))
        yield ", ".join(f"{name} {chosen[name]}" for name in several), chosen


def parts(file: Mapping[str, Any], quick: bool = False) -> dict[str, Settings]:
    """Settings of each recipe of a file, by the name of its part."""
    # A file without parts has one recipe, named "". `InputError` where `parts` or `quick` are
    # something else than tables, or nothing says what a coarse version is
    common = {name: value for name, value in file.items() if name not in ("parts", "quick")}
    coarse, own = _table(file, "quick"), _table(file, "parts") or {"": {}}
    found = {}
    for name in own:
        part = _table(own, name)
        quick_part = _table(part, "quick")
        settings = _merged(common, {key: part[key] for key in part if key != "quick"})
        if quick:
            if not (coarse or quick_part):
                raise InputError("this recipe has no [quick] table: run it whole")
            settings = _merged(_merged(settings, coarse), quick_part)
        found[name] = settings
    return found


def only(file: Mapping[str, Any], part: str | None = None, quick: bool = False) -> Settings:
    """Settings of one recipe of a file."""
    found = parts(file, quick)
    if part is None and "" not in found:
        raise InputError(
            f"the recipe has several parts, {', '.join(found)}: name one by the option --part of "
            "deepfsi sweep"
        )
    if part is not None and "" in found:
        raise InputError(f"the recipe has no parts: leave --part {part} out")
    if (part or "") not in found:
        raise InputError(f"the recipe has no part {part!r}: {closest_choice(str(part), found)}")
    return found[part or ""]


def _table(file: Mapping[str, Any], name: str) -> Settings:
    table = file.get(name, {})
    if not isinstance(table, dict):
        raise InputError(f"{name} of a recipe is a table, not {table!r}: write [{name}]")
    return table


def _merged(settings: Settings, changes: Settings) -> Settings:
    whole = dict(settings)
    for name, value in changes.items():
        here = whole.get(name)
        if isinstance(here, dict) and isinstance(value, dict):
            value = _merged(here, value)
        whole[name] = value
    return whole
