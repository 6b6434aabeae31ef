"""A trial, one training and its tests, and the trials of a recipe."""

import functools
import hashlib
import json
import math
from collections.abc import Callable, Iterator, Mapping, Sequence
from itertools import product
from typing import Any

import numpy as np
from pydantic import BaseModel, ConfigDict, Field

from deepfsi.base import InputError, join_messages, source_hash
from deepfsi.camera import LIGHT_LAWS, ONE_DETECTOR, Camera
from deepfsi.datasets import Dataset
from deepfsi.jobs import DESIGNS, REVISION, Code, Exposure, Job, custom_parts
from deepfsi.sweeps.recipe import NamedCamera, Recipe, TestNoise

MOST_TRIALS = 100_000
"""Trials of one recipe: months of training, and records that still fit the memory."""

SCHEMA = 6
"""Version of what the keys of trials are hashes of."""


NAMES = {"data", "trained_under", "variant", "detectors"}
"""Fields of a trial that only name what other fields hold."""


class Trial(BaseModel):
    """One training and its tests, with all that the result depends on."""

    model_config = ConfigDict(frozen=True, extra="forbid")

    job: Job = Field(description="design that is trained, and its light and noise")
    trained_under: str = Field("", description="noise of the training")
    variant: str = Field("", description="which of several settings, in words")
    detectors: str = Field("1x1", description="name of its detectors: as given, or of their map")
    data: str = Field(description="name")
    data_hash: str = Field(description="of scenes and labels")
    matrix_hash: str = Field("", description="of one's own masks")
    source_hash: str = Field("", description="of the files of one's own classifier, loss and noise")
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
        return self._hash(NAMES)

    @functools.cached_property
    def design_key(self) -> str:
        """Content hash that names the design: of what the training depends on."""
        tests = {"draws", "test_photons", "test_noise", "test_levels"}
        return self._hash({*NAMES, *tests})

    def _hash(self, exclude: set[str]) -> str:
        settings = self.model_dump(mode="json", exclude=exclude)
        return _content_hash({"schema": SCHEMA, "revision": REVISION, **settings})


def plan(recipe: Recipe, data: Dataset, matrix: np.ndarray | None = None) -> list[Trial]:
    """All trials of a recipe, each once."""
    # Left out is what cannot be: the control group, masks of gaussian noise under photon noise,
    # where there is none; designs of one rail on two arms; the signed Hadamard basis on a single
    # rail; several detectors under the law of other optics, `column`. matrix (m, N)
    if faults := [*mask_faults(recipe, data), *trial_faults(recipe, data, matrix)]:
        raise InputError(join_messages(faults))
    trials: dict[str, Trial] = {}
    hashed = functools.cache(source_hash)
    for named, variant, job in _jobs(recipe, data, matrix):
        test_noise = recipe.test_noise or (job.camera.noise_name,)
        trial = Trial(
            job=job,
            trained_under=job.noise,
            variant=variant,
            detectors="1x1" if job.code.every_pixel else named.detectors,
            data=data.name,
            data_hash=data.hash,
            matrix_hash=_matrix_hash(matrix if job.code.is_custom else None),
            source_hash=_source_hash(custom_parts(job, *test_noise), hashed),
            validation=recipe.held_out(data),
            draws=recipe.draws,
            test_photons=recipe.test_photons or (job.photons,),
            test_noise=test_noise,
            test_levels=recipe.test_levels,
        )
        trials[trial.key] = trial
    return list(trials.values())


def mask_faults(recipe: Recipe, data: Dataset) -> list[str]:
    """Numbers of masks, and of scenes to choose on, that the data does not have."""
    faults = [
        f"{count} masks are not allowed on {data.name}: give 1 to {data.pixels}"
        for count in recipe.masks
        if count > data.pixels
    ]
    if recipe.held_out(data):
        try:
            data.hold_out(recipe.held_out(data))
        except InputError as error:
            faults.append(error.message)
    return faults


def trial_faults(recipe: Recipe, data: Dataset, matrix: np.ndarray | None = None) -> list[str]:
    """Everything that trials of a recipe ask and that cannot be had, each once."""
    # Parameters as of `plan`
    try:
        count = count_trials(recipe, data, matrix)
    except InputError as error:  # scenes that an exposure cannot see so
        return [error.message]
    if count > MOST_TRIALS:
        return [f"{count} trials are not allowed: a recipe has at most {MOST_TRIALS}; take less"]
    if not count:
        return [
            f"nothing to compare: {', '.join(recipe.designs)} cannot be had under "
            f"{', '.join(recipe.noises)} noise with {_optics_text(recipe)} (control is for photon "
            "noise, two-arm for dual rails)"
        ]
    found: dict[str, None] = {}
    names: dict[str, None] = {}
    for _, _, job in _jobs(recipe, data, matrix):
        own = matrix if job.code.is_custom else None
        found |= dict.fromkeys(job_faults := job.faults(data, own))
        if own is not None and not job_faults:
            found |= dict.fromkeys(_light_faults(own, job.optics))
        test_noise = recipe.test_noise or (job.camera.noise_name,)
        found |= dict.fromkeys(job.exposure.test_faults(test_noise))
        names |= dict.fromkeys(custom_parts(job, *test_noise))
    for name in names:
        try:
            source_hash(name)
        except InputError as error:
            found[error.message] = None
    return list(found)


def _light_faults(matrix: np.ndarray, camera: Camera) -> list[str]:
    """Why a user's masks (m, N) cannot be shown under a camera's light law."""
    from deepfsi.physics import light_law

    try:
        light_law(camera.light).rails_of(matrix, camera.rails)
    except InputError as error:
        return [error.message]
    return []


def count_trials(recipe: Recipe, data: Dataset, matrix: np.ndarray | None = None) -> int:
    """Number of trials of a recipe, by the lengths of its axes."""
    # Parameters as of `plan`
    return sum(
        len(_counts(recipe, design, named, exposure, data, matrix))
        * math.prod(map(len, recipe.training_axes(design).values()))
        * recipe.trials
        * len(recipe.budgets(named.camera.noise_name))
        for design, named in _kinds(recipe, data)
        for _, exposure in recipe.exposures()
    )


def _kinds(recipe: Recipe, data: Dataset) -> Iterator[tuple[str, NamedCamera]]:
    """Yield every design with every camera that it can have."""
    for named, design in product(recipe.cameras(), recipe.designs):
        count = named.camera.detector_map(data.image_shape).count
        if _possible(DESIGNS[design], named.camera, count):
            yield design, named


def _possible(code: Code, camera: Camera, detectors: int) -> bool:
    law, one_rail = LIGHT_LAWS[camera.light], code.rails == "single" and not code.every_pixel
    return not (
        (code.learned_under is not None and not camera.noise_facts.exact)
        or (law.arms == 2 and one_rail)
        or (code.rails == "dual" and camera.rails == "single")
        or (not law.one_device and detectors > 1)
        or (code.adaptive and not law.looks)
    )


def _counts(
    recipe: Recipe,
    design: str,
    named: NamedCamera,
    exposure: Exposure,
    data: Dataset,
    matrix: np.ndarray | None,
) -> Sequence[int]:
    """Mask counts of a design for scenes as its masks see them."""
    code, scene = DESIGNS[design], exposure.scene(data)
    if exposure.fixed_mask_count:
        return [exposure.fixed_mask_count]
    if code.is_custom and matrix is not None:
        return [len(matrix)]
    detectors = ONE_DETECTOR if code.every_pixel else named.camera.detector_map(scene.image_shape)
    return recipe.mask_counts(design, scene, detectors)


def _jobs(
    recipe: Recipe, data: Dataset, matrix: np.ndarray | None
) -> Iterator[tuple[NamedCamera, str, Job]]:
    """Yield camera, variant of the settings, and job of every trial that can be."""
    for (design, named), exposure in product(_kinds(recipe, data), recipe.exposures()):
        for masks, training, seed, photons in product(
            _counts(recipe, design, named, exposure[1], data, matrix),
            recipe.trainings(design),
            range(recipe.trials),
            recipe.budgets(named.camera.noise_name),
        ):
            job = Job(
                design=design,
                masks=masks,
                photons=photons,
                camera=named.camera,
                exposure=exposure[1],
                training=training[1],
                seed=seed,
            )
            variant = ", ".join(filter(None, (named.variant, training[0], exposure[0])))
            yield named, variant, job.resolved


def _optics_text(recipe: Recipe) -> str:
    lights, rails = (
        ", ".join(dict.fromkeys(getattr(named.camera, field) for named in recipe.cameras()))
        for field in ("light", "rails")
    )
    return f"{lights} light and {rails} rails"


def _source_hash(names: Sequence[str], hashed: Callable[[str], str]) -> str:
    """Hash of the files of a user's own parts, or "" where there is none."""
    return _content_hash({"sources": [hashed(name) for name in names]}) if names else ""


def _content_hash(settings: Mapping[str, Any]) -> str:
    """Hash of settings, JSON types only."""
    return hashlib.sha256(json.dumps(settings, sort_keys=True).encode()).hexdigest()[:24]


def _matrix_hash(matrix: np.ndarray | None) -> str:
    if matrix is None:
        return ""
    return hashlib.sha256(np.ascontiguousarray(matrix, dtype=np.float32).tobytes()).hexdigest()
