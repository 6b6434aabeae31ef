"""Epochs of a training, which a user's callback follows and may end.

After each epoch the designs, as if the training ended there, classify the held-out scenes
(`Dataset.hold_out`). This draws from a separate generator, and the generators of the training are
set back, so that a callback changes no bit of it.
"""

import copy
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from typing import Any

import numpy as np
import torch
from torch import Tensor, nn

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
    """A user's callback in the loops of a training, and the epochs that they took."""

    callback: Callable[[Epoch], bool | None] | None = None
    most: tuple[int, ...] = ()  # largest number of epochs of each loop
    lengths: list[int] = field(default_factory=list)  # epochs of each finished loop
    history: list[list[Epoch]] = field(default_factory=list)  # last loop, for each design

    def for_fold(self) -> "EpochWatch":
        """Watch of a fold: it takes as many epochs and tells nobody."""
        return EpochWatch(most=tuple(self.lengths) if self.callback else ())


class LoopWatch:
    """Epochs of a loop that trains R designs side by side."""

    def __init__(
        self,
        watch: EpochWatch,
        exposure: ExposureTraining,
        *,
        state: LoopState,
        loss: SceneLoss,
        networks: Sequence[nn.Module],
    ) -> None:
        self.callback = watch.callback
        self.most = watch.most[len(watch.lengths)] if watch.most else None
        self.exposure = exposure
        self.state = state
        self.loss = loss
        self.networks = networks
        self.steps = state.draws.steps
        self.history: list[list[Epoch]] = [[] for _ in exposure.jobs]
        self._losses: list[Tensor] = []
        self._lr = 0.0
        self._fixed: list[Design] | None = None

    @property
    def number(self) -> int:
        """Epochs so far."""
        return self.state.step // self.steps

    def take(self, losses: Tensor) -> None:
        """Note losses (B · R,) of a step."""
        if self.callback is not None:
            # they stay on the device, and are read once an epoch
            self._losses.append(losses.detach().view(-1, len(self.exposure.jobs)).mean(dim=0))
            self._lr = self.state.optimiser.param_groups[0]["lr"]

    def ends(self) -> bool:
        """Whether the loop ends after this step."""
        if self.state.step % self.steps:
            return False
        if self.callback is None:
            return self.number == self.most
        means = torch.stack(self._losses).mean(dim=0).tolist()
        self._losses = []
        stop = False
        for job, mean, test, history in zip(
            self.exposure.jobs, means, self._validated(), self.history, strict=True
        ):
            epoch = Epoch(
                epoch=self.number,
                epochs=job.training.epochs,
                loss=mean,
                lr=self._lr,
                design=job.design,
                photons=job.photons,
                seed=job.seed,
                **test,
            )
            history.append(epoch)
            stop |= bool(self.callback(epoch))
        return stop

    def _validated(self) -> list[dict[str, float]]:
        """Validation loss and accuracy of each design; none without held-out scenes."""
        if not self.exposure.training_set.data.held_out:
            return [{} for _ in self.exposure.jobs]
        before = [generator.get_state() for generator in self.state.generators]
        modes = [
            (module, module.training) for network in self.networks for module in network.modules()
        ]
        for module in self.state.modules:
            if isinstance(module, Replicas):
                module.hand_back()
        for network in self.networks:
            network.eval()
        with torch.no_grad():
            tests = [
                self._tested(*pair)
                for pair in zip(self.exposure.jobs, self._designs(), strict=True)
            ]
        for module, mode in modes:
            module.training = mode
        for generator, state in zip(self.state.generators, before, strict=True):
            generator.set_state(state)
        return tests

    def _designs(self) -> list[Design]:
        """Designs as if the training ended here."""
        if self._fixed is not None:
            return self._fixed
        exposure = copy.copy(self.exposure)  # the original goes on learning
        exposure.fix()
        designs = designs_of(exposure, self.networks[: len(exposure.jobs)])
        self._fixed = None if exposure.learns else designs
        return designs

    def _tested(self, job: Any, design: Design) -> dict[str, float]:
        """Loss and accuracy of a design in one exposure of each held-out scene."""
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
