"""Temperatures: what divides the logits of a design, by budget and by masks or looks so far.

Between the budgets and stops of a calibration log τ is interpolated; below the lowest budget τ
grows as 1 / Φ, as the inputs do, and above the highest it stays.
"""

from dataclasses import dataclass

import numpy as np
import torch
from torch import Tensor

from deepfsi.camera.light import TOO_DIM

REACH = 100.0
"""Highest budget of a calibration over the highest of the training; lowest over lowest inverse."""

BOUNDS = (-3.0, 15.0)
"""Least and largest log τ."""

SLACK = 1e-6
"""What rounding may add to them."""


def calibration_budgets(low: float, high: float) -> np.ndarray:
    """Budgets (B,), two a decade, that calibrate a design of a training from low to high."""
    low, high = low / REACH, high * REACH
    return np.geomspace(low, high, 1 + int(np.ceil(2 * np.log10(high / low) - 1e-9)))


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
        if not (BOUNDS[0] - SLACK <= logs.min() and logs.max() <= BOUNDS[1] + SLACK):
            raise ValueError("temperatures are beyond all that are fitted")
        ratios = np.diff(np.log(budgets))
        if not ratios.min() > 0 or not np.allclose(ratios, ratios[0], rtol=1e-3):
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
