"""Losses of a training.

A loss takes outputs (n, C) of a network and the truth, classes (n,) or standardised values (n, q),
and gives a number for each scene, (n,): cross entropy of classes, mean squared error of values, or
a user's function.

If the user limits the counts to C, a cost μ max(0, c / C − 1) joins the loss, where c are the mean
counts of a step. It grows from 0 over the first third of the training, while masks learn from more
light. Then its weight follows the counts: d log μ = κ log(c / C) over a whole training. Masks start
at `Training.start_counts` times C, but dim enough that not nearly all gates click: such readouts
teach nothing.
"""

from collections.abc import Callable
from typing import Any

import torch
from torch import Tensor
from torch.nn import functional

from deepfsi.base.errors import InputError
from deepfsi.base.registry import load_plugin
from deepfsi.exposure.training_set import TrainingSet
from deepfsi.jobs.training import Training

SceneLoss = Callable[[Tensor, Tensor], Tensor]
"""Loss (n,) of outputs (n, C) and truth (n,) or (n, q)."""


def find_loss(settings: Training, training_set: TrainingSet, rows: bool) -> SceneLoss:
    """Loss of a training; `rows` selects the layout of `_cross_entropy`."""
    custom = settings.loss
    if custom is not None:
        return _checked(load_plugin(custom) if isinstance(custom, str) else custom)
    if training_set.values is not None:
        return squared_error
    weights = training_set.class_weights if settings.balance else None
    return lambda logits, labels: _cross_entropy(logits, labels, weights, rows)


def _cross_entropy(
    logits: Tensor, labels: Tensor, weights: Tensor | None = None, rows: bool = True
) -> Tensor:
    """Cross entropy (n,) of logits (n, C) and classes (n,), with weights (C,) of the classes."""
    # Sums over few classes are many times faster along a leading axis, but round differently
    if rows:
        return functional.cross_entropy(logits, labels, weights, reduction="none")
    by_class = logits.T.contiguous()[None]
    return functional.cross_entropy(by_class, labels[None], weights, reduction="none")[0]


def squared_error(outputs: Tensor, values: Tensor) -> Tensor:
    """Squared error (n,) of outputs and standardised values (n, q), averaged over values."""
    return (outputs - values).square().mean(dim=-1)


class CountsCost:
    """Cost of counts above a limit, for trainings side by side."""

    def __init__(self, counts: float, steps: int) -> None:
        self._counts = counts
        self._steps = steps
        self._step = 0
        self.weight = torch.tensor(0.4)  # μ, nats: few counts were found to cost 0.1 to 1

    def restore(self, step: int, weight: Tensor) -> None:
        """Return to a step and its weight μ."""
        self._step = step
        self.weight = weight

    def __call__(self, expected: Tensor) -> Tensor:
        """Cost (R,) of expected counts (R,) in a step; the weight then takes a step."""
        ratio = expected / self._counts
        done = self._step / (1 / 3 * self._steps)
        self._step += 1
        if done < 1:
            return done * self.weight * (ratio - 1).clamp(min=0)
        excess = ratio.detach().log().clamp(-0.3, 0.3)  # counts far off need time to fall
        # κ = 12: counts follow the weight within about a tenth of a training
        self.weight = self.weight.to(excess) * (12.0 / self._steps * excess).exp()
        return self.weight * (ratio - 1).clamp(min=0)


def _checked(custom: Callable[[Tensor, Tensor], Any]) -> SceneLoss:
    """A user's loss, whose faults become one-line errors."""

    def loss(outputs: Tensor, truth: Tensor) -> Tensor:
        losses = custom(outputs, truth)
        shape = tuple(losses.shape) if isinstance(losses, Tensor) else type(losses).__name__
        if shape != (len(outputs),) or not losses.requires_grad:
            raise InputError(
                f"the loss gives {shape} of {len(outputs)} scenes, or no gradient: give "
                "loss(outputs, truth), a tensor of a number a scene that follows the outputs"
            )
        return losses

    return loss
