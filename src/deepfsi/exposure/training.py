"""The masks' half of a training: what its kinds share.

A kind of exposure trains in four calls: it is built with its masks, prepared (what is alike in all
steps is computed once), asked for the inputs of the classifiers in each step, and finished, which
gives what each job has learned. The step itself, and the classifiers, are in `training.loop`.
"""

from abc import ABC, abstractmethod
from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from pkgutil import resolve_name
from typing import NamedTuple

import numpy as np
import torch
from torch import Tensor
from torch.nn import functional

from deepfsi.base.errors import InputError
from deepfsi.camera.names import LIGHT_LAWS
from deepfsi.exposure.kind import MaskExposure
from deepfsi.exposure.training_set import TrainingSet, product_dtype
from deepfsi.jobs.designs import DESIGNS, count_allowed
from deepfsi.jobs.exposures import Entry, FixedEntry
from deepfsi.jobs.job import Job
from deepfsi.jobs.training import Scale
from deepfsi.physics.detection import Detection, Rails
from deepfsi.physics.laws import (
    FixedMasks,
    LearnedMasks,
    frame_peaks,
    frames,
    light_law,
    signed_parts,
)
from deepfsi.physics.noise import noise_of
from deepfsi.physics.scanner import project, project_rails
from deepfsi.physics.training_noise import Draws, TrainingNoise

CHUNK = 4096
"""Scenes that are multiplied at once outside the steps."""

LEAST_POWER = 1e-20
"""Mean square of features, in units of the scene, below which they do not vary."""


@dataclass(frozen=True, eq=False)
class JobGroup:
    """Jobs that train side by side, R of them, and what they train with."""

    training_set: TrainingSet
    jobs: Sequence[Job]  # those of one seed one after another
    noise: TrainingNoise
    matrix: np.ndarray | None = None  # (m, N), a user's own, for ``design="custom"``
    masks: FixedMasks | LearnedMasks | None = None  # that were learned before, of a control group
    start: np.ndarray | None = None  # (m, N)

    @classmethod
    def of(
        cls,
        training_set: TrainingSet,
        jobs: Sequence[Job],
        matrix: np.ndarray | None = None,
        start: np.ndarray | None = None,
    ) -> "JobGroup":
        """Group with the noise that its jobs ask for."""
        job = jobs[0]
        own = job.camera.noise if job.training.noise is None else job.training.noise
        noises = [
            noise_of(each.camera, job.noise if isinstance(own, str) else own) for each in jobs
        ]
        noises[0].check(learning=job.code.learned)
        gains = [each.photons / training_set.summed_reflectance for each in jobs]
        seeds = [each.seed for each in jobs]
        noise = TrainingNoise.of(noises, gains, seeds, training_set.device)
        return cls(training_set, jobs, noise, matrix=matrix, start=start)

    def training(self) -> "ExposureTraining":
        """Masks of the jobs before their training, by the class that their exposure names."""
        return resolve_name(self.jobs[0].exposure.trained_by)(self)


class FeatureStatistics(NamedTuple):
    """Statistics (R, k) of features in units of the scene, over scenes and noise."""

    mean: Tensor
    std: Tensor
    light: Tensor
    """Their mean x S."""


class ExposureTraining(ABC):
    """Masks of R jobs side by side in a training, and what classifiers get of a step's scenes."""

    masks: FixedMasks | LearnedMasks  # of R replicas, or of one where all share them
    entries: Sequence[Entry]  # of each job, of which its exposure is made
    weights: Sequence[dict[str, Tensor]]  # further tensors of each job's design file
    counts: Tensor | None = None  # (R,)

    def __init__(self, group: JobGroup) -> None:
        self.jobs = group.jobs
        self.entries = [FixedEntry()] * len(group.jobs)
        self.weights = [{}] * len(group.jobs)
        self.noise = group.noise
        self.training_set = group.training_set
        self.job = group.jobs[0]
        self.group = group
        self.camera = self.job.optics
        self.scale = self.job.training.scale
        self.law = light_law(self.camera.light)
        self.learns = self.job.code.learned
        self.scenes = self.training_set.view(self.job.exposure)
        self.levels = self.camera.mask_levels(self.scenes.data.image_shape)
        self.detection = Detection.of(self.camera, self.training_set.data.image_shape)
        self.input_count = self.job.features(self.training_set.data.image_shape)
        self.parts = self.training_set.data.pixels // self.scenes.data.pixels

    @abstractmethod
    def prepare(self) -> None:
        """Compute what is alike in all steps, before the first."""

    @abstractmethod
    def inputs(self, draws: Draws) -> Tensor:
        """Inputs (B, R, …) of the classifiers in a step."""

    def fix(self) -> None:
        """Take masks that have learned as they are at the end of their training."""
        if not self.learns:
            return
        pixels = self.scenes.pixels(self.camera.light)
        with torch.no_grad():
            learned = self.masks().stacked
        rails = learned.new_zeros(*learned.shape[:-1], len(pixels))  # dark where none were learned
        rails[..., pixels] = self.detection.of_pixels(pixels).restore(learned)
        self.masks = FixedMasks(rails)

    def finish(self) -> list[MaskExposure]:
        """Masks, statistics and exposure of each job, of masks that are fixed."""
        return self.trained(self.statistics())

    def learned_masks(self) -> LearnedMasks:
        """Masks that learn under the camera's light law."""
        camera = self.camera
        return LearnedMasks(
            self.start(),
            camera.light,
            camera.rails,
            levels=self.levels,
            shortest=camera.shortest_share,
            contrast=camera.contrast,
        ).to(self.scenes.device)

    def fixed_masks(self, rails: Tensor) -> FixedMasks:
        """Masks of rails (R or 1, 2 or 1, m, N), in the levels of the device, with its leak."""
        rails = self.law.quantise(rails, self.levels) if self.levels else rails
        if self.camera.contrast is not None:
            rails = self.law.leak(rails, self.camera.contrast)
        return FixedMasks(rails).to(self.scenes.device)

    def named_rails(self, matrix: np.ndarray | None = None) -> Tensor:
        """Rails (R or 1, 2 or 1, m, N) of a named design or a user's own matrix (m, N)."""
        if matrix is not None:
            return self.law.rails_of(matrix, self.camera.rails).unsqueeze(0)
        signed = self._matrices()
        if self.job.code.scaled:
            return signed.unsqueeze(1)
        return torch.stack([self.law.fit(each, self.camera.rails) for each in signed])

    def start(self) -> Tensor:
        """Matrices (R, m, P) that masks learn from, of the pixels that they may light."""
        pixels = self.scenes.pixels(self.camera.light).cpu()
        own = self.group.start
        matrices = self._matrices() if own is None else torch.from_numpy(own).unsqueeze(0)
        signed = self.detection.of_pixels(pixels).arrange(matrices[..., pixels])
        return signed.expand(len(self.jobs), -1, -1).clone()

    def centred(self) -> tuple[Tensor, FixedMasks | LearnedMasks]:
        """Centred scenes and their mean (n + 1, P), and masks, both arranged by detectors."""
        pixels = self.scenes.pixels(self.camera.light)
        masks = self.masks
        if not self.learns:  # they see every pixel
            pixels = torch.ones_like(pixels)
            masks = FixedMasks(self.detection.arrange(masks().stacked))
        kind = product_dtype(self.job, self.scenes.device)
        return self.scenes.centred(pixels, kind, self.detection), masks

    def statistics(self, factor: float = 1.0, means: Tensor | None = None) -> FeatureStatistics:
        """Statistics of features over all scenes, the noise times a factor.

        The means (n, R or 1, k) are products of the scenes with the masks, where they are known.
        """
        noise = self.noise
        detection = self.detection
        scenes = self.scenes.full
        arranged = self.masks().map(detection.arrange)
        read = detection.readouts(arranged)
        masks = detection.read_of(arranged)
        middle = detection.arrange(scenes.mean(dim=0))
        mean, light = (
            project(middle, sums, detection.count) for sums in (masks.difference, masks.total)
        )
        if not noise.kind.unbiased:  # what it draws is taken
            products = (
                project_rails(detection.arrange(x), masks, detection.count)
                for x in scenes.split(CHUNK)
            )
            first, power = moments(noise.counted(*pair, read) for pair in products)
            std = deviation(power, self.scale)
            return FeatureStatistics(first, std, light.expand_as(std))
        power = torch.zeros_like(mean)
        start = 0
        for x in scenes.split(CHUNK):
            rows = slice(start, start + len(x))
            start = rows.stop
            expected = (
                project(detection.arrange(x), masks.difference, detection.count)
                if means is None
                else means[rows]
            )
            power += (expected - mean).square().sum(dim=0)
        power = power / len(scenes) + noise.variance(mean, light, read) * factor
        std = deviation(power, self.scale)
        return FeatureStatistics(mean.expand_as(std), std, light.expand_as(std))

    def trained(self, statistics: FeatureStatistics) -> list[MaskExposure]:
        """Exposure of each job with its masks, with statistics of all."""
        s = self.training_set.summed_reflectance
        rails = self.masks().stacked
        made = []
        for job, entry in enumerate(self.entries):
            exposure = resolve_name(entry.restored_by)(
                entry=entry,
                rails=Rails.of(self.law.check(rails[job % len(rails)].clone())),
                light=self.camera.light,
                image_shape=self.training_set.data.image_shape,
                detection=self.detection,
                summed_reflectance=s,
                mean=statistics.mean[job] / s,
                std=statistics.std[job] / s,
                shares=statistics.light[job] / s * self.parts,
                weights=self.weights[job],
            )
            made.append(exposure)
        return made

    def _matrices(self) -> Tensor:
        """Matrices (R or 1, m, N) that masks are fitted to or start from."""
        return torch.stack([self._matrix(seed) for seed in matrix_seeds(self.jobs)])

    def _matrix(self, seed: int) -> Tensor:
        """Matrix (m, N) of a seed; of one rail the first lit frames of a design."""
        # Learned masks of two arms that are both read start from these frames, too, and the other
        # arm from what they leave: so they begin where one arm does (0.848 on MNIST's validation
        # images at 1e4 photons and 24 masks; 0.838 from the signed matrix, whose zeros are half
        # light on each arm)
        job = self.job
        camera = self.camera
        scenes = self.scenes
        name = job.start_matrix
        detectors = camera.detector_map(scenes.data.image_shape)
        two_arms = job.code.learned and LIGHT_LAWS[camera.light].arms == 2
        both_arms = two_arms and camera.readout == "both"
        if job.code.rails == "single" or (camera.rails == "dual" and not both_arms):
            return torch.from_numpy(scenes.matrix(name, job.masks, seed, detectors)).float()
        least, most = count_allowed(name, scenes.data, detectors)
        for masks in range(min(max(-(-job.masks // 2), least), most), most + 1):
            signed = torch.from_numpy(scenes.matrix(name, masks, seed, detectors)).float()
            lit = frames(signed_parts(signed))
            if len(lit) >= job.masks:
                first = lit[: job.masks]
                return 2 * first / frame_peaks(first) - 1 if both_arms else first
        raise InputError(f"{job.masks} frames are not allowed for {name}: give at most {len(lit)}")


def matrix_seeds(jobs: Sequence[Job]) -> list[int]:
    """Seed of each matrix that jobs trained together are drawn from; one where all share it."""
    seeds = [job.seed for job in jobs]
    drawn = DESIGNS[jobs[0].start_matrix].seeded
    return seeds if drawn and len(set(seeds)) > 1 else seeds[:1]


def standardise(features: Tensor, scale: Scale) -> Tensor:
    """Divide centred features by the standard deviation of their batch."""
    # features (B, R, m)
    if scale == "each":
        columns = functional.batch_norm(
            features.flatten(1), None, None, training=True, eps=LEAST_POWER
        )
        return columns.view_as(features)
    size = torch.linalg.vector_norm(features, dim=(0, 2)) / (features[:, 0].numel() ** 0.5)
    return features / size.clamp(min=LEAST_POWER**0.5)[:, None]


def deviation(power: Tensor, scale: Scale) -> Tensor:
    """Standard deviation (..., m) of features of known variance; 1 where that is 0."""
    if scale == "common":
        power = (power.sum(dim=-1, keepdim=True) / power.shape[-1]).expand_as(power)
    return torch.where(power > 0, power, 1.0).sqrt()


def moments(parts: Iterable[Tensor]) -> tuple[Tensor, Tensor]:
    """Mean and variance (R, k) of features (n_i, R, k) in parts, summed in float64."""
    count = 0
    sums = []
    for part in parts:
        wide = part.double()
        count += len(part)
        sums.append(torch.stack([wide.sum(dim=0), wide.square().sum(dim=0)]))
    mean, square = torch.stack(sums).sum(dim=0) / count
    return mean.to(part), (square - mean.square()).clamp(min=0).to(part)
