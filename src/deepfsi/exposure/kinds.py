"""Kinds of exposure by what a job or a file asks for: how each trains, and what it becomes."""

from collections.abc import Callable

from deepfsi.exposure.conditioned import ConditionedExposure, ConditionedTraining
from deepfsi.exposure.fixed import FixedExposure, fixed_training
from deepfsi.exposure.kind import MaskExposure
from deepfsi.exposure.looks import LooksExposure, LooksTraining
from deepfsi.exposure.passing import PassingExposure, PassingTraining
from deepfsi.exposure.patches import PatchExposure, PatchTraining
from deepfsi.exposure.training import ExposureTraining, JobGroup
from deepfsi.jobs.exposures import Exposure, Fixed, Looks, Nested, Passing, Patches, Range

TRAININGS: dict[type[Exposure], Callable[[JobGroup], ExposureTraining]] = {
    Fixed: fixed_training,
    Range: ConditionedTraining,
    Nested: ConditionedTraining,
    Looks: LooksTraining,
    Patches: PatchTraining,
    Passing: PassingTraining,
}
"""Training of the masks of each kind of exposure."""

MASK_KINDS: dict[str, type[MaskExposure]] = {
    kind.kind: kind
    for kind in (
        FixedExposure,
        ConditionedExposure,
        LooksExposure,
        PatchExposure,
        PassingExposure,
    )
}
"""Exposure of the masks of a design file, by the kind of their entry."""


def build_training(group: JobGroup) -> ExposureTraining:
    """Masks of jobs before their training, and networks beside the classifiers."""
    return TRAININGS[type(group.jobs[0].exposure)](group)
