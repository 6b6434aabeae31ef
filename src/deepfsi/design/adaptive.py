"""Exposures that look several times: what was counted decides how long each mask is shown next.

One device shows the same masks in every look, each for its own share of the time (`free-dwell`).
In the first look these *dwells* are the same for all scenes; a small network then chooses those of
each further look from the counts so far. Masks that would tell what is already known get hardly
any time. Counts n of a look are Poisson counts given those before it, and its dwells d depend on
these alone, so that the likelihood of a mask's rate r is a constant times r^Σn · e^(−rΣd): sums
over the looks hold all that they say of the scene, and are what both networks are shown.

The classifier learns to answer after every look, so that an exposure may end when it is sure.
"""

from collections.abc import Callable, Iterator
from dataclasses import dataclass

import torch
from torch import Tensor, nn

from deepfsi.design.classifiers import Mlp

REACH = 4.0
"""Bound of the scores whose softmax dwells are: the longest is e⁸ times the shortest at most.

A mask that is never shown is never learned, and the scores would not come back from there.
"""

Read = Callable[[Tensor], tuple[Tensor, Tensor]]
"""From dwells (..., m) to counts (..., m) over the budget, and the dwells really shown."""


@dataclass(frozen=True)
class Exposure:
    """What an exposure of several looks has seen so far.

    Attributes
    ----------
    features : tensor, shape (..., m)
        Counts over the budget, of all looks together.
    dwell : tensor, shape (..., m)
        Share of the whole exposure that each mask had; sums to 1 after the last look.
    """

    features: Tensor
    dwell: Tensor

    def inputs(self, mean: Tensor, std: Tensor) -> Tensor:
        """Inputs (..., 2 m) of the classifier: features and dwells, standardised.

        Parameters
        ----------
        mean, std : tensor, shape (..., m)
            Mean and standard deviation of features whose masks all have the same dwell, 1 / m.
        """
        relative = self.dwell * self.dwell.shape[-1]
        return torch.cat([(self.features - relative * mean) / std, relative / 3], dim=-1)


def expose(
    choose: Callable[[Tensor], Tensor],
    read: Read,
    looks: int,
    mean: Tensor,
    std: Tensor,
) -> Iterator[Exposure]:
    """Take one exposure, or many at once: the same loop in training, in tests and at a camera.

    Parameters
    ----------
    choose : callable
        Network from (..., 2 m + 1), the inputs of the classifier so far and the share of the
        exposure that is left, to scores (..., m): dwells of the next look are their softmax.
    read : callable
        Shows the masks for given shares of the exposure; returns counts over the budget, and the
        shares that it did show.
    looks : int
        K, each 1 / K of the exposure.
    mean, std : tensor, shape (..., m)
        As for `Exposure.inputs`, with the leading axes of the exposures.

    Yields
    ------
    Exposure
        After each look.
    """
    none = torch.zeros_like(mean)
    seen = Exposure(none, none)
    for look in range(looks):
        left = torch.full_like(none[..., :1], 1 - look / looks)
        scores = choose(torch.cat([seen.inputs(mean, std), left], dim=-1))
        dwell = (REACH * torch.tanh(scores / REACH)).softmax(dim=-1) / looks
        counts, shown = read(dwell)
        seen = Exposure(seen.features + counts, seen.dwell + shown)
        yield seen


class AdaptiveDwells(nn.Module):
    """How many looks there are, and the network that chooses dwells.

    Parameters
    ----------
    network : Mlp
        From 2 m + 1 inputs to m outputs.
    looks : int
        K.
    """

    def __init__(self, network: Mlp, looks: int) -> None:
        super().__init__()
        self.network, self.looks = network, looks

    def forward(self, read: Read, mean: Tensor, std: Tensor) -> Iterator[Exposure]:
        """Take exposures, look by look; as `expose`."""
        return expose(self.network, read, self.looks, mean, std)
