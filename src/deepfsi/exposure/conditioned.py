"""Conditioning inputs of the classifier: photon budget and number of masks shown.

The classifier of a design for a range of budgets, or with nested masks, must know the budget and
the number of masks shown. So it has two inputs more: the logarithm of the budget, mapped from
the range to -1 .. 1, and the share of masks shown. Features of masks not shown are 0.

The first k masks, brought to what the whole sequence takes of the light law, see a scene as
they do within the sequence at a budget that is larger by the inverse of their share of it,
`used` (`LightLaw.used`). So one number stands for both, the conditioning budget Φ / used.
"""

import math
from collections.abc import Iterator
from dataclasses import KW_ONLY, dataclass, replace
from typing import Self

import torch
from torch import Tensor
from torch.nn import functional

from deepfsi.base.errors import InputError
from deepfsi.camera.names import LIGHT_LAWS
from deepfsi.exposure.kind import (
    UNTRAINED,
    ExposureKind,
    MaskExposure,
    Observation,
    Stops,
    TrainedMasks,
)
from deepfsi.exposure.training import ExposureTraining, JobGroup, standardise
from deepfsi.jobs.exposures import ConditionedEntry
from deepfsi.physics.laws import light_law
from deepfsi.physics.masks import FixedMasks
from deepfsi.physics.rails import Rails
from deepfsi.physics.scanner import Scanner
from deepfsi.physics.training_noise import Draws, ml_gauss_features, side_by_side

ALL_MASKS_SHARE = 0.25
"""Share of the exposures of nested masks in training that show all of them."""


@dataclass(frozen=True, eq=False)
class ConditionedExposure(MaskExposure):
    """Exposure of fixed dwells whose classifier has the budget and the number of masks as inputs.

    Its fields are those of `ConditionedEntry`.
    """

    photons: float
    span: float
    masks: int
    nested: int = 0
    width: int = 1
    used: float = 1.0
    cap: float = 1.0
    until: float = 1.0
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
        """Number of the classifier's inputs, whatever number of masks is shown."""
        return self.masks * self.width + 2

    def condition(self, inputs: Tensor, photons: Tensor | float) -> Tensor:
        """Inputs of the classifier, from those of `Observation.inputs` and the budget."""
        ratio = torch.as_tensor(photons).to(inputs) / (self.used * self.photons)
        return self.inputs(inputs, ratio, ratio.new_tensor(inputs.shape[-1] // self.width))

    @property
    def chances(self) -> Tensor:
        """Chance of each number of masks 1 .. m to be shown in training, shape (m,).

        Inverse to the number from the fewest on, so that few masks, which do worst, learn as much
        as many, but for the share `ALL_MASKS_SHARE` of exposures that show all: else the last masks
        would hardly learn.
        """
        count = torch.arange(1, self.masks + 1, dtype=torch.float32)
        weight = torch.where(count >= (self.nested or self.masks), 1 / count, 0.0)
        chance = (1 - ALL_MASKS_SHARE) * weight / weight.sum()
        chance[-1] += ALL_MASKS_SHARE
        return chance

    @property
    def fewest_masks(self) -> int:
        """Smallest number of first masks that can be classified alone."""
        return self.nested or self.count

    def observe(
        self, front: Scanner, rates: Tensor, photons: float, generator: torch.Generator
    ) -> Iterator[Observation]:
        """Exposures at each number of masks that is a stop."""
        features = self.read(front, rates * photons, generator, photons)
        for masks in range(self.fewest_masks, features.shape[-1] // self.width + 1):
            yield Observation(features[..., : masks * self.width])

    def stop_place(self, seen: Observation) -> int:
        """Place of an exposure so far among the stops, from 0."""
        masks = seen.features.shape[-1] // self.width
        return masks - (self.nested or masks)

    def as_shown(self, rails: Rails, dimmed: float) -> Self:
        """The kind as patterns realise it."""
        return replace(super().as_shown(rails, dimmed), used=self.used / dimmed)

    def first(self, masks: int) -> tuple[Self, float]:
        """The kind of the first masks alone, all of which take the budget; parameters as before."""
        part, share = super().first(masks)
        if self.cap > 1:
            part = replace(part.dimmed(1 / self.cap), cap=1.0, until=1.0)
            share *= self.cap
        return replace(part, used=self.used * share), share

    def expected(self, rates: Tensor, seen: Observation) -> Tensor:
        """Photons (..., rails, m · D) of the masks shown."""
        shown = seen.features.shape[-1] // self.width
        return rates[..., : shown * self.detection.count]

    @property
    def stops(self) -> Stops:
        """Numbers of masks after which an exposure may stop, and the share taken then."""
        fewest = self.fewest_masks
        masks = self.count
        if fewest == masks:
            return super().stops
        law = light_law(self.optics.light)
        if not LIGHT_LAWS[law.name].in_turn:
            raise InputError(
                "under the {given} constraint all masks see light at once, so that stopping saves "
                "nothing: use a design for one device, {light:free-dwell} or equal-dwell",
                setting="light",
                given=law.name,
            )
        used = law.used(self.optics.rails.stacked)[fewest - 1 :]
        share = (used / used[-1]).double().cpu().numpy()
        return Stops(tuple(range(fewest, masks + 1)), self.cap * share)

    def stopping_at(self, threshold: float) -> ExposureKind:
        """The kind whose exposures end at a probability, or `InputError` of equal light."""
        return replace(self, until=threshold) if self.cap > 1 else super().stopping_at(threshold)

    def inputs(self, scaled: Tensor, ratio: Tensor, shown: Tensor) -> Tensor:
        """Inputs of the classifier, features and two more; 0 are features beyond those shown."""
        # scaled (..., k): standardised features of the first masks; (..., 1): ratio, conditioning
        # budget over `photons`, and shown, number of masks
        seen = torch.where(_first(scaled.shape[-1], shown * self.width), scaled, 0.0)
        seen = functional.pad(seen, (0, self.masks * self.width - scaled.shape[-1]))
        middle = math.log(self.span) / 2
        level = (torch.log(ratio) - middle) / max(middle, 1.0)  # -1 to 1 over the range
        column = seen[..., :1]
        share = shown / self.masks
        return torch.cat([seen, level.expand_as(column), share.expand_as(column)], dim=-1)


def _first(count: int, shown: Tensor) -> Tensor:
    """Mask (..., count), true for the first `shown` (..., 1)."""
    return torch.arange(count, device=shown.device) < shown


def mean_over_exposures(used: Tensor, span: float, chances: Tensor) -> tuple[Tensor, Tensor]:
    """Noise of each mask in the mean over the budgets and numbers of masks of a training."""
    # used (R or 1, m); chances (m,)
    dim = (1 - 1 / span) / math.log(span) if span > 1 else 1.0
    later = (chances * used / used[..., -1:]).flip(-1).cumsum(-1).flip(-1)
    often = chances.flip(-1).cumsum(-1).flip(-1)
    return dim * later / often, often


class ConditionedTraining(ExposureTraining):
    """Masks of which each scene has a budget and a number of its own in each step.

    The fewer masks share the light, the more each has. The gradient includes the light that a mask
    takes from later ones.
    """

    exposures: list[ConditionedExposure]

    def __init__(self, group: JobGroup) -> None:
        super().__init__(group)
        span = self.job.exposure.highest(1.0)
        nested = getattr(self.job.exposure, "nested", 0)
        width = self.input_count // self.job.masks
        cap = self.job.exposure.most_light
        self.exposures = [
            ConditionedExposure(job.photons, span, job.masks, nested=nested, width=width, cap=cap)
            for job in self.jobs
        ]
        self.lowest = self.exposures[0]  # of the lowest budget
        self.input_count = self.lowest.input_count(self.input_count)
        self.brightened = self.learns and nested > 0
        self.masks = (
            self.learned_masks()
            if self.learns
            else self.fixed_masks(self.named_rails(group.matrix))
        )

    def prepare(self) -> None:
        """Take the centred scenes."""
        self.x, self.arranged = self.centred()
        self.chances = self.lowest.chances.to(self.x.device)

    def inputs(self, draws: Draws) -> Tensor:
        """Features and conditioning inputs (B, R, k + 2)."""
        rails = self.arranged()
        masks = self.detection.read_of(rails).combined
        parts = self.detection.count
        used = self.law.used(rails.stacked)
        whole = used[..., -1:]
        used = used if self.brightened else used / whole
        features = []
        ratios = []
        counts = []
        for stream in draws.streams:
            budget, shown = stream.exposures(self.lowest.span, self.chances)
            ratio = budget / stream.of_jobs(used)[:, shown[:, 0, 0] - 1].T.unsqueeze(-1)
            normal = stream.normal(masks.shape[-2] * parts) * stream.noise.unit / ratio.sqrt()
            x = self.x.index_select(0, stream.with_mean)
            of_seed = stream.of_jobs(masks, -3)
            features.append(ml_gauss_features(x, of_seed, normal, False, parts=parts))
            level = ratio * stream.of_jobs(whole) if self.brightened else ratio
            ratios.append(level.expand(*features[-1].shape[:2], 1))
            counts.append(stream.repeated(shown))
        number = side_by_side(counts)
        seen = side_by_side(features)
        scaled = standardise(seen, self.scale, _first(seen.shape[-1], number * self.lowest.width))
        return self.lowest.inputs(scaled, side_by_side(ratios), number)

    def fix(self) -> None:
        """Nested masks take the whole of their light law at the end, by one common factor.

        So they are trained, however many of them are shown.
        """
        if not self.brightened:
            super().fix()
            return
        rails = self.all_pixels()
        self.masks = FixedMasks(rails / self.law.used(rails)[..., -1:][..., None, None])

    def finish(self) -> list[MaskExposure]:
        """Masks of each job, with statistics over budgets and numbers of masks shown, too."""
        used = self.law.used(self.masks().stacked)
        noise = mean_over_exposures(used, self.lowest.span, self.lowest.chances.to(used))
        later, often = (each.repeat_interleave(self.lowest.width, dim=-1) for each in noise)
        return self.trained(self.statistics((later, often)))
