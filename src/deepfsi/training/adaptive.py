"""Designs of adaptive masks: what is known of scenes, and no masks."""

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
from deepfsi.progress import SILENT, Report
from deepfsi.training.info import provenance
from deepfsi.training.job import Job
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
        designs.append(AdaptiveDesign(prior, settings, *known, training_set.scenes))
        report(done / len(jobs))
    return designs


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
