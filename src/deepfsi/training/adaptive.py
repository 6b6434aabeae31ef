"""Designs of adaptive masks: what is known of scenes, and no masks; what they refuse."""

import time
from collections.abc import Sequence

import numpy as np
import torch
from torch import Tensor

from deepfsi.datasets import Dataset
from deepfsi.design.adaptive.design import AdaptiveDesign
from deepfsi.design.adaptive.exposures import AdaptiveMasks, prior_of
from deepfsi.design.adaptive.misfit import (
    BUDGETS,
    LEAST_SCENES,
    MOST_SCENES,
    UsualMisfit,
    measure,
)
from deepfsi.design.adaptive.posterior import LookOptics
from deepfsi.design.adaptive.prior import ScenePrior
from deepfsi.design.exposure import Fixed
from deepfsi.progress import SILENT, Report
from deepfsi.training.info import provenance
from deepfsi.training.job import MLP, Job
from deepfsi.training.training_set import TrainingSet


def adaptive_designs(
    training_set: TrainingSet, jobs: Sequence[Job], report: Report = SILENT
) -> list[AdaptiveDesign]:
    """Designs of jobs that differ in budget and seed, with one prior."""
    began, data = time.perf_counter(), training_set.data
    settings = AdaptiveMasks(looks=jobs[0].masks, clusters=jobs[0].training.clusters)
    prior, designs = prior_of(data, settings), []
    for done, job in enumerate(jobs, start=1):
        shares, usual = _measured(prior, settings, data, job)
        seconds = (time.perf_counter() - began) / done
        info = provenance(job, data, torch.device("cpu"), seconds)
        known = data.image_shape, data.classes, shares, usual, info
        designs.append(AdaptiveDesign(prior, settings, *known))
        report(done / len(jobs))
    return designs


def faults(job: Job, data: Dataset) -> list[str]:
    """Everything in a job of adaptive masks that cannot be had."""
    found = []
    fewest = int(np.bincount(data.y_train, minlength=len(data.classes)).min())
    if (job.training.clusters or 0) > fewest // 2:
        found.append(
            f"{job.training.clusters} clusters of each class are too many where one has "
            f"{fewest} scenes: give at most {fewest // 2}, or leave `clusters` out"
        )
    if not isinstance(job.exposure, Fixed):
        found.append("adaptive masks have a look each: give no looks, nested, span or patch")
    if job.training.classifier != MLP:
        found.append("adaptive masks are read by their posterior: leave `classifier` out")
    shortest = job.camera.shortest_share
    if shortest * job.masks > 1:
        found.append(
            f"{job.masks} looks are shorter than {shortest:.3g} of the exposure, the shortest "
            f"picture of the camera: give at most {int(1 / shortest)} masks"
        )
    return found


def _measured(
    prior: ScenePrior, settings: AdaptiveMasks, data: Dataset, job: Job
) -> tuple[Tensor, UsualMisfit | None]:
    """Share of the budget (K,) that each look counts of training scenes, and their misfit."""
    generator = torch.Generator().manual_seed(job.seed)
    places = torch.randperm(len(prior.order), generator=generator)[:MOST_SCENES]
    scenes = torch.from_numpy(data.x_train[prior.order[places.numpy()]])
    budgets = np.array(BUDGETS) * job.photons
    optics = [LookOptics.of(job.optics, data.image_shape, each) for each in budgets.tolist()]
    own = places if settings.clusters is None else None
    logarithms, counts = measure(prior, settings, optics, scenes, own, generator)
    shares = (counts[BUDGETS.index(1.0)] / job.photons).float()
    return shares, UsualMisfit(budgets, logarithms) if len(scenes) >= LEAST_SCENES else None
