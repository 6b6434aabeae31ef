"""Characterisation of trained designs: light that they count, readouts and confidence."""

from collections.abc import Sequence
from math import prod

import numpy as np
import torch
from torch import Tensor

from deepfsi.datasets import Dataset
from deepfsi.design.design import Design
from deepfsi.designfile import (
    ReadoutDistribution,
    SceneModel,
    Temperatures,
    calibration_budgets,
)
from deepfsi.evaluation import (
    CalibrationScenes,
    Exposed,
    LeftOutTest,
    fit_temperatures,
)
from deepfsi.exposure.readout_fit import find_distribution, sample_scenes
from deepfsi.exposure.statistics import CHUNK
from deepfsi.exposure.training_set import TrainingSet
from deepfsi.jobs import Job
from deepfsi.training.folds import DOUBT, LEFT_OUT, calibrated, draws_of


def characterise(
    training_set: TrainingSet,
    jobs: Sequence[Job],
    designs: Sequence[Design],
    left_out: Sequence[tuple[Dataset, Sequence[Design]]] = (),
) -> None:
    """Give designs that were trained together what simulated exposures tell of them.

    Parameters
    ----------
    training_set : TrainingSet
    jobs : sequence of Job
    designs : sequence of Design
    left_out : sequence of (Dataset, designs)
        Folds of the training scenes, and the designs of the same jobs that were trained on each.
    """
    first, scenes = designs[0], training_set.full
    for place, (job, design) in enumerate(zip(jobs, designs, strict=True)):
        chooses = design.exposure.chooses
        if chooses:
            design.exposure = design.mask_exposure.with_optics(
                shares=_shares(design, scenes, job.photons, job.seed)
            )
        # of fixed dwells a distribution depends on the masks alone, which designs may share
        if (
            design is first
            or chooses
            or not torch.equal(*(each.rails.stacked for each in (first, design)))
        ):
            design.distribution = _distribution(design, scenes, training_set.data.groups)
        else:
            design.distribution = first.distribution
        if design.exposure.comparable and design.gates is None:
            design.scene_model = first.scene_model or _scene_model(
                design, scenes, training_set.data.groups
            )
        if design.classes:
            folds = [(fold, several[place]) for fold, several in left_out]
            design.temperatures, test = find_temperatures(design, job, training_set.data, folds)
            if test is not None:
                design.info["left_out"] = test.as_dict()


def _scene_model(design: Design, scenes: Tensor, labels: np.ndarray) -> SceneModel | None:
    """Model of the scenes (n, N) of classes (n,), if there are enough."""
    rows = sample_scenes(len(scenes), scenes.shape[1])
    x = scenes[rows].double().cpu().numpy()
    return SceneModel.fit(x, labels[rows], len(design.classes) or 1)


def find_temperatures(
    design: Design, job: Job, data: Dataset, left_out: Sequence[tuple[Dataset, Design]] = ()
) -> tuple[Temperatures, LeftOutTest | None]:
    """Temperatures of a trained design, by scenes that were left out where there are any.

    Those are the scenes that the data holds out; else those of folds that designs of the same job
    were trained without; else scenes of the training, which give no test.
    """
    low, high = job.photons, job.exposure.highest(job.photons)
    budgets, stops = calibration_budgets(low, high), design.mask_exposure.count_stops
    if left_out and not data.held_out:
        parts = [
            Exposed(each, each.front_end(job.camera), fold.x_test, fold.y_test)
            for fold, each in left_out
        ]
        draws = draws_of([fold for fold, _ in left_out])
        scenes = CalibrationScenes(parts, stops, draws, doubt=DOUBT)
        return calibrated(scenes, budgets, data, low, job.seed)
    held = data.held_out > 0
    x, labels = (data.x_test, data.y_test) if held else (data.x_train, data.y_train)
    readouts = prod(design.counts_shape) * design.mask_exposure.tokens(design.image_shape)
    rows = sample_scenes(len(x), readouts, job.seed)
    part = Exposed(design, design.front_end(job.camera), x[rows], labels[rows])
    scenes = CalibrationScenes([part], stops, doubt=DOUBT if held and len(x) < LEFT_OUT else 0.0)
    if held:
        return calibrated(scenes, budgets, data, low, job.seed)
    return fit_temperatures(scenes, budgets, trained_on=True, seed=job.seed), None


def _shares(design: Design, scenes: Tensor, photons: float, seed: int) -> Tensor:
    """Share of the budget (k,) that each feature counts, in the mean over scenes (n, N)."""
    scanner, exposure = design.scanner(), design.mask_exposure
    generator = torch.Generator(scenes.device).manual_seed(seed)
    shares = torch.zeros_like(design.mean)
    with torch.no_grad():
        for x in scenes.split(CHUNK):
            rates = design.rates(scanner, x)
            seen = exposure.expose(scanner, rates, photons, generator)
            shares += design.detection.totals(exposure.expected(rates, seen)).sum(dim=0)
    return shares / len(scenes)


def _distribution(design: Design, scenes: Tensor, labels: np.ndarray) -> ReadoutDistribution | None:
    """Distribution of the readouts of scenes (n, N) of classes (n,), if it can be had."""
    if not design.exposure.comparable or design.gates is not None:
        return None
    rows = sample_scenes(len(scenes), prod(design.counts_shape))
    x = scenes[rows]
    with torch.no_grad():
        rates, lit = design.rates(design.scanner(), x), x.sum(dim=-1) / design.summed_reflectance
        whole, counting = design.mask_exposure.usual_readouts(rates, lit)
        return find_distribution(whole, labels[rows], len(design.classes) or 1, expose=counting)
