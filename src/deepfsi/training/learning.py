"""Learn masks and classifier together, one design or several that share a shape."""

import time
from collections.abc import Sequence
from typing import Any

import numpy as np
import torch
from torch import Tensor

from deepfsi.datasets import Dataset
from deepfsi.design.artifact import Design, provenance
from deepfsi.design.conditioning import Conditioning
from deepfsi.errors import InputError, as_input_error
from deepfsi.optics import codes, constraints
from deepfsi.optics.masks import Fixed, Learned
from deepfsi.training.features import CHUNK, statistics
from deepfsi.training.job import Job, TrainingSettings, check_job, training_for
from deepfsi.training.loop import Progress, optimise
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
    progress: Progress | None = None,
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
    progress : callable, optional
        Called with the share of the work that is done.
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
    """
    inner = {
        key: settings.pop(key) for key in list(settings) if key in TrainingSettings.model_fields
    }
    with as_input_error():
        how = training_for(settings.get("design", "deepfsi"), **inner)
        job = Job(photons=photons, masks=masks, training=how, **settings)
    return train(TrainingSet(data, device), [job], matrix=matrix, progress=progress)[0]


def train(
    scenes: TrainingSet,
    jobs: Sequence[Job],
    matrix: np.ndarray | None = None,
    progress: Progress | None = None,
) -> list[Design]:
    """Train designs side by side that differ in budget, sigma and seed only.

    Parameters
    ----------
    scenes : TrainingSet
    jobs : sequence of Job
        R jobs that agree in `Job.companions`, those of one seed one after another.
    matrix : array, shape (m, N), optional
        Sensing matrix of "custom" designs.
    progress : callable, optional

    Returns
    -------
    list of Design
        In the order of `jobs`.
    """
    began = time.perf_counter()
    report = progress or (lambda share: None)
    for job in jobs:
        check_job(job, scenes.data, matrix)
    first = jobs[0]
    if any(job.companions(scenes.device) != first.companions(scenes.device) for job in jobs):
        raise ValueError("jobs that train together may differ in photons, sigma and seed only")

    masks: Fixed | Learned
    if first.design == "control":
        optimised = train(
            scenes,
            [job.masks_from() for job in jobs],
            progress=lambda share: report(share / 2),
        )
        masks = Fixed(torch.stack([design.rails for design in optimised]))
        classifiers, schedules = optimise(
            scenes, jobs, masks, lambda share: report(0.5 + share / 2)
        )
    else:
        masks = _masks(scenes, jobs, matrix).to(scenes.device)
        classifiers, schedules = optimise(scenes, jobs, masks, report)
        if isinstance(masks, Learned):
            masks = _whole(masks, scenes.pixels(first.light))
            if first.training.looks > 1:
                # at the end only: its gradient would take from lit mirrors what they share
                masks = Fixed(constraints.equalise(constraints.separate(*masks())))
            if first.training.nested:
                masks = brighten(masks, first.light)

    with torch.no_grad():
        networks = [*classifiers, *schedules]
        learned = [*masks(), *(part for net in networks for part in net.parameters())]
        if not all(bool(torch.isfinite(part).all()) for part in learned):
            raise Diverged(f"training of {first.design} diverged: lower lr and mask_lr")
        centre, spread, light = statistics(scenes, jobs, masks)
    constraint, _ = first.optics
    every = constraints.separate(*masks())
    seconds = time.perf_counter() - began
    designs = [
        Design(
            name=job.design,
            rails=constraints.check(every[r % len(every)].clone(), constraint),
            classifier=classifiers[r],
            mean=centre[r] / scenes.light,
            std=spread[r] / scenes.light,
            shares=light[r] / scenes.light,
            summed_reflectance=scenes.light,
            light=constraint,
            image_shape=scenes.data.image_shape,
            classes=scenes.data.classes,
            told=Conditioning(job.photons, job.training.span, job.masks)
            if job.training.told
            else None,
            schedule=schedules[r] if schedules else None,
            info=provenance(job, scenes.data, scenes.device, seconds / len(jobs)),
        )
        for r, job in enumerate(jobs)
    ]
    for job, design in zip(jobs, designs, strict=True):
        if design.schedule is not None:
            design.shares = _shares(design, scenes, job)
    return designs


def _shares(design: Design, scenes: TrainingSet, job: Job) -> Tensor:
    """Share of the budget (m,) that each mask counts, in the mean over training scenes."""
    scanner = design.scanner()
    generator = torch.Generator(scenes.device).manual_seed(job.seed)
    shares = torch.zeros_like(design.mean)
    with torch.no_grad():
        for x in scenes.full.split(CHUNK):
            rates = scanner.rates(x / scenes.light)
            *_, seen = design.expose(scanner, rates, generator, job.photons)
            shares += (design.masks * seen.dwell * rates[..., 0, :]).sum(dim=0)
    return shares / len(scenes.full)


def _masks(scenes: TrainingSet, jobs: Sequence[Job], matrix: np.ndarray | None) -> Fixed | Learned:
    job = jobs[0]
    light, rails = job.optics
    name = job.drawn_from
    if matrix is not None:
        own = torch.from_numpy(np.asarray(matrix, dtype=np.float32))
        if rails == "single":
            own_rails = own.unsqueeze(0)
        else:
            own_rails = constraints.arms(own) if light == "two-arm" else constraints.split(own)
        return _fixed(constraints.check(own_rails, light).unsqueeze(0), job)
    signed = []
    for seed in [each.seed for each in jobs] if name == "random" else [job.seed]:
        if rails == "dual" or job.code.single_rail:
            signed.append(torch.from_numpy(scenes.matrix(name, job.masks, seed)).float())
        else:
            signed.append(_frames(scenes, name, job.masks, seed))
    if job.code.learned:
        start = torch.stack(signed)[..., scenes.pixels(light).cpu()]
        start = start.expand(len(jobs), -1, -1).clone()
        shape: constraints.Light = "equal-dwell" if job.training.looks > 1 else light
        return Learned(start, shape, rails, job.training.steps)
    if job.design == "raster":
        return _fixed(signed[0][None, None], job)
    return _fixed(torch.stack([constraints.fit(matrix, light, rails) for matrix in signed]), job)


def _fixed(rails: Tensor, job: Job) -> Fixed:
    """Rails (R or 1, 2 or 1, m, N) with the grey levels of a job."""
    light, steps = job.optics[0], job.training.steps
    if job.training.looks > 1:
        rails = constraints.equalise(rails)
    return Fixed(constraints.quantise(rails, light, steps) if steps else rails)


def _whole(masks: Learned, pixels: Tensor) -> Fixed:
    """What was learned on some pixels, as masks of all: dark elsewhere."""
    with torch.no_grad():
        rails = constraints.separate(*masks())
    whole = rails.new_zeros(*rails.shape[:-1], len(pixels))
    whole[..., pixels] = rails
    return Fixed(whole)


def brighten(masks: Fixed, light: constraints.Light) -> Fixed:
    """Masks with one common factor that takes the whole of their constraint.

    So nested masks are trained, however many of them are shown.
    """
    rails = constraints.separate(*masks())
    used = constraints.used(rails, light)[..., -1:]
    return Fixed(rails / used[..., None, None])


def _frames(scenes: TrainingSet, name: str, count: int, seed: int) -> Tensor:
    """The first `count` lit rails of a design, mask by mask; the masks are as many as needed."""
    least, most = codes.count_allowed(name, scenes.data)
    for masks in range(min(max(-(-count // 2), least), most), most + 1):
        signed = torch.from_numpy(scenes.matrix(name, masks, seed)).float()
        lit_frames = constraints.frames(constraints.split(signed))
        if len(lit_frames) >= count:
            return lit_frames[:count]
    raise InputError(f"{count} frames are not allowed for {name}: give at most {len(lit_frames)}")
