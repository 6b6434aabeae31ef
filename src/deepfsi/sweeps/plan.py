"""Trials of a recipe on its data, each one training and its tests, and what speaks against them."""

import functools
import hashlib
import json
from collections.abc import Callable, Iterator, Mapping
from itertools import product
from typing import Any

import numpy as np
from pydantic import Field

from deepfsi.base.errors import InputError, as_input_error
from deepfsi.base.models import StrictModel
from deepfsi.base.registry import source_hash
from deepfsi.camera.camera import Camera
from deepfsi.camera.detectors import ONE_DETECTOR
from deepfsi.camera.names import LIGHT_LAWS
from deepfsi.datasets.dataset import Dataset
from deepfsi.jobs.designs import DESIGNS, count_allowed, mask_count
from deepfsi.jobs.exposures import Exposure
from deepfsi.jobs.job import REVISION, Job, custom_parts
from deepfsi.sweeps.recipe import CameraVariant, Recipe, TestNoise

PAPER_RATIOS = tuple((k / 10) ** 2 for k in range(1, 11))
"""Ratios of readouts to pixels in the paper: 1, 4, 9, … 100 %."""

ADAPTIVE_SCENES = 5000
"""Scenes with which adaptive masks are compared unasked, at most: each look takes a millisecond."""

KEY_SCHEMA = 6
"""Version of the fields that the keys of trials are hashes of."""

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
    """All trials of a recipe, each once; `InputError` names all that cannot be had.

    Designs that a camera cannot have are left out. `matrix` (m, N) holds the user's masks.
    """
    if (most := max(recipe.masks, default=1)) > data.pixels:
        raise InputError(f"{most} masks are not allowed on {data.name}: give 1 to {data.pixels}")
    planned = list(_jobs(recipe, data, matrix))
    if not planned:
        raise InputError(
            f"nothing to compare: {', '.join(recipe.designs)} cannot be had with this light and "
            "noise: control is for photon noise, two-arm for dual rails"
        )
    held_out = recipe.held_out(data)
    training = data.hold_out(held_out) if held_out else data
    hash_of_file = functools.cache(source_hash)
    matrix_hash = ""
    if matrix is not None:
        content = np.ascontiguousarray(matrix, dtype=np.float32).tobytes()
        matrix_hash = hashlib.sha256(content).hexdigest()
    faults: dict[str, None] = {}
    trials: dict[str, Trial] = {}
    for named, variant, job in planned:
        masks = matrix if job.facts.is_custom else None
        job_faults = job.faults(training, masks)
        if masks is not None and not job_faults:
            from deepfsi.physics.laws import light_law

            # Raises `InputError` where the masks break the law
            light_law(job.optics.light).rails_of(masks, job.optics.rails)
        faults |= dict.fromkeys(job_faults)
        test_noise = recipe.test_noise or (job.camera.noise_name,)
        custom = custom_parts(job, *test_noise)
        trial = Trial(
            job=job,
            trained_under=job.noise,
            variant=variant,
            detectors="1x1" if job.facts.every_pixel else named.detectors,
            data=data.name,
            data_hash=data.hash,
            matrix_hash=matrix_hash if job.facts.is_custom else "",
            source_hash=_content_hash({"sources": [*map(hash_of_file, custom)]}) if custom else "",
            validation=held_out,
            draws=recipe.draws,
            test_photons=recipe.test_photons or (job.photons,),
            test_noise=test_noise,
            test_levels=recipe.test_levels,
        )
        trials[trial.key] = trial
    if faults:
        raise InputError("; ".join(faults))
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
    # Faults are named before any training
    for fold in recipe.parts(data):
        plan_trials(recipe, fold, matrix)
    return recipe, data


def with_adaptive(recipe: Recipe, data: Dataset) -> Recipe:
    """The recipe with adaptive masks too, where they can be had and do not take long."""
    scenes = len(data.x_train) + len(data.x_test)
    if data.measure != "accuracy" or scenes > ADAPTIVE_SCENES or recipe.test_noise:
        return recipe
    try:
        plan_trials(recipe.model_copy(update={"designs": ("adaptive",)}), data)
    except InputError:
        return recipe
    return recipe.model_copy(update={"designs": (*recipe.designs, "adaptive")})


def _jobs(
    recipe: Recipe, data: Dataset, matrix: np.ndarray | None
) -> Iterator[tuple[CameraVariant, str, Job]]:
    """Yield camera, variant of the settings, and job of every possible trial."""
    for named, design in product(recipe.cameras(), recipe.designs):
        if not _goes_with(design, named.camera, data):
            continue
        reads_alone = named.camera.noise_facts.read_noise_alone
        budgets = (recipe.gaussian_photons if reads_alone else ()) or recipe.photons
        for exposure_variant, exposure in recipe.exposures(design):
            for masks, (training_variant, training), seed, photons in product(
                _mask_counts(recipe, design, named, exposure, data, matrix),
                recipe.trainings(design),
                range(recipe.trials),
                budgets,
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
                # The camera as the design uses it: records are hashes of it
                optics = {"camera": job.optics}
                yield named, ", ".join(filter(None, variants)), job.model_copy(update=optics)


def _goes_with(design: str, camera: Camera, data: Dataset) -> bool:
    """True where a camera can have a design."""
    facts = DESIGNS[design]
    law = LIGHT_LAWS[camera.light]
    detectors = camera.detector_map(data.image_shape).count
    return not (
        # The control group learns under read noise what photon noise then tests
        (facts.learned_under is not None and not camera.noise_facts.exact)
        # The second arm sees the complement of a mask, which a design of one rail does not read
        or (law.arms == 2 and facts.rails == "single" and not facts.every_pixel)
        or (facts.rails == "dual" and camera.rails == "single")
        # Under `column` each readout has a detector for the whole scene
        or (not law.one_device and detectors > 1)
        or (facts.adaptive and not law.looks)
    )


def _mask_counts(
    recipe: Recipe,
    design: str,
    named: CameraVariant,
    exposure: Exposure,
    data: Dataset,
    matrix: np.ndarray | None,
) -> list[int]:
    """Mask counts asked for that a design can have, or else the largest it can have.

    A ratio counts readouts, m · D / N. Adaptive masks share the light among their looks, and more
    looks tell more: ratios ask for one count.
    """
    facts = DESIGNS[design]
    if exposure.fixed_mask_count:
        return [exposure.fixed_mask_count]
    if facts.is_custom and matrix is not None:
        return [len(matrix)]
    scene = exposure.scene(data)
    detectors = ONE_DETECTOR if facts.every_pixel else named.camera.detector_map(scene.image_shape)
    low, high = count_allowed(design, scene, detectors)
    asked = recipe.masks or [
        mask_count(ratio, scene.pixels / detectors.count) for ratio in recipe.ratios or PAPER_RATIOS
    ]
    counts = sorted({count for count in asked if low <= count <= high}) or [high]
    if facts.adaptive and not recipe.masks:
        # More than 32 looks tell little and take their time
        return [max((c for c in counts if c <= 32), default=counts[0])]
    return counts


def _content_hash(settings: Mapping[str, Any]) -> str:
    """Hash of settings, JSON types only."""
    # Sorted: the order of settings must not change a key
    return hashlib.sha256(json.dumps(settings, sort_keys=True).encode()).hexdigest()[:24]
