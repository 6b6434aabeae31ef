"""Masks of jobs: those that a training starts from, and those that it ends with."""

from collections.abc import Sequence

import numpy as np
import torch
from torch import Tensor

from deepfsi.errors import InputError
from deepfsi.optics import codes, constraints
from deepfsi.optics.constraints import Light
from deepfsi.optics.masks import Fixed, Learned
from deepfsi.training.job import Job
from deepfsi.training.training_set import TrainingSet


def initial_masks(
    training_set: TrainingSet, jobs: Sequence[Job], matrix: np.ndarray | None
) -> Fixed | Learned:
    """Masks before training: of R replicas, or of one where all share them.

    Parameters
    ----------
    training_set : TrainingSet
    jobs : sequence of Job
    matrix : array, shape (m, N), or None
        Of "custom" designs.
    """
    job = jobs[0]
    light, rails = job.optics
    if matrix is not None:
        own = torch.from_numpy(np.asarray(matrix, dtype=np.float32))
        given = constraints.check(constraints.expand(own, light, rails), light)
        return _fixed(given.unsqueeze(0), job)
    seeds = [each.seed for each in jobs] if job.drawn_from == "random" else [job.seed]
    signed = torch.stack([_matrix(training_set, job, seed) for seed in seeds])
    if job.code.learned:
        start = signed[..., training_set.pixels(light).cpu()].expand(len(jobs), -1, -1).clone()
        shape: Light = "equal-dwell" if job.training.looks > 1 else light
        return Learned(start, shape, rails, job.training.steps)
    if job.design == "raster":  # its scale is what defines it
        return _fixed(signed.unsqueeze(1), job)
    return _fixed(torch.stack([constraints.fit(each, light, rails) for each in signed]), job)


def final_masks(masks: Learned, pixels: Tensor, job: Job) -> Fixed:
    """Masks after training, of all pixels: dark where they were not learned.

    Parameters
    ----------
    masks : Learned
    pixels : tensor, shape (N,)
        On which they were learned.
    job : Job
        One of the jobs.
    """
    with torch.no_grad():
        learned = constraints.separate(*masks())
    rails = learned.new_zeros(*learned.shape[:-1], len(pixels))
    rails[..., pixels] = learned
    if job.training.looks > 1:
        # at the end only: its gradient would take from lit mirrors what they share
        rails = constraints.equalise(rails)
    return Fixed(brighten(rails, job.optics[0]) if job.training.nested else rails)


def brighten(rails: Tensor, light: Light) -> Tensor:
    """Rails with one common factor that takes the whole of their constraint.

    So nested masks are trained, however many of them are shown.
    """
    return rails / constraints.used(rails, light)[..., -1:][..., None, None]


def _fixed(rails: Tensor, job: Job) -> Fixed:
    """Rails (R or 1, 2 or 1, m, N) with the grey levels of a job."""
    if job.training.looks > 1:
        rails = constraints.equalise(rails)
    steps = job.training.steps
    return Fixed(constraints.quantise(rails, job.optics[0], steps) if steps else rails)


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
