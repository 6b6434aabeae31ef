"""What a classifier is told besides counts: the budget, and how many of the masks were shown.

A design for a range of budgets, or one whose first masks do by themselves, must know which of these
it has before it. So its classifier has two inputs more: the logarithm of the budget, mapped from
the range to -1 .. 1, and the share of masks shown. Features of masks not shown are 0.

The first k masks, brought to what the whole sequence takes of the light constraint, see a scene as
they do within the sequence at a budget that is larger by the inverse of their share of it,
`used` (`constraints.used`). So one number stands for both, the *told* budget Φ / used.
"""

import math
from dataclasses import dataclass

import torch
from torch import Tensor
from torch.nn import functional

WHOLE = 0.25
"""Share of the exposures of nested masks in training that show all of them."""


@dataclass(frozen=True)
class Conditioning:
    """What the classifier of a design has learned to be told.

    Attributes
    ----------
    photons : float
        Lowest budget of its training.
    span : float
        Highest over lowest.
    masks : int
        m, of the whole sequence.
    """

    photons: float
    span: float
    masks: int

    def inputs(self, scaled: Tensor, ratio: Tensor, shown: Tensor) -> Tensor:
        """Inputs of the classifier.

        Parameters
        ----------
        scaled : tensor, shape (..., k)
            Standardised features of the first k masks.
        ratio : tensor, broadcastable to (..., 1)
            Told budget over `photons`.
        shown : tensor, broadcastable to (..., 1)
            Masks shown, at most k.

        Returns
        -------
        tensor, shape (..., m + 2)
            Features beyond those shown are 0, whatever they were.
        """
        seen = torch.where(first(scaled.shape[-1], shown), scaled, 0.0)
        seen = functional.pad(seen, (0, self.masks - scaled.shape[-1]))
        half = max(math.log(self.span) / 2, 1.0)
        level = (torch.log(ratio) - math.log(self.span) / 2) / half
        column = seen[..., :1]
        share = shown / self.masks
        return torch.cat([seen, level.expand_as(column), share.expand_as(column)], dim=-1)


def first(masks: int, shown: Tensor) -> Tensor:
    """Which masks (..., m) are among the first `shown` (..., 1)."""
    return torch.arange(masks, device=shown.device) < shown


def chances(masks: int, fewest: int) -> Tensor:
    """Chance of each number of masks 1 .. m to be shown in training, shape (m,).

    Inverse to the number from the fewest on, so that few masks, which do worst, learn as much as
    many, but for the share `WHOLE` of exposures that show all: else the last masks would hardly
    learn. The whole sequence alone if `fewest` is 0.
    """
    count = torch.arange(1, masks + 1, dtype=torch.float32)
    weight = torch.where(count >= (fewest or masks), 1 / count, 0.0)
    chance = (1 - WHOLE) * weight / weight.sum()
    chance[-1] += WHOLE
    return chance
