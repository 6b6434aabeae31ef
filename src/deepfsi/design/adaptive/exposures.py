"""Exposures with adaptive masks: their settings, their prior, and their looks."""

from typing import NamedTuple

import numpy as np
import torch
from pydantic import Field
from torch import Tensor

from deepfsi.base.arrays import check_memory, free_memory
from deepfsi.base.models import UserModel
from deepfsi.datasets import Dataset
from deepfsi.design.adaptive.choice import next_masks
from deepfsi.design.adaptive.posterior import AdaptivePosterior
from deepfsi.design.adaptive.prior import ScenePrior
from deepfsi.optics.noise import poisson

AT_ONCE = 2**22
"""Log-likelihoods that are held at a time."""

COPIES = 6
"""Arrays as large as the log-likelihoods, or as the scenes of the prior, held at a time."""


class AdaptiveMasks(UserModel):
    """Settings of exposures with adaptive masks.

    Examples
    --------
    >>> from deepfsi.design.adaptive.exposures import AdaptiveMasks
    >>> AdaptiveMasks(looks=3, growth=4).shares
    [0.14285714285714285, 0.2857142857142857, 0.5714285714285714]
    """

    looks: int = Field(
        16, ge=1, le=1024, strict=True, description="masks that are shown one after another"
    )
    growth: float = Field(
        1.0,
        ge=1e-3,
        le=1e3,
        description="share of the exposure that the last look takes, over that of the first",
    )
    until: float = Field(
        1.0,
        gt=0,
        le=1,
        description="probability of a class above which the exposure stops; 1 for never",
    )
    components: int = Field(
        120, ge=1, strict=True, description="principal components of the scenes that are kept"
    )
    spread: float = Field(
        0.7,
        ge=0,
        allow_inf_nan=False,
        description="how far scenes lie from those of the prior, over the distance of neighbours "
        "in it; 0 if they are among them",
    )

    clusters: int | None = Field(
        None,
        ge=1,
        strict=True,
        description="clusters of each class whose centres stand for its scenes; all scenes unless "
        "given",
    )

    @property
    def shares(self) -> list[float]:
        """Share of the exposure that each look takes; their sum is 1."""
        each = self.growth ** np.linspace(0, 1, self.looks)
        return (each / each.sum()).tolist()


class Look(NamedTuple):
    """One look of exposures."""

    masks: Tensor  # (b, N) of 0 and 1
    counts: Tensor  # (b, Q)
    light: Tensor  # (b, Q), counts that are expected without dark ones


def look_at(state: AdaptivePosterior, x: Tensor, share: float, generator: torch.Generator) -> Look:
    """Next look at scenes (b, N) for a share of the exposure, which the state does not know yet."""
    masks = next_masks(state, share, generator)
    expected = state.expected(masks, x, share)
    return Look(masks, poisson(expected, generator), expected - state.optics.dark * share)


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
