"""Recipes name axes; a trial is a point of them: one training and its tests.

A recipe is a TOML file or `Recipe(...)`. Every list in it is an axis, in its training settings too,
and `plan` gives the trials of their product.

A file may hold several parts of a study, and a coarse version of each. Settings at its top hold for
every part. `[parts.NAME]` overrides them in one part, `[quick]` in the coarse version, and
`[parts.NAME.quick]` in the coarse version of one part. Tables are merged.
"""

import re
from collections.abc import Iterator, Mapping
from itertools import product
from typing import Annotated, Any, Literal, TypeVar

from pydantic import AfterValidator, BaseModel, BeforeValidator, ConfigDict, Field, model_validator

from deepfsi.datasets import Dataset
from deepfsi.design.evaluation import MOST_DRAWS
from deepfsi.errors import InputError, as_input_error, check_known, closest
from deepfsi.imports import PATTERN
from deepfsi.optics import codes, tiles
from deepfsi.optics.budget import BUDGETS
from deepfsi.optics.constraints import Light
from deepfsi.optics.detection import ONE, Detection, Readout
from deepfsi.optics.noise import check_noise
from deepfsi.optics.rails import RailsKind
from deepfsi.sweeps.workers import Resources
from deepfsi.training.job import MLP, Levels, TrainingNoise, TrainingSettings, training_for

PAPER_RATIOS = tuple((k / 10) ** 2 for k in range(1, 11))
"""1, 4, 9, … 100 %."""

Settings = dict[str, Any]
"""Fields of a recipe, as TOML gives them."""

TRAINING_NOISE = {
    "poisson": "ml_gauss",
    "gaussian": "gaussian",
    "camera": "camera",
    "none": "none",
}
"""For each noise of a camera, the one that is trained under."""


def training_noise(noise: str) -> str:
    """Noise to train under where tests are under another, or `InputError` if it is no camera's.

    A user's own noise is trained under itself.
    """
    if not re.fullmatch(PATTERN, noise):
        check_known("noise", noise, TRAINING_NOISE)
    return TRAINING_NOISE.get(noise, noise)


def _physical(noise: str) -> str:
    training_noise(noise)
    return noise


Physical = Annotated[str, AfterValidator(_physical)]
Noise = Annotated[str, AfterValidator(check_noise)]

RATIOS_OR_MASKS = "give ratios or masks, not both"
"""Said where a recipe has both."""

MASK_SETTINGS = ("start", "mask_lr")
"""Settings of the training that only learned masks have."""

MLP_SETTINGS, OWN_SETTINGS = ("hidden", "dropout"), ("classifier_arguments",)
"""Settings of the training that only the usual classifier has, and those of one's own."""


def axis(value: Any) -> Any:
    """Values of an axis, each once; a single value is an axis of one."""
    if not isinstance(value, (list, tuple)):
        return (value,)
    try:
        return tuple(dict.fromkeys(value))
    except TypeError:  # of tables or lists: they are refused one by one
        return tuple(value)


def _settings(given: dict[str, Any]) -> dict[str, tuple[Any, ...]]:
    """Fields of `TrainingSettings`, each an axis, all of whose values are allowed."""
    axes = {}
    for name, value in given.items():
        one = not isinstance(value, (list, tuple)) or (
            name == "hidden" and not any(isinstance(part, (list, tuple)) for part in value)
        )
        axes[name] = (value,) if one else tuple(value)
    faults = []
    for name, values in axes.items():
        if not values:
            faults.append(f"{name} is empty: give one value or more")
        for value in values:
            try:
                with as_input_error():
                    TrainingSettings.model_validate({name: value})
            except InputError as error:
                faults.append(str(error))
    if faults:
        raise ValueError("; ".join(faults))
    return axes


def _tuned(given: dict[str, Any]) -> dict[str, dict[str, tuple[Any, ...]]]:
    axes, faults = {}, []
    for design, own in given.items():
        try:
            codes.check_design(design)
        except InputError as error:
            faults.append(str(error))
        try:
            if not isinstance(own, dict):
                raise ValueError(f"{own!r} is no table of training settings")
            axes[design] = _settings(own)
        except ValueError as error:
            faults.append(f"{design}: {error}")
    if faults:
        raise ValueError("; ".join(faults))
    return axes


Name = Annotated[str, AfterValidator(codes.check_design)]
Budget = Annotated[float, Field(ge=BUDGETS[0], le=BUDGETS[1])]
Ratio = Annotated[float, Field(gt=0, le=1)]
Count = Annotated[int, Field(ge=1)]
Axes = Annotated[dict[str, Any], AfterValidator(_settings)]
Value = TypeVar("Value")
Axis = Annotated[tuple[Value, ...], BeforeValidator(axis)]
Filled = Annotated[Axis[Value], Field(min_length=1)]


class Recipe(BaseModel):
    """Comparison. Each tuple is an axis; a single value stands for an axis of one."""

    model_config = ConfigDict(frozen=True, extra="forbid")

    data: str = Field("digits", description="name, folder of images or .npz file")
    size: tuple[int, int] | None = Field(None, description="height, width of folder images")
    split: Literal["random", "blocks"] | None = Field(
        None, description="how a hyperspectral image is divided for testing; random unless given"
    )
    designs: Filled[Name] = Field(
        (
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
    photons: Filled[Budget] = Field(
        (1e2, 1e3, 1e4, 1e5), description="budgets Φ: expected photons on the coding device"
    )
    gaussian_photons: Axis[Budget] = Field(
        (), description="budgets under gaussian noise, if others"
    )
    ratios: Axis[Ratio] = Field(
        (), description="readouts over pixels, m · D / N; the paper's unless given"
    )
    masks: Axis[Count] = Field((), description="mask counts, instead of ratios")
    noise: Filled[Physical] = Field(
        ("poisson",), description="noise of the camera: poisson, gaussian, camera, none or your own"
    )
    train_noise: Axis[TrainingNoise] = Field(
        (), description="noises of the training, if others: photon noise is trained by ml_gauss"
    )
    sigma: float = Field(
        1.0,
        gt=0,
        allow_inf_nan=False,
        description="read noise of gaussian and camera noise, counts rms per readout",
    )
    dark: float = Field(
        0.0,
        ge=0,
        allow_inf_nan=False,
        description="dark counts of a detector in an exposure, under camera noise",
    )
    light: Filled[Light] = Field(("column",), description="light laws")
    rails: Filled[RailsKind] = Field(
        ("dual",), description="dual: signed masks of two frames each; single: non-negative masks"
    )
    detectors: Filled[str] = Field(
        ("1x1",),
        description="detectors on parts of the device: ROWSxCOLUMNS, bands, or a .npy map",
    )
    readout: Axis[Readout] = Field(
        (), description="what is read of two rails; both for two-arm, else difference unless given"
    )
    trials: int = Field(1, ge=1, le=1000, description="seeds 0, 1, …")
    validation: int | None = Field(
        None, ge=0, description="training scenes held out to choose on; a sixth unless given"
    )
    draws: int = Field(3, ge=1, le=MOST_DRAWS, description="noise draws of each test scene")
    test_photons: Axis[Budget] = Field(
        (), description="budgets of the tests; that of the training unless given"
    )
    test_noise: Axis[Noise] = Field(
        (), description="noises of the tests; that of the training unless given"
    )
    test_levels: Filled[Levels] = Field(
        (0,),
        description="grey levels, dark included, of the masks shown in the tests; 0: continuous",
    )
    training: Axes = Field({}, description="fields of TrainingSettings, for every design")
    tuned: Annotated[dict[str, Any], AfterValidator(_tuned)] = Field(
        {}, description="the same for single designs"
    )
    resources: Resources = Field(
        Resources(), description="share of a Ray cluster that each batch of trials takes"
    )

    @model_validator(mode="after")
    def _one_or_the_other(self) -> "Recipe":
        if self.ratios and self.masks:
            raise ValueError(RATIOS_OR_MASKS)
        if self.dark and "camera" not in (*self.noise, *self.train_noise, *self.test_noise):
            raise ValueError("dark counts are of camera noise: give noise camera with them")
        return self

    def training_axes(self, design: str) -> dict[str, tuple[Any, ...]]:
        """Values of each setting of the training of a design."""
        axes = {**self.training, **self.tuned.get(design, {})}
        if not codes.has_learned_masks(design):
            axes = {name: axes[name] for name in axes if name not in MASK_SETTINGS}
        return axes

    @property
    def balances(self) -> bool:
        """True if any training weighs its classes: validation then goes by balanced accuracy."""
        return any(
            True in axes.get("balance", ()) for axes in (self.training, *self.tuned.values())
        )

    def trainings(self, design: str) -> Iterator[tuple[str, TrainingSettings]]:
        """Every setting of the training of a design, with a name where there are several."""
        axes = self.training_axes(design)
        several = [name for name, values in axes.items() if len(values) > 1]
        both = len({value == MLP for value in axes.get("classifier", ())}) > 1
        for values in product(*axes.values()):
            chosen = dict(zip(axes, values, strict=True))
            if both:  # settings of the other kind of classifier are left out
                for name in MLP_SETTINGS if chosen["classifier"] != MLP else OWN_SETTINGS:
                    chosen.pop(name, None)
            variant = ", ".join(f"{name} {chosen[name]}" for name in several if name in chosen)
            yield variant, training_for(design, **chosen)

    def train_noises(self, noise: str) -> tuple[str, ...]:
        """Noises to train under where tests are under `noise`."""
        return self.train_noise or (training_noise(noise),)

    def budgets(self, noise: str) -> tuple[float, ...]:
        """Budgets to train at under a noise."""
        return (self.gaussian_photons if noise == "gaussian" else ()) or self.photons

    def mask_counts(self, design: str, data: Dataset, detection: Detection = ONE) -> list[int]:
        """Mask counts of one design: those asked for that it can have, else the most it can have.

        Without ratios and masks, the ratios 1, 4, 9, … 100 % of the paper. A ratio is that of
        readouts, m · D / N, so that it means as much under several detectors.

        Parameters
        ----------
        design : str
            A key of `codes.DESIGNS`.
        data : Dataset
        detection : Detection
        """
        low, high = tiles.count_allowed(design, data, detection)
        asked = self.masks or [
            codes.mask_count(ratio, data.pixels / detection.count)
            for ratio in self.ratios or PAPER_RATIOS
        ]
        return sorted({count for count in asked if low <= count <= high}) or [high]

    def held_out(self, data: Dataset) -> int:
        """Number of training scenes that are kept for validation."""
        return len(data.x_train) // 6 if self.validation is None else self.validation


def parts(file: Mapping[str, Any], quick: bool = False) -> dict[str, Settings]:
    """Settings of each recipe of a file, by the name of its part.

    A file without parts has one recipe, named "". `InputError` where `parts` or `quick` are
    something else than tables, or nothing says what a coarse version is.
    """
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
        raise InputError(f"the recipe has no part {part!r}: {closest(str(part), found)}")
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
