"""Learn masks and classifier together, for one design, or for several of equal shape."""

import os
import time
from collections.abc import Callable, Sequence
from dataclasses import asdict, replace
from typing import Any

import numpy as np
import torch

from deepfsi.adaptive.exposure import training_of
from deepfsi.base.arrays import check_memory, free_memory
from deepfsi.base.errors import InputError
from deepfsi.base.progress import SILENT, Progress, progress_bar
from deepfsi.camera.camera import CameraSource
from deepfsi.datasets.dataset import Dataset
from deepfsi.datasets.load import Source, as_dataset
from deepfsi.design.design import Design
from deepfsi.design.networks import Classifier
from deepfsi.exposure.training import ExposureTraining, JobGroup, matrix_seeds
from deepfsi.exposure.training_set import TrainingSet, network_dtype, product_dtype
from deepfsi.jobs.exposures import AdaptiveMasks, ExposureSource
from deepfsi.jobs.job import Job, job_of
from deepfsi.jobs.training import TrainingSource
from deepfsi.physics.surroundings import library_defaults
from deepfsi.training.assembly import designs_of
from deepfsi.training.characterisation import (
    calibrate_posterior,
    characterise,
    detector_shares,
    fold_answers,
    folds_of,
    provenance,
)
from deepfsi.training.checkpoint import NO_CHECKPOINT, Checkpoint
from deepfsi.training.hooks import Epoch, EpochWatch
from deepfsi.training.loop import batch_of, optimise


class Diverged(InputError):
    """Training ended in numbers that are not finite."""


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
    callback: Callable[[Epoch], bool | None] | None = None,
) -> Design:
    """Train one design on all training scenes of a data set.

    Parameters
    ----------
    data : Dataset, str, path or tuple of arrays
        A data set, or a source for `load_dataset`: a name, a path or ``(x, y)``.
    design : str
        ``"deepfsi"`` learns its masks; ``"pca"``, ``"hadamard"``, … have fixed masks;
        ``"adaptive"`` chooses each mask from the counts so far.
    masks : int, optional
        Number of masks, m. Only an exposure that brings its masks needs none.
    photons : float, optional
        Budget Φ: expected photons on the device in one exposure. Default: flux times exposure time
        of the camera.
    camera : Camera, str, path or mapping, optional
        A camera, a preset's name, a TOML file or fields. Default: ``"dmd"``.
    exposure : Exposure or mapping, optional
        `Range` trains one design for several budgets. Default: `Fixed`.
    training : Training or mapping, optional
        Settings of the training. Default: the settings tuned for the design.
    seed : int
        Seed of the random numbers: it repeats a result bit for bit on one device.
    counts : float, optional
        Photons that an exposure counts, averaged over training scenes: learned masks count no more
        than this of the budget (`training.losses`).
    matrix : array, shape (m, N), optional
        Your sensing matrix, for ``design="custom"``.
    device : str or torch.device
        Torch device such as ``"cuda:1"``; ``"auto"`` takes a GPU if there is one.
    report : Progress, optional
        Receives the progress. Default: a bar if a terminal is attached.
    checkpoint : path, optional
        File for the state of the training, written every two minutes, removed at the end. A
        training that finds it there resumes, to the same bits. Give your own parts by import path
        then; your modules must keep their state in parameters and buffers.
    callback : callable, optional
        Called with an `Epoch` after each epoch: loss, learning rate, and loss and accuracy of the
        scenes that ``data.hold_out()`` holds out. The training ends if it returns true, and does
        not otherwise depend on it. `Design.info` keeps the ``history``.

    Raises
    ------
    InputError
        For a setting that is not allowed, or a checkpoint of another training.

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
    scenes = as_dataset(data)
    return learn_job(
        job_of(settings, scenes, counts=counts, matrix=matrix),
        scenes,
        matrix=matrix,
        device=device,
        report=report,
        checkpoint=checkpoint,
        callback=callback,
    )


@library_defaults(grad=True)
def learn_job(
    job: Job,
    data: Dataset,
    *,
    matrix: np.ndarray | None = None,
    device: str | torch.device = "auto",
    report: Progress | None = None,
    checkpoint: str | os.PathLike[str] | None = None,
    callback: Callable[[Epoch], bool | None] | None = None,
) -> Design:
    """Train the design of a job; `learn` explains the arguments."""
    if callback is not None and job.facts.adaptive:
        raise InputError("adaptive masks learn by no steps: leave callback out")
    training_set = TrainingSet(data, device)
    state = Checkpoint.of(checkpoint, training_set, [job], matrix)
    with progress_bar(report, f"{job.design}, {job.masks} masks") as bar:
        [design] = train(training_set, [job], matrix, bar, state, callback)
    state.remove()
    return design


@library_defaults(grad=True)
def train(
    training_set: TrainingSet,
    jobs: Sequence[Job],
    matrix: np.ndarray | None = None,
    report: Progress = SILENT,
    checkpoint: Checkpoint = NO_CHECKPOINT,
    callback: Callable[[Epoch], bool | None] | None = None,
) -> Sequence[Design]:
    """Train designs side by side that differ only in budget, sigma and seed.

    A callback follows a single design. Shapes: matrix (m, N).
    """
    began = time.perf_counter()
    for job in jobs:
        job.check(training_set.data, matrix)
    check_fits(training_set, jobs)
    if jobs[0].facts.adaptive:
        return _adaptive_designs(training_set, jobs, report)
    folds = [] if training_set.data.held_out else folds_of(training_set.data)
    of_all, *of_folds = report.split(1 + len(folds))
    epochs = EpochWatch(callback)
    group = JobGroup(training_set, jobs, matrix)
    designs = _designs(group, of_all, checkpoint=checkpoint, epochs=epochs)
    for job, design in zip(jobs, designs, strict=True):
        design.info = provenance(job, training_set.data, training_set.device)
        if callback is not None:
            design.info["history"] = [asdict(epoch) for epoch in epochs.history]
        design.training_scenes = training_set.known
    left_out = []
    for fold, span in zip(folds, of_folds, strict=True):
        group = JobGroup(training_set.of(fold), jobs, matrix)
        without = _designs(group, span, checkpoint=checkpoint, epochs=epochs.for_fold())
        left_out.append((fold, without))
    characterise(training_set, jobs, designs, left_out)
    seconds = (checkpoint.seconds + time.perf_counter() - began) / len(jobs)
    for design in designs:
        design.info["seconds"] = seconds
        labels = design.exposure.detection.labels
        if labels is not None:
            design.info["detector_light"] = detector_shares(
                training_set.data.x_train, training_set.data.groups, labels.cpu().numpy()
            )
    return designs


def companions(job: Job, device: torch.device) -> tuple[Any, ...]:
    """Key that jobs trained together share: all settings except budget, sigma and seed."""
    # a user's module may draw from torch's global generator: train such jobs one by one
    alone = job.training.is_custom or not job.exposure.side_by_side
    varying: Any = set() if alone else {"photons": True, "seed": True, "camera": {"sigma"}}
    types = product_dtype(job.mask_job(), device), network_dtype(job, device)
    return (job.model_dump_json(exclude=varying), types)


def _designs(
    group: JobGroup, report: Progress, *, checkpoint: Checkpoint, epochs: EpochWatch
) -> list[Design]:
    """Designs of jobs that train side by side."""
    jobs = group.jobs
    if jobs[0].facts.learned_under:
        # the control group first learns masks under gaussian noise, with a network of their own
        before, report = report.split(2)
        teachers = JobGroup(group.training_set, [job.mask_job() for job in jobs])
        taught = _optimised(teachers, before, checkpoint=checkpoint, epochs=epochs)[0]
        group = replace(group, masks=taught.masks)
    return designs_of(*_optimised(group, report, checkpoint=checkpoint, epochs=epochs))


def _optimised(
    group: JobGroup, report: Progress, *, checkpoint: Checkpoint, epochs: EpochWatch
) -> tuple[ExposureTraining, list[Classifier]]:
    """Masks, fixed from here on, and networks after training."""
    exposure = group.training()
    classifiers = optimise(exposure, report, checkpoint, epochs)
    exposure.fix()
    weights = [parameter for network in classifiers for parameter in network.parameters()]
    if not all(
        bool(torch.isfinite(tensor).all()) for tensor in [exposure.masks().stacked, *weights]
    ):
        checkpoint.remove()
        raise Diverged(
            f"training of {group.jobs[0].design} diverged: lower lr and mask_lr, or try another "
            "seed or more photons"
        )
    return exposure, classifiers


def _adaptive_designs(
    training_set: TrainingSet, jobs: Sequence[Job], report: Progress
) -> list[Design]:
    """Adaptive designs of jobs, which share one prior of scenes and take no steps."""
    began = time.perf_counter()
    data = training_set.data
    first = jobs[0]
    settings = AdaptiveMasks(
        looks=first.masks,
        clusters=first.training.clusters,
        cap=first.exposure.most_light,
        dictionary=first.training.dictionary,
        # Looks of a dictionary do not remember the scene's distance from the prior
        spread=0.5 if first.training.dictionary else 0.7,
    )
    clicks = first.optics.clicks is not None
    training = training_of(clicks)(data, settings)
    folds = [] if clicks else folds_of(data)
    designs: list[Design] = []
    for job, span in zip(jobs, report.split(len(jobs)), strict=True):
        # adaptive masks are computed on the processor
        info = provenance(job, data, torch.device("cpu"))
        exposure, answers = training.make(job, span)
        if folds:
            answers = fold_answers(folds, training, job, exposure.dictionary)
        rest = span.between(0.5, 1)
        longest = training.longest(exposure, job, rest) if settings.cap > 1 else None
        if longest and not folds:
            # temperatures come from answers at the ends of exposures, which probabilities set: here
            # probabilities without temperatures
            answers = longest.ended(longest.shared(exposure))
        exposure, info["left_out"] = calibrate_posterior(exposure, answers, data, job)
        if longest:
            exposure = longest.shared(exposure)  # the same light, now by calibrated probabilities
            info["stopping"] = {"threshold": exposure.settings.until, "photons": job.photons}
        info["seconds"] = (time.perf_counter() - began) / (len(designs) + 1)
        designs.append(
            Design(
                name=job.design,
                classes=data.classes,
                exposure=exposure,
                info=info,
                training_scenes=training_set.known,
            )
        )
        span(1.0)
    return designs


def check_fits(training_set: TrainingSet, jobs: Sequence[Job], processes: int = 1) -> None:
    """Raise `InputError` if training jobs together takes more memory than is free."""
    scenes, pixels = training_set.full.shape
    check_memory(
        # the scenes are in memory already
        footprint(training_set, jobs) * processes - training_set.full.nbytes,
        f"{scenes} scenes of {pixels} pixels, {jobs[0].masks} masks and {processes} processes",
        "give fewer or smaller scenes (`size`), fewer `masks` or fewer `workers`",
        memory_for(training_set.device),
    )


def memory_for(device: torch.device) -> float:
    """Bytes free for this process on a device."""
    if device.type != "cuda":
        return free_memory()
    kept = torch.cuda.memory_reserved(device) - torch.cuda.memory_allocated(device)
    return float(torch.cuda.mem_get_info(device)[0] + kept)  # torch keeps what it has freed


def footprint(training_set: TrainingSet, jobs: Sequence[Job]) -> float:
    """Upper bound in bytes on the tensors of jobs that train together, scenes included."""
    job = jobs[0]
    pixels = training_set.full.shape[1]
    count = len(training_set.labels)
    replicas = len(jobs)
    masks = replicas * job.masks
    batch = batch_of(job.training, count)
    levels = job.optics.mask_levels(training_set.data.image_shape)
    # of a mask: weights, gradients, moments, stages and products; grey levels add their stages
    copies = 16 + (10 if levels else 0)
    learned = copies * masks * pixels if job.mask_job().facts.learned else 0
    matrices = replicas if job.facts.learned_under else len(matrix_seeds(jobs))
    products_of_all = 0 if job.facts.learned else 5 * matrices * count * job.masks
    # features and hidden units
    step = 12 * batch * (masks + replicas * sum(job.training.hidden))
    return 3 * training_set.full.nbytes + 4.0 * (learned + products_of_all + step)
