"""Features of a training step, one class for each kind of training.

Each multiplies scenes with masks, draws noise, and standardises. Products of masks that do not
learn are taken once before the first step.
"""

from dataclasses import dataclass, field
from typing import Protocol

import torch
from torch import Tensor

from deepfsi.camera import LightLawName
from deepfsi.exposure.conditioned import ConditionedExposure, first
from deepfsi.exposure.draws import SeedStream, product_dtype, side_by_side
from deepfsi.exposure.looks import LooksExposure
from deepfsi.exposure.passing import PassingExposure
from deepfsi.exposure.statistics import CHUNK, deviation, feature_statistics, standardise
from deepfsi.exposure.trained import FixedExposure, MaskExposure, PatchExposure
from deepfsi.exposure.training_set import TrainingSet
from deepfsi.jobs import Job, Scale
from deepfsi.networks.classifiers import Replicas
from deepfsi.physics import (
    Detection,
    FixedMasks,
    FixedPattern,
    LearnedMasks,
    LearnedPattern,
    Rails,
    Scanner,
    TrainingNoise,
    light_law,
    ml_gauss_features,
    project,
    project_rails,
    root,
)
from deepfsi.training.passing import PassingFeatures

Streams = list[SeedStream]
"""Draws of the jobs of each seed, in the order of the jobs."""


class Features(Protocol):
    """Inputs of the classifiers in the steps of a training."""

    def at(self, step: int) -> Tensor:
        """Inputs (B, R, …) of a step; of K looks (K · B, R, …)."""


class FixedFeatures:
    """Features of fixed masks, whose products with all scenes (n, N) are known.

    Where no counts are drawn the products are standardised once, for the first of the replicas that
    share them; what the others have in place of that is a factor.
    """

    def __init__(
        self,
        streams: Streams,
        masks: FixedMasks,
        scenes: Tensor,
        noise: TrainingNoise,
        scale: Scale,
        detection: Detection,
    ) -> None:
        self.streams = streams
        arranged = masks().map(detection.arrange)
        frames = detection.read_of(arranged)
        if not noise.kind.of_light:
            frames = Rails(frames.difference)  # their total is not needed
        pairs = [
            project_rails(detection.arrange(x), frames, detection.count)
            for x in scenes.split(CHUNK)
        ]
        self.means = torch.cat([mean for mean, _ in pairs])
        single = frames.count == 1
        totals = self.means if single else torch.cat([counts for _, counts in pairs])
        del pairs
        self.mean, self.std, _ = feature_statistics(
            scenes, masks, noise, scale, detection, means=self.means
        )
        self.read = detection.readouts(arranged)
        self.counting = noise.kind.counting
        self.totals = totals if noise.kind.of_light else None
        if self.counting:
            return
        held = self.means.shape[1]
        self.alone = held == len(self.std)
        self.ratio = self.std[:held] / self.std
        if self.totals is None:
            self.gain = noise.variance(self.mean, self.mean, self.read).sqrt() / self.std
        else:
            gain = noise.unit / self.std
            self.totals = root(self.totals).mul_(gain[:held])
            self.gain = gain / gain[:held]
        self.means.sub_(self.mean[:held]).div_(self.std[:held])

    def at(self, step: int) -> Tensor:
        """Features (B, R, m), standardised as those of the whole training set."""
        return side_by_side([self._of(stream, step) for stream in self.streams])

    def _of(self, stream: SeedStream, step: int) -> Tensor:
        expected = stream.products(self.means, step)
        if self.counting:
            assert self.totals is not None
            mean, std = stream.of_jobs(self.mean), stream.of_jobs(self.std)
            totals, read = stream.products(self.totals, step), stream.readouts(self.read)
            return (stream.noise.counted(expected, totals, read) - mean) / std
        draws, gain = stream.normal(expected.shape[-1]), stream.of_jobs(self.gain)
        if self.totals is not None:
            draws = draws * stream.products(self.totals, step)
            if self.alone:
                return expected.add_(draws)
        scaled = expected if self.alone else expected * stream.of_jobs(self.ratio)
        return torch.addcmul(scaled, draws, gain)


@dataclass
class LearnedFeatures:
    """Features of masks that learn."""

    streams: Streams
    masks: LearnedMasks
    # (n + 1, N): Centred scenes and their mean, from `TrainingSet.centred`, arranged as the masks
    # are
    x: Tensor
    scale: Scale
    detection: Detection
    penalised: bool = False  # whether the counts are a part of the loss
    # (R,): Counts in the mean over the scenes of the last step, where they are
    expected: Tensor = field(init=False)

    def at(self, step: int) -> Tensor:
        """Features (B, R, m), standardised in their batch."""
        return standardise(side_by_side(self.noisy(step)), self.scale)

    def noisy(self, step: int) -> list[Tensor]:
        """Centred features (B, R_i, m) of the jobs of each seed."""
        kind = self.streams[0].noise.kind
        if kind.counting:
            return self._counted(self.masks(), step)
        return self._fused(step) if kind.of_light else self._read(self.masks(), step)

    def _fused(self, step: int) -> list[Tensor]:
        """Under MLGauss; see `ml_gauss_features`."""
        disjoint = self.masks.disjoint and self.detection.readout != "both"
        read = self.detection.read_of
        masks = self.masks.matrix() if disjoint else read(self.masks()).combined
        parts = self.detection.count
        return [
            ml_gauss_features(
                self.x.index_select(0, stream.with_mean[step]),
                stream.of_jobs(masks, -3),
                stream.normal(masks.shape[-2] * parts) * stream.noise.unit,
                disjoint,
                parts,
            )
            for stream in self.streams
        ]

    def _counted(self, rails: Rails, step: int) -> list[Tensor]:
        """Under a noise whose counts of each rail are drawn."""
        # One of a user's own may have another mean than the rates: its features are centred in
        # their batch
        read, masks = self.detection.readouts(rails), self.detection.read_of(rails)
        parts, counted = [], []
        for stream in self.streams:
            x = self.x.index_select(0, stream.with_mean[step])
            mean, counts = project_rails(x, masks.map(stream.of_jobs), self.detection.count)
            expected = mean[:-1] + mean[-1], counts[:-1] + counts[-1]
            drawn = stream.noise.counted(*expected, stream.readouts(read))
            parts.append(drawn - (mean[-1] if stream.noise.kind.unbiased else drawn.mean(dim=0)))
            if self.penalised:
                counted.append(stream.noise.expected(*expected))
        if self.penalised:
            self.expected = torch.cat(counted)
        return parts

    def _read(self, rails: Rails, step: int) -> list[Tensor]:
        """Under read noise, or none."""
        with torch.no_grad():
            read = self.detection.readouts(rails)
        difference = self.detection.read_of(rails).difference
        parts = []
        for stream in self.streams:
            x = self.x.index_select(0, stream.rows[step])
            mean = project(x, stream.of_jobs(difference), self.detection.count)
            parts.append(stream.noise.features(mean, mean, stream.readouts(read), stream.normal))
        return parts


@dataclass
class ConditionedFeatures:
    """Inputs of conditioned classifiers: each scene has a budget and a number of masks of its own.

    The fewer masks share the light, the more each has. The gradient includes the light that a mask
    takes from later ones.
    """

    streams: Streams  # as for `LearnedFeatures`; masks may be fixed
    masks: FixedMasks | LearnedMasks
    x: Tensor
    conditioning: ConditionedExposure  # of the lowest budget
    light: LightLawName
    scale: Scale
    detection: Detection

    def __post_init__(self) -> None:
        self.chances = self.conditioning.chances.to(self.x.device)
        # masks that learn are brightened at their end, see `learning`
        self.brightened = self.conditioning.nested > 0 and isinstance(self.masks, LearnedMasks)

    def at(self, step: int) -> Tensor:
        """Features and conditioning inputs (B, R, k + 2)."""
        rails = self.masks()
        masks = self.detection.read_of(rails).combined
        parts, width = self.detection.count, self.conditioning.width
        used = light_law(self.light).used(rails.stacked)
        whole = used[..., -1:]
        used = used if self.brightened else used / whole
        every, ratios, counts = [], [], []
        for stream in self.streams:
            budget, shown = stream.exposures(self.conditioning.span, self.chances)
            ratio = budget / stream.of_jobs(used)[:, shown[:, 0, 0] - 1].T.unsqueeze(-1)
            every.append(
                ml_gauss_features(
                    self.x.index_select(0, stream.with_mean[step]),
                    stream.of_jobs(masks, -3),
                    stream.normal(masks.shape[-2] * parts) * stream.noise.unit / ratio.sqrt(),
                    False,
                    parts,
                )
            )
            told = ratio * stream.of_jobs(whole) if self.brightened else ratio
            ratios.append(told.expand(*every[-1].shape[:2], 1))
            counts.append(stream.repeated(shown))
        seen, shown = side_by_side(every), side_by_side(counts)
        scaled = standardise(seen, self.scale, first(seen.shape[-1], shown * width))
        return self.conditioning.inputs(scaled, side_by_side(ratios), shown)


@dataclass
class LooksFeatures:
    """Inputs of classifiers after each of several looks, with masks of equal dwells."""

    streams: Streams
    masks: FixedMasks | LearnedMasks
    x: Tensor
    choose: Replicas  # networks that choose dwells
    exposure: LooksExposure
    gain: Tensor  # (R, 1): of all jobs, from `TrainingNoise`
    scale: Scale
    detection: Detection

    def at(self, step: int) -> Tensor:
        """Features and dwells (K · B, R, k + q) after each of K looks."""
        masks, detection, dwells = self.masks(), self.detection, self.exposure.dwells
        rails, usual = masks.stacked, detection.readouts(masks)
        parts = []
        for stream in self.streams:
            x = self.x.index_select(0, stream.with_mean[step])
            products = project(x, stream.of_jobs(rails), detection.count)
            parts.append(stream.repeated(products))
        products_of_all = side_by_side(parts)
        centred, middle = products_of_all[:-1], products_of_all[-1]
        light, mean = centred + middle, detection.features(middle)
        power = detection.features(centred).square().mean(dim=0)
        std = deviation(power + detection.totals(middle) / self.gain, self.scale)

        def read(dwell: Tensor) -> tuple[Tensor, Tensor]:
            rates = dwells.scaled(light, dwell)
            expected, sums = detection.features(rates), detection.totals(rates)
            drawn = []
            for stream in self.streams:
                own, read = stream.replicas, stream.readouts(usual)
                if stream.noise.kind.facts.dark:
                    share = dwells.scaled(torch.ones_like(light[:, own]), dwell[:, own])
                    read = read.lasting(share, detection)
                pair = expected[:, own], sums[:, own]
                drawn.append(stream.noise.features(*pair, read, stream.normal))
            return side_by_side(drawn), dwell

        start = mean.expand(len(light), *mean.shape)
        every = self.exposure.expose_live(read, start, std, self.choose)
        return torch.cat([seen.inputs(mean, std) for seen in every])


@dataclass
class PatchFeatures:
    """Features of every patch of images; one job alone trains on them."""

    streams: Streams
    masks: FixedMasks | LearnedMasks
    x: Tensor  # (n, P, N): patches of the training images, of the pixels that the masks have
    scale: Scale

    def __post_init__(self) -> None:
        [self.stream] = self.streams
        self.scanner = Scanner(self.masks, self.stream.noise.kind)
        self.mean = self.x.mean(dim=(0, 1))

    def at(self, step: int) -> Tensor:
        """Features (B, 1, P, m), standardised in their batch."""
        photons = float(self.stream.noise.gain)
        scenes = self.x[self.stream.rows[step]] * photons
        counts = self.scanner(scenes, self.stream.generator) / photons
        features = (counts - project(self.mean, self.masks().difference)).squeeze(2)
        over = (0, 1) if self.scale == "each" else (0, 1, 2)
        std = deviation(features.square().mean(dim=over), "each")
        return (features / std).unsqueeze(1)


def features_of(
    training_set: TrainingSet,
    job: Job,
    masks: FixedMasks | LearnedMasks,
    noise: TrainingNoise,
    streams: Streams,
    exposure: MaskExposure,
    choose: Replicas,
) -> Features:
    """Features of the kind of exposure of jobs, of which `job` is one."""
    scale = job.training.scale
    detection = Detection.of(job.optics, training_set.data.image_shape)
    if isinstance(exposure, PassingExposure):
        assert isinstance(masks, FixedPattern | LearnedPattern)
        return PassingFeatures(streams, masks, training_set.full, scale)
    if isinstance(exposure, PatchExposure):
        seen = training_set.seen(job.exposure)
        patches, lit = seen.full.view(len(training_set.full), -1, seen.data.pixels), seen.varying
        dark = isinstance(masks, LearnedMasks) and not lit.all()
        return PatchFeatures(streams, masks, patches[..., lit] if dark else patches, scale)
    if isinstance(masks, FixedMasks) and isinstance(exposure, FixedExposure):
        return FixedFeatures(streams, masks, training_set.full, noise, scale, detection)
    pixels = training_set.pixels(job.optics.light)
    if isinstance(masks, FixedMasks):  # which see every pixel
        pixels = torch.ones_like(pixels)
    x = training_set.centred(pixels, product_dtype(job, training_set.device), detection)
    if isinstance(masks, FixedMasks):
        masks = FixedMasks(detection.arrange(masks().stacked))
    if isinstance(exposure, LooksExposure):
        return LooksFeatures(streams, masks, x, choose, exposure, noise.gain, scale, detection)
    if isinstance(exposure, ConditionedExposure):
        law = job.optics.light
        return ConditionedFeatures(streams, masks, x, exposure, law, scale, detection)
    assert isinstance(masks, LearnedMasks)
    few = job.training.counts is not None
    return LearnedFeatures(streams, masks, x, scale, detection, few)
