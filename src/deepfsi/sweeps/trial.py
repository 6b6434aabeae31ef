"""A trial, one training and its tests, and the trials of a recipe."""

import functools
import hashlib
import math
from collections.abc import Callable, Iterator, Sequence
from itertools import product
from typing import NamedTuple

import numpy as np
from pydantic import BaseModel, ConfigDict, Field

from deepfsi.datasets import Dataset
from deepfsi.errors import InputError
from deepfsi.imports import UNNAMED, source_hash
from deepfsi.optics import codes
from deepfsi.optics.constraints import Light
from deepfsi.optics.detection import ONE, Detection, read_detectors
from deepfsi.optics.rails import RailsKind
from deepfsi.sweeps.recipe import Noise, Recipe
from deepfsi.sweeps.records import content_hash
from deepfsi.training.job import ONE_DEVICE, REVISION, Job, job_faults

MOST_TRIALS = 100_000
"""Trials of one recipe: months of training, and records that still fit the memory."""

SCHEMA = 2
"""Version of what the keys of trials are hashes of."""


NAMES = {"data", "variant", "detectors"}
"""Fields of a trial that only name what other fields hold."""


class Trial(BaseModel):
    """One training and its tests, with all that the result depends on."""

    model_config = ConfigDict(frozen=True, extra="forbid")

    job: Job = Field(description="design that is trained, and its light and noise")
    variant: str = Field("", description="which of several training settings, in words")
    detectors: str = Field("1x1", description="name of its detectors: as given, or of their map")
    data: str = Field(description="name")
    data_hash: str = Field(description="of scenes and labels")
    matrix_hash: str = Field("", description="of one's own masks")
    source_hash: str = Field("", description="of the files of one's own classifier and noise")
    validation: int = Field(description="training scenes held out")
    draws: int = Field(description="noise draws of each test scene")
    test_photons: tuple[float, ...] = Field(description="budgets of the tests")
    test_noise: tuple[Noise, ...] = Field(description="noises of the tests")
    test_levels: tuple[int, ...] = Field(
        (0,), description="grey levels of the masks in the tests, dark included; 0: continuous"
    )

    @property
    def key(self) -> str:
        """Content hash that names the record."""
        return self._hash(NAMES)

    @property
    def design_key(self) -> str:
        """Content hash that names the design: of what the training depends on."""
        tests = {"draws", "test_photons", "test_noise", "test_levels"}
        return self._hash({*NAMES, *tests})

    def _hash(self, exclude: set[str]) -> str:
        settings = self.model_dump(mode="json", exclude=exclude)
        return content_hash({"schema": SCHEMA, "revision": REVISION, **settings})


def plan(recipe: Recipe, data: Dataset, matrix: np.ndarray | None = None) -> list[Trial]:
    """All trials of a recipe, each once.

    Left out is what cannot be: the control group, masks of gaussian noise under photon noise, where
    there is none; designs of one rail on two arms; the signed Hadamard basis on a single rail;
    several detectors under the law of other optics, `column`.

    Parameters
    ----------
    recipe : Recipe
    data : Dataset
    matrix : array, shape (m, N), optional
        Sensing matrix of "custom" designs.

    Raises
    ------
    InputError
        That names all that its data or a constraint does not allow.
    """
    if faults := [*mask_faults(recipe, data), *trial_faults(recipe, data, matrix)]:
        raise InputError("; ".join(faults))
    trials: dict[str, Trial] = {}
    hashed = functools.cache(source_hash)
    for kind, variant, job in _jobs(recipe, data, matrix):
        test_noise = recipe.test_noise or (kind.noise,)
        trial = Trial(
            job=job,
            variant=variant,
            detectors="1x1" if job.design == "impulse" else kind.detectors,
            data=data.name,
            data_hash=data.hash,
            matrix_hash=_matrix_hash(matrix if job.design == "custom" else None),
            source_hash=_source_hash(_own_names(job, test_noise), hashed),
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
            faults.append(str(error))
    return faults


def trial_faults(recipe: Recipe, data: Dataset, matrix: np.ndarray | None = None) -> list[str]:
    """Everything that trials of a recipe ask and that cannot be had, each once.

    Parameters as of `plan`.
    """
    if faults := _detector_faults(recipe, data):
        return faults
    count = count_trials(recipe, data, matrix)
    if count > MOST_TRIALS:
        return [f"{count} trials are not allowed: a recipe has at most {MOST_TRIALS}; take less"]
    if not count:
        return [
            f"nothing to compare: {', '.join(recipe.designs)} cannot be had under "
            f"{', '.join(recipe.noise)} noise with {', '.join(recipe.light)} light and "
            f"{', '.join(recipe.rails)} rails (control is for photon noise, two-arm for dual rails)"
        ]
    found: dict[str, None] = {}
    names: dict[str, None] = {}
    for kind, _, job in _jobs(recipe, data, matrix):
        own = matrix if job.design == "custom" else None
        found |= dict.fromkeys(job_faults(job, data, own))
        test_noise = recipe.test_noise or (kind.noise,)
        if job.training.looks > 1 and set(test_noise) - {"poisson", "ml_gauss", "none"}:
            found["several looks are tested under photon noise: leave others out of noise"] = None
        names |= dict.fromkeys(_own_names(job, test_noise))
    for name in names:
        try:
            source_hash(name)
        except InputError as error:
            found[str(error)] = None
    return list(found)


def count_trials(recipe: Recipe, data: Dataset, matrix: np.ndarray | None = None) -> int:
    """Number of trials of a recipe, by the lengths of its axes.

    Parameters as of `plan`.
    """
    return sum(
        len(_counts(recipe, kind, data, matrix))
        * len(recipe.train_noises(kind.noise))
        * math.prod(map(len, recipe.training_axes(kind.design).values()))
        * len(recipe.readout or (None,))
        * recipe.trials
        * len(recipe.budgets(kind.noise))
        for kind in _kinds(recipe, data)
    )


class Kind(NamedTuple):
    """Design, optics and noise of tests of some trials."""

    design: str
    noise: str
    light: Light
    rails: RailsKind
    detectors: str  # name of them
    labels: str | tuple[int, ...]  # the same as `Job.detectors`
    detection: Detection


def _kinds(recipe: Recipe, data: Dataset) -> Iterator[Kind]:
    """Yield all kinds of trials that can be."""
    for name in recipe.detectors:
        labels = read_detectors(name)
        detection = Detection.of(labels, data.image_shape)
        for optics in product(recipe.designs, recipe.noise, recipe.light, recipe.rails):
            own = ONE if optics[0] == "impulse" else detection
            kind = Kind(*optics, name, labels, own)
            if _possible(kind):
                yield kind


def _detector_faults(recipe: Recipe, data: Dataset) -> list[str]:
    """Detectors of a recipe that cannot be had."""
    faults, most = list[str](), 1
    for name in recipe.detectors:
        try:
            most = max(most, Detection.of(read_detectors(name), data.image_shape).count)
        except InputError as error:
            faults.append(str(error))
    return faults + [ONE_DEVICE] * (most > 1 and set(recipe.light) == {"column"})


def _counts(recipe: Recipe, kind: Kind, data: Dataset, matrix: np.ndarray | None) -> Sequence[int]:
    if kind.design == "custom" and matrix is not None:
        return [len(matrix)]
    return recipe.mask_counts(kind.design, data, kind.detection)


def _jobs(
    recipe: Recipe, data: Dataset, matrix: np.ndarray | None
) -> Iterator[tuple[Kind, str, Job]]:
    """Yield kind, variant of the training and job of every trial that can be."""
    for kind in _kinds(recipe, data):
        for masks, train_noise, (variant, training), readout, seed, photons in product(
            _counts(recipe, kind, data, matrix),
            recipe.train_noises(kind.noise),
            recipe.trainings(kind.design),
            recipe.readout or (None,),
            range(recipe.trials),
            recipe.budgets(kind.noise),
        ):
            job = Job(
                design=kind.design,
                masks=masks,
                photons=photons,
                noise=train_noise,
                sigma=recipe.sigma,
                dark=recipe.dark,
                light=kind.light,
                rails=kind.rails,
                detectors=kind.labels,
                readout=readout,
                seed=seed,
                training=training,
            )
            yield kind, variant, job.in_force


def _possible(kind: Kind) -> bool:
    one_rail = codes.DESIGNS[kind.design].single_rail and kind.design != "impulse"
    return not (
        (kind.design == "control" and kind.noise != "poisson")
        or (kind.light == "two-arm" and (one_rail or kind.rails == "single"))
        or (kind.design == "hadamard" and kind.rails == "single")
        or (kind.light == "column" and kind.detection.count > 1)
    )


def _own_names(job: Job, test_noise: Sequence[str]) -> list[str]:
    """Import paths of a user's own parts that a trial needs."""
    every = {job.noise, *test_noise, job.training.classifier}
    return sorted(name for name in every if ":" in name or name == UNNAMED)


def _source_hash(names: Sequence[str], hashed: Callable[[str], str]) -> str:
    """Hash of the files of a user's own parts, or "" where there is none."""
    return content_hash({"sources": [hashed(name) for name in names]}) if names else ""


def _matrix_hash(matrix: np.ndarray | None) -> str:
    if matrix is None:
        return ""
    return hashlib.sha256(np.ascontiguousarray(matrix, dtype=np.float32).tobytes()).hexdigest()
