"""Learn masks and classifier together, one design or several that share a shape."""

import time
from collections.abc import Sequence
from importlib.metadata import version
from typing import Any

import numpy as np
import torch
from pydantic import BaseModel
from torch import Tensor

from deepfsi.datasets import Dataset
from deepfsi.design.adaptive import AdaptiveDwells
from deepfsi.design.artifact import Design
from deepfsi.design.classifiers import Mlp
from deepfsi.design.exposure import FixedDwells
from deepfsi.errors import InputError, as_input_error
from deepfsi.optics import codes, constraints
from deepfsi.optics.features import CHUNK, FeatureNoise, feature_statistics, mean_over_exposures
from deepfsi.optics.grey_levels import quantise
from deepfsi.optics.masks import Fixed, Learned
from deepfsi.progress import SILENT, Report
from deepfsi.training.job import Job, TrainingSettings, check_jobs, training_for
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
    """Train designs side by side that differ in budget, sigma and seed only, in their order.

    Parameters
    ----------
    training_set : TrainingSet
    jobs : sequence of Job
        R jobs that agree in `Job.companions`, those of one seed one after another.
    matrix : array, shape (m, N), optional
        Sensing matrix of "custom" designs.
    report : Report
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
    masks = _initial_masks(training_set, jobs, matrix, learned).to(device)
    classifiers, schedules = optimise(training_set, jobs, masks, noise, report)
    if isinstance(masks, Learned):
        masks = _final_masks(masks, training_set, first)
    networks = [*classifiers, *(each.network for each in schedules)]
    numbers = [*masks(), *(part for network in networks for part in network.parameters())]
    if not all(bool(torch.isfinite(part).all()) for part in numbers):
        raise Diverged(f"training of {first.design} diverged: lower lr and mask_lr")
    designs = _designs(training_set, jobs, masks, noise, classifiers, schedules)
    seconds = (time.perf_counter() - began) / len(jobs)
    for job, design in zip(jobs, designs, strict=True):
        design.info = provenance(job, training_set.data, device, seconds)
    return designs


def _initial_masks(
    training_set: TrainingSet,
    jobs: Sequence[Job],
    matrix: np.ndarray | None = None,
    learned: Tensor | None = None,
) -> Fixed | Learned:
    """Masks before training: of R replicas, or of one where all share them."""
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
    return Fixed(quantise(fitted, light, levels) if levels else fitted)


def _final_masks(masks: Learned, training_set: TrainingSet, job: Job) -> Fixed:
    """Masks after training, of all pixels: dark where they were not learned.

    Nested ones take the whole of their constraint, by one common factor: so they are trained,
    however many of them are shown.
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


def provenance(
    job: BaseModel, data: Dataset, device: torch.device, seconds: float
) -> dict[str, Any]:
    """Provenance of a design for `Design.info`, from parameters of its training."""
    return {
        "job": job.model_dump(mode="json"),
        "data": {"name": data.name, "hash": data.hash},
        "preprocessing": data.preprocessing,
        "deepfsi": version("deepfsi"),
        "torch": torch.__version__,
        "device": device.type,
        "seconds": seconds,
    }
