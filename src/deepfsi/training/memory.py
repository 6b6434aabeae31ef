"""Memory that a training takes."""

from collections.abc import Sequence

from deepfsi.training.job import Job
from deepfsi.training.loop import batch_of
from deepfsi.training.training_set import TrainingSet

MASK_COPIES = 16
"""Copies of the masks alive in a step: weights, gradients, moments, their stages and products."""

QUANTISED_MASK_COPIES = 10
"""Those besides of quantised masks: two rails, their steps, what is shown, and its two sums."""

FEATURE_COPIES = 12
"""Copies of the features and hidden units alive in a step."""

FLOAT_BYTES = 4.0
"""Bytes of a number."""


def footprint(training_set: TrainingSet, jobs: Sequence[Job]) -> float:
    """Bytes that training jobs together takes at most, the scenes included, by the tensors alive.

    Parameters
    ----------
    training_set : TrainingSet
    jobs : sequence of Job
        As for `loop.optimise`.
    """
    job, scene = jobs[0], training_set.full[0].numel()
    count, replicas = len(training_set.labels), len(jobs)
    masks, batch = replicas * job.masks, batch_of(job.training, count)
    copies = MASK_COPIES + (QUANTISED_MASK_COPIES if job.training.levels else 0)
    learned = copies * masks * scene if job.masks_from().code.learned else 0
    own = replicas if job.design in ("control", "random") else 1
    products_of_all = 0 if job.code.learned else 5 * own * count * job.masks
    step = FEATURE_COPIES * batch * (masks + replicas * sum(job.training.hidden))
    step *= job.training.looks
    return FLOAT_BYTES * (3 * training_set.full.numel() + learned + products_of_all + step)
