"""Epochs of a training, which a user's callback follows and may end.

After each epoch the design, as if the training ended there, classifies the held-out scenes
(`Dataset.hold_out`). This draws from a separate generator, and the generators of the training are
set back, so that a callback changes no bit of it.
"""

import copy
from collections.abc import Callable
from dataclasses import dataclass, field

import numpy as np
import torch
from torch import Tensor

from deepfsi.design.design import Design
from deepfsi.design.networks import Replicas
from deepfsi.exposure.training import CHUNK, ExposureTraining
from deepfsi.training.assembly import designs_of
from deepfsi.training.checkpoint import LoopState
from deepfsi.training.losses import SceneLoss


@dataclass(frozen=True)
class Epoch:
    """One epoch of a training."""

    epoch: int  # from 1
    epochs: int  # number asked for
    # Mean over the scenes of the epoch, under noise and changing weights, without the cost of
    # counts
    loss: float
    lr: float  # learning rate of the classifier in the last step
    design: str  # a control group trains its masks first, as "deepfsi"
    photons: float  # budget of the training; the lowest of a range
    seed: int
    # For held-out scenes under the camera's noise, at the middle budget of a range; None without
    # such scenes. Values have no accuracy
    validation_loss: float | None = None
    validation_accuracy: float | None = None


@dataclass
class EpochWatch:
    """A user's callback in the loops of a training of one design, and the epochs that they took."""

    callback: Callable[[Epoch], bool | None] | None = None
    most: tuple[int, ...] = ()  # largest number of epochs of each loop
    lengths: list[int] = field(default_factory=list)  # epochs of each finished loop
    history: list[Epoch] = field(default_factory=list)  # of the last loop

    def for_fold(self) -> "EpochWatch":
        """Watch of a fold: it takes as many epochs and calls no callback."""
        return EpochWatch(most=tuple(self.lengths) if self.callback else ())


@dataclass
class LoopWatch:
    """Epochs of a loop."""

    watch: EpochWatch
    exposure: ExposureTraining
    state: LoopState
    loss: SceneLoss
    classify: Replicas

    def __post_init__(self) -> None:
        self.watch.history = []
        self.steps = self.state.draws.steps
        self._losses: list[Tensor] = []
        self._lr = 0.0

    @property
    def number(self) -> int:
        """Epochs so far."""
        return self.state.step // self.steps

    def take(self, losses: Tensor) -> None:
        """Note losses of a step."""
        if self.watch.callback is not None:
            # they stay on the device, and are read once an epoch
            self._losses.append(losses.detach().mean())
            self._lr = self.state.optimiser.param_groups[0]["lr"]

    def ends(self) -> bool:
        """Whether the loop ends after this step."""
        if self.state.step % self.steps:
            return False
        if self.watch.callback is None:
            most = self.watch.most
            return bool(most) and self.number == most[len(self.watch.lengths)]
        job = self.exposure.job
        epoch = Epoch(
            epoch=self.number,
            epochs=job.training.epochs,
            loss=float(torch.stack(self._losses).mean()),
            lr=self._lr,
            design=job.design,
            photons=job.photons,
            seed=job.seed,
            **self._validated(),
        )
        self._losses = []
        self.watch.history.append(epoch)
        return bool(self.watch.callback(epoch))

    def _validated(self) -> dict[str, float]:
        """Validation loss and accuracy; nothing without held-out scenes."""
        if not self.exposure.training_set.data.held_out:
            return {}
        before = [generator.get_state() for generator in self.state.generators]
        networks = self.classify.networks
        modes = [(module, module.training) for network in networks for module in network.modules()]
        self.classify.hand_back()
        for network in networks:
            network.eval()
        with torch.no_grad():
            exposure = copy.copy(self.exposure)  # the original goes on learning
            exposure.fix()
            tested = self._tested(*designs_of(exposure, networks))
        for module, mode in modes:
            module.training = mode
        for generator, state in zip(self.state.generators, before, strict=True):
            generator.set_state(state)
        return tested

    def _tested(self, design: Design) -> dict[str, float]:
        """Loss and accuracy of a design in one exposure of each held-out scene."""
        job = self.exposure.job
        training_set = self.exposure.training_set
        device = training_set.device
        photons = (job.photons * job.exposure.highest(job.photons)) ** 0.5
        truth = training_set.truth_of(training_set.data.y_test)
        generator = torch.Generator(device).manual_seed(job.seed)
        losses = []
        right = []
        scenes = torch.from_numpy(np.require(training_set.data.x_test, requirements="W"))
        for x, answers in zip(scenes.split(CHUNK), truth.split(CHUNK), strict=True):
            logits = design.exposures(x, job.camera)(photons, generator)[0].logits
            with torch.enable_grad():  # the check of a user's loss needs a gradient
                losses.append(self.loss(logits.requires_grad_(), answers).detach())
            if design.values is None:
                right.append(logits.argmax(dim=-1) == answers)
        test = {"validation_loss": float(torch.cat(losses).mean())}
        if right:
            test["validation_accuracy"] = float(torch.cat(right).float().mean())
        return test
