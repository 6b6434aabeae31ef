"""Jobs: each is one design to train, with its camera, exposure and training.

Each setting is declared once, here, in `training`, in `exposures` or in the camera, with a text
that helps to choose it. These fields become options of the command line, keywords of `learn`, axes
of recipes, keys of records, and tables of the pages.
"""

from collections.abc import Iterator, Mapping
from typing import TYPE_CHECKING, Annotated, Any

import numpy as np
from pydantic import AfterValidator, BeforeValidator, Field, model_validator

from deepfsi.base.errors import InputError
from deepfsi.base.models import UserModel
from deepfsi.base.registry import UNNAMED_PLUGIN
from deepfsi.camera.camera import Camera
from deepfsi.camera.light import PhotonBudget, check_budget
from deepfsi.camera.names import LIGHT_LAWS, NOISES, check_light_law, find_noise, noise_name
from deepfsi.datasets.dataset import Dataset
from deepfsi.jobs.designs import DESIGNS, DesignFacts, check_count, check_design, count_allowed
from deepfsi.jobs.exposures import AdaptiveMasks, AnyExposure, Fixed, SharedLight, find_exposure
from deepfsi.jobs.training import MLP, TUNED, Training, find_classifier, part_name

FEW_SCENES = 1000
"""Training sets below this size are learned by heart, so folds of them calibrate a design."""

REVISION = 5
"""Raised when a change makes the same job end in another design, so that old records expire."""


class Job(UserModel):
    """One design to train.

    The training's defaults are tuned for the design and its exposure. Give an exposure or a
    training as an object or as its fields, such as ``{"span": 100}``.

    Examples
    --------
    >>> import deepfsi
    >>> job = deepfsi.Job(masks=10, photons=1e4, camera="two-arm", exposure={"span": 100})
    >>> job.camera.rails, job.exposure, job.training.start
    ('dual', Range(span=100.0), 'pca')
    """

    design: Annotated[str, AfterValidator(check_design)] = Field(
        default="deepfsi", description="which design: deepfsi, pca, raster, hadamard, …"
    )
    masks: int = Field(ge=1, description="number of masks, m")
    photons: Annotated[PhotonBudget, BeforeValidator(check_budget)] = Field(
        description="budget Φ: expected photons on the coding device, LOW:HIGH for a range of "
        "budgets; default: flux times exposure of the camera"
    )
    camera: Camera = Field(
        default=Camera(),
        description="the camera: a preset (dmd, dmd-2x2, dmd-4x4, two-arm, paper) or a "
        "TOML file; default: dmd",
    )
    exposure: AnyExposure = Field(default=Fixed(), description="what is shown when")
    training: Training = Field(default=Training(), description="settings of the training")
    seed: int = Field(
        default=0,
        ge=0,
        lt=2**32,
        description="seed of the random numbers: the same one repeats the result exactly on one "
        "device",
    )

    if TYPE_CHECKING:  # a field has one type, and may be given as others

        def __init__(self, **fields: Any) -> None: ...

    @model_validator(mode="before")
    @classmethod
    def _completed(cls, fields: Any) -> Any:
        """The fields, with defaults that follow from the camera, the exposure and the design."""
        if not isinstance(fields, Mapping):
            return fields
        fields = {name: value for name, value in fields.items() if value is not None}
        camera = Camera.load(fields.get("camera"))
        fields = {"photons": camera.budget, **fields, "camera": camera}
        if fields["photons"] is None:
            raise InputError(
                "the light of a design is told once: give `photons`, the budget on the device, or "
                "a camera with its flux"
            )
        exposure = find_exposure(fields.get("exposure", {}))
        if exposure.fixed_mask_count:
            fields.setdefault("masks", exposure.fixed_mask_count)
        training = _training_settings(fields)
        few = {"start": "random"} if training.get("counts") is not None else {}
        usual = {**exposure.training, **TUNED.get(fields.get("design", "deepfsi"), {}), **few}
        return {**fields, "exposure": exposure, "training": Training(**{**usual, **training})}

    @property
    def facts(self) -> DesignFacts:
        """Facts that the design's name implies."""
        return DESIGNS[self.design]

    @property
    def noise(self) -> str:
        """Name of the noise of the training."""
        if self.training.noise is not None:
            return noise_name(self.training.noise)
        noise = self.camera.noise_name
        return noise if self.training.counts else find_noise(noise).trains_as or noise

    @property
    def optics(self) -> Camera:
        """The camera as the design uses it.

        A detector for each pixel means `column` light and no device, whatever the camera; a design
        of one rail has one.
        """
        changes = self.exposure.optics(self.camera)
        if self.facts.every_pixel:
            changes = {"light": "column", "detectors": "1x1", "device": None, "shortest_dwell": 0.0}
        one_arm = self.facts.adaptive and LIGHT_LAWS[self.camera.light].arms == 1
        if self.facts.rails == "single" or one_arm:
            changes |= {"rails": "single", "readout": "difference"}
        elif self.camera.rails == "single":
            changes |= {"readout": "difference"}
        return self.camera.model_copy(update=changes)

    @property
    def start_matrix(self) -> str:
        """Named design whose matrix the masks are, or start from."""
        return self.training.start if self.mask_job().facts.learned else self.design

    def features(self, image_shape: tuple[int, ...]) -> int:
        """Number of features k that the network reads of a scene of this shape."""
        camera = self.optics
        rails = camera.rail_count if camera.readout == "both" else 1
        return self.masks * rails * camera.detector_map(image_shape).count

    def mask_job(self) -> "Job":
        """The job that makes the masks: for a control group a DeepFSI job under another noise."""
        under = self.facts.learned_under
        if under is None:
            return self
        training = self.training.model_copy(update={"noise": under})
        return self.model_copy(update={"design": "deepfsi", "training": training})

    def check(self, data: Dataset, matrix: np.ndarray | None = None) -> None:
        """Raise `InputError` with all `faults` on this data."""
        if faults := self.faults(data, matrix):
            raise InputError("; ".join(faults))

    def faults(self, data: Dataset, matrix: np.ndarray | None = None) -> list[str]:
        """A sentence for each setting that cannot be had on this data.

        Whether a user's own matrix (m, N) breaks the light law is checked when it becomes rails.
        """
        faults = [*self._basic_faults(), *self.exposure.faults(self)]
        if self.training.counts is not None:
            faults += self._few_counts_faults(data.image_shape)
        if data.values:
            faults += self._value_faults()
            if self.facts.of_classes:  # no masks can be made of such data, nor their number checked
                return faults
        if self.facts.adaptive:
            faults += self._adaptive_faults(data)
        try:
            self._check_masks(data, matrix)
        except InputError as error:
            faults.append(str(error))
        return faults

    def _check_masks(self, data: Dataset, matrix: np.ndarray | None) -> None:
        """Raise `InputError` for masks that the camera cannot show, or this data cannot give."""
        camera = self.optics
        check_light_law(camera.light, camera.rails)
        scene = self.exposure.scene(data)
        camera.mask_levels(scene.image_shape)
        if self.facts.adaptive:
            AdaptiveMasks.check_camera(camera)
        if (matrix is not None) != self.facts.is_custom:
            raise InputError('a matrix goes with `design="custom"` alone: give both, or neither')
        if matrix is None:
            check_count(self.design, self.masks, scene, camera.detector_map(scene.image_shape))
            return
        array = np.asarray(matrix)
        real = array.dtype.kind in "biuf" and array.shape == (self.masks, data.pixels)
        # Comparisons of NaN are false, too
        if not real or not 0 < np.abs(array, dtype=float).max() < 1e30:
            wanted = f"({self.masks}, {data.pixels}) finite real numbers that are not all zero"
            raise InputError(f"a matrix of shape {array.shape} does not fit: give {wanted}")

    def _basic_faults(self) -> Iterator[str]:
        """Yield faults that the job has on any data."""
        training = self.training
        name = part_name(training.classifier)
        facts = find_classifier(name)
        if facts.features != self.exposure.features:
            seen = self.exposure.features or "whole scenes"
            yield f"{name} does not read features of {seen}: give another `classifier`"
        if training.balance and training.loss is not None:
            yield "`balance` weighs the usual loss: leave it out, or `loss`"
        sizes = training.classifier_arguments
        integers = all(type(size) is int and size > 0 for size in sizes.values())
        if not training.is_custom and not (integers and sizes.keys() <= {*facts.sizes}):
            names = ", ".join(facts.sizes) or "none"
            yield f"{training.classifier} cannot have {sizes}: give whole numbers of {names}"
        if self.facts.rails == "dual" and self.camera.rails == "single":
            yield f"{self.design} is signed: use dual rails, or the s-matrix"
        noises = [find_noise(noise) for noise in (self.noise, self.mask_job().noise)]
        if any(noise.read_noise_alone for noise in noises) and not self.camera.sigma:
            yield "gaussian noise is read noise: give `sigma` above 0"

    def _few_counts_faults(self, image_shape: tuple[int, ...]) -> Iterator[str]:
        """Yield faults of a job whose mean counts are set below its budget."""
        camera = self.optics
        counts = self.training.counts or 0.0
        noise = find_noise(self.noise)
        if self.facts.adaptive and self.camera.clicks is not None:
            return  # fewer than any number: exposures end where a click is not worth its price
        if not (self.facts.learned and isinstance(self.exposure, Fixed) and noise.counting):
            counting = ", ".join(name for name, facts in NOISES.items() if facts.counting)
            yield (
                "counts within a budget are of learned masks that are shown once each, trained "
                f"under {counting} noise, or of adaptive masks for clicks: leave `counts` "
                'out, or give `design="deepfsi"` without span, or `noise="click"`'
            )
            return
        most = self.photons
        limit = "the photons of its budget"
        if noise.gates:
            readouts = self.masks * camera.rail_count * camera.detector_map(image_shape).count
            most = min(most, readouts * camera.gates)
            limit = "the clicks of all its gates"
        if counts >= most:
            yield f"{counts:g} counts are not fewer than {most:g}, {limit}: give fewer"

    def _value_faults(self) -> Iterator[str]:
        """Yield faults of a job on scenes with values: settings that need classes."""
        start = self.training.start
        if self.facts.of_classes:
            yield f"{self.design} is of classes, and these scenes have values: give another design"
        elif self.facts.learns_masks and DESIGNS[start].of_classes:
            yield f'{start} is of classes, and these scenes have values: give `start="pca"`'
        if self.training.balance:
            yield "`balance` is of classes, and these scenes have values: leave it out"

    def _adaptive_faults(self, data: Dataset) -> Iterator[str]:
        """Yield faults of a job of adaptive masks."""
        scenes = len(data.x_train)
        fewest = int(np.bincount(data.y_train, minlength=len(data.classes)).min())
        clicks = self.camera.clicks is not None
        cap = self.exposure.most_light
        if (clusters := self.training.clusters or 0) > fewest // 2:
            yield f"{clusters} clusters of each class are too many: give at most {fewest // 2}"
        if not isinstance(self.exposure, Fixed | SharedLight):
            yield "adaptive masks have a look each: give no span"
        if self.masks < cap:
            first = f"{cap / self.masks:.3g} of the budget"
            yield f"the first of {self.masks} looks takes {first}: give more, or a lower `cap`"
        needed = FEW_SCENES if clicks else 50 if cap > 1 else 0
        if scenes < needed:
            what = "what a click is worth" if clicks else "the mean light of exposures that stop"
            yield f"{scenes} training scenes say too little of {what}: give {needed} or more"
        if clicks and cap > 1:
            yield "exposures of adaptive masks for clicks end by themselves: leave `cap` out"
        many = LIGHT_LAWS[self.optics.light].arms > 1 or not self.optics.one_detector
        if self.training.dictionary and (clicks or many):
            yield "a `dictionary` is for one detector and one arm, which count: leave it out"
        if self.training.classifier != MLP:
            yield "adaptive masks are read by their posterior: leave `classifier` out"
        shortest = self.camera.shortest_share
        if shortest * self.masks > cap:
            most = int(cap / shortest)
            yield f"{self.masks} looks are shorter than a picture: give at most {most} masks"


def job_of(
    settings: Mapping[str, Any],
    data: Dataset,
    *,
    counts: float | None = None,
    matrix: np.ndarray | None = None,
) -> Job:
    """Job that a user asks for, with the counts and the matrix (m, N) of `learn`."""
    fields = {name: value for name, value in settings.items() if value is not None}
    if matrix is not None:
        fields = {"design": "custom", "masks": len(matrix), **fields}
    training = _training_settings(fields)
    if counts is not None:
        fields["training"] = {**training, "counts": counts}
    facts = DESIGNS[check_design(str(fields.get("design", "deepfsi")))]
    # One mask stands in until the job's camera says how many pixels each detector sees
    unknown = facts.complete and "masks" not in fields
    job = Job(**fields, **({"masks": 1} if unknown else {}))
    if unknown:
        scene = job.exposure.scene(data)
        _, most = count_allowed(job.design, scene, job.optics.detector_map(scene.image_shape))
        job = job.model_copy(update={"masks": most})
    unused = {"clusters", "dictionary"}
    if facts.adaptive:
        unused = Training.model_fields.keys() - unused - {"counts"}
    elif not facts.learns_masks:
        unused |= {"start", "start_counts"}
    for name in sorted(training.keys() & unused):
        raise InputError(
            f"{facts.title} has no use for `{name}`: leave it out, or give another design"
        )
    return job


def _training_settings(settings: Mapping[str, Any]) -> Mapping[str, Any]:
    """Settings of the training that are set, of the fields of a job."""
    training = settings.get("training", {})
    if isinstance(training, Training):
        return {name: getattr(training, name) for name in training.model_fields_set}
    if not isinstance(training, Mapping):
        raise InputError(f"training = {training!r}: give a table of settings, or Training")
    return training


def custom_parts(job: Job, *noises: str) -> list[str]:
    """Import paths of a user's own parts in a job and in further noises, or `UNNAMED_PLUGIN`."""
    parts = part_name(job.training.classifier), part_name(job.training.loss) or ""
    names = {job.noise, *noises, *parts}
    return sorted(name for name in names if ":" in name or name == UNNAMED_PLUGIN)
