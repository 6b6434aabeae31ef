"""Confidence: temperatures that make the probabilities of a network agree with its accuracy.

A network is often too confident, and far too confident of counts that it was not trained for: at a
hundredth of its budget each photon is a hundred times as large among its inputs. A temperature τ
divides its logits, which moves no class past another. It is fitted by the log loss of scenes with
known classes and exact counts, over budgets and over the numbers of masks or looks after which an
exposure is classified.
"""

from collections.abc import Sequence
from functools import singledispatch
from typing import Any

import numpy as np
import torch
from scipy.optimize import minimize_scalar

from deepfsi.design.artifact import Design
from deepfsi.design.temperatures import BOUNDS, REACH, Temperatures
from deepfsi.optics.scanner import Scanner

CALIBRATED_STOPS = 8
"""Numbers of masks or looks at which temperatures are fitted, at most."""

CHUNK = 1024
"""Scenes that are exposed at once."""

BINS = 15
"""Groups of answers of like confidence, all of one size, in which calibration is measured."""


def fit_temperatures(
    design: Design,
    scanner: Scanner,
    x: np.ndarray,
    labels: np.ndarray,
    budgets: tuple[float, float],
    *,
    trained_on: bool,
    seed: int,
) -> Temperatures:
    """Temperatures of a design by scenes (n, N) of classes (n,), for a training between budgets.

    A network may be surer of scenes that it was trained on than it is right on others. So by these
    it becomes less sure only, never surer than it is.
    """
    low, high = budgets[0] / REACH, budgets[1] * REACH
    grid = np.geomspace(low, high, 1 + int(np.ceil(2 * np.log10(high / low) - 1e-9)))
    stops = design.exposure.count_stops(design.masks)
    fitted = np.unique(np.rint(np.geomspace(1, stops, CALIBRATED_STOPS)).astype(int)) - 1
    logs = np.array(
        [
            [
                _fit(logits, labels)
                for logits in logits_at_stops(design, scanner, x, budget, 1, seed, fitted.tolist())
            ]
            for budget in grid
        ]
    )
    if trained_on:
        logs = logs.clip(min=0)
    every = [np.interp(np.arange(stops), fitted, column) for column in logs]
    return Temperatures(np.stack(every, axis=1), grid)


@singledispatch
def stops_of(design: Any) -> tuple[tuple[int, ...], np.ndarray]:
    """Masks or looks after which an exposure may stop, and the share of it that each takes."""
    return design.exposure.stops(design.rails, design.light)


@singledispatch
def logits_at_stops(
    design: Any,
    scanner: Any,
    x: np.ndarray,
    photons: float,
    draws: int,
    seed: int,
    places: Sequence[int] | None = None,
) -> np.ndarray:
    """Logits (K, E, C) of exposures at some stops, or all; draws of a scene follow one another."""
    # x (n, N); places from 0
    generator = torch.Generator(design.rails.device).manual_seed(seed)
    chunks = []
    with torch.no_grad():
        for rows in torch.arange(len(x)).split(CHUNK):
            rates = design.rates(scanner, torch.from_numpy(x[rows]))
            several = []
            for _ in range(draws):
                seen = list(design.expose(scanner, rates, generator, photons))
                kept = seen if places is None else [seen[place] for place in places]
                several.append(torch.stack([design.logits_of(each, photons) for each in kept]))
            chunks.append(torch.stack(several, dim=-2).flatten(-3, -2))
    return torch.cat(chunks, dim=-2).cpu().numpy()


def _fit(logits: np.ndarray, labels: np.ndarray) -> float:
    """Log τ that gives logits (E, C) of known classes the least log loss."""
    wide, rows = logits.astype(float), np.arange(len(labels))
    top = wide.max(axis=1, keepdims=True)
    lost = float((top - wide[rows, labels][:, None]).mean())
    wide -= top

    def log_loss(log: float) -> float:
        return lost / np.exp(log) + float(np.log(np.exp(wide / np.exp(log)).sum(axis=1)).mean())

    found = minimize_scalar(log_loss, bounds=BOUNDS, method="bounded", options={"xatol": 1e-2})
    return float(found.x)


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
