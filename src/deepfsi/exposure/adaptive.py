"""Exposures with adaptive masks: their settings, their prior, and their looks."""

from typing import NamedTuple

import torch
from torch import Tensor

from deepfsi.base.numeric import check_memory, free_memory
from deepfsi.datasets import Dataset
from deepfsi.exposure.choice import next_masks
from deepfsi.exposure.posterior import AdaptivePosterior
from deepfsi.exposure.prior import ScenePrior
from deepfsi.jobs import AdaptiveMasks
from deepfsi.physics import Poisson

AT_ONCE = 2**22
"""Log-likelihoods that are held at a time."""

COPIES = 6
"""Arrays as large as the log-likelihoods, or as the scenes of the prior, held at a time."""


class Look(NamedTuple):
    """One look of exposures."""

    masks: Tensor  # (b, N) of 0 and 1
    counts: Tensor  # (b, Q)
    light: Tensor  # (b, Q), counts that are expected without dark ones


def look_at(state: AdaptivePosterior, x: Tensor, share: float, generator: torch.Generator) -> Look:
    """Next look at scenes (b, N) for a share of the exposure, which the state does not know yet."""
    masks = next_masks(state, share, generator)
    expected = state.expected(masks, x, share)
    return Look(masks, Poisson().draw(expected, generator), expected - state.optics.dark * share)


def expose(
    state: AdaptivePosterior, x: Tensor, settings: AdaptiveMasks, generator: torch.Generator
) -> tuple[Tensor, Tensor]:
    """Expose scenes (b, N) look after look until each stops, from the state before all looks.

    Probabilities (b, C) of the classes, and the sum (looks,) of the expected counts of all
    exposures without dark counts.
    """
    chances = torch.empty(len(x), state.prior.classes)
    counts, running = torch.zeros(settings.looks, dtype=torch.double), torch.arange(len(x))
    for look, share in enumerate(settings.shares):
        masks, found, light = look_at(state, x[running], share, generator)
        state.update(masks, found, share)
        counts[look] = light.double().sum()
        last = look == settings.looks - 1
        if settings.until < 1 or last:
            chances[running] = state.chances
            going = chances[running].amax(dim=1) <= settings.until
            if not last and not bool(going.all()):
                state, running = state.part(going), running[going]
        if not len(running):
            break
    return chances, counts


def prior_of(data: Dataset, settings: AdaptiveMasks) -> ScenePrior:
    """Prior of the training scenes of a data set, or `InputError` if it does not fit the memory."""
    scenes = len(data.x_train)
    needed = 4 * (scenes * (3 * data.pixels + settings.components) + COPIES * AT_ONCE)
    check_memory(needed, free_memory(), "the prior of these scenes", "give fewer scenes")
    return ScenePrior(
        data.x_train,
        data.y_train,
        len(data.classes),
        settings.components,
        settings.spread,
        clusters=settings.clusters,
    )
