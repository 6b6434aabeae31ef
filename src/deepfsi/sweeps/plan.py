"""Trials of a recipe on its data, each one training and its tests, and what speaks against them."""

import functools
import hashlib
import json
from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass
from itertools import islice, product
from typing import Any

import numpy as np
from pydantic import Field

from deepfsi.base.errors import InputError, as_input_error
from deepfsi.base.models import StrictModel
from deepfsi.base.registry import source_hash
from deepfsi.camera.detectors import ONE_DETECTOR
from deepfsi.camera.names import LIGHT_LAWS
from deepfsi.datasets.dataset import Dataset
from deepfsi.jobs.designs import DESIGNS
from deepfsi.jobs.exposures import Exposure
from deepfsi.jobs.job import REVISION, Job, custom_parts
from deepfsi.sweeps.recipe import CameraVariant, Recipe, TestNoise

MOST_TRIALS = 100_000
"""Trials of a recipe at most: months of training, whose records still fit the memory."""

ADAPTIVE_SCENES = 5000
"""Scenes with which adaptive masks are compared unasked, at most: each look takes a millisecond."""

KEY_SCHEMA = 6
"""Version of what the keys of trials are hashes of."""

_NAMING_FIELDS = {"data", "trained_under", "variant", "detectors"}
"""Fields of a trial that only name what other fields hold."""

_TEST_FIELDS = {"draws", "test_photons", "test_noise", "test_levels"}
"""Fields of a trial that its training does not depend on."""


class Trial(StrictModel):
    """One training and its tests, with all that the result depends on."""

    job: Job = Field(description="design that is trained, and its light and noise")
    trained_under: str = Field("", description="noise of the training")
    variant: str = Field("", description="which of several settings, in words")
    detectors: str = Field("1x1", description="name of its detectors: as given, or of their map")
    data: str = Field(description="name")
    data_hash: str = Field(description="of scenes and labels")
    matrix_hash: str = Field("", description="of your own masks")
    source_hash: str = Field("", description="of the files of your own classifier, loss and noise")
    validation: int = Field(description="training scenes held out")
    draws: int = Field(description="noise draws of each test scene")
    test_photons: tuple[float, ...] = Field(description="budgets of the tests")
    test_noise: tuple[TestNoise, ...] = Field(description="noises of the tests")
    test_levels: tuple[int, ...] = Field(
        (0,), description="grey levels of the masks in the tests, dark included; 0: continuous"
    )

    @functools.cached_property
    def key(self) -> str:
        """Content hash that names the record."""
        return self._hash(_NAMING_FIELDS)

    @functools.cached_property
    def design_key(self) -> str:
        """Content hash that names the design: of what the training depends on."""
        return self._hash(_NAMING_FIELDS | _TEST_FIELDS)

    def _hash(self, exclude: set[str]) -> str:
        settings = self.model_dump(mode="json", exclude=exclude)
        return _content_hash({"schema": KEY_SCHEMA, "revision": REVISION, **settings})


def plan_trials(recipe: Recipe, data: Dataset, matrix: np.ndarray | None = None) -> list[Trial]:
    """All trials of a recipe, each once.

    Left out is what cannot be: the control group, masks of gaussian noise under photon noise, where
    there is none; designs of one rail on two arms; the signed Hadamard basis on a single rail;
    several detectors under the law of other optics, `column`.

    Shapes: matrix (m, N).
    """
    plan = _Plan(recipe, data, matrix)
    if faults := plan.faults():
        raise InputError("; ".join(faults))
    trials: dict[str, Trial] = {}
    hash_of_file = functools.cache(source_hash)
    matrix_hash = "" if matrix is None else _matrix_hash(matrix)
    for named, variant, job in plan.jobs():
        test_noise = plan.test_noise(job)
        custom = custom_parts(job, *test_noise)
        trial = Trial(
            job=job,
            trained_under=job.noise,
            variant=variant,
            detectors="1x1" if job.code.every_pixel else named.detectors,
            data=data.name,
            data_hash=data.hash,
            matrix_hash=matrix_hash if job.code.is_custom else "",
            source_hash=_content_hash({"sources": [*map(hash_of_file, custom)]}) if custom else "",
            validation=recipe.held_out(data),
            draws=recipe.draws,
            test_photons=recipe.test_photons or (job.photons,),
            test_noise=test_noise,
            test_levels=recipe.test_levels,
        )
        trials[trial.key] = trial
    return list(trials.values())


def check_settings(
    settings: Mapping[str, Any],
    load: Callable[[Recipe], Dataset],
    matrix: np.ndarray | None = None,
) -> tuple[Recipe, Dataset]:
    """Recipe of settings, and its data; `matrix` (m, N) holds the user's masks."""
    with as_input_error():
        recipe = Recipe.model_validate(settings)
    if matrix is not None and "custom" not in recipe.designs:
        recipe = recipe.model_copy(update={"designs": (*recipe.designs, "custom")})
    data = load(recipe)
    plans = [_Plan(recipe, fold, matrix) for fold in recipe.parts(data)]
    if faults := dict.fromkeys(fault for plan in plans for fault in plan.faults()):
        raise InputError("; ".join(faults))
    return recipe, data


def with_adaptive(recipe: Recipe, data: Dataset) -> Recipe:
    """The recipe with adaptive masks too, where they can be had and do not take long."""
    scenes = len(data.x_train) + len(data.x_test)
    alone = recipe.model_copy(update={"designs": ("adaptive",)})
    if (
        data.measure != "accuracy"
        or scenes > ADAPTIVE_SCENES
        or recipe.test_noise
        or _Plan(alone, data).faults()
    ):
        return recipe
    return recipe.model_copy(update={"designs": (*recipe.designs, "adaptive")})


@dataclass(frozen=True)
class _Plan:
    """Recipe, its data, and the user's masks (m, N)."""

    recipe: Recipe
    data: Dataset
    matrix: np.ndarray | None = None

    def jobs(self) -> Iterator[tuple[CameraVariant, str, Job]]:
        """Yield camera, variant of the settings, and job of every trial that can be."""
        recipe = self.recipe
        pairs = (
            (*pair, *exposure) for pair in self._pairs() for exposure in recipe.exposures(pair[1])
        )
        for named, design, exposure_variant, exposure in pairs:
            for masks, (training_variant, training), seed, photons in product(
                self._mask_counts(design, named, exposure),
                recipe.trainings(design),
                range(recipe.trials),
                recipe.budgets(named.camera.noise_name),
            ):
                job = Job(
                    design=design,
                    masks=masks,
                    photons=photons,
                    camera=named.camera,
                    exposure=exposure,
                    training=training,
                    seed=seed,
                )
                variants = (named.variant, training_variant, exposure_variant)
                yield named, ", ".join(filter(None, variants)), job.resolved

    def test_noise(self, job: Job) -> tuple[str, ...]:
        """Noises of the tests of a job."""
        return self.recipe.test_noise or (job.camera.noise_name,)

    def faults(self) -> list[str]:
        """Everything that trials ask and that cannot be had, each once."""
        pixels = self.data.pixels
        if (most := max(self.recipe.masks, default=1)) > pixels:
            return [f"{most} masks are not allowed on {self.data.name}: give 1 to {pixels}"]
        try:
            training = self._training_data
            jobs = [job for _, _, job in islice(self.jobs(), MOST_TRIALS + 1)]
        except InputError as error:  # too few scenes, or such that an exposure cannot see
            return [str(error)]
        if len(jobs) > MOST_TRIALS:
            return [f"a recipe has at most {MOST_TRIALS} trials: take less"]
        if not jobs:
            cameras = [named.camera for named in self.recipe.cameras()]
            lights = ", ".join(dict.fromkeys(camera.light for camera in cameras))
            rails = ", ".join(dict.fromkeys(camera.rails for camera in cameras))
            return [
                f"nothing to compare: {', '.join(self.recipe.designs)} cannot be had under "
                f"{', '.join(self.recipe.noises)} noise with {lights} light and {rails} rails "
                "(control is for photon noise, two-arm for dual rails)"
            ]
        faults: dict[str, None] = {}
        custom: dict[str, None] = {}
        for job in jobs:
            masks = self.matrix if job.code.is_custom else None
            job_faults = job.faults(training, masks)
            if masks is not None and not job_faults:
                job_faults = _light_faults(job, masks)
            faults |= dict.fromkeys(job_faults)
            custom |= dict.fromkeys(custom_parts(job, *self.test_noise(job)))
        for name in custom:
            try:
                source_hash(name)
            except InputError as error:
                faults[str(error)] = None
        return list(faults)

    @property
    def _training_data(self) -> Dataset:
        """The data as trainings see them: without those to choose on."""
        count = self.recipe.held_out(self.data)
        return self.data.hold_out(count) if count else self.data

    def _pairs(self) -> Iterator[tuple[CameraVariant, str]]:
        """Yield every camera with every design that it can have."""
        for named, design in product(self.recipe.cameras(), self.recipe.designs):
            camera = named.camera
            code = DESIGNS[design]
            law = LIGHT_LAWS[camera.light]
            detectors = camera.detector_map(self.data.image_shape).count
            if not (
                (code.learned_under is not None and not camera.noise_facts.exact)
                or (law.arms == 2 and code.rails == "single" and not code.every_pixel)
                or (code.rails == "dual" and camera.rails == "single")
                or (not law.one_device and detectors > 1)
                or (code.adaptive and not law.looks)
            ):
                yield named, design

    def _mask_counts(self, design: str, named: CameraVariant, exposure: Exposure) -> list[int]:
        """Mask counts of a design for scenes as its masks see them."""
        code = DESIGNS[design]
        scene = exposure.scene(self.data)
        if exposure.fixed_mask_count:
            return [exposure.fixed_mask_count]
        if code.is_custom and self.matrix is not None:
            return [len(self.matrix)]
        one = code.every_pixel
        detectors = ONE_DETECTOR if one else named.camera.detector_map(scene.image_shape)
        return self.recipe.mask_counts(design, scene, detectors)


def _light_faults(job: Job, matrix: np.ndarray) -> list[str]:
    """Why a user's masks (m, N) cannot be shown under a camera's light law."""
    from deepfsi.physics.laws import light_law

    try:
        light_law(job.optics.light).rails_of(matrix, job.optics.rails)
    except InputError as error:
        return [str(error)]
    return []


def _content_hash(settings: Mapping[str, Any]) -> str:
    """Hash of settings, JSON types only."""
    return hashlib.sha256(json.dumps(settings, sort_keys=True).encode()).hexdigest()[:24]


def _matrix_hash(matrix: np.ndarray) -> str:
    return hashlib.sha256(np.ascontiguousarray(matrix, dtype=np.float32).tobytes()).hexdigest()
