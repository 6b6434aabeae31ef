"""Masks of jobs: those that a training starts from, and those that it ends with."""

from collections.abc import Sequence

import numpy as np
import torch
from torch import Tensor

from deepfsi.errors import InputError
from deepfsi.optics import codes, constraints
from deepfsi.optics.masks import Fixed, Learned
from deepfsi.training.job import Job
from deepfsi.training.training_set import TrainingSet


def initial_masks(
    training_set: TrainingSet,
    jobs: Sequence[Job],
    matrix: np.ndarray | None = None,
    learned: Tensor | None = None,
) -> Fixed | Learned:
    """Masks before training: of R replicas, or of one where all share them.

    Parameters
    ----------
    training_set : TrainingSet
    jobs : sequence of Job
    matrix : array, shape (m, N), optional
        Of "custom" designs.
    learned : tensor, shape (R, 2 or 1, m, N), optional
        Rails of the control group, learned before.
    """
    if learned is not None:
        return Fixed(learned)
    job = jobs[0]
    light, rails = job.optics
    levels, several = job.training.levels, job.training.looks > 1
    if matrix is not None:
        signed = torch.from_numpy(np.asarray(matrix, dtype=np.float32)).unsqueeze(0)
    else:
        seeds = [each.seed for each in jobs] if job.drawn_from == "random" else [job.seed]
        signed = torch.stack([_matrix(training_set, job, seed) for seed in seeds])
    if job.code.learned:
        start = signed[..., training_set.pixels(light).cpu()].expand(len(jobs), -1, -1).clone()
        return Learned(start, "equal-dwell" if several else light, rails, levels)
    if matrix is not None:
        fitted = constraints.check(constraints.expand(signed[0], light, rails), light).unsqueeze(0)
    elif job.design == "raster":  # its scale is what defines it
        fitted = signed.unsqueeze(1)
    else:
        fitted = torch.stack([constraints.fit(each, light, rails) for each in signed])
    fitted = constraints.equalise(fitted) if several else fitted
    return Fixed(constraints.quantise(fitted, light, levels) if levels else fitted)


def final_masks(masks: Learned, training_set: TrainingSet, job: Job) -> Fixed:
    """Masks after training, of all pixels: dark where they were not learned.

    Nested ones take the whole of their constraint, by one common factor: so they are trained,
    however many of them are shown.

    Parameters
    ----------
    masks : Learned
    training_set : TrainingSet
    job : Job
        One of the jobs.
    """
    light, pixels = job.optics[0], training_set.pixels(job.optics[0])
    with torch.no_grad():
        learned = constraints.separate(*masks())
    rails = learned.new_zeros(*learned.shape[:-1], len(pixels))
    rails[..., pixels] = learned
    if job.training.looks > 1:
        # at the end only: its gradient would take from lit mirrors what they share
        rails = constraints.equalise(rails)
    if job.training.nested:
        rails = rails / constraints.used(rails, light)[..., -1:][..., None, None]
    return Fixed(rails)


def _matrix(training_set: TrainingSet, job: Job, seed: int) -> Tensor:
    """Matrix (m, N) that masks are fitted from; of one rail the first lit frames of a design."""
    name, count = job.drawn_from, job.masks
    if job.optics[1] == "dual" or job.code.single_rail:
        return torch.from_numpy(training_set.matrix(name, count, seed)).float()
    least, most = codes.count_allowed(name, training_set.data)
    for masks in range(min(max(-(-count // 2), least), most), most + 1):
        signed = torch.from_numpy(training_set.matrix(name, masks, seed)).float()
        frames = constraints.frames(constraints.expand(signed, "column"))
        if len(frames) >= count:
            return frames[:count]
    raise InputError(f"{count} frames are not allowed for {name}: give at most {len(frames)}")
