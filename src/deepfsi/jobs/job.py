"""Jobs: one design to be trained, with its camera, its exposure and the settings of the training.

Each setting is declared here, in `optics.camera` or in `design.exposure`, with the text that helps
to choose it. Options of the command line, keywords of `learn`, axes of recipes, records and tables
of the documents are made from these fields.
"""

from collections.abc import Collection, Mapping
from functools import partial
from typing import TYPE_CHECKING, Annotated, Any, Literal

from pydantic import AfterValidator, BeforeValidator, Field, model_validator

from deepfsi.base.errors import InputError, closest
from deepfsi.base.models import UserModel
from deepfsi.camera.camera import Camera
from deepfsi.camera.light import BUDGETS, check_budget, check_one_budget
from deepfsi.camera.names import MLP, VIT, NoiseSetting, Scale, Widths, noise_name
from deepfsi.design.exposure import (
    KINDS,
    AnyExposure,
    Exposure,
    Fixed,
    Patches,
    find_exposure,
)
from deepfsi.jobs.own_names import Classifier, Loss, classifier_name
from deepfsi.training.faults import of_adaptive_masks, of_few_counts, of_values

if TYPE_CHECKING:
    import numpy as np

    from deepfsi.datasets import Dataset
    from deepfsi.jobs.designs import Code
    from deepfsi.optics.detection import Detection
    from deepfsi.optics.noise import OwnNoise

Precision = Literal["auto", "float32", "bfloat16"]
"""Type of the products of training; "auto" is bfloat16 where its rounding is under the noise."""

REVISION = 5
"""Raised whenever a change makes the same job end in another design: old records then expire."""

MOST_EPOCHS = 100_000
"""Epochs of one training: far more than any has needed, and fewer than never end."""

VIT_SIZES = ("width", "depth", "heads", "hidden")
"""Arguments of that transformer."""

LearningRate = Annotated[float, Field(gt=0, allow_inf_nan=False)]
"""Above 0, finite."""


def _design(name: str) -> str:
    from deepfsi.jobs.designs import check_design

    return check_design(name)


def _start(name: str) -> str:
    from deepfsi.jobs.designs import DESIGNS

    if DESIGNS[_design(name)].make is None:
        raise InputError(f"masks cannot start from {name}: name a fixed design")
    return name


def _is_size(given: Any) -> bool:
    return isinstance(given, int) and not isinstance(given, bool) and given >= 1


def _widths(given: Any) -> Any:
    return [part for part in given.split(",") if part] if isinstance(given, str) else given


class Training(UserModel):
    """Settings of a training: its steps, its network, its precision and its start.

    Examples
    --------
    >>> import deepfsi
    >>> deepfsi.Training(epochs=20, hidden=(256, 128), start="class-pairs").lr
    0.01
    """

    epochs: int = Field(40, ge=1, le=MOST_EPOCHS, description="passes over the training scenes")
    batch: int | None = Field(
        None, ge=2, description="scenes of a step; a hundredth of all, 32 to 500, unless given"
    )
    lr: LearningRate = Field(
        1e-2,
        description="peak learning rate of a one-cycle schedule; the default holds where none was "
        "tuned for the design",
    )
    mask_lr: LearningRate = Field(
        1e-1, description="peak learning rate of the masks, relative to their rms"
    )
    hidden: Annotated[Widths, BeforeValidator(_widths)] = Field(
        (40, 128), description="widths of the hidden layers of mlp"
    )
    dropout: float = Field(0.0, ge=0, lt=1, description="share of hidden units left out in a step")
    classifier: Classifier = Field(
        MLP, description="mlp, or module:factory of a torch module of your own"
    )
    classifier_arguments: dict[str, Any] = Field(
        {}, description="keyword arguments of that factory, besides the numbers"
    )
    scale: Scale = Field("common", description="standard deviation of features: each, or common")
    decay: float = Field(
        0.0, ge=0, allow_inf_nan=False, description="decoupled weight decay of the classifier"
    )
    balance: bool = Field(
        False, description="weigh training scenes so that all classes count alike in the loss"
    )
    counts: float | None = Field(
        None,
        gt=0,
        allow_inf_nan=False,
        description="mean counts of an exposure: with photons, masks learn to count no more of "
        "them; without, the budget at which a design counts so many is found",
    )
    start: Annotated[str, AfterValidator(_start)] = Field(
        "pca",
        description="design that learned masks start from; unless given pca, for several looks "
        "class-pairs, for few counts random",
    )
    clusters: int | None = Field(
        None,
        ge=1,
        description="of adaptive masks: the prior is the centres of so many clusters of each "
        "class; all training scenes unless given",
    )
    precision: Precision = Field(
        "auto",
        description="number type of the products of learned masks and of wide networks: float32, "
        "bfloat16, or auto (bfloat16 where its rounding is below the noise)",
    )
    loss: Loss = Field(
        None,
        description="module:function of a loss of your own, of outputs (n, C) and truth (n,) of "
        "classes or (n, q) of values; cross entropy, or the squared error of values, unless given",
    )
    noise: NoiseSetting | None = Field(
        None,
        description="noise of the training, if other than the camera's: ml_gauss, poisson, "
        "gaussian, camera or none; unless given ml_gauss stands for photon noise, and several "
        "looks get exact counts",
    )

    @model_validator(mode="before")
    @classmethod
    def _arguments(cls, given: Any) -> Any:
        """The settings, with the keywords of a partial among the arguments of its function."""
        classifier = given.get("classifier", MLP) if isinstance(given, Mapping) else MLP
        if isinstance(classifier, str) or not callable(classifier):
            return given
        from deepfsi.design.own import describe

        _, arguments = describe(classifier, given.get("classifier_arguments"))
        if isinstance(classifier, partial):
            classifier = classifier.func
        return {**given, "classifier": classifier, "classifier_arguments": arguments}

    @property
    def own(self) -> bool:
        """True if the classifier is a user's own."""
        return classifier_name(self.classifier) not in (MLP, VIT)


TUNED: dict[str, dict[str, Any]] = {
    "impulse": {"lr": 5e-3},
    "truncated-hadamard": {"lr": 5e-3},
    "raster": {"lr": 5e-3, "scale": "each"},
    "hadamard": {"lr": 5e-3, "scale": "each"},
}
"""Where a design does better with other settings than the defaults of `Training`.

Chosen on the last 10 000 training images of MNIST at 1e3, 1e4 and 1e5 photons, each design from
the same grid: lr 2e-3, 5e-3, 1e-2; scale each, common; dropout 0, 0.1 (for those of a thousand
readouts at one setting at most). Designs not named here, but for learned ones and PCA, are untuned.
"""


FEW_COUNTS: dict[str, Any] = {"start": "random"}
"""Settings of a training for few counts, where none are given."""


class Job(UserModel):
    """One design to be trained.

    Settings of the training that are not given are those tuned for the design and its exposure.
    An exposure may be given by its settings, ``{"looks": 4}``, and a training by its fields.

    Examples
    --------
    >>> import deepfsi
    >>> job = deepfsi.Job(masks=10, photons=1e4, camera="two-arm", exposure={"looks": 4})
    >>> job.camera.rails, job.exposure, job.training.start
    ('dual', Looks(looks=4), 'class-pairs')
    """

    design: Annotated[str, AfterValidator(_design)] = Field(
        "deepfsi", description="which design: deepfsi, pca, raster, hadamard, …"
    )
    masks: int = Field(ge=1, description="number of masks, m")
    photons: Annotated[float, BeforeValidator(check_budget)] = Field(
        ge=BUDGETS[0],
        le=BUDGETS[1],
        description="budget Φ: expected photons on the coding device, LOW:HIGH for a range of "
        "budgets; flux times exposure of the camera unless given",
    )
    camera: Camera = Field(
        Camera(),
        description="the camera: a preset (dmd, dmd-2x2, dmd-4x4, two-arm, paper) or a "
        "TOML file; dmd unless given",
    )
    exposure: AnyExposure = Field(Fixed(), description="what is shown when")
    training: Training = Field(Training(), description="settings of the training")
    seed: int = Field(
        0,
        ge=0,
        lt=2**32,
        description="seed of the random numbers: the same one repeats the result exactly on one "
        "device",
    )

    @model_validator(mode="before")
    @classmethod
    def _completed(cls, given: Any) -> Any:
        """The settings, with what the camera, the exposure and the design imply of others."""
        if not isinstance(given, Mapping):
            return given
        for name in given.keys() - cls.model_fields.keys():
            table, field = owner(name)
            where = (
                f"give `{table}={{{field!r}: ...}}`" if table else closest(name, cls.model_fields)
            )
            raise InputError(f"a job has no setting {name!r}: {where}")
        camera, photons = Camera.load(given.get("camera")), given.get("photons")
        if photons is None:
            photons = check_one_budget(camera.budget, None)
        given = {**given, "camera": camera, "photons": photons}
        told = _training_of(given)
        exposure = find_exposure(given.get("exposure", {}))
        if isinstance(exposure, Exposure) and exposure.own_count and given.get("masks") is None:
            given["masks"] = exposure.own_count
        if not (isinstance(told, Mapping) and isinstance(exposure, Exposure)):
            return given
        for name in told:
            if name not in Training.model_fields:
                raise InputError(
                    f"a training has no setting {name!r}: {closest(name, Training.model_fields)}"
                )
        few = FEW_COUNTS if told.get("counts") is not None else {}
        usual = {**exposure.training, **TUNED.get(given.get("design", "deepfsi"), {}), **few}
        return {**given, "exposure": exposure, "training": {**usual, **told}}

    @property
    def code(self) -> "Code":
        """All that the design's name implies."""
        from deepfsi.jobs.designs import DESIGNS

        return DESIGNS[self.design]

    @property
    def draws(self) -> int:
        """Noise draws of a test of this design: one of adaptive masks, which take milliseconds."""
        return 1 if self.code.adaptive else 3

    @property
    def noise(self) -> str:
        """Name of the noise that is trained under."""
        own = self.training.noise
        if own is not None:
            return noise_name(own)
        known = self.camera.noise_name
        return known if self.training.counts else self.exposure.training_noise(known)

    @property
    def own_noise(self) -> "OwnNoise | None":
        """The noise that is trained under, where it is a user's own."""
        from deepfsi.optics.noise import resolve

        told = self.training.noise
        return resolve(self.camera.noise if told is None else told, self.camera.gates)[1]

    @property
    def optics(self) -> Camera:
        """The camera as the design has it: one with a detector for each pixel needs no other.

        Impulse imaging is `column` whatever else is compared, and a design of one rail has one.
        """
        told = self.exposure.optics(self.camera)
        if self.code.every_pixel:
            told = {"light": "column", "detectors": "1x1", "device": None, "shortest_dwell": 0.0}
        one_arm = self.code.adaptive and self.camera.light != "two-arm"
        if self.code.single_rail or one_arm:
            told |= {"rails": "single", "readout": "difference"}
        elif self.camera.rails == "single":
            told |= {"readout": "difference"}
        return self.camera.model_copy(update=told)

    @property
    def in_force(self) -> "Job":
        """The job with the camera as the design has it: what its record is a hash of."""
        return self.model_copy(update={"camera": self.optics})

    @property
    def drawn_from(self) -> str:
        """The named design whose matrix the masks are or start from."""
        return self.training.start if self.masks_from().code.learned else self.design

    def detection(self, image_shape: tuple[int, ...]) -> "Detection":
        """Detectors of scenes of a shape, and what is read of two rails."""
        return self.optics.detection(image_shape)

    def features(self, image_shape: tuple[int, ...]) -> int:
        """Numbers that are read of the masks of scenes of a shape, k."""
        return self.masks * self.detection(image_shape).width(self.optics.rail_count)

    def masks_from(self) -> "Job":
        """The job that makes the masks: of a design that learns them before, DeepFSI's."""
        under = self.code.learned_under
        if under is None:
            return self
        training = self.training.model_copy(update={"noise": under})
        return self.model_copy(update={"design": "deepfsi", "training": training})

    def check(self, data: "Dataset", matrix: "np.ndarray | None" = None) -> None:
        """Raise `InputError` for whatever the job asks that cannot be had on this data."""
        if faults := self.faults(data, matrix):
            raise InputError("; ".join(faults))

    def faults(self, data: "Dataset", matrix: "np.ndarray | None" = None) -> list[str]:
        """Everything that the job asks and that cannot be had on this data.

        The matrix (m, N) is of a design whose masks are the user's own.
        """
        faults = [*self._classifier_faults(), *self.exposure.faults(self)]
        if self.training.counts is not None:
            faults += of_few_counts(self, data.image_shape)
        if data.values:
            faults += of_values(self)
            if self.code.of_classes:  # it has no masks of such data, whose number could be told
                return faults
        if self.training.balance and self.training.loss is not None:
            faults.append("`balance` weighs the usual loss: leave it out, or `loss`")
        if self.code.signed and self.camera.rails == "single":
            faults.append(f"{self.design} is signed: use dual rails, or the s-matrix")
        if "gaussian" in (self.noise, self.masks_from().noise) and not self.camera.sigma:
            faults.append("gaussian noise is read noise: give `sigma` above 0")
        if self.code.adaptive:
            faults += of_adaptive_masks(self, data)
        if (matrix is not None) != self.code.own:
            faults.append(
                'a matrix goes with the custom design, and only with it: give `design="custom"` '
                "and `matrix`, or neither"
            )
        return [*faults, *self._matrix_faults(data, matrix)]

    def _matrix_faults(self, data: "Dataset", matrix: "np.ndarray | None") -> list[str]:
        import numpy as np

        from deepfsi.design.adaptive.posterior import LookOptics
        from deepfsi.jobs import designs as codes
        from deepfsi.jobs import tiles
        from deepfsi.optics import constraints

        camera = self.optics
        try:
            constraints.check_light(camera.light, camera.rails)
            scene = self.exposure.scene(data)
            camera.mask_levels(scene.image_shape)
            if self.code.adaptive:
                LookOptics.of(camera, scene.image_shape, self.photons)
            if matrix is None:
                tiles.check_count(self.design, self.masks, scene, self.detection(scene.image_shape))
            else:
                codes.check_matrix(np.asarray(matrix), (self.masks, data.pixels))
                constraints.own_rails(matrix, camera.light, camera.rails)
        except InputError as error:
            return [str(error)]
        return []

    def _classifier_faults(self) -> list[str]:
        usual, mine, faults = Training(), self.training, []
        if mine.classifier != MLP and (mine.hidden, mine.dropout) != (usual.hidden, usual.dropout):
            faults.append(
                "`hidden` and `dropout` are of the usual classifier: give them to a classifier of "
                "your own as its arguments"
            )
        if mine.classifier == VIT:
            if not isinstance(self.exposure, Patches):
                faults.append("vit reads patches, and nothing else does: give `patch`, or mlp")
            sizes = mine.classifier_arguments.items()
            if any(name not in VIT_SIZES or not _is_size(size) for name, size in sizes):
                faults.append(
                    f"vit cannot have {mine.classifier_arguments}: give whole numbers of "
                    f"{', '.join(VIT_SIZES)}"
                )
        if mine.classifier_arguments and mine.classifier == MLP:
            faults.append("arguments of a classifier go with one of your own: give `classifier`")
        return faults


ALIASES = {"dmd": ("camera", "device"), "train_noise": ("training", "noise")}
"""Table and field of single settings whose field's name is taken by another."""


def owner(setting: str) -> tuple[str, str]:
    """Table of a job that holds a setting, "" for its own fields, and the setting's name there."""
    # Three names have two owners. As single settings `dmd` is the camera's device, `train_noise`
    # the noise of the training, and `exposure` the camera's time
    if setting in ALIASES:
        return ALIASES[setting]
    tables: dict[str, Collection[str]] = {
        "camera": Camera.model_fields,
        "exposure": KINDS,
        "training": Training.model_fields,
    }
    return next((table for table, fields in tables.items() if setting in fields), ""), setting


def sorted_settings(flat: Mapping[str, Any]) -> dict[str, Any]:
    """Fields of a job of single settings, each where it is declared."""
    tables: dict[str, dict[str, Any]] = {"": {}, "camera": {}, "exposure": {}, "training": {}}
    for setting, value in flat.items():
        table, name = owner(setting)
        tables[table][name] = value
    job = tables.pop("")
    if fields := tables.pop("camera"):
        job["camera"] = Camera.load(job.get("camera"), **fields)
    return job | {name: table for name, table in tables.items() if table}


def find_job(settings: Mapping[str, Any], counts: float | None = None) -> Job:
    """Job of its fields, or `InputError`: its light is a budget, its camera's, or counts."""
    # Of counts alone the budget of the job is these, until a training says what it is
    within = counts is not None and settings.get("photons") is not None
    if within:
        settings = {**settings, "training": {**_training_of(settings), "counts": counts}}
    elif counts is not None:
        settings = {**settings, "photons": check_one_budget(None, counts)}
    job = Job(**settings)
    if counts is not None and not within and job.camera.noise_name == "click":
        raise InputError(
            "clicks are not in proportion to the light, so that they tell no budget: give "
            "`photons`, too"
        )
    if counts is not None and job.exposure.highest(1.0) != 1.0:
        raise InputError("counts are of one budget: leave the range of budgets, `span`, out")
    if job.training.clusters and not job.code.adaptive:
        raise InputError(
            '`clusters` are of adaptive masks: leave it out, or give `design="adaptive"`'
        )
    if "start" in _training_of(settings) and not job.code.learns_masks:
        raise InputError(
            f"`start` is of learned masks, and {job.design} has its own: leave it out, or give "
            '`design="deepfsi"`'
        )
    return job


def _training_of(settings: Mapping[str, Any]) -> Any:
    """Settings of the training that were given."""
    told = settings.get("training", {})
    if not isinstance(told, Training):
        return told
    return {name: getattr(told, name) for name in told.model_fields_set}
