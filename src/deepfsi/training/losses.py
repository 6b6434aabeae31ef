"""Losses of a training: what it costs a network to answer as it does.

A loss takes outputs (n, C) of a network and the truth, classes (n,) or standardised values (n, q),
and gives a number for each scene, (n,): cross entropy of classes, the mean squared error of values,
or a function of the user's own.
"""

from collections.abc import Callable
from typing import Any

from torch import Tensor
from torch.nn import functional

from deepfsi.base import InputError, load_plugin

Loss = Callable[[Tensor, Tensor], Tensor]
"""Loss (n,) of outputs (n, C) and truth (n,) or (n, q)."""

EARLY_LOOKS_WEIGHT = 0.2
"""Weight of the loss of the answers before the last look, in their mean; the last has 1."""


def find_loss(own: Any, values: bool, weights: Tensor | None, rows: bool) -> Loss:
    """Loss of a training; weights (C,) are of classes, `rows` as of `cross_entropy`."""
    if own is not None:
        return _checked(load_plugin(own) if isinstance(own, str) else own)
    if values:
        return squared_error
    return lambda logits, labels: cross_entropy(logits, labels, weights, rows)


def cross_entropy(
    logits: Tensor, labels: Tensor, weights: Tensor | None = None, rows: bool = True
) -> Tensor:
    """Cross entropy (n,) of logits (n, C) and classes (n,), with weights (C,) if there are any."""
    # Sums over few classes are many times faster along a leading axis, and rounded otherwise
    if rows:
        return functional.cross_entropy(logits, labels, weights, reduction="none")
    by_class, truth = logits.T.contiguous()[None], labels[None]
    return functional.cross_entropy(by_class, truth, weights, reduction="none")[0]


def squared_error(outputs: Tensor, values: Tensor) -> Tensor:
    """Squared error (n,) of outputs and standardised values (n, q), in the mean over values."""
    return (outputs - values).square().mean(dim=-1)


def total(loss: Loss, outputs: Tensor, truth: Tensor) -> Tensor:
    """Sum of a loss over scenes and replicas: outputs (K · B, R, C) of K answers, truth (B, R).

    Truth of values is (B, R, q). Answers before the last look count `EARLY_LOOKS_WEIGHT`.
    """
    answers = len(outputs) // len(truth)
    wanted = truth.repeat(answers, *[1] * (truth.ndim - 1)).flatten(0, 1)
    *early, last = loss(outputs.flatten(0, 1), wanted).view(answers, -1).sum(dim=1)
    if not early:
        return last
    return last + EARLY_LOOKS_WEIGHT / len(early) * sum(early)


def _checked(own: Callable[[Tensor, Tensor], Any]) -> Loss:
    """A user's own loss, which says in one line what is wrong with what it gives."""

    def loss(outputs: Tensor, truth: Tensor) -> Tensor:
        try:
            found = own(outputs, truth)
        except Exception as error:
            told = " ".join(str(error).split()) or type(error).__name__
            raise InputError(
                f"the loss fails at outputs of shape {tuple(outputs.shape)} and truth of shape "
                f"{tuple(truth.shape)}: {told}; give loss(outputs, truth), a number a scene"
            ) from error
        shape = tuple(found.shape) if isinstance(found, Tensor) else type(found).__name__
        if shape != (len(outputs),) or not found.requires_grad:
            raise InputError(
                f"the loss gives {shape} of {len(outputs)} scenes, or no gradient: give "
                "loss(outputs, truth), a tensor of a number a scene that follows the outputs"
            )
        return found

    return loss
