"""Jobs: one design with its light, noise and settings, checked before any work."""

import re
from collections.abc import Sequence
from typing import Annotated, Any, Literal

import numpy as np
import torch
from pydantic import AfterValidator, BaseModel, ConfigDict, Field
from torch import Tensor

from deepfsi.datasets import Dataset
from deepfsi.design.adaptive import LOOKING
from deepfsi.design.conditioning import Conditioning
from deepfsi.errors import InputError
from deepfsi.imports import PATTERN, UNNAMED
from deepfsi.optics import codes, constraints, tiles
from deepfsi.optics.budget import BUDGETS
from deepfsi.optics.constraints import Light
from deepfsi.optics.detection import ONE, Detection, Readout
from deepfsi.optics.features import Scale
from deepfsi.optics.noise import check_noise
from deepfsi.optics.rails import RailsKind

Precision = Literal["auto", "float32", "bfloat16"]
"""Type of the products of training; "auto" is bfloat16 where its rounding is under the noise."""

REVISION = 3
"""Raised whenever a change makes the same job end in another design: old records then expire."""

BFLOAT16_COUNTS = 2.0**14
"""Largest share of the budget a readout may have for bfloat16 products in training, Φ / readouts.

Rounding to 8 bits is wrong by at most 2⁻⁹ of the count, √2¹⁴ · 2⁻⁹ = 1/4 of its photon noise.
"""

BFLOAT16_WIDTH = 512
"""Units of the widest hidden layer from which a processor is faster with bfloat16 networks.

In float32 an epoch with layers of 512 and 256 takes 1.5 times as long, with 256 and 128 as long,
and with 40 and 128 eight tenths as long (`benchmarks/networks.py`).
"""


MOST_EPOCHS = 100_000
"""Epochs of one training: far more than any has needed, and fewer than never end."""

LearningRate = Annotated[float, Field(gt=0, allow_inf_nan=False)]
"""Above 0, finite."""


def _start(name: str) -> str:
    if codes.DESIGNS[codes.check_design(name)].learned or name in ("control", "custom"):
        raise InputError(f"masks cannot start from {name}: name a fixed design")
    return name


Start = Annotated[str, AfterValidator(_start)]
"""Name of a design with a matrix of its own."""


def _levels(count: int) -> int:
    if count == 1:
        raise InputError("one grey level is dark alone: give 2 or more, or 0 for continuous masks")
    return count


Levels = Annotated[int, Field(ge=0, le=2**24), AfterValidator(_levels)]
"""Grey levels, dark included; 0 for continuous masks."""


MLP = "mlp"
"""Name of the paper's classifier in settings."""


ONE_DEVICE = (
    "several detectors are parts of one device, and column is other optics: give light "
    "equal-dwell, free-dwell or two-arm"
)
"""Said where detectors are asked for under the light law `column`."""


def _classifier(name: str) -> str:
    if name not in (MLP, UNNAMED) and not re.fullmatch(PATTERN, name):
        raise ValueError(f"give {MLP}, or module:factory of your own")
    return name


class TrainingSettings(BaseModel):
    """Settings of a training; all designs that train together share them."""

    model_config = ConfigDict(frozen=True, extra="forbid")

    epochs: int = Field(40, ge=1, le=MOST_EPOCHS, description="passes over the training scenes")
    batch: int | None = Field(None, ge=2, description="a hundredth of the scenes, 32 to 500")
    lr: LearningRate = Field(1e-2, description="peak of the one-cycle schedule")
    mask_lr: LearningRate = Field(1e-1, description="the same for masks, relative to their rms")
    hidden: tuple[Annotated[int, Field(ge=1)], ...] = Field(
        (40, 128), description="widths of the hidden layers of mlp"
    )
    dropout: float = Field(0.0, ge=0, lt=1, description="share of hidden units left out in a step")
    classifier: Annotated[str, AfterValidator(_classifier)] = Field(
        MLP,
        description="mlp, or module:factory of your own; own: given as an object",
    )
    classifier_arguments: dict[str, Any] = Field(
        {}, description="keyword arguments of that factory, besides the numbers"
    )
    scale: Scale = Field("common", description="standard deviation of features")
    decay: float = Field(
        0.0, ge=0, allow_inf_nan=False, description="decoupled weight decay of the classifier"
    )
    balance: bool = Field(
        False, description="weigh scenes so that every class counts alike in the loss"
    )
    start: Start = Field("pca", description="design that learned masks start from")
    precision: Precision = Field(
        "auto",
        description="type of the products of learned masks, and on a processor of networks with a "
        f"layer of {BFLOAT16_WIDTH} or more; auto: bfloat16 where its rounding is below the noise",
    )
    levels: Levels = Field(
        0, description="grey levels of the device, dark included, that masks are made of; 0: any"
    )

    span: float = Field(
        1.0,
        ge=1,
        le=1e12,
        description="budgets of the training range log-uniformly from `photons` to span times that",
    )
    nested: int = Field(
        0, ge=0, description="fewest masks, first ones, that must do for a class; 0: all are needed"
    )

    looks: int = Field(
        1,
        ge=1,
        le=64,
        description="looks of an exposure; from 2 on, counts choose the dwells of the next. Train "
        "with `noise` poisson: a look shows many masks too shortly for MLGauss",
    )
    shortest_dwell: float = Field(
        0.0,
        ge=0,
        lt=1,
        description="shortest dwell of a frame that the device shows, a share of the exposure: "
        "frames below it are not shown, and their time is shared out among the others",
    )

    @property
    def own(self) -> bool:
        """True if the classifier is a user's own."""
        return self.classifier != MLP

    @property
    def conditioned(self) -> bool:
        """True if budget and number of masks shown are inputs of the classifier."""
        return self.span > 1 or self.nested > 0


TUNED: dict[str, dict[str, Any]] = {
    "impulse": {"lr": 5e-3},
    "truncated-hadamard": {"lr": 5e-3},
    "raster": {"lr": 5e-3, "scale": "each"},
    "hadamard": {"lr": 5e-3, "scale": "each"},
}
"""Where a design does better with other settings than the defaults of `TrainingSettings`.

Chosen on the last 10 000 training images of MNIST at 1e3, 1e4 and 1e5 photons, each design from
the same grid: lr 2e-3, 5e-3, 1e-2; scale each, common; dropout 0, 0.1 (for those of a thousand
readouts at one setting at most). Designs not named here, but for learned ones and PCA, are untuned.
"""


def training_for(design: str, **settings: Any) -> TrainingSettings:
    """Settings of a design: the defaults, those tuned for the design, then `settings`.

    Masks of several looks start from `class-pairs` (0.866 on MNIST's validation images at 1e4
    photons, 64 masks and 4 looks; 0.845 from principal components).
    """
    looking = {"start": "class-pairs"} if settings.get("looks", 1) != 1 else {}
    return TrainingSettings(**{**TUNED.get(design, {}), **looking, **settings})


def _noise(name: str) -> str:
    return name if name == UNNAMED else check_noise(name)


TrainingNoise = Annotated[str, AfterValidator(_noise)]
"""Name or import path of a noise that masks and classifier are trained under."""


class Job(BaseModel):
    """One design to be trained: what it is, and the light and noise it is trained under."""

    model_config = ConfigDict(frozen=True, extra="forbid")

    design: str = Field("deepfsi", description="name of the design")
    masks: int = Field(ge=1, description="number of masks, m")
    photons: float = Field(
        ge=BUDGETS[0], le=BUDGETS[1], description="budget Φ: expected photons on the coding device"
    )
    noise: TrainingNoise = Field("ml_gauss", description="noise of the training")
    sigma: float = Field(
        1.0, gt=0, allow_inf_nan=False, description="read noise, counts rms per readout"
    )
    dark: float = Field(
        0.0, ge=0, allow_inf_nan=False, description="dark counts of a detector in an exposure"
    )
    light: Light = Field("column", description="light law")
    rails: RailsKind = Field("dual", description="signed masks, or non-negative ones")
    detectors: str | tuple[int, ...] = Field(
        "1x1",
        description="ROWSxCOLUMNS of parts of the device with a detector each; or each pixel's",
    )
    readout: Readout | None = Field(
        None,
        description="difference, or both: what the network reads of two rails; both for two-arm "
        "unless given",
    )
    seed: int = Field(0, ge=0, lt=2**32, description="repeats the training exactly on one device")
    training: TrainingSettings = Field(TrainingSettings(), description="settings of the training")

    def conditioning(self, image_shape: tuple[int, ...]) -> Conditioning | None:
        """Conditioning inputs of the classifier for scenes of a shape, if it has any."""
        settings = self.training
        if not settings.conditioned:
            return None
        width = self.detection(image_shape).width({"dual": 2, "single": 1}[self.optics[1]])
        return Conditioning(self.photons, settings.span, self.masks, settings.nested, width)

    @property
    def code(self) -> codes.Code:
        """Properties of the named design; `InputError` if it does not exist."""
        return codes.DESIGNS[codes.check_design(self.design)]

    @property
    def drawn_from(self) -> str:
        """The named design whose matrix the masks are or start from."""
        return self.training.start if self.masks_from().code.learned else self.design

    @property
    def optics(self) -> tuple[Light, RailsKind]:
        """Constraint and rails in force: designs with one rail by definition keep it.

        Impulse imaging has a detector for each pixel, which is `column` whatever else is compared.
        """
        light: Light = "column" if self.design == "impulse" else self.light
        return light, "single" if self.code.single_rail else self.rails

    def detection(self, image_shape: tuple[int, ...]) -> Detection:
        """Detectors of scenes of a shape, and what is read of two rails.

        Impulse imaging has a detector for each pixel of the scene, whatever else is compared.
        """
        if self.design == "impulse":
            return ONE
        return Detection.of(self.detectors, image_shape, self._read)

    @property
    def _read(self) -> Readout:
        usual: Readout = "both" if self.optics[0] == "two-arm" else "difference"
        return self.readout or usual

    @property
    def in_force(self) -> "Job":
        """Job with the light, rails, detectors and readout that its design has.

        Impulse imaging has a detector for each pixel, and a single rail is read as it is.
        """
        light, rails = self.optics
        readout = self._read if rails == "dual" else None
        told: dict[str, Any] = {"light": light, "rails": rails, "readout": readout}
        if self.design == "impulse":
            told["detectors"] = "1x1"
        return self.model_copy(update=told)

    def companions(self, device: torch.device) -> tuple[Any, ...]:
        """Key that jobs trained together share: all but budget, sigma and seed."""
        # a module of a user's own may draw from torch's global generator: one after another
        apart = set() if self.training.own else {"photons", "sigma", "seed"}
        return (self.model_dump_json(exclude=apart), dtypes(self, device))

    def masks_from(self) -> "Job":
        """The job that makes the masks: for the control group DeepFSI under gaussian noise."""
        if self.design != "control":
            return self
        return self.model_copy(update={"design": "deepfsi", "noise": "gaussian"})


def seeds_of_matrices(jobs: Sequence[Job]) -> list[int]:
    """Seed of each matrix that jobs trained together are drawn from; one where all share it."""
    seeds = [job.seed for job in jobs]
    return seeds if jobs[0].drawn_from == "random" and len(set(seeds)) > 1 else seeds[:1]


def product_dtype(job: Job, device: torch.device) -> torch.dtype:
    """Type of the products of learned masks: bfloat16 where that stays under the readout noise."""
    if job.training.precision == "auto" and job.training.looks > 1:
        return torch.float32  # bfloat16 was not tried
    return _rounded(job, device)


def network_dtype(job: Job, device: torch.device) -> torch.dtype:
    """Type of the products of the networks in training: bfloat16 for wide ones on a processor."""
    wide = max(job.training.hidden, default=0) >= BFLOAT16_WIDTH
    if device.type != "cpu" or job.training.own or not wide:
        return torch.float32
    return _rounded(job, device)


def dtypes(job: Job, device: torch.device) -> tuple[torch.dtype, torch.dtype]:
    """Types of the products of a job's masks and of its networks."""
    return product_dtype(job.masks_from(), device), network_dtype(job, device)


def _rounded(job: Job, device: torch.device) -> torch.dtype:
    """Type whose rounding stays under the readout noise, unless one was asked for.

    See `BFLOAT16_COUNTS`. Read noise of σ counts stands in for √count under gaussian noise. The
    light of all masks may come to the first of nested ones, and with looks to a single readout.
    """
    if job.training.precision != "auto":
        return getattr(torch, job.training.precision)
    fast = (
        torch.cuda.is_bf16_supported(including_emulation=False)
        if device.type == "cuda"
        else torch.cpu.get_capabilities().get("avx512_bf16", False)
    )
    masks = 1 if job.training.looks > 1 else job.training.nested or job.masks
    readouts = masks * (2 if job.optics[1] == "dual" else 1)
    counts = job.photons * job.training.span / readouts
    limit = {
        "ml_gauss": BFLOAT16_COUNTS,
        "poisson": BFLOAT16_COUNTS,
        "camera": BFLOAT16_COUNTS,
        "gaussian": job.sigma * BFLOAT16_COUNTS**0.5,
    }
    return torch.bfloat16 if fast and counts <= limit.get(job.noise, 0) else torch.float32


def check_job(job: Job, data: Dataset, matrix: np.ndarray | None = None) -> None:
    """Raise `InputError` for whatever a job asks that cannot be had on this data.

    Shapes: matrix (m, N).
    """
    if faults := job_faults(job, data, matrix):
        raise InputError("; ".join(faults))


def job_faults(job: Job, data: Dataset, matrix: np.ndarray | None = None) -> list[str]:
    """Everything that a job asks and that cannot be had on this data.

    Parameters as for `check_job`.
    """
    faults = _classifier_faults(job.training)
    if job.training.looks > 1:
        faults += _look_faults(job)
    if job.training.shortest_dwell:
        faults += _dwell_faults(job)
    if job.training.conditioned and job.masks_from().noise != "ml_gauss":
        control = "the control group, whose masks learn under gaussian noise"
        faults.append(
            "a range of budgets and nested masks are trained under ml_gauss: leave out "
            + (control if job.design == "control" else "`noise` and `train_noise`")
        )
    if job.training.nested > job.masks:
        faults.append(
            f"the first {job.training.nested} of {job.masks} masks cannot be nested: give at most "
            f"{job.masks}"
        )
    if job.design == "hadamard" and job.rails == "single":
        faults.append("hadamard is signed: use dual rails, or the s-matrix")
    if (matrix is not None) != (job.design == "custom"):
        faults.append(
            'a matrix goes with the custom design, and only with it: give `design="custom"` and '
            "`matrix`, or neither"
        )
    try:
        constraints.check_light(*job.optics)
        detection = job.detection(data.image_shape)
        if detection.count > 1 and job.light == "column":
            raise InputError(ONE_DEVICE)
        if matrix is None:
            tiles.check_count(job.design, job.masks, data, detection)
        else:
            codes.check_matrix(np.asarray(matrix), (job.masks, data.pixels))
            own_rails(matrix, *job.optics)
    except InputError as error:
        faults.append(str(error))
    return faults


def own_rails(matrix: np.ndarray, light: Light, rails: RailsKind) -> Tensor:
    """Rails (2 or 1, m, N) of a user's matrix (m, N), or `InputError` if it breaks its constraint.

    Parameters as for `constraints.expand`.
    """
    signed = torch.from_numpy(np.asarray(matrix, dtype=np.float32))
    return constraints.check(constraints.expand(signed, light, rails), light)


def check_jobs(
    jobs: Sequence[Job], data: Dataset, device: torch.device, matrix: np.ndarray | None = None
) -> Job:
    """Return the first of jobs that are to be trained together, each checked.

    Parameters as for `check_job`.
    """
    if len({job.companions(device) for job in jobs}) > 1:
        raise ValueError("jobs that train together may differ in photons, sigma and seed only")
    for job in jobs:
        check_job(job, data, matrix)
    return jobs[0]


def _classifier_faults(settings: TrainingSettings) -> list[str]:
    usual, faults = TrainingSettings(), []
    if settings.own and (settings.hidden, settings.dropout) != (usual.hidden, usual.dropout):
        faults.append(
            "`hidden` and `dropout` are of the usual classifier: give them to a classifier of your "
            "own as its arguments"
        )
    if settings.classifier_arguments and not settings.own:
        faults.append("arguments of a classifier go with one of your own: give `classifier`")
    return faults


def _dwell_faults(job: Job) -> list[str]:
    shortest, looks = job.training.shortest_dwell, job.training.looks
    if looks == 1 and not (job.code.learned and job.optics[0] in LOOKING):
        return [
            "a shortest dwell goes with dwells that are learned or chosen: give deepfsi with "
            '`light="free-dwell"` or "two-arm", or several looks'
        ]
    if shortest * looks > 1:
        return [
            f"a frame lasts {shortest:g} of the exposure at least, and a look {1 / looks:g}: give "
            "fewer looks, or a longer exposure"
        ]
    return []


def _look_faults(job: Job) -> list[str]:
    faults = []
    if job.design in ("impulse", "control", "custom"):
        faults.append(
            f"{job.design} has one look only: several looks are for deepfsi and for named designs "
            "that one device shows"
        )
    light, rails = job.optics
    if light not in LOOKING:
        faults.append(
            f"several looks choose how long one device shows each frame, not {light}: use "
            '`light="free-dwell"` or "two-arm"'
        )
    elif (light, rails) == ("free-dwell", "dual") and job.readout != "both":
        faults.append(
            "several looks show each rail for a time of its own, whose counts are to be read by "
            'themselves: use `readout="both"`, or `rails="single"`'
        )
    if job.training.conditioned or job.noise not in ("ml_gauss", "poisson"):
        faults.append(
            "several looks are for one budget under photon noise: leave a range of budgets, "
            "`nested` and other noise out"
        )
    return faults
