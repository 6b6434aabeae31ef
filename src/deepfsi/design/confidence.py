"""Confidence: temperatures that make the probabilities of a network agree with its accuracy.

A network is often too confident, and far too confident of counts that it was not trained for: at a
hundredth of its budget each photon is a hundred times as large among its inputs. A temperature τ
divides its logits, which moves no class past another. It is fitted by the log loss of scenes with
known classes and exact counts, over budgets and over the numbers of masks or looks after which an
exposure is classified. Between them log τ is interpolated; below the lowest budget τ grows as
1 / Φ, as the inputs do, and above the highest it stays.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np
import torch
from scipy.optimize import minimize_scalar
from torch import Tensor

from deepfsi.optics.budget import TOO_DIM
from deepfsi.optics.scanner import Scanner

if TYPE_CHECKING:  # a design holds temperatures
    from deepfsi.design.artifact import Design

REACH = 100.0
"""Highest budget of a calibration over the highest of the training; lowest over lowest inverse."""

CALIBRATED_STOPS = 8
"""Numbers of masks or looks at which temperatures are fitted, at most."""

BOUNDS = (-3.0, 15.0)
"""Least and largest log τ."""

SLACK = 1e-6
"""What rounding may add to them."""

CHUNK = 1024
"""Scenes that are exposed at once."""

BINS = 15
"""Groups of answers of like confidence, all of one size, in which calibration is measured."""


@dataclass(frozen=True)
class Temperatures:
    """Temperatures of a design over budgets and stops."""

    logs: np.ndarray  # (K, B): log τ after each number of masks or looks, rising, at each budget
    budgets: np.ndarray  # (B,): of whole exposures, rising in equal ratios

    @classmethod
    def restored(cls, tensors: dict[str, Tensor], stops: int) -> "Temperatures":
        """Temperatures from a design file, or `ValueError` if it holds none of so many stops."""
        logs, budgets = (tensors[name].double().numpy() for name in ("logs", "budgets"))
        if logs.shape != (stops, len(budgets)) or len(budgets) < 2 or budgets.min() <= 0:
            raise ValueError("temperatures are not of this design")
        if logs.min() < BOUNDS[0] - SLACK or logs.max() > BOUNDS[1] + SLACK:
            raise ValueError("temperatures are beyond all that are fitted")
        ratios = np.diff(np.log(budgets))
        if ratios.min() <= 0 or not np.allclose(ratios, ratios[0], rtol=1e-3):
            raise ValueError("budgets of temperatures do not rise in equal ratios")
        return cls(logs, budgets)

    @property
    def tensors(self) -> dict[str, Tensor]:
        """Fields by name."""
        return {name: torch.from_numpy(part) for name, part in vars(self).items()}

    @property
    def dimmest(self) -> float:
        """Lowest budget of which a design can say something: a tenth of the training's lowest."""
        return float(self.budgets[0]) * REACH / TOO_DIM

    def scaled(self, factor: float, stops: int | None = None) -> "Temperatures":
        """Temperatures where the same counts take so many times the budget, at the first stops."""
        return Temperatures(self.logs[:stops], self.budgets * factor)

    def of_stops(self, photons: float) -> np.ndarray:
        """Temperatures (K,) after each number of masks or looks at a budget."""
        places, budget = torch.arange(len(self.logs)), torch.tensor([photons], dtype=torch.double)
        return self.at(places[:, None], budget.expand(len(places), 1)).squeeze(1).numpy()

    def at(self, place: Tensor | int, photons: Tensor) -> Tensor:
        """Temperatures (..., 1) at places among the stops, from 0, and at budgets (..., 1)."""
        start, step = np.log(self.budgets[0]), np.log(self.budgets[1] / self.budgets[0])
        level = (photons.log() - start) / step
        logs = torch.from_numpy(self.logs).to(level)
        rows = _hats(torch.as_tensor(place).to(level), len(logs)) @ logs
        log = (rows * _hats(level, logs.shape[1])).sum(dim=-1, keepdim=True)
        return (log - level.clamp(max=0) * step).exp()


def _hats(place: Tensor, count: int) -> Tensor:
    """Weights (..., count) of linear interpolation between equidistant values; ends are held."""
    # place (..., 1) or ()
    away = place.clamp(0, count - 1) - torch.arange(count).to(place)
    return (1 - away.abs()).relu()


def fit_temperatures(
    design: "Design",
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


def logits_at_stops(
    design: "Design",
    scanner: Scanner,
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
