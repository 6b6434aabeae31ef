"""Learn masks and classifier together, one design or several that share a shape."""

import time
from collections.abc import Sequence
from typing import Any

import numpy as np
import torch
from torch import Tensor

from deepfsi.datasets import Dataset
from deepfsi.design.adaptive import AdaptiveDwells
from deepfsi.design.artifact import Design, provenance
from deepfsi.design.classifiers import Mlp
from deepfsi.design.exposure import FixedDwells
from deepfsi.errors import InputError, as_input_error
from deepfsi.optics import constraints
from deepfsi.optics.feature_noise import FeatureNoise
from deepfsi.optics.masks import Fixed, Learned
from deepfsi.optics.standardisation import (
    CHUNK,
    feature_statistics,
    mean_over_exposures,
)
from deepfsi.progress import SILENT, Report
from deepfsi.training.job import Job, TrainingSettings, check_jobs, training_for
from deepfsi.training.job_masks import final_masks, initial_masks
from deepfsi.training.loop import optimise
from deepfsi.training.training_set import TrainingSet


class Diverged(InputError):
    """Training ended in numbers that are not finite."""


def learn(
    data: Dataset,
    *,
    photons: float,
    masks: int,
    matrix: np.ndarray | None = None,
    device: str = "auto",
    report: Report = SILENT,
    **settings: Any,
) -> Design:
    """Train one design on all training scenes of a data set.

    Parameters
    ----------
    data : Dataset
    photons : float
        Budget Φ: expected photons on the coding device, in the mean over training scenes.
    masks : int
        m.
    matrix : array, shape (m, N), optional
        Your own sensing matrix, for ``design="custom"``.
    device : {"auto", "cpu", "cuda"}
    report : Report
    **settings
        Further fields of `Job` (`design`, `noise`, `sigma`, `light`, `rails`, `seed`) and of
        `TrainingSettings` (`epochs`, `batch`, `lr`, `mask_lr`, `hidden`, `dropout`, `scale`,
        `decay`, `start`, `precision`, `levels`, `span`, `nested`, `looks`).

    Returns
    -------
    Design

    Raises
    ------
    InputError
        For any setting that is not allowed.

    Examples
    --------
    >>> import deepfsi
    >>> digits = deepfsi.load_dataset("digits")
    >>> deepfsi.learn(digits, photons=1e4, masks=10, epochs=1).matrix.shape
    (10, 64)
    """
    inner = {
        key: settings.pop(key) for key in list(settings) if key in TrainingSettings.model_fields
    }
    with as_input_error():
        training = training_for(settings.get("design", "deepfsi"), **inner)
        job = Job(photons=photons, masks=masks, training=training, **settings)
    return train(TrainingSet(data, device), [job], matrix=matrix, report=report)[0]


def train(
    training_set: TrainingSet,
    jobs: Sequence[Job],
    matrix: np.ndarray | None = None,
    report: Report = SILENT,
) -> list[Design]:
    """Train designs side by side that differ in budget, sigma and seed only.

    Parameters
    ----------
    training_set : TrainingSet
    jobs : sequence of Job
        R jobs that agree in `Job.companions`, those of one seed one after another.
    matrix : array, shape (m, N), optional
        Sensing matrix of "custom" designs.
    report : Report

    Returns
    -------
    list of Design
        In the order of `jobs`.
    """
    began = time.perf_counter()
    device = training_set.device
    first = check_jobs(jobs, training_set.data, device, matrix)
    noise = FeatureNoise.of(
        first.noise,
        [job.photons / training_set.summed_reflectance for job in jobs],
        [job.sigma for job in jobs],
        [job.seed for job in jobs],
        device,
    )
    learned = None
    if first.design == "control":
        sources = [job.masks_from() for job in jobs]
        optimised = train(training_set, sources, report=report.part(0.0, 0.5))
        learned, report = torch.stack([each.rails for each in optimised]), report.part(0.5, 1.0)
    masks = initial_masks(training_set, jobs, matrix, learned).to(device)
    classifiers, schedules = optimise(training_set, jobs, masks, noise, report)
    if isinstance(masks, Learned):
        masks = final_masks(masks, training_set, first)
    networks = [*classifiers, *(each.network for each in schedules)]
    numbers = [*masks(), *(part for network in networks for part in network.parameters())]
    if not all(bool(torch.isfinite(part).all()) for part in numbers):
        raise Diverged(f"training of {first.design} diverged: lower lr and mask_lr")
    designs = _designs(training_set, jobs, masks, noise, classifiers, schedules)
    seconds = (time.perf_counter() - began) / len(jobs)
    for job, design in zip(jobs, designs, strict=True):
        design.info = provenance(job, training_set.data, device, seconds)
    return designs


def _designs(
    training_set: TrainingSet,
    jobs: Sequence[Job],
    masks: Fixed,
    noise: FeatureNoise,
    classifiers: list[Mlp],
    schedules: list[AdaptiveDwells],
) -> list[Design]:
    """Designs of trained masks and networks, with the statistics of their features."""
    light, s = jobs[0].optics[0], training_set.summed_reflectance
    rails = constraints.separate(*masks())
    exposures, conditioning = None, jobs[0].conditioning
    if conditioning:
        used = constraints.used(rails, light)
        exposures = mean_over_exposures(used, conditioning.span, conditioning.chances.to(used))
    with torch.no_grad():
        mean, std, counts = feature_statistics(
            training_set.full, masks, noise, jobs[0].training.scale, exposures
        )
    designs = [
        Design(
            name=job.design,
            rails=constraints.check(rails[r % len(rails)].clone(), light),
            classifier=classifiers[r],
            mean=mean[r] / s,
            std=std[r] / s,
            shares=counts[r] / s,
            summed_reflectance=s,
            light=light,
            image_shape=training_set.data.image_shape,
            classes=training_set.data.classes,
            exposure=schedules[r] if schedules else job.conditioning or FixedDwells(),
        )
        for r, job in enumerate(jobs)
    ]
    for job, design in zip(jobs, designs, strict=True):
        if job.training.looks > 1:
            design.shares = _shares(design, training_set, job)
    return designs


def _shares(design: Design, training_set: TrainingSet, job: Job) -> Tensor:
    """Share of the budget (m,) that each mask counts, in the mean over training scenes."""
    scanner = design.scanner()
    generator = torch.Generator(training_set.device).manual_seed(job.seed)
    shares = torch.zeros_like(design.mean)
    with torch.no_grad():
        for x in training_set.full.split(CHUNK):
            rates = design.rates(scanner, x)
            *_, seen = design.expose(scanner, rates, generator, job.photons)
            assert seen.dwell is not None
            shares += (design.masks * seen.dwell * rates[..., 0, :]).sum(dim=0)
    return shares / len(training_set.full)
