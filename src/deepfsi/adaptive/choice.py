"""Choice of the next masks: those whose counts are expected to tell most of the class.

A candidate separates the likeliest classes in two groups: its mirrors are ON where the mean scenes
of the groups differ most for the photon noise that they bring. Of the candidates that one is shown
whose counts tell most, as told by scenes drawn of the posterior: on the scale of 2 √counts, where
photon noise is the same for all, their distribution within a class is taken for normal.

The choice is greedy, a look at a time. Sources: sequential design by expected information (Lindley
1956); 2 √counts is Anscombe's (1948).
"""

from typing import NamedTuple

import torch
from torch import Tensor
from torch.nn import functional

from deepfsi.adaptive.posterior import AdaptivePosterior
from deepfsi.physics.noise import Fluctuation, Poisson

SAMPLES = 128
"""Scenes drawn of the posterior by which masks are compared; all where there are no more."""


def next_masks(state: AdaptivePosterior, share: float, generator: torch.Generator) -> Tensor:
    """Masks (b, N) of 0 and 1 to be shown next, for a share of the exposure."""
    chosen = state.dictionary_masks()
    if chosen is not None:
        return chosen
    masks = candidate_masks(state)
    prior = state.prior
    places, drawn = draw_places(state.weights, generator)
    mean, parts = prior.light(state.optics.readouts(masks))  # (b, P, Q), (b, P, Q, d)
    left = state.unknown(parts)
    scenes = prior.coefficients[places].transpose(1, 2)  # (b, d, S), the same for all masks
    away = (left.flatten(1, 2) @ scenes).unflatten(1, mean.shape[1:])
    light = (mean + state.offset_light(parts))[..., None] + away
    gain = state.gain * share
    dark = torch.as_tensor(state.optics.dark * share)[..., None]
    counts = light.clamp(min=0) * gain + dark
    unknown = left @ parts.transpose(2, 3) if prior.spread else None
    if unknown is not None:
        usual = (counts * drawn[:, None, None]).sum(dim=-1, keepdim=True)
        steps = usual.clamp(min=1e-6).rsqrt()
        scale = steps * gain
        unknown = unknown * scale * scale.transpose(2, 3)
        if state.optics.fluctuation:  # alike for all readouts of a look
            bright = state.optics.fluctuation * (usual - dark) * steps
            unknown = unknown + bright * bright.transpose(2, 3)
    members = functional.one_hot(prior.labels[places], prior.classes) * drawn[..., None]
    best = information(counts, members, unknown).argmax(dim=1)
    return masks[torch.arange(len(masks)), best]


def candidate_masks(state: AdaptivePosterior) -> Tensor:
    """Masks (b, P, N) that separate the likeliest classes in two groups."""
    differ = group_differences(state)
    scene = state.scene.clamp(min=1e-3)[:, None]  # reflectance of the mean scene at least
    areas = state.optics.areas(scene)
    return difference_masks(differ, scene.expand_as(differ), areas, state.optics.arms)


def group_differences(state: AdaptivePosterior) -> Tensor:
    """Differences (b, P, N) of the mean scenes of two groups of the likeliest classes.

    On one arm either group is the brighter one; on two the masks of both are the same.
    """
    chances = state.class_weights
    sums = state.class_sums
    count = min(4, chances.shape[1])  # classes that a mask is to separate at most
    likely, top = chances.topk(count, dim=1)
    own = sums.gather(1, top[..., None].expand(-1, -1, sums.shape[-1]))
    # all ways to part them in two groups: 1 for one of them, the last in neither
    numbers = torch.arange(1, 2 ** (count - 1))
    groups = (numbers[:, None] >> torch.arange(count) & 1).to(sums.dtype)
    means = [
        (group @ own) / (likely @ group.T).clamp(min=1e-9)[..., None]
        for group in (groups, 1 - groups)
    ]
    differ = state.unknown(means[0] - means[1]) @ state.prior.components
    return torch.cat([differ, -differ], dim=1) if state.optics.arms == 1 else differ


def difference_masks(differ: Tensor, scene: Tensor, areas: Tensor, arms: int = 1) -> Tensor:
    """Masks (..., N) of 0 and 1 with the largest difference over its photon noise.

    Of pixels with differences d (..., N) and light μ (..., N) these are those of a mask F that
    maximises, on the pixels (D, N) of each detector, (Σ F d)² / Σ F μ, and the same of 1 − F with
    two arms: d / μ of each is above the mean of what it is of those ON and of those OFF together,
    which is 0 with one arm. Found in steps, it may be a local maximum.
    """
    ratio = differ / scene
    threshold = torch.zeros_like(differ)
    if arms == 2:
        threshold = _ratio(torch.ones_like(differ), differ, scene, areas) @ areas
    for _ in range(4):  # steps by which the threshold is found
        on = (ratio > threshold).to(differ.dtype)
        middle = _ratio(on, differ, scene, areas)
        if arms == 2:
            middle = middle + _ratio(1 - on, differ, scene, areas)
        threshold = (middle / 2) @ areas
    return (ratio > threshold).to(differ.dtype)


def _ratio(on: Tensor, differ: Tensor, scene: Tensor, areas: Tensor) -> Tensor:
    """Difference over light of the mirrors that are ON, (..., D)."""
    return ((on * differ) @ areas.T) / ((on * scene) @ areas.T).clamp(min=1e-12)


def information(counts: Tensor, members: Tensor, unknown: Tensor | None = None) -> Tensor:
    """Nats (b, P) that counts tell of the class, were they normal within each on 2 √counts.

    Expected counts are (b, P, Q, S) of Q readouts of S scenes, whose weights in each class are
    (b, S, C), all of them together 1. What scenes near these add to the covariance of readouts is
    `unknown`, (b, P, Q, Q).
    """
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
    if counts.shape[2] == 1:
        within = (total - between).clamp(min=0) + noise
        return (between / within).log1p()[..., 0, 0] / 2
    return (torch.logdet(total + noise) - torch.logdet(total - between + noise)) / 2


def draw_places(
    weights: Tensor, generator: torch.Generator, count: int = SAMPLES
) -> tuple[Tensor, Tensor]:
    """Places (b, S) of scenes drawn by their weights (b, n), and weights (b, S) of the drawn."""
    exposures, scenes = weights.shape
    if scenes <= count:
        return torch.arange(scenes).expand(exposures, -1), weights
    start = torch.rand(exposures, 1, generator=generator)
    points = (torch.arange(count) + start) / count
    sums = weights.cumsum(dim=1)
    places = torch.searchsorted(sums, points * sums[:, -1:])
    return places.clamp(max=scenes - 1), torch.full_like(points, 1 / count)


class Look(NamedTuple):
    """One look of exposures."""

    masks: Tensor  # (b, N) of 0 and 1
    counts: Tensor  # (b, Q)
    light: Tensor  # (b, Q), counts that are expected without dark ones


def look_at(state: AdaptivePosterior, x: Tensor, share: float, generator: torch.Generator) -> Look:
    """Next look at scenes (b, N) for a share of the exposure, which the state does not know yet."""
    masks = next_masks(state, share, generator)
    expected = state.expected(masks, x, share)
    dark = state.optics.dark * share
    light = expected - dark
    if state.optics.fluctuation:
        noise = Fluctuation(Poisson(), state.optics.fluctuation)
        expected = light * noise.brightness(light[:, :1], generator) + dark
    return Look(masks, Poisson().draw(expected, generator), light)
