"""Faults of jobs that go beyond one setting: few counts, values, and adaptive masks."""

from typing import TYPE_CHECKING, Protocol

from deepfsi.camera.names import MLP
from deepfsi.design.exposure import Exposure, Fixed
from deepfsi.design.exposure.base import Job
from deepfsi.jobs.designs import DESIGNS

if TYPE_CHECKING:
    from deepfsi.camera.camera import Camera
    from deepfsi.datasets import Dataset
    from deepfsi.optics.detection import Detection


COUNTING = ("poisson", "camera", "click")
"""Noises under which counts are drawn, whose mean is known."""


class WholeJob(Job, Protocol):
    """A job, as far as its faults ask for it: `training.job.Job`."""

    @property
    def camera(self) -> "Camera":
        """The camera as it was given."""

    @property
    def exposure(self) -> Exposure:
        """Kind of exposure."""

    def detection(self, image_shape: tuple[int, ...]) -> "Detection":
        """Detectors of scenes of a shape, and what is read of two rails."""


def of_few_counts(job: WholeJob, image_shape: tuple[int, ...]) -> list[str]:
    """Everything in a job of few counts within its budget that cannot be had."""
    counts, camera = job.training.counts or 0.0, job.optics
    if not job.code.learned or not isinstance(job.exposure, Fixed):
        return [
            "counts within a budget are of learned masks that are shown once each: leave "
            '`counts` or `photons` out, or give `design="deepfsi"` without looks, nested, span '
            "or patch"
        ]
    if job.noise not in COUNTING:
        return [
            f"counts within a budget are trained on counts, not under {job.noise} noise: give "
            f"one of {', '.join(COUNTING)}"
        ]
    most, of = job.photons, "the photons of its budget"
    if job.noise == "click":
        readouts = job.masks * camera.rail_count * job.detection(image_shape).count
        most, of = min(most, readouts * camera.gates), "the clicks of all its gates"
    if counts < most:
        return []
    return [f"{counts:g} counts are not fewer than {most:g}, {of}: give fewer"]


def of_values(job: WholeJob) -> list[str]:
    """Everything in a job on scenes with values that is of classes alone."""
    found = []
    if job.code.of_classes:
        found.append(
            f"{job.design} is made of classes, and these scenes have values: give another design"
        )
    elif job.code.learns_masks and DESIGNS[job.training.start].of_classes:
        found.append(
            f"masks cannot start from {job.training.start}, which is made of classes, where scenes "
            'have values: give `start="pca"`'
        )
    if job.exposure.of_classes:
        found.append(
            "several looks are decided by the probabilities of classes, and these scenes have "
            "values: leave `looks` out"
        )
    if job.training.balance:
        found.append("`balance` is of classes, and these scenes have values: leave it out")
    return found


def of_adaptive_masks(job: WholeJob, data: "Dataset") -> list[str]:
    """Everything in a job of adaptive masks that cannot be had."""
    import numpy as np

    found = []
    fewest = int(np.bincount(data.y_train, minlength=len(data.classes)).min())
    if (job.training.clusters or 0) > fewest // 2:
        found.append(
            f"{job.training.clusters} clusters of each class are too many where one has "
            f"{fewest} scenes: give at most {fewest // 2}, or leave `clusters` out"
        )
    if not isinstance(job.exposure, Fixed):
        found.append("adaptive masks have a look each: give no looks, nested, span or patch")
    if job.training.classifier != MLP:
        found.append("adaptive masks are read by their posterior: leave `classifier` out")
    shortest = job.camera.shortest_share
    if shortest * job.masks > 1:
        found.append(
            f"{job.masks} looks are shorter than {shortest:.3g} of the exposure, the shortest "
            f"picture of the camera: give at most {int(1 / shortest)} masks"
        )
    return found
