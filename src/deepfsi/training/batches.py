"""Memory that a training takes, planned before it is used."""

from collections.abc import Sequence

import torch

from deepfsi.base import Message
from deepfsi.base.numeric import check_memory, free_memory
from deepfsi.exposure.training_set import TrainingSet
from deepfsi.jobs import Job, Training
from deepfsi.training.masks import matrix_seeds

MASK_COPIES = 16
"""Copies of the masks alive in a step: weights, gradients, moments, their stages and products."""

QUANTISED_MASK_COPIES = 10
"""Those besides of quantised masks: two rails, their steps, what is shown, and its two sums."""

FEATURE_COPIES = 12
"""Copies of the features and hidden units alive in a step."""

FLOAT_BYTES = 4.0
"""Bytes of a number."""


def batch_of(settings: Training, count: int) -> int:
    """Scenes of a step, of `count` in all."""
    return min(settings.batch or min(max(count // 100, 32), 500), count)


def check_fits(training_set: TrainingSet, jobs: Sequence[Job], processes: int = 1) -> None:
    """Raise `InputError` where training jobs together would take more memory than is free."""
    scenes, pixels = training_set.full.shape
    held = training_set.full.nbytes
    check_memory(
        footprint(training_set, jobs) * processes - held,
        memory_for(training_set.device),
        f"{scenes} scenes of {pixels} pixels, {jobs[0].masks} masks and {processes} processes",
        Message(
            "give fewer or smaller scenes ({size}), fewer {masks} or fewer {workers}",
            setting=("size", "masks", "workers"),
        ),
    )


def memory_for(device: torch.device) -> float:
    """Bytes that this process may take on a device."""
    if device.type != "cuda":
        return free_memory()
    kept = torch.cuda.memory_reserved(device) - torch.cuda.memory_allocated(device)
    return float(torch.cuda.mem_get_info(device)[0] + kept)  # torch keeps what it has freed


def footprint(training_set: TrainingSet, jobs: Sequence[Job]) -> float:
    """Bytes that training jobs together takes at most, scenes included, by the tensors alive."""
    job, scene = jobs[0], training_set.full[0].numel()
    count, replicas = len(training_set.labels), len(jobs)
    masks, batch = replicas * job.masks, batch_of(job.training, count)
    levels = job.optics.mask_levels(training_set.data.image_shape)
    copies = MASK_COPIES + (QUANTISED_MASK_COPIES if levels else 0)
    learned = copies * masks * scene if job.mask_job().code.learned else 0
    own = replicas if job.code.learned_under else len(matrix_seeds(jobs))
    products_of_all = 0 if job.code.learned else 5 * own * count * job.masks
    step = FEATURE_COPIES * batch * (masks + replicas * sum(job.training.hidden))
    step *= job.exposure.parts
    return FLOAT_BYTES * (3 * training_set.full.numel() + learned + products_of_all + step)
