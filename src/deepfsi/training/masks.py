"""Masks of a training: the matrix that they are or start from, and what they are at its end."""

from collections.abc import Sequence

import numpy as np
import torch
from torch import Tensor

from deepfsi.base import InputError
from deepfsi.camera import LIGHT_LAWS, Camera
from deepfsi.exposure.passing import PassingExposure
from deepfsi.exposure.trained import MaskExposure
from deepfsi.exposure.training_set import TrainingSet
from deepfsi.jobs import DESIGNS, Code, Job, count_allowed
from deepfsi.physics import (
    Detection,
    FixedMasks,
    FixedPattern,
    LearnedMasks,
    LearnedPattern,
    frames,
    light_law,
    peak,
    signed_parts,
)
from deepfsi.training.passing import initial_pattern


def initial_masks(
    seen: TrainingSet,
    jobs: Sequence[Job],
    exposure: MaskExposure,
    matrix: np.ndarray | None = None,
) -> FixedMasks | LearnedMasks:
    """Masks before training: of R replicas, or of one where all share them."""
    # The scenes are those that the masks see; the matrix (m, N) is a user's own
    job, camera, shape = jobs[0], jobs[0].optics, seen.data.image_shape
    law, levels = light_law(camera.light), camera.mask_levels(shape)
    if isinstance(exposure, PassingExposure):
        seeds, learned = [each.seed for each in jobs], job.code.learned
        held = seeds if learned else matrix_seeds(jobs)
        return initial_pattern(exposure.transit, held, learned, levels, seen.device)
    if matrix is not None:
        rails = law.rails_of(matrix, camera.rails).unsqueeze(0)
    else:
        signed = torch.stack([_matrix(seen, job, seed) for seed in matrix_seeds(jobs)])
        if job.code.learned:
            kept = seen.pixels(camera.light).cpu()
            detection = Detection.of(camera, shape)
            start = detection.of_pixels(kept).arrange(signed[..., kept])
            return exposure.learned_masks(start.expand(len(jobs), -1, -1).clone(), camera, levels)
        rails = exposure.fixed(_fitted(signed, job.code, camera), camera.light)
    return FixedMasks(law.quantise(rails, levels) if levels else rails)


def matrix_seeds(jobs: Sequence[Job]) -> list[int]:
    """Seed of each matrix that jobs trained together are drawn from; one where all share it."""
    seeds = [job.seed for job in jobs]
    drawn = DESIGNS[jobs[0].start_matrix].seeded
    return seeds if drawn and len(set(seeds)) > 1 else seeds[:1]


def _fitted(signed: Tensor, code: Code, camera: Camera) -> Tensor:
    """Rails (R, 2 or 1, m, N) of matrices (R, m, N), with all the light that the law allows."""
    if code.scaled:
        return signed.unsqueeze(1)
    return torch.stack([light_law(camera.light).fit(each, camera.rails) for each in signed])


def final_masks(
    masks: LearnedMasks, seen: TrainingSet, job: Job, exposure: MaskExposure
) -> FixedMasks:
    """Masks after training, of all pixels: dark where they were not learned."""
    if isinstance(masks, LearnedPattern):
        with torch.no_grad():
            return FixedPattern(masks.pattern, masks.transit)
    light, pixels = job.optics.light, seen.pixels(job.optics.light)
    with torch.no_grad():
        learned = masks().stacked
    rails = learned.new_zeros(*learned.shape[:-1], len(pixels))
    detection = Detection.of(job.optics, seen.data.image_shape)
    rails[..., pixels] = detection.of_pixels(pixels).restore(learned)
    return FixedMasks(exposure.final(rails, light))


def _matrix(seen: TrainingSet, job: Job, seed: int) -> Tensor:
    """Matrix (m, N) that masks are fitted from; of one rail the first lit frames of a design."""
    # Learned masks of two arms that are both read start from these frames, too, and the other arm
    # from what they leave: so they begin where one arm does (0.848 on MNIST's validation images at
    # 1e4 photons and 24 masks; 0.838 from the signed matrix, whose zeros are half light on each
    # arm)
    name, count, camera = job.start_matrix, job.masks, job.optics
    detectors = camera.detector_map(seen.data.image_shape)
    both_arms = job.code.learned and LIGHT_LAWS[camera.light].arms == 2 and camera.readout == "both"
    if job.code.rails == "single" or (camera.rails == "dual" and not both_arms):
        return torch.from_numpy(seen.matrix(name, count, seed, detectors)).float()
    least, most = count_allowed(name, seen.data, detectors)
    for masks in range(min(max(-(-count // 2), least), most), most + 1):
        signed = torch.from_numpy(seen.matrix(name, masks, seed, detectors)).float()
        lit = frames(signed_parts(signed))
        if len(lit) >= count:
            first = lit[:count]
            return 2 * first / peak(first) - 1 if both_arms else first
    raise InputError(f"{count} frames are not allowed for {name}: give at most {len(lit)}")
