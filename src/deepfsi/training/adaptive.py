"""Designs of adaptive masks: what is known of scenes, and no masks."""

import time
from collections.abc import Sequence

import torch
from torch import Tensor

from deepfsi.datasets import Dataset
from deepfsi.design.adaptive.design import AdaptiveDesign
from deepfsi.design.adaptive.exposures import AdaptiveMasks, expose, prior_of
from deepfsi.design.adaptive.posterior import AdaptivePosterior, LookOptics
from deepfsi.design.adaptive.prior import ScenePrior
from deepfsi.progress import SILENT, Report
from deepfsi.training.info import provenance
from deepfsi.training.job import Job
from deepfsi.training.training_set import TrainingSet

MEASURED_SCENES = 64
"""Training scenes by which the light that each look counts is measured."""


def adaptive_designs(
    training_set: TrainingSet, jobs: Sequence[Job], report: Report = SILENT
) -> list[AdaptiveDesign]:
    """Designs of jobs that differ in budget and seed, with one prior."""
    began, data = time.perf_counter(), training_set.data
    settings = AdaptiveMasks(looks=jobs[0].masks, clusters=jobs[0].training.clusters)
    prior, designs = prior_of(data, settings), []
    for done, job in enumerate(jobs, start=1):
        shares = _shares(prior, settings, data, job)
        seconds = (time.perf_counter() - began) / done
        info = provenance(job, data, torch.device("cpu"), seconds)
        designs.append(
            AdaptiveDesign(prior, settings, data.image_shape, data.classes, shares, info)
        )
        report(done / len(jobs))
    return designs


def _shares(prior: ScenePrior, settings: AdaptiveMasks, data: Dataset, job: Job) -> Tensor:
    """Share of the budget (K,) that each look counts, in the mean over training scenes."""
    generator = torch.Generator().manual_seed(job.seed)
    rows = torch.randperm(len(data.x_train), generator=generator)[:MEASURED_SCENES]
    scenes = torch.from_numpy(data.x_train[rows.numpy()])
    optics = LookOptics.of(job.optics, data.image_shape, job.photons)
    with torch.no_grad():
        state = AdaptivePosterior(prior, len(scenes), optics)
        _, counts = expose(state, scenes, settings, generator)
    return (counts / (job.photons * len(scenes))).float()
