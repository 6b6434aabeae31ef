"""Answers of exposures at each of their stops, and how sure and how right they are."""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
import torch
from scipy.optimize import minimize_scalar
from scipy.special import log_softmax, logsumexp

from deepfsi.design.artifact import Design
from deepfsi.statistics.intervals import wilson

THRESHOLDS = 1 - np.geomspace(0.5, 1e-7, 135)
"""Confidences that are tried, and 1, which none is above."""

BINS = 15
"""Groups of answers of like confidence, all of one size, in which calibration is measured."""

CHUNK = 1024
"""Scenes that are exposed at once."""


@dataclass(frozen=True)
class Estimate:
    """Mean over images and noise draws with its 95 % interval."""

    mean: float
    low: float
    high: float


def logits_at_stops(
    design: Design,
    x: np.ndarray,
    photons: float,
    draws: int,
    seed: int,
) -> np.ndarray:
    """Logits (K, E, C) of exposures at each of K stops; draws of a scene follow one another.

    Parameters
    ----------
    design : Design
    x : array, shape (n, N)
        Scenes.
    photons : float
        Budget Φ of a whole exposure.
    draws : int
        Noise draws of each scene: E is n times as many.
    seed : int
        Of the noise; that of `evaluation.evaluate`.
    """
    scanner = design.scanner()
    generator = torch.Generator(design.rails.device).manual_seed(seed)
    chunks = []
    with torch.no_grad():
        for rows in torch.arange(len(x)).split(CHUNK):
            rates = design.rates(scanner, torch.from_numpy(x[rows]))
            several = []
            for _ in range(draws):
                seen = design.expose(scanner, rates, generator, photons)
                several.append(torch.stack([design.logits_of(each, photons) for each in seen]))
            chunks.append(torch.stack(several, dim=-2).flatten(-3, -2))
    return torch.cat(chunks, dim=-2).cpu().numpy()


class Answers:
    """Answers of E exposures at K stops, right or wrong, and their confidences.

    Parameters
    ----------
    logits : array, shape (K, E, C)
        From `logits_at_stops`.
    labels : array, shape (n,)
        Classes of the scenes.
    temperatures : sequence of float or of array, shape (E, 1)
        Divisors of the logits at each stop.
    """

    def __init__(self, logits: np.ndarray, labels: np.ndarray, temperatures: Sequence[Any]) -> None:
        draws = logits.shape[1] // len(labels)
        self.images = np.repeat(np.arange(len(labels)), draws)
        labels = labels[self.images]
        true = np.arange(len(labels)), labels
        confidence, raw, right, self.log_loss, self.raw_log_loss = [], [], [], 0.0, 0.0
        for each, temperature in zip(logits, temperatures, strict=True):
            wide = each.astype(float)
            calibrated, plain = (log_softmax(z, axis=1) for z in (wide / temperature, wide))
            confidence.append(np.exp(calibrated.max(axis=1)))
            raw.append(np.exp(plain.max(axis=1)))
            right.append(plain.argmax(axis=1) == labels)
            self.log_loss -= float(calibrated[true].mean()) / len(temperatures)
            self.raw_log_loss -= float(plain[true].mean()) / len(temperatures)
        self.confidence, self.raw_confidence, self.right = (
            np.stack(part, axis=1) for part in (confidence, raw, right)
        )

    def ends(self, threshold: float) -> np.ndarray:
        """Stop (E,), from 0, at which each exposure ends."""
        enough = self.confidence > threshold
        enough[:, -1] = True
        return enough.argmax(axis=1)

    def least_threshold(self, used: np.ndarray) -> float:
        """Threshold of fewest photons whose accuracy is not below that of whole exposures."""
        whole = self.right[:, -1].mean()
        costs = [(used[-1], 1.0)]
        for threshold in THRESHOLDS:
            ends = self.ends(threshold)
            if at(self.right, ends).mean() >= whole:
                costs.append((used[ends].mean(), float(threshold)))
        return min(costs)[1]

    def estimate(self, values: np.ndarray) -> Estimate:
        """Mean of values (E,), normal over the images as the trials; Wilson's if true or false."""
        each = np.bincount(self.images, values) / np.bincount(self.images)
        mean, count = float(each.mean()), len(each)
        if values.dtype == bool:
            return Estimate(mean, *wilson(mean, count))
        half = 1.96 * float(each.std(ddof=1)) / count**0.5
        return Estimate(mean, mean - half, mean + half)


def at(values: np.ndarray, ends: np.ndarray) -> np.ndarray:
    """Entries (E,) of values (E, K) at the stops (E,) at which exposures end."""
    return values[np.arange(len(ends)), ends]


def fit_temperature(logits: np.ndarray, labels: np.ndarray) -> float:
    """Temperature from 1/20 to 20 that gives logits (E, C) of known classes the least log loss."""

    def log_loss(log: float) -> float:
        scaled = logits / np.exp(log)
        true = scaled[np.arange(len(labels)), labels]
        return float((logsumexp(scaled, axis=1) - true).mean())

    found = minimize_scalar(
        log_loss,
        bounds=(-np.log(20), np.log(20)),
        method="bounded",
        options={"xatol": 1e-3},
    )
    return float(np.exp(found.x))


def confidence_groups(
    confidence: np.ndarray, right: np.ndarray
) -> list[tuple[float, float, float]]:
    """Confidence, accuracy and weight of answers in `BINS` groups, the least sure first."""
    order = np.argsort(confidence, kind="stable")
    return [
        (float(confidence[part].mean()), float(right[part].mean()), len(part) / len(order))
        for part in np.array_split(order, min(BINS, len(order)))
    ]


def calibration_error(groups: Sequence[tuple[float, float, float]]) -> float:
    """Mean distance of confidence and accuracy over groups from `confidence_groups`."""
    return sum(weight * abs(confidence - right) for confidence, right, weight in groups)


def accuracy_of_surest(confidence: np.ndarray, right: np.ndarray, share: float) -> float:
    """Accuracy of a share of the answers, the surest."""
    kept = np.argsort(-confidence, kind="stable")[: max(1, round(share * len(confidence)))]
    return float(right[kept].mean())
