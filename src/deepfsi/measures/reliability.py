"""Reliability of probabilities: how far the confidence of answers is from their accuracy."""

from collections.abc import Sequence

import numpy as np

BINS = 15
"""Groups of answers of like confidence, all of one size, in which calibration is measured."""


def confidence_groups(
    confidence: np.ndarray, right: np.ndarray
) -> list[tuple[float, float, float]]:
    """Confidence, accuracy and weight of E answers in `BINS` groups, the least sure first."""
    order = np.argsort(confidence, kind="stable")
    return [
        (float(confidence[part].mean()), float(right[part].mean()), len(part) / len(order))
        for part in np.array_split(order, min(BINS, len(order)))
    ]


def calibration_error(groups: Sequence[tuple[float, float, float]]) -> float:
    """Mean distance of confidence and accuracy over groups from `confidence_groups`."""
    return sum(weight * abs(confidence - right) for confidence, right, weight in groups)


def confidence_error(confidence: np.ndarray, right: np.ndarray) -> float:
    """Expected calibration error of E answers, by their confidence and which are right."""
    return calibration_error(confidence_groups(confidence, right))


def chance_error(confidence: np.ndarray, draws: int = 200, seed: int = 0) -> float:
    """Calibration error that exactly calibrated answers of confidence (E,) show, in the mean.

    Groups are finite: each answer is right with the probability that it says, and yet the accuracy
    of a group differs from its confidence.
    """
    rng = np.random.default_rng(seed)
    errors = [
        confidence_error(confidence, rng.random(len(confidence)) < confidence) for _ in range(draws)
    ]
    return float(np.mean(errors))
