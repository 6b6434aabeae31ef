"""Classifiers of a user's own: any module from features (batch, inputs) to logits (batch, C).

They are given as a module, as a factory that makes one of the number of its inputs and classes, or
as the import path of a factory, ``"module:name"``. A design file holds their weights and that path,
never code; `Design.load` imports it only where the user says so.
"""

import copy
import functools
import inspect
import json
from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager
from typing import Any

import torch
from torch import Tensor, nn

from deepfsi.base.errors import InputError
from deepfsi.base.registry import UNNAMED_PLUGIN, load_plugin
from deepfsi.jobs.training import describe_classifier
from deepfsi.networks.classifiers import Classifier

Factory = Callable[..., nn.Module]
"""Makes a module of the number of features and, if it takes two numbers, that of classes."""

Given = nn.Module | Factory | str
"""A module, a factory or the import path of one."""


class OwnClassifier(Classifier):
    """A user's module as the classifier of a design.

    Parameters
    ----------
    module : nn.Module or None
        From features (batch, inputs) to logits (batch, C). None where a file is loaded without
        saying whose code to run: then it keeps the weights and answers nothing.
    factory : str
        Import path of what made it, or "".
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
        try:
            arguments = json.loads(json.dumps(self.arguments))
        except (TypeError, ValueError):
            raise InputError(
                f"arguments of the classifier cannot be saved: give numbers, words and lists, not "
                f"{self.arguments}"
            ) from None
        return {"kind": "own", "factory": self.factory, "arguments": arguments}

    @property
    def weights(self) -> dict[str, Tensor]:
        """State of the module, tensors only."""
        state = self._kept if self.module is None else self.module.state_dict()
        if not all(isinstance(value, Tensor) for value in state.values()):
            raise InputError("the classifier's state_dict() holds other things than tensors")
        return dict(state)

    @property
    def title(self) -> str:
        """Name of the module's class, or of the factory whose code was not run."""
        return self.factory if self.module is None else type(self.module).__name__

    def forward(self, features: Tensor) -> Tensor:
        """Logits (..., C) of features (..., inputs)."""
        if self.module is None:
            code = self.factory or "a module of its maker"
            raise InputError(
                f"the classifier of this design is {code}, whose code was not run: load it with "
                "`trust` if you trust its file, or give the code to Design.load"
            )
        rows = features if features.ndim == 2 else features.reshape(-1, features.shape[-1])
        try:
            logits = self.module(rows)
        except (Exception, SystemExit) as error:
            if torch.compiler.is_exporting() or isinstance(error, torch.OutOfMemoryError):
                raise  # who exports, or trains side by side, knows what to do
            told = " ".join(str(error).split()) or type(error).__name__
            raise InputError(
                f"the classifier {self.title} fails at features of shape {tuple(rows.shape)}: "
                f"{told}; mend it, so that it takes any number of rows"
            ) from error
        return logits.reshape(*features.shape[:-1], logits.shape[-1])


def make_custom(
    given: Given, arguments: Mapping[str, Any], inputs: int, classes: int, seed: int = 0
) -> OwnClassifier:
    """Classifier for so many inputs and classes, tried on zeros."""
    name, every = describe_classifier(given, arguments)
    factory = given.func if isinstance(given, functools.partial) else given
    factory = load_plugin(factory) if isinstance(factory, str) else factory
    with seeded(seed):
        try:
            if isinstance(factory, nn.Module):
                module = copy.deepcopy(factory)
            else:
                module = _called(factory, every, inputs, classes)
            if not isinstance(module, nn.Module):
                raise TypeError(f"{type(module).__name__} is no torch.nn.Module")
            _try(module, inputs, classes)
        except InputError:
            raise
        except (Exception, SystemExit) as error:
            told = " ".join(str(error).split())
            raise InputError(
                f"the classifier cannot be used: {told or type(error).__name__}; give a module "
                f"from (batch, {inputs}) features to (batch, {classes}) logits, or a factory of it"
            ) from error
    return OwnClassifier(module, "" if name == UNNAMED_PLUGIN else name, every)


def _try(module: nn.Module, inputs: int, classes: int) -> None:
    """Raise an error unless a module makes logits of zeros."""
    first = next(iter(module.parameters()), torch.empty(0))
    zeros = torch.zeros(3, inputs, device=first.device)
    with torch.no_grad():
        shape = tuple(module.eval()(zeros).shape)
    if shape != (3, classes):
        raise InputError(
            f"the classifier makes logits of shape {shape} of features of shape (3, {inputs}): "
            f"give one that makes (3, {classes})"
        )


def _called(factory: Factory, arguments: Mapping[str, Any], inputs: int, classes: int) -> nn.Module:
    """Outcome of a factory that takes both numbers, or the first alone."""
    try:
        inspect.signature(factory).bind(inputs, classes, **arguments)
    except TypeError:
        return factory(inputs, **arguments)
    except ValueError:  # no signature to be had
        pass
    return factory(inputs, classes, **arguments)


@contextmanager
def seeded(seed: int) -> Iterator[None]:
    """Draw from torch's global generators as of a seed; their state is put back at the end."""
    # A module of a user's own draws its weights and its dropout there
    with torch.random.fork_rng():
        torch.manual_seed(seed)
        yield


def rebuilt(
    known: nn.Module, classifier: "Given | None", inputs: int, classes: int
) -> OwnClassifier:
    """Classifier with a user's code and the weights of one that was read from a file."""
    if not isinstance(known, OwnClassifier):
        raise InputError("this design has a classifier of the package's own: give none")
    if not classifier:
        raise InputError(
            "this design does not say where its classifier is imported from: give `classifier`"
        )
    arguments = {} if isinstance(classifier, nn.Module) else known.arguments
    made = make_custom(classifier, arguments, inputs, classes)
    assert made.module is not None
    try:
        made.module.load_state_dict(known.weights)
    except (RuntimeError, TypeError) as error:
        told = " ".join(str(error).split())
        raise InputError(f"the classifier is not the one of this design: {told}") from None
    return made.eval()
