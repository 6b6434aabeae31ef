"""Temperatures: what divides the logits of a design, by budget and by looks so far.

Between the budgets and stops of a calibration log τ is interpolated; below the lowest budget τ
grows as 1 / Φ, as the inputs do, and above the highest it stays.
"""

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np

from deepfsi.camera.light import TOO_DIM

CALIBRATION_REACH = 100.0
"""Highest budget of a calibration over the highest of the training; lowest over lowest inverse."""

LOG_BOUNDS = (-3.0, 15.0)
"""Least and largest log τ."""

BOUNDS_SLACK = 1e-6
"""What rounding may add to them."""


def calibration_budgets(low: float, high: float) -> np.ndarray:
    """Budgets that calibrate a design, two a decade."""
    low = low / CALIBRATION_REACH
    high = high * CALIBRATION_REACH
    return np.geomspace(low, high, 1 + int(np.ceil(2 * np.log10(high / low) - 1e-9)))


@dataclass(frozen=True)
class Temperatures:
    """Temperatures of a design over budgets and stops."""

    logs: np.ndarray  # (K, B), log τ after each number of looks, rising, at each budget
    budgets: np.ndarray  # (B,), of whole exposures, rising in equal ratios

    @classmethod
    def restored(cls, arrays: Mapping[str, np.ndarray], stops: int) -> "Temperatures":
        """Temperatures from a design file, or `ValueError` if it holds none of so many stops."""
        logs, budgets = (arrays[name].astype(float) for name in ("logs", "budgets"))
        if logs.shape != (stops, len(budgets)) or len(budgets) < 2 or not budgets.min() > 0:
            raise ValueError("temperatures are not of this design")
        least, most = LOG_BOUNDS
        if not (least - BOUNDS_SLACK <= logs.min() and logs.max() <= most + BOUNDS_SLACK):
            raise ValueError("temperatures are beyond all that are fitted")
        ratios = np.diff(np.log(budgets))
        if not ratios.min() > 0 or not np.allclose(ratios, ratios[0], rtol=1e-3):
            raise ValueError("budgets of temperatures do not rise in equal ratios")
        return cls(logs, budgets)

    @property
    def arrays(self) -> dict[str, np.ndarray]:
        """Fields by name, as a design file takes them."""
        return dict(vars(self))

    @property
    def dimmest(self) -> float:
        """Lowest budget of which a design can say something: a tenth of the training's lowest."""
        return float(self.budgets[0]) * CALIBRATION_REACH / TOO_DIM

    def scaled(self, factor: float) -> "Temperatures":
        """Temperatures where the same counts take so many times the budget."""
        return Temperatures(self.logs, self.budgets * factor)
