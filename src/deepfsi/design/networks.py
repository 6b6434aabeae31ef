"""Networks that read counts: a perceptron, networks side by side, and a user's module.

A user's module maps features (batch, inputs) to logits (batch, C). The user gives the module, a
factory that makes it from the numbers of inputs and classes, or the import path of a factory,
``"module:name"``. A design file holds the weights and this path, never code; `Design.load` imports
it only if the user says so.
"""

import copy
import itertools
import math
from abc import ABC, abstractmethod
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from pkgutil import resolve_name
from typing import Any, ClassVar, Self

import torch
from torch import Tensor, nn

from deepfsi.base.errors import InputError
from deepfsi.base.registry import UNNAMED_PLUGIN, load_plugin
from deepfsi.jobs.training import MLP, Training, find_classifier, part_name


class Classifier(nn.Module, ABC):
    """A classifier that a design file can hold."""

    stackable: ClassVar[bool] = False  # whether several learn faster on a GPU with weights stacked
    generator: torch.Generator | None = None  # of its draws in a training

    @property
    @abstractmethod
    def header(self) -> dict[str, Any]:
        """Entry of the file's header: kind, and parameters except inputs and classes."""

    @property
    @abstractmethod
    def title(self) -> str:
        """Name for people."""

    @property
    def weights(self) -> dict[str, Tensor]:
        """Tensors that the file keeps of it."""
        return self.state_dict()


class Mlp(Classifier):
    """The paper's classifier: fully connected hidden layers, each with dropout, then ReLU.

    Parameters
    ----------
    hidden : sequence of int
        Widths of the hidden layers.
    dropout : float
        Probability, in steps of 2⁻¹⁶.
    generator : torch.Generator, optional
        For the initial weights (uniform in ±1/√inputs, as `nn.Linear`) and for dropout. Default:
        torch's global one.

    Examples
    --------
    >>> classifier = Mlp(inputs=6, classes=10, hidden=(8,), generator=torch.Generator())
    >>> classifier(torch.zeros(5, 6)).shape
    torch.Size([5, 10])
    """

    stackable = True

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
    def of_settings(
        cls, settings: Training, inputs: int, classes: int, parts: int, generator: torch.Generator
    ) -> Self:
        """Untrained classifier of a training, with its inputs from each part of a scene."""
        return cls(inputs, classes, settings.hidden, settings.dropout, generator)

    @property
    def header(self) -> dict[str, Any]:
        """Entry of a design file's header: kind, and parameters except inputs and classes."""
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
        """Draw the factors of hidden units in dropout: 0, or 1 / (1 − dropout)."""
        # torch's own dropout takes no generator, and draws one random word a unit where 16 bits do
        words = torch.empty(-(-h.numel() // 4), dtype=torch.int64, device=h.device)
        words.random_(-(2**63), None, generator=self.generator)
        drawn = words.view(torch.int16)[: h.numel()].view(h.shape)
        kept = drawn >= round(self.dropout * 2**16) - 2**15
        return kept * (1 / (1 - self.dropout))


def find_network(name: str) -> Any:
    """Class of a classifier that settings and design files name; it has `of_settings` of `Mlp`."""
    return Mlp if name == MLP else resolve_name(find_classifier(name).network)


class Replicas(nn.Module):
    """Networks of equal shape that learn side by side, each from its own features."""

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
            # (R, inputs, outputs), as a batched product takes them without a transpose in each step
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
            return torch.stack([network(inputs) for network, inputs in pairs], dim=1)
        h = features.transpose(0, 1)
        for weight, bias in zip(self.weights[:-1], self.biases[:-1], strict=True):
            h = torch.baddbmm(bias, h, weight)
            if self.networks[0].dropout:
                drawn = zip(self.networks, h, strict=True)
                h = h * torch.stack([network.kept(units) for network, units in drawn])
            h = h.relu()
        return torch.baddbmm(self.biases[-1], h, self.weights[-1]).transpose(0, 1)

    def hand_back(self) -> None:
        """Give the networks what they have learned."""
        with torch.no_grad():
            for layer, (weight, bias) in enumerate(zip(self.weights, self.biases, strict=True)):
                for network, w, b in zip(self.networks, weight, bias, strict=True):
                    to_weight, to_bias = network.layers[layer].parameters()
                    to_weight.copy_(w.T)
                    to_bias.copy_(b[0])


Factory = Callable[..., nn.Module]
"""Makes a module from the numbers of features and classes."""

Given = nn.Module | Factory | str
"""A module, a factory or the import path of one."""


class OwnClassifier(Classifier):
    """A user's module as the classifier of a design.

    Parameters
    ----------
    module : nn.Module or None
        Maps features (batch, inputs) to logits (batch, C). None if a file is loaded without its
        code: the classifier then keeps the weights and answers nothing.
    factory : str
        Import path of the function or class that made it, or "".
    arguments : mapping
        Keyword arguments of the factory besides the numbers, JSON types only.
    weights : mapping of tensor, optional
        State of the module, where it is None.

    Examples
    --------
    >>> import deepfsi, torch
    >>> classifier = deepfsi.OwnClassifier(torch.nn.Linear(6, 10))
    >>> classifier(torch.zeros(2, 6)).shape
    torch.Size([2, 10])
    """

    def __init__(
        self,
        module: nn.Module | None,
        factory: str = "",
        arguments: Mapping[str, Any] | None = None,
        weights: Mapping[str, Tensor] | None = None,
    ) -> None:
        super().__init__()
        self.module = module
        self.factory = factory
        self.arguments = dict(arguments or {})
        self._kept = dict(weights or {})

    @property
    def header(self) -> dict[str, Any]:
        """Entry of a design file's header."""
        return {"kind": "own", "factory": self.factory, "arguments": self.arguments}

    @property
    def weights(self) -> dict[str, Tensor]:
        """State of the module, tensors only."""
        return self._kept if self.module is None else dict(self.module.state_dict())

    @property
    def title(self) -> str:
        """Name of the module's class, or of the factory whose code was not run."""
        return self.factory if self.module is None else type(self.module).__name__

    @property
    def loaded(self) -> nn.Module:
        """The module, or `InputError` where its code was not run."""
        if self.module is None:
            code = self.factory or "a module of its maker"
            raise InputError(
                f"the classifier of this design is {code}, whose code was not run: load it with "
                "`trust` if you trust its file, or give the code to Design.load"
            )
        return self.module

    def forward(self, features: Tensor) -> Tensor:
        """Logits (..., C) of features (..., inputs)."""
        # A user's module may take rows alone
        rows = features if features.ndim == 2 else features.reshape(-1, features.shape[-1])
        logits = self.loaded(rows)
        return logits.reshape(*features.shape[:-1], logits.shape[-1])


def make_custom(
    code: Given, arguments: Mapping[str, Any], inputs: int, classes: int, seed: int = 0
) -> OwnClassifier:
    """Classifier with these numbers of inputs and classes, tried on zeros."""
    factory = load_plugin(code) if isinstance(code, str) else code
    with seeded(seed):
        try:
            if isinstance(factory, nn.Module):
                if arguments:
                    raise TypeError("arguments go with a factory, and it is a module")
                module = copy.deepcopy(factory)
            else:
                module = factory(inputs, classes, **arguments)
            first = next(iter(module.parameters()), torch.empty(0))
            with torch.no_grad():
                tried = module.eval()(torch.zeros(3, inputs, device=first.device))
            if tuple(tried.shape) != (3, classes):
                raise ValueError(f"it makes logits of shape {tuple(tried.shape)} of 3 exposures")
        except (Exception, SystemExit) as error:
            reason = " ".join(str(error).split()) or type(error).__name__
            raise InputError(
                f"the classifier cannot be used: {reason}; give a module "
                f"from (batch, {inputs}) features to (batch, {classes}) logits, or a factory of it"
            ) from error
    name = part_name(code)
    return OwnClassifier(module, "" if name == UNNAMED_PLUGIN else name, arguments)


def with_code(stored: OwnClassifier, code: Given, inputs: int, classes: int) -> OwnClassifier:
    """The classifier of a file, made by the user's code, with the weights of the file."""
    arguments = {} if isinstance(code, nn.Module) else stored.arguments
    network = make_custom(code, arguments, inputs, classes)
    try:
        network.loaded.load_state_dict(stored.weights)
    except (RuntimeError, TypeError) as error:
        reason = " ".join(str(error).split())
        raise InputError(f"the classifier is not the one of this design: {reason}") from None
    return network.eval()


@contextmanager
def seeded(seed: int) -> Iterator[None]:
    """Seed torch's global generators, and put their state back at the end."""
    # A user's module draws its weights and its dropout from these
    with torch.random.fork_rng():
        torch.manual_seed(seed)
        yield
