"""Masks that separate two groups of classes, and what the counts behind a mask tell of the class.

Sources: sequential design by expected information (Lindley 1956); 2 √counts is Anscombe's (1948).
"""

import torch
from torch import Tensor


def difference_masks(differ: Tensor, scene: Tensor, areas: Tensor, arms: int = 1) -> Tensor:
    """Masks (..., N) of 0 and 1 with the largest difference over its photon noise.

    Pixels have differences d (..., N) and light μ (..., N). A mask F maximises (Σ F d)² / Σ F μ
    over the pixels (D, N) of each detector; with two arms, the sum of this for F and 1 − F.
    """
    # At the maximum a pixel is ON where d / μ exceeds a threshold: half of Σ F d / Σ F μ, plus
    # with two arms half of this ratio for 1 − F. A few steps find the threshold, or a local maximum
    ratio = differ / scene
    threshold = torch.zeros_like(differ)
    if arms == 2:
        threshold = _ratio(torch.ones_like(differ), differ, scene, areas) @ areas
    for _ in range(4):  # steps by which the threshold is found
        on = (ratio > threshold).to(differ.dtype)
        ratios = _ratio(on, differ, scene, areas)
        if arms == 2:
            ratios = ratios + _ratio(1 - on, differ, scene, areas)
        threshold = (ratios / 2) @ areas
    return (ratio > threshold).to(differ.dtype)


def _ratio(on: Tensor, differ: Tensor, scene: Tensor, areas: Tensor) -> Tensor:
    """Difference over light of the mirrors that are ON, (..., D)."""
    return ((on * differ) @ areas.T) / ((on * scene) @ areas.T).clamp(min=1e-12)


def information(counts: Tensor, members: Tensor, unknown: Tensor | None = None) -> Tensor:
    """Nats (b, P) that counts tell of the class, if 2 √counts are normal within each class.

    Shapes: expected counts (b, P, Q, S) of Q readouts of S scenes; weights (b, S, C) of scenes in
    classes, with the sum 1; `unknown` (b, P, Q, Q), the covariance that scenes near these add.
    """
    # on this scale photon noise has the variance 1
    scale = 2 * (counts + 3 / 8).sqrt()
    weights = members.sum(dim=-1)[:, None, None]  # (b, 1, 1, S)
    scale = scale - (scale * weights).sum(dim=-1, keepdim=True)
    sums = (scale.flatten(1, 2) @ members).unflatten(1, counts.shape[1:3])  # (b, P, Q, C)
    size = members.sum(dim=1)[:, None, None].clamp(min=1e-12)
    between = (sums / size) @ sums.transpose(2, 3)
    total = (scale * weights) @ scale.transpose(2, 3)
    noise = torch.eye(counts.shape[2], dtype=counts.dtype, device=counts.device)
    if unknown is not None:
        noise = noise + unknown
    if counts.shape[2] == 1:  # one readout needs no determinant
        within = (total - between).clamp(min=0) + noise
        return (between / within).log1p()[..., 0, 0] / 2
    return (torch.logdet(total + noise) - torch.logdet(total - between + noise)) / 2


def draw_scenes(weights: Tensor, generator: torch.Generator, count: int) -> tuple[Tensor, Tensor]:
    """Indices (b, S) of scenes drawn by their weights (b, n), and weights (b, S) of the drawn.

    All scenes are taken if there are no more than `count`.
    """
    exposures, scenes = weights.shape
    if scenes <= count:
        return torch.arange(scenes).expand(exposures, -1), weights
    # one random start and equal steps: the sample follows the weights closer than free draws
    start = torch.rand(exposures, 1, generator=generator)
    points = (torch.arange(count) + start) / count
    sums = weights.cumsum(dim=1)
    indices = torch.searchsorted(sums, points * sums[:, -1:])
    return indices, torch.full_like(points, 1 / count)
