"""Neural back ends. Any module from features (..., m) to logits (..., C) can take their place."""

import itertools
import math
from collections.abc import Mapping, Sequence

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
    replicas : int, optional
        Train that many classifiers side by side, all from the same start: features and logits
        then have a leading axis, (replicas, batch, ·).
    generator : torch.Generator, optional
        For the initial weights (uniform in ±1/√inputs, as `nn.Linear`) and for dropout.
    """

    def __init__(
        self,
        inputs: int,
        classes: int,
        hidden: Sequence[int] = (40, 128),
        dropout: float = 0.0,
        replicas: int | None = None,
        generator: torch.Generator | None = None,
    ) -> None:
        super().__init__()
        self.hidden, self.dropout = tuple(hidden), dropout
        self.generator, self.replicas = generator, replicas
        widths = (inputs, *hidden, classes)
        self.weights = nn.ParameterList()
        self.biases = nn.ParameterList()
        for fan_in, fan_out in itertools.pairwise(widths):
            bound = 1 / math.sqrt(fan_in)
            device = generator.device if generator is not None else None
            weight = torch.empty(fan_in, fan_out, device=device)
            bias = torch.empty(fan_out, device=device)
            for parameter in (weight, bias):
                parameter.uniform_(-bound, bound, generator=generator)
            if replicas is not None:
                weight = weight.repeat(replicas, 1, 1)
                bias = bias.repeat(replicas, 1, 1)  # broadcasts over the batch
            self.weights.append(nn.Parameter(weight))
            self.biases.append(nn.Parameter(bias))

    def forward(self, features: Tensor) -> Tensor:
        """Logits ([replicas,] ..., C) of features ([replicas,] ..., m)."""
        h = features
        last = len(self.weights) - 1
        for layer, (weight, bias) in enumerate(zip(self.weights, self.biases, strict=True)):
            h = h @ weight + bias
            if layer < last:
                h = self._drop(h).relu()
        return h

    def _drop(self, h: Tensor) -> Tensor:
        if not self.training or self.dropout == 0:
            return h
        # torch's own dropout takes no generator, and draws one random word a unit where 16 bits do
        shape = h.shape if self.replicas is None else h.shape[1:]
        units = shape.numel()
        words = torch.empty(-(-units // 4), dtype=torch.int64, device=h.device)
        words.random_(-(2**63), None, generator=self.generator)
        drawn = words.view(torch.int16)[:units].view(shape)
        kept = drawn >= round(self.dropout * 2**16) - 2**15
        return h * (kept * (1 / (1 - self.dropout)))

    def replica(self, index: int) -> "Mlp":
        """The classifier at `index` of the replica axis, on its own, ready for inference."""
        inputs, classes = self.weights[0].shape[-2], self.weights[-1].shape[-1]
        state = {
            key: value[index, 0] if key.startswith("biases") else value[index]
            for key, value in self.state_dict().items()
        }
        return Mlp.restored(state, inputs, classes, self.hidden, self.dropout)

    @classmethod
    def restored(
        cls,
        state: Mapping[str, Tensor],
        inputs: int,
        classes: int,
        hidden: Sequence[int],
        dropout: float,
    ) -> "Mlp":
        """A classifier with given weights, ready for inference."""
        with torch.device("meta"):
            single = cls(inputs, classes, hidden, dropout)
        single.load_state_dict(state, assign=True)
        return single.eval()
