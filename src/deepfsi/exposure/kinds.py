"""Behaviour of each kind of exposure that a job asks for, and its beginning before a training."""

import torch

from deepfsi.exposure.conditioned import ConditionedExposure
from deepfsi.exposure.looks import LooksExposure
from deepfsi.exposure.passing import PassingExposure
from deepfsi.exposure.trained import FixedExposure, MaskExposure, PatchExposure
from deepfsi.jobs import Exposure, Fixed, Job, Looks, Nested, Passing, Patches, Range

TRAINED_KINDS: dict[type[Exposure], type[MaskExposure]] = {
    Fixed: FixedExposure,
    Range: ConditionedExposure,
    Nested: ConditionedExposure,
    Looks: LooksExposure,
    Patches: PatchExposure,
    Passing: PassingExposure,
}
"""What exposures of each kind become by a training."""

KIND_OF_ENTRY = {kind.kind: kind for kind in TRAINED_KINDS.values()}
"""What a design does with the masks of its file, by the kind of their entry."""


def begin(job: Job, image_shape: tuple[int, ...], seed: torch.Generator) -> MaskExposure:
    """The exposure of a design that is to be trained on scenes of a shape.

    Where it has a network of its own, that is untrained.
    """
    return TRAINED_KINDS[type(job.exposure)].begin(job, image_shape, seed)
