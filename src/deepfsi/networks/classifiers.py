"""Neural back ends, what their answers mean, and the temperatures that divide their logits.

Any module from features (..., m) to logits (..., C) can take their place.
"""

import itertools
import math
from abc import ABC, abstractmethod
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from pkgutil import resolve_name
from typing import Any, NamedTuple, Self, TypeVar

import numpy as np
import torch
from torch import Tensor, nn

from deepfsi.base.errors import InputError
from deepfsi.datasets.dataset import Dataset
from deepfsi.designfile.design_file import Temperatures
from deepfsi.jobs.training import MLP, Training, find_classifier


class Classifier(nn.Module, ABC):
    """A classifier that a design file can hold."""

    @property
    @abstractmethod
    def header(self) -> dict[str, Any]:
        """Entry of the file's header: kind, and parameters but inputs and classes."""

    @property
    @abstractmethod
    def title(self) -> str:
        """Name for people."""


class Sizes(NamedTuple):
    """Sizes of a classifier that its data decide."""

    inputs: int  # m, features of a scene, or of each of its parts
    classes: int  # C, outputs
    parts: int  # parts of a scene that are exposed by themselves


class NamedClassifier(Classifier):
    """A classifier of the package, which settings name: as `find_network` finds it."""

    @classmethod
    @abstractmethod
    def of_settings(cls, settings: Training, sizes: Sizes, generator: torch.Generator) -> Self:
        """Untrained classifier of a training."""


class Mlp(NamedClassifier):
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

    Examples
    --------
    >>> classifier = Mlp(inputs=6, classes=10, hidden=(8,), generator=torch.Generator())
    >>> classifier(torch.zeros(5, 6)).shape
    torch.Size([5, 10])
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
        self.hidden = tuple(hidden)
        self.dropout = dropout
        self.generator = generator
        device = torch.get_default_device() if generator is None else generator.device
        self.layers = nn.ModuleList()
        for fan_in, fan_out in itertools.pairwise((inputs, *hidden, classes)):
            layer = nn.utils.skip_init(nn.Linear, fan_in, fan_out, device=device)
            for parameter in layer.parameters():
                bound = 1 / math.sqrt(fan_in)
                nn.init.uniform_(parameter, -bound, bound, generator=generator)
            self.layers.append(layer)

    @classmethod
    def of_settings(cls, settings: Training, sizes: Sizes, generator: torch.Generator) -> Self:
        """Untrained classifier of a training, as `NamedClassifier` says."""
        return cls(sizes.inputs, sizes.classes, settings.hidden, settings.dropout, generator)

    @property
    def arrays(self) -> list[tuple[np.ndarray, np.ndarray]]:
        """Weights (outputs, inputs) and biases (outputs,) of the layers, in their order."""
        layers = (
            [parameter.detach().cpu().numpy() for parameter in each.parameters()]
            for each in self.layers
        )
        return [(weight, bias) for weight, bias in layers]

    @property
    def header(self) -> dict[str, Any]:
        """Entry of a design file's header: kind, and parameters but inputs and classes."""
        return {"kind": "mlp", "hidden": self.hidden, "dropout": self.dropout}

    @property
    def title(self) -> str:
        """Name, and widths of the hidden layers."""
        return "-".join(["mlp", *map(str, self.hidden)])

    def forward(self, features: Tensor) -> Tensor:
        """Logits (..., C) of features (..., m)."""
        *inner, last = self.layers
        h = features
        for layer in inner:
            h = layer(h)
            if self.training and self.dropout:
                h = h * self.kept(h)
            h = h.relu()
        return last(h)

    def kept(self, h: Tensor) -> Tensor:
        """Draw what dropout multiplies hidden units with: 0, or 1 / (1 − dropout)."""
        # torch's own dropout takes no generator, and draws one random word a unit where 16 bits do
        words = torch.empty(-(-h.numel() // 4), dtype=torch.int64, device=h.device)
        words.random_(-(2**63), None, generator=self.generator)
        drawn = words.view(torch.int16)[: h.numel()].view(h.shape)
        kept = drawn >= round(self.dropout * 2**16) - 2**15
        return kept * (1 / (1 - self.dropout))


def find_network(name: str) -> type[NamedClassifier]:
    """Class of a classifier that settings and design files name."""
    return Mlp if name == MLP else resolve_name(find_classifier(name).network)


Network = TypeVar("Network", bound=NamedClassifier)


class Replicas(nn.Module):
    """Networks of one shape that learn side by side, each from its own features."""

    def __init__(
        self, networks: Sequence[nn.Module], stacked: bool, dtype: torch.dtype = torch.float32
    ) -> None:
        super().__init__()
        self.stacked = stacked
        self.dtype = dtype
        self.networks: list[Any] = list(networks)
        self.weights = nn.ParameterList()
        self.biases = nn.ParameterList()
        if not stacked:
            self.registered = nn.ModuleList(networks)
            return
        for layers in zip(*(network.layers for network in networks), strict=True):
            weights, biases = zip(*(layer.parameters() for layer in layers), strict=True)
            self.weights.append(torch.stack([weight.detach().T for weight in weights]))
            self.biases.append(torch.stack([bias.detach()[None] for bias in biases]))

    def forward(self, features: Tensor) -> Tensor:
        """Logits (B, R, C) of features (B, R, m)."""
        if self.dtype == torch.float32:
            return self._logits(features)
        with torch.autocast(features.device.type, self.dtype):
            return self._logits(features).float()

    def _logits(self, features: Tensor) -> Tensor:
        if len(self.networks) == 1 and not self.stacked:
            return self.networks[0](features.squeeze(1)).unsqueeze(1)
        if not self.stacked:
            pairs = zip(self.networks, features.unbind(1), strict=True)
            return torch.stack([network(own) for network, own in pairs], dim=1)
        h = features.transpose(0, 1)
        for weight, bias in zip(self.weights[:-1], self.biases[:-1], strict=True):
            h = torch.baddbmm(bias, h, weight)
            if self.networks[0].dropout:
                drawn = zip(self.networks, h, strict=True)
                h = h * torch.stack([network.kept(own) for network, own in drawn])
            h = h.relu()
        return torch.baddbmm(self.biases[-1], h, self.weights[-1]).transpose(0, 1)

    def hand_back(self) -> None:
        """Give the networks what they have learned."""
        with torch.no_grad():
            for place, (weight, bias) in enumerate(zip(self.weights, self.biases, strict=True)):
                for network, w, b in zip(self.networks, weight, bias, strict=True):
                    own_weight, own_bias = network.layers[place].parameters()
                    own_weight.copy_(w.T)
                    own_bias.copy_(b[0])


def temperatures_at(fitted: Temperatures, place: Tensor | int, photons: Tensor) -> Tensor:
    """Temperatures (..., 1) at places among the stops, from 0, and at budgets (..., 1)."""
    start = np.log(fitted.budgets[0])
    step = np.log(fitted.budgets[1] / fitted.budgets[0])
    level = (photons.log() - start) / step
    logs = torch.from_numpy(fitted.logs).to(level)
    rows = _hats(torch.as_tensor(place).to(level), len(logs)) @ logs
    log = (rows * _hats(level, logs.shape[1])).sum(dim=-1, keepdim=True)
    return (log - level.clamp(max=0) * step).exp()


def stop_temperatures(fitted: Temperatures, photons: float) -> np.ndarray:
    """Temperatures (K,) after each number of masks or looks at a budget."""
    places = torch.arange(len(fitted.logs))
    budget = torch.tensor([photons], dtype=torch.double)
    every = temperatures_at(fitted, places[:, None], budget.expand(len(places), 1))
    return every.squeeze(1).numpy()


def _hats(place: Tensor, count: int) -> Tensor:
    """Weights (..., count) of linear interpolation between equidistant values; ends stay."""
    # place (..., 1) or ()
    away = place.clamp(0, count - 1) - torch.arange(count).to(place)
    return (1 - away.abs()).relu()


def check_classes(values: "Values | tuple[str, ...] | None", what: str) -> None:
    """Raise `InputError` where a design estimates values and `what` is of classes."""
    if values:
        names = values if isinstance(values, tuple) else values.names
        raise InputError(
            f"{what} is of classes, and this design estimates {', '.join(names)}: use "
            "Design.estimate, or `deepfsi evaluate`"
        )


@dataclass(frozen=True, eq=False)
class Values:
    """Names of q values, and their mean and standard deviation in the training, (q,) each."""

    names: tuple[str, ...]
    mean: Tensor  # (q,)
    std: Tensor  # (q,)

    @classmethod
    def of(cls, data: Dataset) -> "Values | None":
        """Those of the training scenes of a data set; None where scenes have classes."""
        if not data.values:
            return None
        y = torch.from_numpy(data.y_train)
        return cls(data.values, y.mean(dim=0), y.std(dim=0, correction=0))

    @classmethod
    def restored(cls, names: tuple[str, ...], tensors: Mapping[str, Tensor]) -> "Values":
        """Values of a design file, or an error where its tensors are not of these names."""
        mean = tensors["mean"]
        std = tensors["std"]
        if not mean.shape == std.shape == (len(names),) or not bool((std > 0).all()):
            raise ValueError("scales are not those of the values")
        return cls(names, mean, std)

    def standardised(self, values: Tensor) -> Tensor:
        """Truth for a network of values (..., q)."""
        return (values - self.mean) / self.std

    def estimated(self, outputs: Tensor) -> Tensor:
        """Values (..., q) of answers of a network, in their own units."""
        return self.mean + self.std * outputs

    def to(self, device: str | torch.device) -> Self:
        """Move to a device."""
        return replace(self, mean=self.mean.to(device), std=self.std.to(device))

    @property
    def tensors(self) -> dict[str, Tensor]:
        """Tensors of a design file."""
        return {"mean": self.mean, "std": self.std}
