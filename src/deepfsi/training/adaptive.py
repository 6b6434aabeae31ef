"""Designs of adaptive masks: what is known of scenes, and no masks."""

import time
from collections.abc import Sequence
from typing import Any

import numpy as np
import torch
from torch import Tensor

from deepfsi.base import SILENT, Progress
from deepfsi.datasets import Dataset
from deepfsi.design.design import Design
from deepfsi.designfile import CALIBRATION_REACH, Temperatures
from deepfsi.evaluation import CalibrationScenes, Exposed
from deepfsi.exposure.adaptive import AdaptiveExposure, prior_of
from deepfsi.exposure.misfit import BUDGETS, LEAST_SCENES, MOST_SCENES, UsualMisfit, measure
from deepfsi.exposure.posterior import LookOptics
from deepfsi.exposure.prior import ScenePrior
from deepfsi.exposure.training_set import TrainingSet
from deepfsi.jobs import AdaptiveMasks, Job
from deepfsi.training.folds import DOUBT, calibrated, folds_of
from deepfsi.training.info import provenance


def adaptive_designs(
    training_set: TrainingSet, jobs: Sequence[Job], report: Progress = SILENT
) -> list[Design]:
    """Designs of jobs that differ in budget and seed, with one prior."""
    began, data = time.perf_counter(), training_set.data
    settings = AdaptiveMasks(looks=jobs[0].masks, clusters=jobs[0].training.clusters)
    prior, designs = prior_of(data, settings), []
    folds = [(fold, prior_of(fold, _fitting(settings, fold))) for fold in folds_of(data)]
    for done, job in enumerate(jobs, start=1):
        shares, usual = _measured(prior, settings, data, job)
        info = provenance(job, data, torch.device("cpu"), 0.0)
        own = prior
        report((done - 0.5) / len(jobs))
        if folds:
            own, info["left_out"] = _calibrated(prior, settings, folds, data, job)
        info["seconds"] = (time.perf_counter() - began) / done
        exposure = AdaptiveExposure(
            own,
            settings,
            shape=data.image_shape,
            counted=shares,
            usual_misfit=usual,
            optics=info["job"]["camera"],
        )
        designs.append(
            Design(
                name=job.design,
                classes=data.classes,
                exposure=exposure,
                info=info,
                training_scenes=training_set.scenes,
            )
        )
        report(done / len(jobs))
    return designs


def _fitting(settings: AdaptiveMasks, data: Dataset) -> AdaptiveMasks:
    """The settings with no more clusters of a class than a prior of these scenes can have."""
    if settings.clusters is None:
        return settings
    most = max(1, int(np.bincount(data.y_train, minlength=len(data.classes)).min()) // 2)
    return settings.model_copy(update={"clusters": min(settings.clusters, most)})


def _calibrated(
    prior: ScenePrior,
    settings: AdaptiveMasks,
    folds: Sequence[tuple[Dataset, ScenePrior]],
    data: Dataset,
    job: Job,
) -> tuple[ScenePrior, dict[str, Any]]:
    """The prior with temperatures, by scenes that those of the folds leave out; their test."""
    parts, share = [], min(1.0, MOST_SCENES / sum(len(fold.x_test) for fold, _ in folds))
    for fold, without in folds:
        n = len(fold.x_test)  # in the order of classes: some of each
        rows = np.linspace(0, n - 1, max(1, round(share * n))).astype(int)
        x, labels = fold.x_test[rows], fold.y_test[rows]
        exposure = AdaptiveExposure(
            without, settings, shape=fold.image_shape, counted=torch.zeros(settings.looks)
        )
        design = Design(job.design, fold.classes, exposure)
        parts.append(Exposed(design, job.optics, x, labels))
    classes = prior.class_shares.double().numpy()
    scenes = CalibrationScenes(parts, settings.looks, shares=classes, doubt=DOUBT)
    found, test = calibrated(scenes, np.array(BUDGETS) * job.photons, data, job.photons, job.seed)
    # beyond the light that is measured as at its ends
    logs = np.pad(found.logs, ((0, 0), (1, 1)), mode="edge")
    budgets = np.array([1 / CALIBRATION_REACH, *BUDGETS, CALIBRATION_REACH]) * job.photons
    return prior.with_temperatures(Temperatures(logs, budgets)), test.as_dict()


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
