"""Characterisation of trained designs: light that they count, readouts and confidence."""

from collections.abc import Sequence
from math import prod

import numpy as np
import torch
from torch import Tensor

from deepfsi.datasets import Dataset
from deepfsi.design.artifact import Design
from deepfsi.design.confidence import fit_temperatures
from deepfsi.design.consistency import ReadoutDistribution
from deepfsi.design.evaluation import scanner_for
from deepfsi.design.readout_fit import sample_scenes
from deepfsi.design.temperatures import Temperatures
from deepfsi.optics.features import CHUNK
from deepfsi.training.job import Job
from deepfsi.training.training_set import TrainingSet


def characterise(training_set: TrainingSet, jobs: Sequence[Job], designs: Sequence[Design]) -> None:
    """Give designs that were trained together what simulated exposures tell of them."""
    first, scenes = designs[0], training_set.full
    for job, design in zip(jobs, designs, strict=True):
        chooses = design.exposure.chooses
        if chooses:
            design.shares = _shares(design, scenes, job.photons, job.seed)
        # of fixed dwells a distribution depends on the masks alone, which designs may share
        if (
            design is first
            or chooses
            or not torch.equal(*(each.rails.stacked for each in (first, design)))
        ):
            design.distribution = _distribution(design, scenes, training_set.data.groups)
        else:
            design.distribution = first.distribution
        if design.classes:
            design.temperatures = find_temperatures(design, job, training_set.data)


def find_temperatures(design: Design, job: Job, data: Dataset) -> Temperatures:
    """Temperatures of a trained design, by scenes that were held out where there are any."""
    held = data.held_out > 0
    x, labels = (data.x_test, data.y_test) if held else (data.x_train, data.y_train)
    readouts = prod(design.counts_shape) * design.exposure.tokens(design.image_shape)
    rows = sample_scenes(len(x), readouts, job.seed)
    budgets = job.photons, job.exposure.highest(job.photons)
    return fit_temperatures(
        design,
        scanner_for(design, job.camera),
        x[rows],
        labels[rows],
        budgets,
        trained_on=not held,
        seed=job.seed,
    )


def _shares(design: Design, scenes: Tensor, photons: float, seed: int) -> Tensor:
    """Share of the budget (k,) that each feature counts, in the mean over scenes (n, N)."""
    scanner = design.scanner()
    generator = torch.Generator(scenes.device).manual_seed(seed)
    shares = torch.zeros_like(design.mean)
    with torch.no_grad():
        for x in scenes.split(CHUNK):
            rates = design.rates(scanner, x)
            *_, seen = design.expose(scanner, rates, generator, photons)
            shares += design.detection.totals(design.exposure.shown(rates, seen)).sum(dim=0)
    return shares / len(scenes)


def _distribution(design: Design, scenes: Tensor, labels: np.ndarray) -> ReadoutDistribution | None:
    """Distribution of the readouts of scenes (n, N) of classes (n,), if it can be had."""
    if not design.exposure.comparable or design.gates is not None:
        return None
    rows = sample_scenes(len(scenes), prod(design.counts_shape))
    x = scenes[rows]
    several = labels[rows], len(design.classes) or 1, design.detection
    with torch.no_grad():
        rates, lit = design.rates(design.scanner(), x), x.sum(dim=-1) / design.summed_reflectance
        return design.exposure.distribution(rates, lit, *several, design.mean, design.std)
