"""The masks' half of a training: what its kinds share, fixed masks and ranges of budgets.

A kind of exposure trains in four calls. It is built with its masks; `prepare` computes what all
steps share; `inputs` gives what the classifiers read in a step; `finish` gives what each job has
learned. The step itself, and the classifiers, are in `training.loop`.
"""

import math
from abc import ABC, abstractmethod
from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from pkgutil import resolve_name

import numpy as np
import torch
from torch import Tensor
from torch.nn import functional

from deepfsi.base.errors import InputError
from deepfsi.camera.names import LIGHT_LAWS
from deepfsi.exposure.kind import Clicks, MaskExposure, with_budget
from deepfsi.exposure.training_set import TrainingSet, product_dtype
from deepfsi.jobs.designs import DESIGNS, count_allowed
from deepfsi.jobs.exposures import ConditionedEntry, Entry, FixedEntry
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
from deepfsi.physics.noise import noise_of, root
from deepfsi.physics.scanner import project, project_rails
from deepfsi.physics.training_noise import (
    Draws,
    SeedStream,
    TrainingNoise,
    ml_gauss_features,
    side_by_side,
)

CHUNK = 4096
"""Scenes that are multiplied at once outside the steps."""

LEAST_POWER = 1e-20
"""Mean square of features, in units of the scene, below which they do not vary."""


@dataclass(frozen=True, eq=False)
class JobGroup:
    """Jobs that train side by side, R of them, and what they train with."""

    training_set: TrainingSet
    jobs: Sequence[Job]  # jobs of one seed are neighbours
    matrix: np.ndarray | None = None  # (m, N), the user's, for ``design="custom"``
    masks: FixedMasks | LearnedMasks | None = None  # of a control group, learned before

    def training(self) -> "ExposureTraining":
        """Masks of the jobs before their training, by the class that their exposure names."""
        return resolve_name(self.jobs[0].exposure.trained_by)(self)


def _noise_of(group: JobGroup) -> TrainingNoise:
    """Noise that jobs train under."""
    job = group.jobs[0]
    noise = job.camera.noise if job.training.noise is None else job.training.noise
    setting = job.noise if isinstance(noise, str) else noise
    noises = [noise_of(job.camera, setting) for job in group.jobs]
    noises[0].check(learning=job.facts.learned)
    gains = [job.photons / group.training_set.summed_reflectance for job in group.jobs]
    seeds = [job.seed for job in group.jobs]
    return TrainingNoise.of(noises, gains, seeds, group.training_set.device)


FeatureStatistics = tuple[Tensor, Tensor, Tensor]
"""Mean and deviation (R, k) of features over scenes and noise, and mean light (R, k)."""


class ExposureTraining(ABC):
    """Masks of R jobs in a training side by side, and the classifiers' inputs in each step."""

    masks: FixedMasks | LearnedMasks  # R replicas, or one that all jobs share
    entries: Sequence[Entry]  # header entry of each job's exposure
    weights: Sequence[dict[str, Tensor]]  # further tensors of each job's design file
    counts: Tensor | None = None  # (R,)

    def __init__(self, group: JobGroup) -> None:
        self.jobs = group.jobs
        self.entries = [FixedEntry()] * len(group.jobs)
        self.weights = [{}] * len(group.jobs)
        self.training_set = group.training_set
        self.job = group.jobs[0]
        self.noise = _noise_of(group)
        self.camera = self.job.optics
        self.scale = self.job.training.scale
        self.law = light_law(self.camera.light)
        self.learns = self.job.facts.learned
        self.scenes = self.training_set.view(self.job.exposure)
        self.levels = self.camera.mask_levels(self.scenes.data.image_shape)
        image_shape = self.training_set.data.image_shape
        self.detection = Detection.by(self.camera.detector_map(image_shape), self.camera.readout)
        self.input_count = self.job.features(image_shape)
        self.parts = self.training_set.data.pixels // self.scenes.data.pixels

    @abstractmethod
    def prepare(self) -> None:
        """Compute what all steps share, before the first."""

    @abstractmethod
    def inputs(self, draws: Draws) -> Tensor:
        """Inputs (B, R, …) of the classifiers in a step."""

    def fix(self) -> None:
        """Fix learned masks at the end of their training."""
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
        """Masks (R, m, P) that learn under the light law, of the pixels that they may light."""
        camera = self.camera
        pixels = self.scenes.pixels(camera.light).cpu()
        signed = self.detection.of_pixels(pixels).arrange(self._matrices()[..., pixels])
        return LearnedMasks(
            signed.expand(len(self.jobs), -1, -1).clone(),
            camera.light,
            camera.rails,
            levels=self.levels,
            shortest=camera.shortest_share,
        ).to(self.scenes.device)

    def fixed_masks(self, matrix: np.ndarray | None = None) -> FixedMasks:
        """Masks (R or 1, m, N), as shown, of a named design or a user's own matrix (m, N)."""
        rails_kind = self.camera.rails
        if matrix is not None:
            rails = self.law.rails_of(matrix, rails_kind).unsqueeze(0)
        elif self.job.facts.scaled:
            rails = self._matrices().unsqueeze(1)
        else:
            rails = torch.stack([self.law.fit(matrix, rails_kind) for matrix in self._matrices()])
        rails = self.law.quantise(rails, self.levels) if self.levels else rails
        return FixedMasks(rails).to(self.scenes.device)

    def centred(self) -> tuple[Tensor, FixedMasks | LearnedMasks]:
        """Centred scenes and their mean (n + 1, P), and masks, both arranged by detectors."""
        pixels = self.scenes.pixels(self.camera.light)
        masks = self.masks
        if not self.learns:  # masks of a named design are lit at pixels that never vary, too
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
        mean_scene = detection.arrange(scenes.mean(dim=0))
        mean, light = (
            project(mean_scene, rails, detection.count) for rails in (masks.difference, masks.total)
        )
        if not noise.kind.unbiased:  # its mean is not the rate: draws give both moments
            products = (
                project_rails(detection.arrange(x), masks, detection.count)
                for x in scenes.split(CHUNK)
            )
            first, power = moments(noise.counted(*pair, read) for pair in products)
            std = deviation(power, self.scale)
            return first, std, light.expand_as(std)
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
        return mean.expand_as(std), std, light.expand_as(std)

    def trained(self, statistics: FeatureStatistics) -> list[MaskExposure]:
        """Exposure of each job, with its masks and statistics."""
        s = self.training_set.summed_reflectance
        mean, std, light = statistics
        rails = self.masks().stacked
        exposures = []
        for job, entry in enumerate(self.entries):
            exposure = resolve_name(entry.restored_by)(
                entry=entry,
                # all jobs have masks of their own, or share one set
                rails=Rails.of(self.law.check(rails[job % len(rails)].clone())),
                light=self.camera.light,
                image_shape=self.training_set.data.image_shape,
                detection=self.detection,
                summed_reflectance=s,
                mean=mean[job] / s,
                std=std[job] / s,
                shares=light[job] / s * self.parts,
                weights=self.weights[job],
                clicks=Clicks.of(self.job.camera, self.jobs[job].photons),
            )
            exposures.append(exposure)
        return exposures

    def _matrices(self) -> Tensor:
        """Matrices (R or 1, m, N) that masks are fitted to or start from."""
        return torch.stack([self._matrix(seed) for seed in matrix_seeds(self.jobs)])

    def _matrix(self, seed: int) -> Tensor:
        """Matrix (m, N) of a seed; a single rail takes the first lit frames of its design."""
        # Learned masks of two arms that are both read start from these frames, too, and the other
        # arm from what they leave: so they begin where one arm does (0.848 on MNIST's validation
        # images at 1e4 photons and 24 masks; 0.838 from the signed matrix, whose zeros are half
        # light on each arm)
        job = self.job
        camera = self.camera
        scenes = self.scenes
        name = job.start_matrix
        detectors = camera.detector_map(scenes.data.image_shape)
        two_arms = job.facts.learned and LIGHT_LAWS[camera.light].arms == 2
        both_arms = two_arms and camera.readout == "both"
        if job.facts.rails == "single" or (camera.rails == "dual" and not both_arms):
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


def standardise_batch(features: Tensor, scale: Scale) -> Tensor:
    """Divide centred features (B, R, m) by the standard deviation of their batch."""
    if scale == "each":
        # features that do not vary become 0, not NaN, by `eps`
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


def moments(batches: Iterable[Tensor]) -> tuple[Tensor, Tensor]:
    """Mean and variance (R, k) of batches of features (n_i, R, k), summed in float64."""
    count = 0
    sums = []
    for batch in batches:
        wide = batch.double()
        count += len(batch)
        sums.append(torch.stack([wide.sum(dim=0), wide.square().sum(dim=0)]))
    mean, square = torch.stack(sums).sum(dim=0) / count
    return mean.to(batch), (square - mean.square()).clamp(min=0).to(batch)


class _FixedTraining(ExposureTraining):
    """Masks that do not learn, whose products with all scenes are known."""

    def __init__(self, group: JobGroup) -> None:
        super().__init__(group)
        self.masks = group.masks or self.fixed_masks(group.matrix)

    def prepare(self) -> None:
        """Compute the products of all scenes and their statistics."""
        noise = self.noise
        detection = self.detection
        arranged = self.masks().map(detection.arrange)
        masks = detection.read_of(arranged)
        if not noise.kind.depends_on_light:
            masks = Rails(masks.difference)  # spares the product with the total
        products = [
            project_rails(detection.arrange(x), masks, detection.count)
            for x in self.scenes.full.split(CHUNK)
        ]
        self.means = torch.cat([mean for mean, _ in products])
        single = masks.count == 1
        totals = self.means if single else torch.cat([total for _, total in products])
        del products  # as large as both
        self.mean, self.std, _ = self.statistics(means=self.means)
        self.read = detection.readouts(arranged)
        self.totals = totals if noise.kind.depends_on_light else None
        if noise.kind.draws_rails:
            return
        # Products are standardised here, not in each step. Replicas that share products have
        # deviations of their own: the products have that of the first, a factor gives the others'
        replicas = self.means.shape[1]
        self.own_products = replicas == len(self.std)
        self.std_ratio = self.std[:replicas] / self.std
        if self.totals is None:
            self.gain = noise.variance(self.mean, self.mean, self.read).sqrt() / self.std
        else:
            gain = noise.unit / self.std
            self.totals = root(self.totals).mul_(gain[:replicas])
            self.gain = gain / gain[:replicas]
        self.means.sub_(self.mean[:replicas]).div_(self.std[:replicas])

    def inputs(self, draws: Draws) -> Tensor:
        """Features (B, R, k), standardised by the statistics of the whole training set."""
        return side_by_side([self._of_seed(stream) for stream in draws.streams])

    def _of_seed(self, stream: SeedStream) -> Tensor:
        mean = stream.products(self.means)
        if self.noise.kind.draws_rails:
            assert self.totals is not None
            totals = stream.products(self.totals)
            counts = stream.noise.counted(mean, totals, stream.readouts(self.read))
            return (counts - stream.of_jobs(self.mean)) / stream.of_jobs(self.std)
        normal = stream.normal(mean.shape[-1])
        gain = stream.of_jobs(self.gain)
        if self.totals is not None:
            normal = normal * stream.products(self.totals)
            if self.own_products:
                return mean.add_(normal)
        scaled = mean if self.own_products else mean * stream.of_jobs(self.std_ratio)
        return torch.addcmul(scaled, normal, gain)


class _LearnedTraining(ExposureTraining):
    """Masks that learn."""

    masks: LearnedMasks

    def __init__(self, group: JobGroup) -> None:
        super().__init__(group)
        self.masks = self.learned_masks()

    def prepare(self) -> None:
        """Take the centred scenes, and dim masks that would count too much."""
        self.x, _ = self.centred()
        if self.job.training.counts is not None:
            self._dim(self.job.training.counts)

    def inputs(self, draws: Draws) -> Tensor:
        """Features (B, R, k), standardised in their batch."""
        features, light = self.noise.learned_features(self.x, self.masks, self.detection, draws)
        if self.job.training.counts is not None:
            pairs = zip(draws.streams, light, strict=True)
            self.counts = torch.cat([stream.noise.expected(*pair) for stream, pair in pairs])
        return standardise_batch(features, self.scale)

    def _dim(self, counts: float) -> None:
        """Dim masks before their training, if they would count too much."""
        masks = self.masks
        detection = self.detection
        # the last row of x is the mean of the centred scenes: with it they are bright again
        scenes = (self.x[: min(CHUNK, len(self.training_set.labels))] + self.x[-1:]).float()

        def counted() -> Tensor:
            light = project_rails(scenes, detection.read_of(masks()), detection.count)
            return self.noise.expected(*light)

        with torch.no_grad():
            bright = counted()
            rails = masks()
            readouts = rails.count * rails.masks * detection.count
            # a detector that clicks has at most one count a gate; others have no limit
            largest = float(self.noise.kind.mean(torch.tensor(torch.inf)))
            bright_start = self.job.training.start_counts * counts
            # nine tenths of the gates click at most
            goal = max(counts, min(bright_start, 0.9 * largest * readouts))
            low = torch.full_like(bright, -20.0)
            high = torch.zeros_like(bright)
            start = {name: tensor.clone() for name, tensor in masks.state_dict().items()}
            for _ in range(30):  # bisection of the logarithm of the factor
                masks.load_state_dict(start)
                middle = (low + high) / 2
                masks.dim(middle.exp())
                over = counted() > goal
                low = torch.where(over, low, middle)
                high = torch.where(over, middle, high)


def fixed_training(group: JobGroup) -> ExposureTraining:
    """Training of masks that are shown once, whether they learn or not."""
    return (_LearnedTraining if group.jobs[0].facts.learned else _FixedTraining)(group)


def standardise_by_power(features: Tensor, scale: Scale) -> Tensor:
    """Standardise features (B, R, k) in their batch; `standardise_batch` rounds differently."""
    axes = (0,) if scale == "each" else (0, 2)
    power = features.square().sum(dim=axes, keepdim=True)
    power = power / (features.numel() // power.numel())
    return features / power.clamp(min=LEAST_POWER).sqrt()


class ConditionedTraining(ExposureTraining):
    """Training for a range: each scene of a step draws its own budget."""

    def __init__(self, group: JobGroup) -> None:
        super().__init__(group)
        self.span = self.job.exposure.highest(1.0)
        width = self.input_count // self.job.masks
        self.entries = [
            ConditionedEntry(photons=job.photons, span=self.span, masks=job.masks, width=width)
            for job in self.jobs
        ]
        self.input_count += 2
        self.masks = self.learned_masks() if self.learns else self.fixed_masks(group.matrix)

    def prepare(self) -> None:
        """Take the centred scenes."""
        self.x, self.arranged = self.centred()

    def inputs(self, draws: Draws) -> Tensor:
        """Features and conditioning inputs (B, R, k + 2)."""
        rails = self.arranged()
        masks = self.detection.read_of(rails).combined
        count = self.detection.count
        used = self.law.used(rails.stacked)[..., -1:]
        features = []
        ratios = []
        for stream in draws.streams:
            # a factor 1 whose gradient is only rounding: it keeps the bits of earlier trainings
            one = stream.of_jobs(used / used).T.unsqueeze(-1)
            ratio = stream.budgets(self.span) / one
            normal = stream.normal(masks.shape[-2] * count) * stream.noise.unit / ratio.sqrt()
            x = self.x.index_select(0, stream.with_mean)
            of_seed = stream.of_jobs(masks, -3)
            features.append(ml_gauss_features(x, of_seed, normal, False, detectors=count))
            ratios.append(ratio.expand(*features[-1].shape[:2], 1))
        scaled = standardise_by_power(side_by_side(features), self.scale)
        return with_budget(scaled, side_by_side(ratios), self.span)

    def finish(self) -> list[MaskExposure]:
        """Masks of each job, with the statistics of the mean over their budgets, too."""
        # mean of 1 / ratio over ratios span**u, u uniform in [0, 1]: noise falls as 1 / Φ
        factor = (1 - 1 / self.span) / math.log(self.span)
        return self.trained(self.statistics(factor))
