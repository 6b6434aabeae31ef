"""Counts that are asked for: of a budget that follows from them, or few within a budget.

A design with the shares p_i counts Φ Σ p_i photons in the mean over training scenes. The shares of
named designs and of one's own matrix are known before any training. Those of learned masks follow
from it, and hardly change with Φ: it is trained at the budget that the shares of its start ask for,
then at the one that its own shares ask for, until these are the same.

Few counts within a budget have a cost in the loss of a training, which is the cross entropy plus
μ max(0, c / C − 1), of the mean counts c of a step and the counts C that are asked for. The cost
grows from 0 over the first third of the training, while masks learn from more light; then its
weight follows the counts, d log μ = κ log(c / C) in a whole training. Masks start with ten times
the counts, but not so bright that nearly all gates click: such readouts teach nothing.
"""

from collections.abc import Callable

import torch
from torch import Tensor

from deepfsi.base import Progress
from deepfsi.design.design import Design
from deepfsi.exposure.statistics import CHUNK
from deepfsi.physics import Detection, LearnedMasks, TrainingNoise, project_rails

NEAR = 0.02
"""Relative difference between the counts asked for and those in the mean that is taken for none."""

MOST_TRAININGS = 6
"""Trainings after which the last design is taken, whatever it counts."""


def train_for_counts(
    counts: float, share: float, train: Callable[[float, Progress], Design], report: Progress
) -> Design:
    """Design that counts a number of photons in the mean over training scenes, to within `NEAR`."""
    # Where that is not reached after `MOST_TRAININGS`, the last one: its own counts are the budget
    # of its training times the sum of its shares
    for number in range(MOST_TRAININGS):
        photons = counts / share
        design = train(photons, report.between(1 - 2.0**-number, 1 - 2.0 ** -(number + 1)))
        share = float(design.shares.sum())
        if abs(photons * share / counts - 1) <= NEAR:
            break
    return design


RAMP = 1 / 3
"""Part of the training after which the counts are to be those asked for."""

FIRST_WEIGHT = 0.4
"""μ before it follows the counts, nats: of what few counts were found to cost, 0.1 to 1."""

PACE = 12.0
"""κ: the counts follow the weight within a tenth of a training or so."""

MOST_EXCESS = 0.3
"""Largest |log(c / C)| that the weight follows, as counts that are far off take time to fall."""

START = 10.0
"""Counts of the start over those asked for, at most."""

CLICKING = 0.9
"""Part of the gates that click at the start, at most."""

HALVINGS = 30
"""Steps of the search for the brightness of the start."""


class CountsCost:
    """Cost of the counts of trainings side by side, step by step."""

    def __init__(self, counts: float, steps: int) -> None:
        self._counts, self._steps, self._step = counts, steps, 0
        self.weight = torch.tensor(FIRST_WEIGHT)

    def restore(self, step: int, weight: Tensor) -> None:
        """Go to a step, at which μ was this."""
        self._step, self.weight = step, weight

    def __call__(self, expected: Tensor) -> Tensor:
        """Cost (R,) of expected counts (R,) of a step, and one step of the weight."""
        ratio, done = expected / self._counts, self._step / (RAMP * self._steps)
        self._step += 1
        if done < 1:
            return done * self.weight * (ratio - 1).clamp(min=0)
        excess = ratio.detach().log().clamp(-MOST_EXCESS, MOST_EXCESS)
        self.weight = self.weight.to(excess) * (PACE / self._steps * excess).exp()
        return self.weight * (ratio - 1).clamp(min=0)


def dim_start(
    masks: LearnedMasks, x: Tensor, noise: TrainingNoise, counts: float, detection: Detection
) -> None:
    """Dim masks before their training, where they would count too much."""
    # x (n + 1, N): centred scenes, and their mean
    scenes = (x[:-1][:CHUNK] + x[-1]).float()

    def counted() -> Tensor:
        return noise.expected(*project_rails(scenes, detection.read_of(masks()), detection.count))

    with torch.no_grad():
        bright, goal = counted(), START * counts
        rails = masks()
        readouts = rails.count * rails.masks * detection.count
        most = float(noise.kind.mean(torch.tensor(torch.inf)))  # of a readout, if it is limited
        goal = max(counts, min(goal, CLICKING * most * readouts))
        low, high = torch.full_like(bright, -20.0), torch.zeros_like(bright)
        whole = {name: each.clone() for name, each in masks.state_dict().items()}
        for _ in range(HALVINGS):
            masks.load_state_dict(whole)
            middle = (low + high) / 2
            masks.dim(middle.exp())
            over = counted() > goal
            low, high = torch.where(over, low, middle), torch.where(over, middle, high)
