"""Conditioning input of the classifier: the photon budget.

The classifier of a design for a range of budgets must know the budget. So it has two inputs more:
the logarithm of the budget, mapped from the range to -1 .. 1, and 1, the share of masks shown,
which designs of earlier versions could have below that.
"""

import math
from dataclasses import KW_ONLY, dataclass, replace
from typing import Self

import torch
from torch import Tensor

from deepfsi.exposure.kind import UNTRAINED, MaskExposure, TrainedMasks
from deepfsi.exposure.training import LEAST_POWER, ExposureTraining, JobGroup
from deepfsi.jobs.exposures import ConditionedEntry
from deepfsi.jobs.training import Scale
from deepfsi.physics.rails import Rails
from deepfsi.physics.training_noise import Draws, ml_gauss_features, side_by_side


@dataclass(frozen=True, eq=False)
class ConditionedExposure(MaskExposure):
    """Exposure of fixed dwells whose classifier has the budget as an input.

    Its fields are those of `ConditionedEntry`.
    """

    photons: float
    span: float
    masks: int
    width: int = 1
    used: float = 1.0
    _: KW_ONLY
    optics: TrainedMasks = UNTRAINED
    kind = "conditioned"

    def entry(self) -> ConditionedEntry:
        """Entry of the design file's header."""
        every = {name: value for name, value in vars(self).items() if name != "optics"}
        return ConditionedEntry(**every)

    def check_masks(self) -> None:
        """Raise `ValueError` unless the masks can be exposed so."""
        if self.count > self.masks:
            raise ValueError("more masks than in the whole sequence")

    def input_count(self, features: int) -> int:
        """Number of the classifier's inputs."""
        return self.masks * self.width + 2

    def condition(self, inputs: Tensor, photons: Tensor | float) -> Tensor:
        """Inputs of the classifier, from those of `Observation.inputs` and the budget."""
        ratio = torch.as_tensor(photons).to(inputs) / (self.used * self.photons)
        return self.inputs(inputs, ratio)

    def as_shown(self, rails: Rails, dimmed: float) -> Self:
        """The kind as patterns realise it."""
        return replace(super().as_shown(rails, dimmed), used=self.used / dimmed)

    def inputs(self, scaled: Tensor, ratio: Tensor) -> Tensor:
        """Inputs of the classifier: standardised features (..., k) and two more."""
        middle = math.log(self.span) / 2
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

    exposures: list[ConditionedExposure]

    def __init__(self, group: JobGroup) -> None:
        super().__init__(group)
        span = self.job.exposure.highest(1.0)
        width = self.input_count // self.job.masks
        self.exposures = [
            ConditionedExposure(job.photons, span, job.masks, width=width) for job in self.jobs
        ]
        self.lowest = self.exposures[0]  # of the lowest budget
        self.input_count = self.lowest.input_count(self.input_count)
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
            ratio = stream.budgets(self.lowest.span, self.lowest.masks) / whole
            normal = stream.normal(masks.shape[-2] * parts) * stream.noise.unit / ratio.sqrt()
            x = self.x.index_select(0, stream.with_mean)
            of_seed = stream.of_jobs(masks, -3)
            features.append(ml_gauss_features(x, of_seed, normal, False, parts=parts))
            ratios.append(ratio.expand(*features[-1].shape[:2], 1))
        scaled = standardised(side_by_side(features), self.scale)
        return self.lowest.inputs(scaled, side_by_side(ratios))

    def finish(self) -> list[MaskExposure]:
        """Masks of each job, with the statistics of the mean over their budgets, too."""
        span = self.lowest.span
        return self.trained(self.statistics((1 - 1 / span) / math.log(span)))
