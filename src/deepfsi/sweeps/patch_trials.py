"""Trials of designs that see images patch by patch: recipe, plan, training and tests."""

from collections.abc import Sequence
from functools import cached_property
from itertools import product
from typing import Any

import torch
from pydantic import BaseModel, ConfigDict, Field, field_validator

from deepfsi.datasets import Dataset, list_datasets, load_dataset
from deepfsi.design.artifact import Design
from deepfsi.design.evaluation import evaluate
from deepfsi.optics.budget import BUDGETS
from deepfsi.progress import SILENT, Report
from deepfsi.sweeps.queue import Done
from deepfsi.sweeps.records import content_hash, record_of
from deepfsi.training.learning import Diverged
from deepfsi.training.patches import (
    REVISION,
    PatchedDesign,
    Patches,
    PatchJob,
    PatchTraining,
    train,
)
from deepfsi.training.training_set import find_device

KEYS = 1
"""Version of what the keys of these trials are hashes of."""


class PatchRecipe(BaseModel):
    """Comparison on patches: every design at every budget, with every seed."""

    model_config = ConfigDict(frozen=True, extra="forbid")

    data: str = Field(description="name of a data set of images")
    instead: str | None = Field(None, description="taken where it is here and the first is not")
    size: tuple[int, int] = (64, 64)
    images: int | None = Field(None, description="training images, those of validation included")
    validation: int = Field(ge=1, description="how many of them are not trained on")
    patch: int = Field(8, ge=2, description="side of a patch in pixels")
    designs: tuple[PatchedDesign, ...] = Field(min_length=1)
    photons: tuple[float, ...] = Field(min_length=1, description="of the whole image")
    trials: int = Field(3, ge=1, description="training seeds for each point")
    draws: int = Field(1, ge=1, description="noise draws of each test image")
    training: PatchTraining = PatchTraining()
    tuned: dict[PatchedDesign, dict[str, Any]] = Field({}, description="for single designs")

    @field_validator("photons")
    @classmethod
    def _allowed(cls, budgets: tuple[float, ...]) -> tuple[float, ...]:
        if not all(BUDGETS[0] <= budget <= BUDGETS[1] for budget in budgets):
            raise ValueError(f"give budgets from {BUDGETS[0]:g} to {BUDGETS[1]:g} photons")
        return budgets

    def training_of(self, design: PatchedDesign) -> PatchTraining:
        """Settings of the training of a design."""
        own = {**self.training.model_dump(), **self.tuned.get(design, {})}
        return PatchTraining.model_validate(own)

    def load(self) -> Dataset:
        """The images."""
        here = {each.name for each in list_datasets() if each.where != "not here"}
        name = self.instead if self.data not in here and self.instead in here else self.data
        return load_dataset(name or self.data, size=self.size, images=self.images)


class PatchTrial(BaseModel):
    """One training and its test, with all that the result depends on."""

    model_config = ConfigDict(frozen=True, extra="forbid")

    job: PatchJob
    data: str
    data_hash: str
    validation: int
    draws: int

    @property
    def key(self) -> str:
        """Content hash that names the record."""
        return self._hash(exclude={"data"})

    @property
    def design_key(self) -> str:
        """Content hash that names the design: of what the training depends on."""
        return self._hash(exclude={"data", "draws"})

    def _hash(self, exclude: set[str]) -> str:
        settings = self.model_dump(mode="json", exclude=exclude)
        return content_hash({"patches": KEYS, "revision": REVISION, **settings})


def plan_patches(recipe: PatchRecipe, data: Dataset) -> list[PatchTrial]:
    """All trials, seed by seed, so that what a stopped study has done is whole for some seeds."""
    return [
        PatchTrial(
            job=PatchJob(
                design=design,
                photons=photons,
                patch=recipe.patch,
                seed=seed,
                training=recipe.training_of(design),
            ),
            data=data.name,
            data_hash=data.hash,
            validation=recipe.validation,
            draws=recipe.draws,
        )
        for seed, photons, design in product(range(recipe.trials), recipe.photons, recipe.designs)
    ]


class PatchContext:
    """Work on trials of patches, each a batch of its own, and what it needs."""

    def __init__(self, data: Dataset, held_out: int, side: int, device: str = "auto") -> None:
        self.data, self.held_out, self.side, self.device = data, held_out, side, device

    @cached_property
    def parts(self) -> Dataset:
        """The data, its validation part as test part."""
        return self.data.hold_out(self.held_out)

    @cached_property
    def patches(self) -> Patches:
        """Images that are trained on."""
        return Patches(self.parts, self.side, self.device)

    def __getstate__(self) -> dict[str, Any]:
        made_there = ("parts", "patches")
        return {name: value for name, value in vars(self).items() if name not in made_there}

    @property
    def processor(self) -> torch.device:
        """Device that trials are trained on here."""
        return find_device(self.device)

    def batches(self, trials: Sequence[PatchTrial], workers: int = 1) -> list[list[PatchTrial]]:
        """Every trial by itself, in the order of the plan."""
        return [[trial] for trial in trials]

    def prepare(self, trials: Sequence[PatchTrial]) -> None:
        """Nothing is shared by the processes."""

    def effort(self, batch: Sequence[PatchTrial]) -> float:
        """Epochs of a batch."""
        return float(sum(trial.job.training.epochs for trial in batch))

    def title(self, batch: Sequence[PatchTrial]) -> str:
        """Design, budget and seed."""
        job = batch[0].job
        return f"{job.design}, {job.photons:g} photons, seed {job.seed}"

    def train(self, batch: list[PatchTrial], report: Report = SILENT) -> list[Done[PatchTrial]]:
        """Train and test a batch, of one trial; its record is None where it diverges."""
        [trial] = batch
        try:
            design = train(self.patches, trial.job, report)
        except Diverged:
            return [(trial, None, None)]
        return [(trial, self.record(trial, design), design.to_bytes())]

    def record(self, trial: PatchTrial, design: Design) -> dict[str, Any]:
        """Record of a trial whose design is tested now."""
        job = trial.job
        validation, test = (
            [
                result.as_dict()
                for result in evaluate(
                    design, data, job.photons, draws=trial.draws, seed=job.seed, report=SILENT
                )
            ]
            for data in (self.parts, self.data)
        )
        return record_of(trial, design, validation, test)
