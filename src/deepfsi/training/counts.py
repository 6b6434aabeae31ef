"""Budget of photons at which a design counts a given number of them.

A design with the shares p_i counts Φ Σ p_i photons in the mean over training scenes. The shares of
named designs and of one's own matrix are known before any training. Those of learned masks follow
from it, and hardly change with Φ: it is trained at the budget that the shares of its start ask for,
then at the one that its own shares ask for, until these are the same.
"""

from collections.abc import Callable

from deepfsi.base import Progress
from deepfsi.design.adaptive.design import AnyDesign

NEAR = 0.02
"""Relative difference between the counts asked for and those in the mean that is taken for none."""

MOST_TRAININGS = 6
"""Trainings after which the last design is taken, whatever it counts."""


def train_for_counts(
    counts: float, share: float, train: Callable[[float, Progress], AnyDesign], report: Progress
) -> AnyDesign:
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
