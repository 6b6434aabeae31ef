"""Kinds of exposure by what a job asks for: how each trains."""

from collections.abc import Callable

from deepfsi.exposure.conditioned import ConditionedTraining
from deepfsi.exposure.fixed import fixed_training
from deepfsi.exposure.looks import LooksTraining
from deepfsi.exposure.passing import PassingTraining
from deepfsi.exposure.patches import PatchTraining
from deepfsi.exposure.training import ExposureTraining, JobGroup
from deepfsi.jobs import Exposure, Fixed, Looks, Nested, Passing, Patches, Range

TRAININGS: dict[type[Exposure], Callable[[JobGroup], ExposureTraining]] = {
    Fixed: fixed_training,
    Range: ConditionedTraining,
    Nested: ConditionedTraining,
    Looks: LooksTraining,
    Patches: PatchTraining,
    Passing: PassingTraining,
}
"""Training of the masks of each kind of exposure."""


def build(group: JobGroup) -> ExposureTraining:
    """Masks of jobs before their training, and networks beside the classifiers."""
    return TRAININGS[type(group.jobs[0].exposure)](group)
