"""Characterise trained designs: their light, readouts, confidence and provenance.

A small training set is split into folds. Designs trained without a fold calibrate the design that
is trained on all scenes.
"""

from collections.abc import Sequence
from copy import copy, deepcopy
from dataclasses import asdict, replace
from importlib.metadata import version
from math import prod
from typing import Any

import numpy as np
import torch
from pydantic import BaseModel

from deepfsi.adaptive.dictionary import MaskDictionary
from deepfsi.adaptive.exposure import (
    AdaptiveExposure,
    AdaptiveTraining,
    LeftOutAnswers,
    LeftOutScenes,
)
from deepfsi.datasets.alike import deal
from deepfsi.datasets.dataset import Dataset
from deepfsi.design.design import Design
from deepfsi.designfile.design_file import CALIBRATION_REACH, Temperatures, calibration_budgets
from deepfsi.designfile.misfit import MISFIT_BUDGETS, UsualMisfit
from deepfsi.designfile.provenance import TrainedOn
from deepfsi.designfile.view_test import SceneModel
from deepfsi.evaluation.confidence import (
    CalibrationScenes,
    Labelled,
    LeftOutTest,
    fit_temperatures,
    measure_left_out,
    sample_scenes,
)
from deepfsi.exposure.training_set import TrainingSet
from deepfsi.jobs.job import FEW_SCENES, Job

FOLDS = 10
"""Parts of the training scenes; one training leaves each out."""

LEFT_OUT = 150
"""Scenes that suffice for calibration: no fold is added beyond them."""

DOUBT = 1.0
"""Scenes of unknown class that calibration adds to the scenes left out."""


def characterise(
    training_set: TrainingSet,
    jobs: Sequence[Job],
    designs: Sequence[Design],
    left_out: Sequence[tuple[Dataset, Sequence[Design]]] = (),
) -> None:
    """Give trained designs usual misfit, scene model and temperatures, from simulation."""
    if designs[0].exposure.comparable and designs[0].camera.clicks is None:
        _model_counts(training_set, jobs, designs)
    for index, (job, design) in enumerate(zip(jobs, designs, strict=True)):
        if design.classes:
            folds = [(fold, of_jobs[index]) for fold, of_jobs in left_out]
            design.temperatures, test = find_temperatures(design, job, training_set.data, folds)
            if test is not None:
                design.info["left_out"] = asdict(test)


def find_temperatures(
    design: Design, job: Job, data: Dataset, left_out: Sequence[tuple[Dataset, Design]] = ()
) -> tuple[Temperatures, LeftOutTest | None]:
    """Temperatures of a trained design, and their test.

    They are fitted to held-out scenes; without these to folds; without folds to training scenes,
    and then there is no test.
    """
    budgets = calibration_budgets(job.photons, job.exposure.highest(job.photons))
    held = data.held_out > 0
    if left_out and not held:
        sets = [
            Labelled(trained, job.camera, fold.x_test, fold.y_test) for fold, trained in left_out
        ]
        # enough for about 1000 exposures in all
        draws = max(1, 1000 // sum(len(fold.x_test) for fold, _ in left_out))
        scenes = CalibrationScenes.of(sets, job.seed, draws, DOUBT)
    else:
        x, labels = (data.x_test, data.y_test) if held else (data.x_train, data.y_train)
        readouts = prod(design.counts_shape) * prod(design.mask_exposure.part_axis)
        rows = sample_scenes(len(x), readouts, job.seed)
        scene_set = Labelled(design, job.camera, x[rows], labels[rows])
        doubt = DOUBT if held and len(x) < LEFT_OUT else 0.0
        scenes = CalibrationScenes.of([scene_set], job.seed, doubt=doubt)
    fitted = fit_temperatures(scenes, budgets, trained_on=not (left_out or held))
    if not (left_out or held):
        return fitted, None
    return fitted, measure_left_out(scenes, fitted, job.photons, _guess(data))


def _model_counts(
    training_set: TrainingSet, jobs: Sequence[Job], designs: Sequence[Design]
) -> None:
    """Give designs the models for tests of a run's counts."""
    x = training_set.full
    rows = sample_scenes(len(x), x.shape[1])
    scenes = x[rows].double().cpu().numpy()
    labels = training_set.data.groups[rows]  # scenes with values are one class
    if not SceneModel.are_enough(np.bincount(labels, minlength=len(designs[0].classes))):
        return
    model = SceneModel.fit(scenes, labels)
    # The designs of a training have masks of one kind, and so counts of one shape
    fewer = min(2048, len(sample_scenes(len(scenes), prod(designs[0].counts_shape))))
    scenes = scenes[:fewer]
    labels = labels[:fewer]
    rng = np.random.default_rng([0, 12])
    folds = np.array_split(rng.permutation(fewer), 4)
    others = [SceneModel.fit(np.delete(scenes, f, 0), np.delete(labels, f)) for f in folds]
    for job, design in zip(jobs, designs, strict=True):
        design.scene_model = model
        # readouts of a frame share noise under unsteady light, which the test lacks
        if not design.camera.fluctuation:
            left_out = zip(folds, others, strict=True)
            design.usual_misfit = _usual_misfit(
                design, job.photons, scenes, list(left_out), deepcopy(rng)
            )


def _usual_misfit(
    design: Design,
    photons: float,
    scenes: np.ndarray,
    left_out: Sequence[tuple[np.ndarray, SceneModel]],
    rng: np.random.Generator,
) -> UsualMisfit:
    """Misfit of simulated exposures of scenes (n, N): of each fold by the model of the others."""
    exposure = design.mask_exposure
    with torch.no_grad():
        shown = torch.from_numpy(scenes).float().to(exposure.device)
        rates = exposure.rates(design.scanner(), shown).double().cpu().numpy()
    budgets = np.array(MISFIT_BUDGETS) * photons
    misfits = np.empty((len(budgets), 1, len(scenes)))
    for row, budget in enumerate(budgets.tolist()):
        counts = rng.poisson(rates * budget).astype(float)
        for fold, model in left_out:
            readouts = exposure.scene_readouts(counts[fold], budget, 0.0)
            misfits[row, 0, fold] = model.misfit(readouts)
    return UsualMisfit.of(budgets, misfits, scenes.sum(axis=1), rates.sum(axis=(1, 2)))


def fold_answers(
    folds: Sequence[Dataset],
    training: AdaptiveTraining,
    job: Job,
    dictionary: MaskDictionary | None,
) -> LeftOutAnswers:
    """Answers to the scenes of folds, each by a prior made without its fold.

    It is not enough to remove a scene from a finished prior: the components of a small set still
    tell its class.
    """
    answers = []
    for fold in folds:
        settings = training.settings
        if settings.clusters is not None:
            smallest = int(np.bincount(fold.y_train, minlength=len(fold.classes)).min())
            # a class needs as many different scenes as clusters
            clusters = min(settings.clusters, max(1, smallest // 2))
            settings = settings.model_copy(update={"clusters": clusters})
        scenes = LeftOutScenes(torch.from_numpy(fold.x_test), torch.from_numpy(fold.y_test), None)
        answers.append(AdaptiveTraining(fold, settings).measured(job, dictionary, scenes)[1])
    odds = torch.cat([of_fold.odds for of_fold in answers], dim=2)
    labels = torch.cat([of_fold.labels for of_fold in answers])
    return LeftOutAnswers(answers[0].budgets, odds, labels)


def calibrate_posterior(
    exposure: AdaptiveExposure, answers: LeftOutAnswers, data: Dataset, job: Job
) -> tuple[AdaptiveExposure, dict[str, Any]]:
    """The exposure with calibrated probabilities, and their test.

    Each step and budget with answers has its own temperature.
    """
    shares = exposure.prior.class_shares.double().numpy()
    looks = answers.odds.shape[1]
    budgets = answers.budgets.tolist()

    def odds(photons: float, step: int) -> np.ndarray:
        return answers.odds[budgets.index(photons), step].numpy()

    labels = answers.labels.numpy()
    scenes = CalibrationScenes(labels, odds, looks, base=np.log(shares), doubt=DOUBT)
    fitted = fit_temperatures(scenes, answers.budgets, trained_on=False)
    # beyond the measured light, the temperatures of its ends hold
    logs = np.pad(fitted.logs, ((0, exposure.count - looks), (1, 1)), mode="edge")
    ends = job.photons / CALIBRATION_REACH, job.photons * CALIBRATION_REACH
    temperatures = Temperatures(logs, np.array([ends[0], *answers.budgets, ends[1]]))
    test = measure_left_out(scenes, temperatures, job.photons, _guess(data))
    prior = copy(exposure.prior)  # other jobs share it, and have temperatures of their own
    prior.temperatures = temperatures
    return replace(exposure, prior=prior), asdict(test)


def folds_of(data: Dataset) -> list[Dataset]:
    """Folds of a small training set: the test part of each is left out of its training part.

    Each fold has all classes in proportion; its test part is sorted by class. The only scene of a
    class is never left out. Large sets and scenes with values have no folds. Pictures that are
    alike are left out together, and one of them is tested.
    """
    n = len(data.x_train)
    _, first = np.unique(data.alike, return_index=True)
    if not data.classes or len(first) >= FEW_SCENES:
        return []
    labels = data.y_train
    order = np.random.default_rng(0).permutation(n)
    order = order[np.argsort(labels[order], kind="stable")]
    order = order[np.bincount(labels)[labels[order]] > 1]
    left = [order[start::FOLDS] for start in range(FOLDS)]
    if len(first) < n:
        part = deal(data.alike, labels, FOLDS, seed=0)
        left = [np.flatnonzero(part == number) for number in range(FOLDS)]
    count = min(FOLDS, -(-LEFT_OUT * FOLDS // len(first)))
    return [_without(data, rows, first) for rows in left[:count] if len(rows)]


def _without(data: Dataset, rows: np.ndarray, tested: np.ndarray) -> Dataset:
    """Data without the given rows of the training scenes; its test part are those `tested`."""
    kept = np.setdiff1d(np.arange(len(data.x_train)), rows)
    rows = rows[np.isin(rows, tested)]
    return replace(
        data,
        x_train=data.x_train[kept],
        y_train=data.y_train[kept],
        x_test=data.x_train[rows],
        y_test=data.y_train[rows],
        origin=None,
    )


def _guess(data: Dataset) -> np.ndarray:
    """Share (C,) of each class in the training scenes."""
    return np.bincount(data.y_train, minlength=len(data.classes)) / len(data.y_train)


def provenance(job: BaseModel, data: Dataset, device: torch.device) -> dict[str, Any]:
    """Provenance of a design for `Design.info`."""
    return {
        "job": job.model_dump(mode="json"),
        "data": TrainedOn.of(data).model_dump(mode="json"),
        "preprocessing": data.preprocessing,
        "brightness": brightness(data.x_train, data.groups),
        "deepfsi": version("deepfsi"),
        "torch": torch.__version__,
        "device": device.type,
        "seconds": 0.0,  # the end of the training sets it
    }


def brightness(x: np.ndarray, labels: np.ndarray) -> dict[str, float] | None:
    """Spread of the summed reflectance of scenes (n, N); None if a class is dark.

    `low` and `high` are the dimmest and the brightest scene, relative to the mean; `between` is the
    brightest class relative to the dimmest; `within` is the largest relative standard deviation
    within a class.
    """
    sums = x.sum(axis=1, dtype=np.float64)
    groups = [sums[labels == label] for label in np.unique(labels)]
    means = np.array([group.mean() for group in groups])
    if not means.min() > 0:
        return None
    return {
        "low": float(sums.min() / sums.mean()),
        "high": float(sums.max() / sums.mean()),
        "between": float(means.max() / means.min()),
        "within": max(float(g.std() / mean) for g, mean in zip(groups, means, strict=True)),
    }


def detector_shares(
    x: np.ndarray, labels: np.ndarray, detectors: np.ndarray
) -> dict[str, list[Any]] | None:
    """Share of each detector in the light of each class; None if a class is dark.

    Scenes are (n, N), labels (n,), `detectors` (N,) has the detector of each pixel. Returns
    `shares` (C, D), and `spread` (D,): the standard deviation of single scenes about them, in the
    class where it is largest.
    """
    light = np.stack(
        [x[:, detectors == d].sum(axis=1, dtype=np.float64) for d in range(detectors.max() + 1)], 1
    )
    shares = []
    spread = []
    for label in np.unique(labels):
        of_class = light[labels == label]
        total = of_class.sum(axis=1, keepdims=True)
        if not total.mean() > 0:
            return None
        share = of_class.sum(axis=0) / total.sum()
        shares.append(share.tolist())
        spread.append(((of_class - share * total) / total.mean()).std(axis=0))
    return {"shares": shares, "spread": np.max(spread, axis=0).tolist()}
