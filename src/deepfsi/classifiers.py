"""Neural back ends. Any module from features (..., m) to logits (..., C) can take their place."""

import itertools
import math
from collections.abc import Sequence

import torch
from torch import Tensor, nn


class Mlp(nn.Module):
    """The paper's classifier: fully connected hidden layers, each with dropout, then ReLU.

    Parameters
    ----------
    inputs : int
        m, number of features.
    classes : int
        C.
    hidden : sequence of int
        Widths of the hidden layers.
    dropout : float
        Probability, in steps of 2⁻¹⁶.
    generator : torch.Generator, optional
        For the initial weights (uniform in ±1/√inputs, as `nn.Linear`) and for dropout; torch's
        global one unless given.
    """

    def __init__(
        self,
        inputs: int,
        classes: int,
        hidden: Sequence[int] = (40, 128),
        dropout: float = 0.0,
        generator: torch.Generator | None = None,
    ) -> None:
        super().__init__()
        self.hidden, self.dropout, self.generator = tuple(hidden), dropout, generator
        device = None if generator is None else generator.device
        self.layers = nn.ModuleList()
        for fan_in, fan_out in itertools.pairwise((inputs, *hidden, classes)):
            layer = nn.utils.skip_init(nn.Linear, fan_in, fan_out, device=device)
            for parameter in layer.parameters():
                bound = 1 / math.sqrt(fan_in)
                nn.init.uniform_(parameter, -bound, bound, generator=generator)
            self.layers.append(layer)

    def forward(self, features: Tensor) -> Tensor:
        """Logits (..., C) of features (..., m)."""
        *inner, last = self.layers
        h = features
        for layer in inner:
            h = self._drop(layer(h)).relu()
        return last(h)

    def _drop(self, h: Tensor) -> Tensor:
        if not self.training or self.dropout == 0:
            return h
        # torch's own dropout takes no generator, and draws one random word a unit where 16 bits do
        words = torch.empty(-(-h.numel() // 4), dtype=torch.int64, device=h.device)
        words.random_(-(2**63), None, generator=self.generator)
        drawn = words.view(torch.int16)[: h.numel()].view(h.shape)
        kept = drawn >= round(self.dropout * 2**16) - 2**15
        return h * (kept * (1 / (1 - self.dropout)))
