"""Learn masks and classifier together, one design or several that share a shape."""

import os
import time
from collections.abc import Sequence
from dataclasses import replace
from typing import Any

import numpy as np
import torch

from deepfsi.base import SILENT, InputError, Progress, plain_keywords, progress_bar
from deepfsi.camera import CameraSource, check_budget
from deepfsi.datasets import Source, as_dataset
from deepfsi.design.design import Design
from deepfsi.exposure.draws import dtypes
from deepfsi.exposure.kinds import begin
from deepfsi.exposure.statistics import feature_statistics
from deepfsi.exposure.trained import Clicks, MaskExposure, TrainedMasks
from deepfsi.exposure.training_set import TrainingSet
from deepfsi.jobs import ExposureSource, Job, TrainingSource, find_job, table_advice
from deepfsi.physics import (
    Detection,
    FixedMasks,
    FixedPattern,
    LearnedMasks,
    Rails,
    TrainingNoise,
    library_defaults,
    light_law,
    noise_of,
)
from deepfsi.training.adaptive import adaptive_designs
from deepfsi.training.batches import check_fits
from deepfsi.training.characterisation import characterise
from deepfsi.training.checkpoint import NO_CHECKPOINT, Checkpoint
from deepfsi.training.counts import train_for_counts
from deepfsi.training.folds import folds_of
from deepfsi.training.info import detector_shares, provenance
from deepfsi.training.loop import Classifier, optimise
from deepfsi.training.masks import final_masks, initial_masks
from deepfsi.training.passing import passing_statistics

REMEDY = "lower lr and mask_lr, or try another seed or more photons"
"""What to do where a training diverged."""

USUAL_SHARE = 0.5
"""Share of the budget that adaptive masks count, nearly: half of the mirrors are ON."""


class Diverged(InputError):
    """Training ended in numbers that are not finite."""


@plain_keywords(table_advice)
@library_defaults(grad=True)
def learn(
    data: Source,
    *,
    design: str = "deepfsi",
    masks: int | None = None,
    photons: float | None = None,
    camera: CameraSource = None,
    exposure: ExposureSource | None = None,
    training: TrainingSource | None = None,
    seed: int = 0,
    counts: float | None = None,
    matrix: np.ndarray | None = None,
    device: str | torch.device = "auto",
    report: Progress | None = None,
    checkpoint: str | os.PathLike[str] | None = None,
) -> Design:
    """Train one design on all training scenes of a data set.

    Parameters
    ----------
    data : Dataset, str, path or tuple of arrays
        Or whatever `load_dataset` makes one of: a name, a path, ``(x, y)``.
    design : str
        Which design: ``"deepfsi"``, whose masks are learned, ``"pca"``, ``"adaptive"``, … .
    masks : int, optional
        Number of masks, m; needed but for `Passing`, which has as many as bins.
    photons : float, optional
        Budget Φ; flux times exposure of the camera unless given.
    camera : Camera, str, path or mapping, optional
        The camera, a preset's name, a TOML file or fields; ``"dmd"`` unless given.
    exposure : Exposure or mapping, optional
        `Looks`, `Nested`, `Range`, `Patches`, `Passing` or their fields; `Fixed` unless given.
    training : Training or mapping, optional
        Settings of the training; those tuned for the design unless given.
    seed : int
        Of the random numbers: the same one repeats the result exactly on one device.
    counts : float, optional
        What the detectors are to count, in the mean over training scenes. Instead of `photons`:
        learned masks are trained again until that holds, see `training.counts`. With `photons`:
        masks learn to count no more of that budget, see `training.counts`.
    matrix : array, shape (m, N), optional
        Your own sensing matrix, for ``design="custom"``.
    device : str or torch.device
        Such as ``"cuda:1"`` (`physics.torch_device`).
    report : Report, optional
        Where to say how far the training is; a bar where a terminal is attached unless given.
    checkpoint : path, optional
        File of the training's state, written every two minutes and at Ctrl-C, removed at the end.
        If it is there, the training is resumed from it, to the same bits. Parts of your own are
        given by their import paths then; modules keep their state in parameters and buffers.

    Raises
    ------
    InputError
        For any setting that is not allowed; for a checkpoint of another training.

    Examples
    --------
    >>> import deepfsi
    >>> digits, few = deepfsi.load_dataset("digits"), deepfsi.Training(epochs=1)
    >>> deepfsi.learn(digits, camera="dmd", photons=1e4, masks=10, training=few).matrix.shape
    (10, 64)
    """
    settings = {
        "design": design,
        "masks": masks,
        "photons": photons,
        "camera": camera,
        "exposure": exposure,
        "training": training,
        "seed": seed,
    }
    job = find_job(settings, counts)
    training_set = TrainingSet(as_dataset(data), device)
    state = Checkpoint.of(checkpoint, training_set, [job], matrix, counts)

    def train_at(photons: float, bar: Progress) -> Design:
        at_budget = job.model_copy(update={"photons": check_budget(photons)})
        return train(training_set, [at_budget], matrix, bar, state)[0]

    with progress_bar(report, f"{job.design}, {job.masks} masks") as bar:
        if counts is None or job.training.counts is not None:
            made = train_at(job.photons, bar)
        else:
            share = _first_share(training_set, job, matrix)
            made = train_for_counts(counts, share, train_at, bar)
    state.remove()
    return made


@library_defaults(grad=True)
def train(
    training_set: TrainingSet,
    jobs: Sequence[Job],
    matrix: np.ndarray | None = None,
    report: Progress = SILENT,
    checkpoint: Checkpoint = NO_CHECKPOINT,
) -> Sequence[Design]:
    """Train designs side by side that differ in budget, sigma and seed only, in their order."""
    # The jobs agree in `companions`, those of one seed one after another; the matrix (m, N) is of
    # "custom" designs. Whoever keeps the designs removes the checkpoint
    began = time.perf_counter()
    _check(training_set, jobs, matrix)
    if jobs[0].code.adaptive:
        return adaptive_designs(training_set, jobs, report)
    folds = [] if training_set.data.held_out else folds_of(training_set.data)
    own, *others = report.split(1 + len(folds))
    designs = _designs(training_set, jobs, *_optimised(training_set, jobs, matrix, own, checkpoint))
    for job, design in zip(jobs, designs, strict=True):
        design.info = provenance(job, training_set.data, training_set.device, 0.0)
        design.exposure = design.mask_exposure.with_optics(clicks=Clicks.of(design.info))
        design.training_scenes = training_set.scenes
    left_out = []
    for fold, part in zip(folds, others, strict=True):
        kept = training_set.of(fold)
        trained = _optimised(kept, jobs, matrix, part, checkpoint)
        left_out.append((fold, _designs(kept, jobs, *trained)))
    characterise(training_set, jobs, designs, left_out)
    seconds = (checkpoint.seconds + time.perf_counter() - began) / len(jobs)
    for design in designs:
        design.info["seconds"] = seconds
        labels = design.detection.labels
        if labels is not None:
            design.info["detector_light"] = detector_shares(
                training_set.data.x_train, training_set.data.groups, labels.cpu().numpy()
            )
    return designs


def companions(job: Job, device: torch.device) -> tuple[Any, ...]:
    """Key that jobs trained together share: all but budget, sigma and seed."""
    # a module of a user's own may draw from torch's global generator: one after another
    alone = job.training.is_custom or not job.exposure.side_by_side
    apart: Any = set() if alone else {"photons": True, "seed": True, "camera": {"sigma"}}
    return (job.model_dump_json(exclude=apart), dtypes(job, device))


def _check(training_set: TrainingSet, jobs: Sequence[Job], matrix: np.ndarray | None) -> None:
    """Raise an error unless jobs can train together on the data, in the memory that is free."""
    # Jobs that learn the masks of others before ask for nothing that these do not
    if len({companions(each, training_set.device) for each in jobs}) > 1:
        raise ValueError("jobs that train together may differ in photons, sigma and seed only")
    for each in jobs:
        each.check(training_set.data, matrix)
    check_fits(training_set, jobs)


Optimised = tuple[FixedMasks, TrainingNoise, list[Classifier], list[MaskExposure]]
"""Masks after training, the noise that they were trained under, networks and exposures."""


def _optimised(
    training_set: TrainingSet,
    jobs: Sequence[Job],
    matrix: np.ndarray | None,
    report: Progress,
    checkpoint: Checkpoint,
) -> Optimised:
    """Masks and networks after training."""
    # Masks of the control group are learned before, under gaussian noise and with a network of
    # their own
    device, shape, job = training_set.device, training_set.data.image_shape, jobs[0]
    noise, seen = _noise(jobs, training_set), training_set.seen(job.exposure)
    seeds = [torch.Generator(device).manual_seed(each.seed) for each in jobs]
    exposures = [begin(each, shape, seed) for each, seed in zip(jobs, seeds, strict=True)]
    masks: FixedMasks | LearnedMasks
    if job.code.learned_under:
        before, report = report.between(0.0, 0.5), report.between(0.5, 1.0)
        sources = [each.mask_job() for each in jobs]
        masks = _optimised(training_set, sources, None, before, checkpoint)[0]
    else:
        masks = initial_masks(seen, jobs, exposures[0], matrix).to(device)
    classifiers = optimise(training_set, jobs, masks, noise, exposures, report, checkpoint)
    if isinstance(masks, LearnedMasks):
        masks = final_masks(masks, seen, job, exposures[0])
    networks = [*classifiers, *(each.network for each in exposures if each.network is not None)]
    numbers = [masks().stacked, *(part for network in networks for part in network.parameters())]
    if not all(bool(torch.isfinite(part).all()) for part in numbers):
        checkpoint.remove()
        raise Diverged(f"training of {job.design} diverged: {REMEDY}")
    return masks, noise, classifiers, exposures


def _noise(jobs: Sequence[Job], training_set: TrainingSet) -> TrainingNoise:
    """Noise of the training of jobs."""
    mine = jobs[0].camera.noise if jobs[0].training.noise is None else jobs[0].training.noise
    setting = jobs[0].noise if isinstance(mine, str) else mine
    noises = [noise_of(job.camera, setting) for job in jobs]
    noises[0].check(learning=jobs[0].code.learned)
    gains = [job.photons / training_set.summed_reflectance for job in jobs]
    return TrainingNoise.of(noises, gains, [job.seed for job in jobs], training_set.device)


def _first_share(training_set: TrainingSet, job: Job, matrix: np.ndarray | None) -> float:
    """Share of the budget that the masks count before training; parameters as for `train`."""
    job.check(training_set.data, matrix)
    if job.code.adaptive:
        return USUAL_SHARE
    seen, shape = training_set.seen(job.exposure), training_set.data.image_shape
    exposure = begin(job, shape, torch.Generator().manual_seed(job.seed))
    masks = initial_masks(seen, [job], exposure, matrix)
    if isinstance(masks, LearnedMasks):
        masks = final_masks(masks, seen, job, exposure)
    total = masks.to(training_set.device)().total
    counts = float((total[0] @ seen.full.mean(dim=0)).sum()) * exposure.tokens(shape)
    return counts / training_set.summed_reflectance


def _designs(
    training_set: TrainingSet,
    jobs: Sequence[Job],
    masks: FixedMasks,
    noise: TrainingNoise,
    classifiers: list[Classifier],
    exposures: list[MaskExposure],
) -> list[Design]:
    """Designs of trained masks and networks, with the statistics of their features."""
    job, s = jobs[0], training_set.summed_reflectance
    light, shape = job.optics.light, training_set.data.image_shape
    law = light_law(light)
    rails, detection = masks().stacked, Detection.of(job.optics, shape)
    seen, scale = training_set.seen(job.exposure).full, job.training.scale
    with torch.no_grad():
        if isinstance(masks, FixedPattern):
            mean, std, counts = passing_statistics(seen, masks, noise, scale, job.seed)
        else:
            drawn = exposures[0].drawn(rails, light)
            mean, std, counts = feature_statistics(seen, masks, noise, scale, detection, drawn)
    designs = []
    for r, each in enumerate(jobs):
        optics = TrainedMasks(
            rails=Rails.of(law.check(rails[r % len(rails)].clone())),
            light=light,
            image_shape=shape,
            detection=detection,
            summed_reflectance=s,
            mean=mean[r] / s,
            std=std[r] / s,
            shares=counts[r] / s * exposures[r].tokens(shape),
        )
        designs.append(
            Design(
                name=each.design,
                classes=training_set.data.classes,
                exposure=replace(exposures[r].trained(masks, r), optics=optics),  # type: ignore[type-var]
                classifier=classifiers[r],
                values=training_set.values,
            )
        )
    return designs
