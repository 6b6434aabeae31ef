"""Learn masks and classifier together, one design or several that share a shape."""

import time
from collections.abc import Mapping, Sequence
from dataclasses import replace
from importlib.metadata import version
from typing import Any

import numpy as np
import torch
from pydantic import BaseModel
from torch import Tensor, nn

from deepfsi.datasets import Dataset, Source, as_dataset
from deepfsi.design.adaptive import AdaptiveDwells
from deepfsi.design.artifact import Design
from deepfsi.design.exposure import FixedDwells
from deepfsi.design.memory import Memory
from deepfsi.design.own import Factory, Given, describe
from deepfsi.errors import InputError, as_input_error
from deepfsi.optics import codes, constraints, tiles
from deepfsi.optics.budget import brightness, check_budget, check_one_budget
from deepfsi.optics.constraints import Light
from deepfsi.optics.detection import Detectors, Readout
from deepfsi.optics.features import (
    CHUNK,
    FeatureNoise,
    Scale,
    feature_statistics,
    mean_over_exposures,
)
from deepfsi.optics.grey_levels import quantise
from deepfsi.optics.masks import FixedMasks, LearnedMasks
from deepfsi.optics.noise import OwnNoise, check_dark, resolve, try_own
from deepfsi.optics.rails import Rails, RailsKind
from deepfsi.progress import SILENT, Report, shown
from deepfsi.training.counts import train_for_counts
from deepfsi.training.job import (
    MLP,
    Job,
    Precision,
    TrainingSettings,
    check_job,
    check_jobs,
    own_rails,
    seeds_of_matrices,
    training_for,
)
from deepfsi.training.loop import Classifier, check_fits, optimise
from deepfsi.training.training_set import TrainingSet

OWN_DEFAULT = ("lr", "scale", "start")
"""Settings that are the design's own unless given, see `training_for`."""


REMEDY = (
    "lower lr and mask_lr, in a recipe or in Python (for `deepfsi design`: try another --seed or "
    "more --photons)"
)
"""What to do where a training diverged."""


class Diverged(InputError):
    """Training ended in numbers that are not finite."""


def learn(
    data: Source,
    *,
    masks: int,
    photons: float | None = None,
    counts: float | None = None,
    design: str = "deepfsi",
    matrix: np.ndarray | None = None,
    noise: str | OwnNoise = "ml_gauss",
    sigma: float = 1.0,
    dark: float = 0.0,
    light: Light = "column",
    rails: RailsKind = "dual",
    detectors: Detectors = "1x1",
    readout: Readout | None = None,
    seed: int = 0,
    span: float = 1.0,
    nested: int = 0,
    looks: int = 1,
    shortest_dwell: float = 0.0,
    levels: int = 0,
    epochs: int = 40,
    batch: int | None = None,
    lr: float | None = None,
    mask_lr: float = 1e-1,
    hidden: Sequence[int] = (40, 128),
    dropout: float = 0.0,
    scale: Scale | None = None,
    decay: float = 0.0,
    balance: bool = False,
    start: str | None = None,
    precision: Precision = "auto",
    classifier: Given = MLP,
    classifier_arguments: Mapping[str, Any] | None = None,
    device: str = "auto",
    report: Report | None = None,
) -> Design:
    """Train one design on all training scenes of a data set.

    Parameters
    ----------
    data : Dataset, str, path or tuple of arrays
        Or whatever `load_dataset` makes one of: a name, a path, ``(x, y)``.
    masks : int
        m.
    photons : float, optional
        Budget Φ: expected photons on the coding device, in the mean over training scenes.
    counts : float, optional
        Instead of it: photons that the detectors are to count, in the mean over training scenes.
        Learned masks are trained again until that holds, see `training.counts`.
    design : str
        A key of `codes.DESIGNS`.
    matrix : array, shape (m, N), optional
        Your own sensing matrix, for ``design="custom"``.
    noise : {"ml_gauss", "poisson", "gaussian", "camera", "none"} or callable
        Of the training; or one of your own, as for `Scanner`.
    sigma : float
        Read noise in counts rms per readout, for gaussian and camera noise.
    dark : float
        Expected dark counts of one detector in a whole exposure, for camera noise.
    light : {"column", "equal-dwell", "free-dwell", "two-arm"}
    rails : {"dual", "single"}
    detectors : str or array of int, shape (N,)
        Parts of the device, each seen by a detector of its own: ``"2x2"`` for 2 rows and 2 columns,
        or the detector of each pixel, from 0.
    readout : {"difference", "both"}, optional
        What the network reads of two rails: y⁺ − y⁻, or each rail's counts. Both for two-arm and
        the difference else, unless given.
    seed : int
        Of the order of scenes, the initial weights and the noise.
    span : float
        Above 1 for a range of budgets, from `photons` to span times that.
    nested : int
        Fewest masks, first ones, that must do for a class; 0: all are needed.
    looks : int
        Looks of an exposure; from 2 on, counts choose the dwells of the next.
    shortest_dwell : float
        Shortest dwell of a frame that the device shows, a share of the exposure, where dwells are
        learned or chosen.
    levels : int
        Grey levels of the device, dark included; 0 for continuous masks.
    epochs, batch : int
        Batches are a hundredth of the scenes, 32 to 500, unless given.
    lr, mask_lr : float
        Peaks of the one-cycle schedule of the classifier, 1e-2 or what was tuned for the design
        unless given, and of the masks, relative to their rms.
    hidden : sequence of int
        Widths of the classifier's hidden layers.
    dropout, decay : float
        Of the classifier: probability, and decoupled weight decay.
    balance : bool
        Weigh training scenes so that every class counts alike, however few scenes it has.
    scale : {"each", "common"}, optional
        Whether each feature has a standard deviation of its own; common, or what was tuned for the
        design unless given.
    start : str, optional
        Design that learned masks start from; pca, or class-pairs for several looks unless given.
    precision : {"auto", "float32", "bfloat16"}
        Of the products of training, of learned masks and of wide networks.
    classifier : nn.Module, callable or str
        "mlp", or one of your own: a module from (batch, inputs) standardised features to (batch,
        C) logits, of which a copy is trained; a factory of it, ``factory(inputs, classes)`` or
        ``factory(inputs)``; or the import path of a factory, ``"module:name"``.
    classifier_arguments : mapping, optional
        Further keyword arguments of the factory.
    device : {"auto", "cpu", "cuda"}
    report : Report, optional
        Where to say how far the training is; a bar where a terminal is attached unless given.

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
    given = {
        name: value
        for name, value in locals().items()
        if value is not None or name not in OWN_DEFAULT
    }
    given["photons"] = check_one_budget(photons, counts, span)
    given["classifier"], given["classifier_arguments"] = describe(classifier, classifier_arguments)
    given["noise"], own_noise = resolve(noise)
    given["dark"] = check_dark(dark, given["noise"])
    if not isinstance(detectors, str):
        given["detectors"] = tuple(np.asarray(detectors).ravel().tolist())
    own = None if isinstance(classifier, str) else classifier
    with as_input_error():
        training = training_for(
            design, **{name: given[name] for name in TrainingSettings.model_fields if name in given}
        )
        named = {name: given[name] for name in Job.model_fields if name in given}
        job = Job(**named, training=training)
    if start and not codes.has_learned_masks(codes.check_design(design)):
        raise InputError(
            f"`start` is of learned masks, and {design} has its own: leave it out, or give "
            '`design="deepfsi"`'
        )
    training_set = TrainingSet(as_dataset(data), device)

    def train_at(photons: float, bar: Report) -> Design:
        at_budget = job.model_copy(update={"photons": check_budget(photons)})
        return train(training_set, [at_budget], matrix, bar, own, own_noise)[0]

    with shown(report, f"{design}, {masks} masks") as bar:
        if photons is not None:
            return train_at(photons, bar)
        share = _first_share(training_set, job, matrix)
        return train_for_counts(given["photons"], share, train_at, bar)


def train(
    training_set: TrainingSet,
    jobs: Sequence[Job],
    matrix: np.ndarray | None = None,
    report: Report = SILENT,
    classifier: nn.Module | Factory | None = None,
    own_noise: OwnNoise | None = None,
) -> list[Design]:
    """Train designs side by side that differ in budget, sigma and seed only, in their order.

    Shapes: matrix (m, N).
    """
    began = time.perf_counter()
    trained = _optimised(training_set, jobs, matrix, report, classifier, own_noise)
    designs = _designs(training_set, jobs, *trained)
    seconds = (time.perf_counter() - began) / len(jobs)
    for job, design in zip(jobs, designs, strict=True):
        design.info = provenance(job, training_set.data, training_set.device, seconds)
    return designs


def _optimised(
    training_set: TrainingSet,
    jobs: Sequence[Job],
    matrix: np.ndarray | None,
    report: Report,
    classifier: nn.Module | Factory | None,
    own_noise: OwnNoise | None,
) -> tuple[FixedMasks, FeatureNoise, list[Classifier], list[AdaptiveDwells]]:
    """Masks after training, the noise that they were trained under, and the networks.

    The jobs are checked first. Masks of the control group are learned before, under gaussian noise
    and with a network of their own, as jobs that are checked like any other.
    """
    device = training_set.device
    first = check_jobs(jobs, training_set.data, device, matrix)
    check_fits(training_set, jobs)
    own_noise = own_noise or resolve(first.noise)[1]
    if own_noise is not None:
        try_own(own_noise, first.code.learned)
    noise = FeatureNoise.of(
        first.noise,
        [job.photons / training_set.summed_reflectance for job in jobs],
        [job.sigma for job in jobs],
        [job.seed for job in jobs],
        device,
        [job.dark for job in jobs],
        own_noise,
    )
    learned = None
    if first.design == "control":
        before, report = report.part(0.0, 0.5), report.part(0.5, 1.0)
        sources = [job.masks_from() for job in jobs]
        optimised, *_ = _optimised(training_set, sources, None, before, classifier, None)
        learned = optimised().stacked
    masks = _initial_masks(training_set, jobs, matrix, learned).to(device)
    classifiers, schedules = optimise(training_set, jobs, masks, noise, report, classifier)
    if isinstance(masks, LearnedMasks):
        masks = _final_masks(masks, training_set, first)
    networks = [*classifiers, *(each.network for each in schedules)]
    numbers = [masks().combined, *(part for network in networks for part in network.parameters())]
    if not all(bool(torch.isfinite(part).all()) for part in numbers):
        raise Diverged(f"training of {first.design} diverged: {REMEDY}")
    return masks, noise, classifiers, schedules


def _initial_masks(
    training_set: TrainingSet,
    jobs: Sequence[Job],
    matrix: np.ndarray | None = None,
    learned: Tensor | None = None,
) -> FixedMasks | LearnedMasks:
    """Masks before training: of R replicas, or of one where all share them."""
    if learned is not None:
        return FixedMasks(learned)
    job = jobs[0]
    light, rails = job.optics
    detection = job.detection(training_set.data.image_shape)
    levels, several = job.training.levels, job.training.looks > 1
    if matrix is not None:
        own = own_rails(matrix, light, rails).unsqueeze(0)
        return FixedMasks(quantise(own, light, levels) if levels else own)
    signed = torch.stack([_matrix(training_set, job, seed) for seed in seeds_of_matrices(jobs)])
    if job.code.learned:
        kept = training_set.pixels(light).cpu()
        start = detection.of_pixels(kept).arrange(signed[..., kept])
        start = start.expand(len(jobs), -1, -1).clone()
        equal = several and light != "two-arm"
        shortest = 0.0 if several else job.training.shortest_dwell
        masks = LearnedMasks(start, "equal-dwell" if equal else light, rails, levels, shortest)
        if several and light == "two-arm":
            masks.dwell.requires_grad_(False)  # equal from the start
        return masks
    if job.design == "raster":  # its scale is what defines it
        fitted = signed.unsqueeze(1)
    else:
        fitted = torch.stack([constraints.fit(each, light, rails) for each in signed])
    fitted = constraints.equalise(fitted) if several and light != "two-arm" else fitted
    return FixedMasks(quantise(fitted, light, levels) if levels else fitted)


def _first_share(training_set: TrainingSet, job: Job, matrix: np.ndarray | None) -> float:
    """Share of the budget that the masks count before training; parameters as for `train`."""
    check_job(job, training_set.data, matrix)
    masks = _initial_masks(training_set, [job], matrix)
    shown = _final_masks(masks, training_set, job) if isinstance(masks, LearnedMasks) else masks
    total = shown.to(training_set.device)().total[0]
    counts = float((total @ training_set.full.mean(dim=0)).sum())
    return counts / training_set.summed_reflectance


def _final_masks(masks: LearnedMasks, training_set: TrainingSet, job: Job) -> FixedMasks:
    """Masks after training, of all pixels: dark where they were not learned.

    Nested ones take the whole of their constraint, by one common factor: so they are trained,
    however many of them are shown.
    """
    light, pixels = job.optics[0], training_set.pixels(job.optics[0])
    with torch.no_grad():
        learned = masks().stacked
    detection = job.detection(training_set.data.image_shape)
    rails = learned.new_zeros(*learned.shape[:-1], len(pixels))
    rails[..., pixels] = detection.of_pixels(pixels).restore(learned)
    if job.training.looks > 1 and light != "two-arm":
        # at the end only: its gradient would take from lit mirrors what they share
        rails = constraints.equalise(rails)
    if job.training.nested:
        rails = rails / constraints.used(rails, light)[..., -1:][..., None, None]
    return FixedMasks(rails)


def _matrix(training_set: TrainingSet, job: Job, seed: int) -> Tensor:
    """Matrix (m, N) that masks are fitted from; of one rail the first lit frames of a design.

    Learned masks of two arms that are both read start from these frames, too, and the other arm
    from what they leave: so they begin where one arm does (0.848 on MNIST's validation images at
    1e4 photons and 24 masks; 0.838 from the signed matrix, whose zeros are half light on each arm).
    """
    name, count = job.drawn_from, job.masks
    detection = job.detection(training_set.data.image_shape)
    both_arms = job.code.learned and job.optics[0] == "two-arm" and detection.readout == "both"
    if job.code.single_rail or (job.optics[1] == "dual" and not both_arms):
        return torch.from_numpy(training_set.matrix(name, count, seed, detection)).float()
    least, most = tiles.count_allowed(name, training_set.data, detection)
    for masks in range(min(max(-(-count // 2), least), most), most + 1):
        signed = torch.from_numpy(training_set.matrix(name, masks, seed, detection)).float()
        frames = constraints.frames(constraints.expand(signed, "column"))
        if len(frames) >= count:
            first = frames[:count]
            return 2 * first / constraints.peak(first) - 1 if both_arms else first
    raise InputError(f"{count} frames are not allowed for {name}: give at most {len(frames)}")


def _designs(
    training_set: TrainingSet,
    jobs: Sequence[Job],
    masks: FixedMasks,
    noise: FeatureNoise,
    classifiers: list[Classifier],
    schedules: list[AdaptiveDwells],
) -> list[Design]:
    """Designs of trained masks and networks, with the statistics of their features."""
    light, s = jobs[0].optics[0], training_set.summed_reflectance
    rails = masks().stacked
    shape, exposures = training_set.data.image_shape, None
    detection, conditioning = jobs[0].detection(shape), jobs[0].conditioning(shape)
    if conditioning:
        used = constraints.used(rails, light)
        every = mean_over_exposures(used, conditioning.span, conditioning.chances.to(used))
        later, often = (each.repeat_interleave(conditioning.width, dim=-1) for each in every)
        exposures = later, often
    with torch.no_grad():
        mean, std, counts = feature_statistics(
            training_set.full, masks, noise, jobs[0].training.scale, detection, exposures
        )
    designs = [
        Design(
            name=job.design,
            rails=Rails.of(constraints.check(rails[r % len(rails)].clone(), light)),
            classifier=classifiers[r],
            mean=mean[r] / s,
            std=std[r] / s,
            shares=counts[r] / s,
            summed_reflectance=s,
            light=light,
            image_shape=training_set.data.image_shape,
            classes=training_set.data.classes,
            exposure=schedules[r] if schedules else job.conditioning(shape) or FixedDwells(),
            detection=detection,
        )
        for r, job in enumerate(jobs)
    ]
    if schedules:
        for job, design in zip(jobs, designs, strict=True):
            design.shares = _shares(design, training_set, job)
        return designs
    known = [
        each.calibrated(training_set.full, training_set.labels).distribution
        for each in designs[: len(rails)]
    ]
    return [replace(each, distribution=known[r % len(known)]) for r, each in enumerate(designs)]


def _shares(design: Design, training_set: TrainingSet, job: Job) -> Tensor:
    """Share of the budget (k,) that each feature counts, in the mean over training scenes."""
    scanner = design.scanner()
    generator = torch.Generator(training_set.device).manual_seed(job.seed)
    shares = torch.zeros_like(design.mean)
    with torch.no_grad():
        for x in training_set.full.split(CHUNK):
            rates = design.rates(scanner, x)
            *_, seen = design.expose(scanner, rates, generator, job.photons)
            shown = design.exposure.shown(rates, seen)
            shares += design.detection.totals(shown).sum(dim=0)
    return shares / len(training_set.full)


def provenance(
    job: BaseModel, data: Dataset, device: torch.device, seconds: float
) -> dict[str, Any]:
    """Provenance of a design for `Design.info`, from parameters of its training."""
    return {
        "job": job.model_dump(mode="json"),
        "data": Memory.of(data).model_dump(mode="json"),
        "preprocessing": data.preprocessing,
        "brightness": brightness(data.x_train, data.y_train),
        "deepfsi": version("deepfsi"),
        "torch": torch.__version__,
        "device": device.type,
        "seconds": seconds,
    }
