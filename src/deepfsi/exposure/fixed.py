"""Exposures of which every mask is shown once and all are needed, of masks that learn or not."""

from dataclasses import KW_ONLY, dataclass

import torch
from torch import Tensor

from deepfsi.exposure.kind import UNTRAINED, MaskExposure, TrainedMasks
from deepfsi.exposure.training import (
    CHUNK,
    ExposureTraining,
    JobGroup,
    standardise,
)
from deepfsi.jobs.exposures import FixedEntry
from deepfsi.physics.masks import LearnedMasks
from deepfsi.physics.noise import root
from deepfsi.physics.rails import Rails
from deepfsi.physics.scanner import project_rails
from deepfsi.physics.training_noise import Draws, SeedStream

CLICKING = 0.9
"""Part of the gates that click at the start, at most."""

DIMMINGS = 30
"""Steps of the search for the brightness of the start."""


@dataclass(frozen=True, eq=False)
class FixedExposure(MaskExposure):
    """Exposure of which all masks are needed, each with its own dwell."""

    _: KW_ONLY
    optics: TrainedMasks = UNTRAINED  # its masks, with the statistics of their features
    kind = "fixed"

    def entry(self) -> FixedEntry:
        """Entry of the design file's header."""
        return FixedEntry()


class _FixedTraining(ExposureTraining):
    """Masks that do not learn, whose products with all scenes are known.

    Where no counts are drawn the products are standardised once, for the first of the replicas that
    share them; what the others have in place of that is a factor.
    """

    def __init__(self, group: JobGroup) -> None:
        super().__init__(group)
        self.exposures = [FixedExposure()] * len(self.jobs)
        self.masks = group.masks or self.fixed_masks(self.named_rails(group.matrix))

    def prepare(self) -> None:
        """Take the products of all scenes, and their statistics."""
        noise = self.noise
        detection = self.detection
        arranged = self.masks().map(detection.arrange)
        frames = detection.read_of(arranged)
        if not noise.kind.of_light:
            frames = Rails(frames.difference)  # their total is not needed
        pairs = [
            project_rails(detection.arrange(x), frames, detection.count)
            for x in self.scenes.full.split(CHUNK)
        ]
        self.means = torch.cat([mean for mean, _ in pairs])
        single = frames.count == 1
        totals = self.means if single else torch.cat([total for _, total in pairs])
        del pairs
        self.mean, self.std, _ = self.statistics(means=self.means)
        self.read = detection.readouts(arranged)
        self.totals = totals if noise.kind.of_light else None
        if noise.kind.draws_rails:
            return
        replicas = self.means.shape[1]
        self.alone = replicas == len(self.std)
        self.ratio = self.std[:replicas] / self.std
        if self.totals is None:
            self.gain = noise.variance(self.mean, self.mean, self.read).sqrt() / self.std
        else:
            gain = noise.unit / self.std
            self.totals = root(self.totals).mul_(gain[:replicas])
            self.gain = gain / gain[:replicas]
        self.means.sub_(self.mean[:replicas]).div_(self.std[:replicas])

    def inputs(self, draws: Draws) -> Tensor:
        """Features (B, R, k), standardised as those of the whole training set."""
        return draws.side_by_side(self._of_seed)

    def _of_seed(self, stream: SeedStream) -> Tensor:
        expected = stream.products(self.means)
        if self.noise.kind.draws_rails:
            assert self.totals is not None
            totals = stream.products(self.totals)
            counts = stream.noise.counted(expected, totals, stream.readouts(self.read))
            return (counts - stream.of_jobs(self.mean)) / stream.of_jobs(self.std)
        normal = stream.normal(expected.shape[-1])
        gain = stream.of_jobs(self.gain)
        if self.totals is not None:
            normal = normal * stream.products(self.totals)
            if self.alone:
                return expected.add_(normal)
        scaled = expected if self.alone else expected * stream.of_jobs(self.ratio)
        return torch.addcmul(scaled, normal, gain)


class _LearnedTraining(ExposureTraining):
    """Masks that learn."""

    masks: LearnedMasks

    def __init__(self, group: JobGroup) -> None:
        super().__init__(group)
        self.exposures = [FixedExposure()] * len(self.jobs)
        self.masks = self.learned_masks()

    def prepare(self) -> None:
        """Take the centred scenes, and masks that are not too bright where few counts are asked."""
        self.x, _ = self.centred()
        if self.job.training.counts is not None:
            self._dim(self.job.training.counts)

    def inputs(self, draws: Draws) -> Tensor:
        """Features (B, R, k), standardised in their batch."""
        features, light = self.noise.learn(self.x, self.masks, self.detection, draws)
        if self.job.training.counts is not None:
            pairs = zip(draws.streams, light, strict=True)
            self.counts = torch.cat([stream.noise.expected(*pair) for stream, pair in pairs])
        return standardise(features, self.scale)

    def _dim(self, counts: float) -> None:
        """Dim masks before their training, where they would count too much."""
        # x (n + 1, P): centred scenes, and their mean
        masks = self.masks
        detection = self.detection
        first = torch.arange(min(CHUNK, len(self.training_set.labels)), device=self.x.device)
        mean = self.x.index_select(0, first.new_tensor([len(self.training_set.labels)]))
        scenes = (self.x.index_select(0, first) + mean).float()

        def counted() -> Tensor:
            light = project_rails(scenes, detection.read_of(masks()), detection.count)
            return self.noise.expected(*light)

        with torch.no_grad():
            bright = counted()
            rails = masks()
            readouts = rails.count * rails.masks * detection.count
            most = float(self.noise.kind.mean(torch.tensor(torch.inf)))  # if it is limited
            bright_start = self.job.training.start_counts * counts
            goal = max(counts, min(bright_start, CLICKING * most * readouts))
            low = torch.full_like(bright, -20.0)
            high = torch.zeros_like(bright)
            whole = {name: each.clone() for name, each in masks.state_dict().items()}
            for _ in range(DIMMINGS):
                masks.load_state_dict(whole)
                middle = (low + high) / 2
                masks.dim(middle.exp())
                over = counted() > goal
                low = torch.where(over, low, middle)
                high = torch.where(over, middle, high)


def fixed_training(group: JobGroup) -> ExposureTraining:
    """Training of masks that are shown once, whether they learn or not."""
    return (_LearnedTraining if group.jobs[0].code.learned else _FixedTraining)(group)
