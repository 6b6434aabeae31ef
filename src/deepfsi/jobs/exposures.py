"""Kinds of exposure: what is shown when, and what the network is told.

    Fixed     every mask once, each for its own dwell; all are needed for an answer
    Range     the same for a range of budgets, and the network is told the budget
    SharedLight  adaptive masks whose exposures end when a class is sure, at a mean budget

A kind has settings, which a job asks for, and an entry in the header of a design file. Old files
are read by these entries: no field of theirs may change its name, order or default. What a trained
design does with its masks is in `exposure`.
"""

from collections.abc import Iterator, Mapping
from dataclasses import replace
from functools import cache
from pkgutil import resolve_name
from typing import TYPE_CHECKING, Annotated, Any, ClassVar, Literal, get_args

import numpy as np
from pydantic import BeforeValidator, Field, SerializeAsAny

from deepfsi.base.errors import InputError, closest_choice
from deepfsi.base.models import Amount, Count, Positive, StrictModel, UserModel, of_kinds
from deepfsi.base.registry import installed
from deepfsi.camera.camera import Camera
from deepfsi.camera.names import LIGHT_LAWS, find_noise
from deepfsi.datasets.dataset import Dataset
from deepfsi.jobs.training import MOST_READY

if TYPE_CHECKING:
    from deepfsi.jobs.job import Job


class Exposure(UserModel):
    """Settings of an exposure, which shows every mask once."""

    training: ClassVar[dict[str, Any]] = {"start": "pca"}  # defaults of the training
    side_by_side: ClassVar[bool] = True  # jobs that differ in budget and seed train together
    features: ClassVar[str] = ""  # parts of scenes that a classifier reads; "" for whole scenes
    allow_bf16: ClassVar[bool] = True  # masks may be multiplied in bfloat16

    # Import path of the training of its masks
    trained_by: ClassVar[str] = "deepfsi.exposure.training:fixed_training"

    # Header entry, which only exposures of packages beside the core declare here
    entry_type: ClassVar[type["Entry"]]

    def allow_bf16_networks(self, device: str, wide: bool) -> bool:
        """True if networks are faster in bfloat16: wide ones, on a processor."""
        return device == "cpu" and wide

    def highest(self, photons: float) -> float:
        """Highest budget of a training whose lowest is `photons`."""
        return photons

    @property
    def most_light(self) -> float:
        """Largest light of one exposure, as a multiple of the budget; above 1 that is a mean."""
        return 1.0

    @property
    def fixed_mask_count(self) -> int | None:
        """Number of masks, if the exposure fixes it."""
        return None

    def optics(self, camera: Camera) -> dict[str, Any]:
        """Fields of the camera that the exposure decides."""
        return {}

    def describe(self, camera: Camera) -> str:
        """The camera and how it exposes, in a few lines."""
        return camera.describe()

    def view(self, data: Dataset) -> Dataset:
        """The data as the masks see it: whole scenes."""
        return data

    def scene(self, data: Dataset) -> Dataset:
        """One training scene as the masks see it: its shape, and the classes."""
        return self.view(replace(data, x_train=data.x_train[:1], y_train=data.y_train[:1]))

    def faults(self, job: "Job") -> Iterator[str]:
        """Yield a sentence for each setting of a job that this exposure cannot have."""
        yield from ()


class Entry(StrictModel, strict=True):
    """Entry of a design file's header: no further fields, and no conversions."""

    features: ClassVar[str] = ""  # as in `Exposure`
    no_frames: ClassVar[str] = ""  # why frames of a device cannot show the masks
    restored_by: ClassVar[str] = "deepfsi.exposure.kind:MaskExposure"  # import path

    def mask_shape(self, image_shape: tuple[int, ...]) -> tuple[int, ...]:
        """Shape of a mask."""
        return image_shape


class Fixed(Exposure):
    """Every mask is shown once, for a dwell of its own, and all are needed for an answer.

    Examples
    --------
    >>> import deepfsi
    >>> deepfsi.Job(masks=10, photons=1e4).exposure == deepfsi.Fixed()
    True
    """


class FixedEntry(Entry):
    """Header entry of fixed masks, each with its dwell."""

    kind: Literal["fixed"] = "fixed"


class Range(Exposure):
    """One design for a range of budgets, which are log-uniform in its training.

    Examples
    --------
    >>> import deepfsi
    >>> deepfsi.Range(span=1e4).highest(1e2)
    1000000.0
    """

    trained_by: ClassVar[str] = "deepfsi.exposure.training:ConditionedTraining"
    span: float = Field(gt=1, le=1e12, description="highest budget over the lowest, `photons`")

    def highest(self, photons: float) -> float:
        """The upper end of the range."""
        return photons * self.span

    def faults(self, job: "Job") -> Iterator[str]:
        """Refuse a training noise other than MLGauss, and the control group's."""
        alone = "a range of budgets is trained under ml_gauss: leave out"
        if job.facts.learned_under:
            yield f"{alone} {job.design}, whose masks learn under {job.facts.learned_under} noise"
        elif not find_noise(job.noise).stands_for:
            yield f"{alone} {job.noise} noise, or train under ml_gauss"
        elif job.camera.fluctuation:
            yield f"{alone} fluctuation"


class ConditionedEntry(Entry):
    """Header entry of fixed masks whose classifier has the budget as an input."""

    photons: Positive  # lowest budget of the training
    span: Annotated[float, Field(ge=1, allow_inf_nan=False)]  # highest over lowest
    masks: Count  # m
    nested: Literal[0] = 0  # files of earlier versions have it
    width: Count = 1  # features of each mask
    used: Positive = 1.0  # share of the light law that the masks take
    kind: Literal["conditioned"] = "conditioned"
    restored_by: ClassVar[str] = "deepfsi.exposure.kind:ConditionedExposure"


def _registered_entry(kind: Any) -> type[Entry] | None:
    """Entry of a kind that a package beside the core registered."""
    _, path = installed().schemes.get(str(kind), ((), ""))
    return resolve_name(path).entry_type if path else None


_Entries = FixedEntry | ConditionedEntry
ExposureEntry = Annotated[
    SerializeAsAny[Annotated[_Entries, Field(discriminator="kind")]],
    of_kinds(get_args(_Entries), _registered_entry),
]
"""Field of a header that says how known masks are exposed."""


class SharedLight(Exposure):
    """Adaptive masks that share light: the budget is the mean light of all exposures.

    An exposure ends when the probability of one class reaches a threshold, or when it has taken
    `cap` times the budget. The training chooses the threshold so that its scenes, each left out of
    the prior, take the budget on average.

    Examples
    --------
    >>> import deepfsi
    >>> seen = deepfsi.SharedLight(cap=2)
    >>> deepfsi.Job(design="adaptive", masks=32, photons=1e4, exposure=seen).exposure.cap
    2.0
    """

    cap: float = Field(
        gt=1,
        le=100,
        description="largest light of one exposure with adaptive masks, as a multiple of the mean; "
        "exposures end when one class is certain; by default all take the same",
    )

    @property
    def most_light(self) -> float:
        """The cap."""
        return self.cap

    def faults(self, job: "Job") -> Iterator[str]:
        """Refuse masks that are not adaptive."""
        if not job.facts.adaptive:
            yield '`cap` is of exposures that may end early: give `design="adaptive"` or no cap'


class AdaptiveMasks(UserModel):
    """Settings of adaptive masks, each made from the counts so far."""

    # Files hold these names. Later fields are left out at their defaults: older files stay the same
    looks: int = Field(default=16, ge=1, le=1024, strict=True)  # masks shown one after another
    growth: float = Field(default=1.0, ge=1e-3, le=1e3)  # light of the last look over the first's
    until: float = Field(default=1.0, gt=0, le=1)  # probability that ends an exposure; 1 for never
    components: int = Field(default=120, ge=1, strict=True)  # principal components of scenes

    # Distance of scenes from those of the prior, over that of neighbours in it
    spread: Amount = 0.7

    # Clusters of each class whose centres stand for its scenes; None for all scenes
    clusters: int | None = Field(default=None, ge=1, strict=True)

    # Light of all looks over the budget, which is the mean of exposures that stop
    cap: float = Field(default=1.0, ge=1, le=100, exclude_if=lambda cap: cap == 1)

    # For a detector that clicks at most once a look: nats about the class that a click must tell,
    # and price in clicks of a photon on the device
    price: Amount | None = Field(default=None, exclude_if=lambda price: price is None)
    light_price: Amount = Field(default=0.0, exclude_if=lambda price: price == 0)

    # Masks that stay on the device, of which each look shows one; None for masks made anew
    dictionary: int | None = Field(
        default=None, ge=1, le=MOST_READY, strict=True, exclude_if=lambda count: count is None
    )

    @property
    def shares(self) -> list[float]:
        """Share of the budget that each look takes; their sum is `cap`."""
        times = self.growth ** np.linspace(0, 1, self.looks)
        return (self.cap * (times / times.sum())).tolist()

    @staticmethod
    def check_camera(camera: Camera) -> None:
        """Raise `InputError` where a camera shows no binary masks, or has read noise."""
        if not LIGHT_LAWS[camera.light].looks:
            advice = "give the light law free-dwell or two-arm"
            raise InputError(
                f"adaptive masks are shown by one device, not {camera.light}: {advice}"
            )
        noise = camera.noise_facts
        if not noise.counting or (noise.read_noise and camera.sigma) or camera.fluctuation:
            raise InputError(
                "adaptive masks are for photon counts or clicks of steady light: give poisson "
                "noise, click noise, or camera noise of dark counts alone, without `fluctuation`"
            )
        # A posterior for clicks has one outcome a look: a click or none
        many = camera.gates != 1 or not camera.one_detector or LIGHT_LAWS[camera.light].arms > 1
        if noise.gates and many:
            raise InputError(
                "adaptive masks for clicks have one detector, which clicks at most once a look: "
                'leave `gates` and `detectors` out, and give `light="free-dwell"`'
            )


@cache
def exposure_kinds() -> dict[str, type[Exposure]]:
    """Kinds of exposure by the setting that asks for one; the first that is set counts."""
    schemes = installed().schemes.values()
    core: dict[str, type[Exposure]] = {"span": Range, "cap": SharedLight}
    return core | {name: resolve_name(path) for names, path in schemes for name in names}


def find_exposure(settings: Any) -> Exposure:
    """Exposure of its settings: none for `Fixed`, ``{"span": 10}`` for `Range`, and so on."""
    if isinstance(settings, Exposure):
        return settings
    if not isinstance(settings, Mapping):
        raise InputError(f"exposure = {settings!r}: give a table of settings, or an exposure")
    # In an axis of a recipe 1 asks for no range, and for no shared light
    neutral = {name for name in ("span", "cap") if str(settings.get(name)) in ("1", "1.0")}
    asked = {name: value for name, value in settings.items() if name not in neutral}
    kinds = exposure_kinds()
    for name, kind in kinds.items():
        if name in asked:
            return kind(**asked)  # which refuses settings of other kinds
    for name in asked:
        raise InputError(f"an exposure has no setting {name!r}: {closest_choice(name, kinds)}")
    return Fixed()


ExposureSource = Exposure | Mapping[str, Any]
"""An exposure, or its settings."""

AnyExposure = Annotated[SerializeAsAny[Exposure], BeforeValidator(find_exposure)]
"""Field of a model: an exposure, or its settings."""
