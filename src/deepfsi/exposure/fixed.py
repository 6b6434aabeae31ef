"""Exposures of which every mask is shown once and all are needed, at one budget or a range."""

import math
from dataclasses import dataclass, replace
from typing import Self

import torch
from torch import Tensor

from deepfsi.exposure.kind import MaskExposure
from deepfsi.exposure.training import CHUNK, LEAST_POWER, ExposureTraining, JobGroup, standardise
from deepfsi.jobs.exposures import ConditionedEntry
from deepfsi.jobs.training import Scale
from deepfsi.physics.detection import Rails
from deepfsi.physics.laws import LearnedMasks
from deepfsi.physics.noise import root
from deepfsi.physics.scanner import project_rails
from deepfsi.physics.training_noise import Draws, SeedStream, ml_gauss_features, side_by_side


class _FixedTraining(ExposureTraining):
    """Masks that do not learn, whose products with all scenes are known.

    Where no counts are drawn the products are standardised once, for the first of the replicas that
    share them; what the others have in place of that is a factor.
    """

    def __init__(self, group: JobGroup) -> None:
        super().__init__(group)
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
            # nine tenths of the gates click at most
            goal = max(counts, min(bright_start, 0.9 * most * readouts))
            low = torch.full_like(bright, -20.0)
            high = torch.zeros_like(bright)
            whole = {name: each.clone() for name, each in masks.state_dict().items()}
            for _ in range(30):
                masks.load_state_dict(whole)
                middle = (low + high) / 2
                masks.dim(middle.exp())
                over = counted() > goal
                low = torch.where(over, low, middle)
                high = torch.where(over, middle, high)


def fixed_training(group: JobGroup) -> ExposureTraining:
    """Training of masks that are shown once, whether they learn or not."""
    return (_LearnedTraining if group.jobs[0].code.learned else _FixedTraining)(group)


@dataclass(frozen=True, eq=False, kw_only=True)
class ConditionedExposure(MaskExposure):
    """Exposure of fixed dwells whose classifier has two inputs more, as it must know the budget.

    They are the logarithm of the budget, mapped from the range to -1 .. 1, and 1, the share of
    masks shown, which designs of earlier versions could have below that.
    """

    entry: ConditionedEntry

    def __post_init__(self) -> None:
        """Raise `ValueError` unless the masks can be exposed so."""
        if self.count > self.entry.masks:
            raise ValueError("more masks than in the whole sequence")

    def input_count(self, features: int) -> int:
        """Number of the classifier's inputs."""
        return self.entry.masks * self.entry.width + 2

    def inputs(self, features: Tensor, photons: Tensor | float) -> Tensor:
        """Inputs of the classifier, of features over the budget, and the budget."""
        scaled = super().inputs(features, photons)
        ratio = torch.as_tensor(photons).to(scaled) / (self.entry.used * self.entry.photons)
        return _with_budget(scaled, ratio, self.entry.span)

    def as_shown(self, rails: Rails, dimmed: float) -> Self:
        """The kind as patterns realise it."""
        entry = self.entry.model_copy(update={"used": self.entry.used / dimmed})
        return replace(super().as_shown(rails, dimmed), entry=entry)


def _with_budget(scaled: Tensor, ratio: Tensor, span: float) -> Tensor:
    """Inputs (..., k + 2): standardised features, the budget over the lowest of a range, and 1."""
    middle = math.log(span) / 2
    level = (torch.log(ratio) - middle) / max(middle, 1.0)  # -1 to 1 over the range
    column = scaled[..., :1]
    return torch.cat([scaled, level.expand_as(column), torch.ones_like(column)], dim=-1)


def standardised(features: Tensor, scale: Scale) -> Tensor:
    """Features (B, R, k) as of `training.standardise`, which rounds otherwise: bits stay."""
    over = (0,) if scale == "each" else (0, 2)
    power = features.square().sum(dim=over, keepdim=True)
    power = power / (features.numel() // power.numel())
    return features / power.clamp(min=LEAST_POWER).sqrt()


class ConditionedTraining(ExposureTraining):
    """Masks of which each scene has a budget of its own in each step."""

    def __init__(self, group: JobGroup) -> None:
        super().__init__(group)
        self.span = self.job.exposure.highest(1.0)
        width = self.input_count // self.job.masks
        self.entries = [
            ConditionedEntry(photons=job.photons, span=self.span, masks=job.masks, width=width)
            for job in self.jobs
        ]
        self.input_count += 2
        self.masks = (
            self.learned_masks()
            if self.learns
            else self.fixed_masks(self.named_rails(group.matrix))
        )

    def prepare(self) -> None:
        """Take the centred scenes."""
        self.x, self.arranged = self.centred()

    def inputs(self, draws: Draws) -> Tensor:
        """Features and conditioning inputs (B, R, k + 2)."""
        rails = self.arranged()
        masks = self.detection.read_of(rails).combined
        parts = self.detection.count
        used = self.law.used(rails.stacked)[..., -1:]
        features = []
        ratios = []
        for stream in draws.streams:
            # 1, whose gradient is that of rounding: trainings are bit for bit those of before
            whole = stream.of_jobs(used / used).T.unsqueeze(-1)
            ratio = stream.budgets(self.span, self.job.masks) / whole
            normal = stream.normal(masks.shape[-2] * parts) * stream.noise.unit / ratio.sqrt()
            x = self.x.index_select(0, stream.with_mean)
            of_seed = stream.of_jobs(masks, -3)
            features.append(ml_gauss_features(x, of_seed, normal, False, parts=parts))
            ratios.append(ratio.expand(*features[-1].shape[:2], 1))
        scaled = standardised(side_by_side(features), self.scale)
        return _with_budget(scaled, side_by_side(ratios), self.span)

    def finish(self) -> list[MaskExposure]:
        """Masks of each job, with the statistics of the mean over their budgets, too."""
        factor = (1 - 1 / self.span) / math.log(self.span)
        return self.trained(self.statistics(factor))
