"""Two ways to test the same designs, over budgets and compression ratios."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from matplotlib.figure import Figure

from deepfsi.base.numeric.intervals import Difference, accuracy_difference
from deepfsi.report.style import photons_text
from deepfsi.sweeps.results import Point
from deepfsi_paper.experiment import budgets
from deepfsi_paper.report.maps import accuracy_grid, contour_figure


@dataclass(frozen=True)
class Pair:
    """Accuracies (ratios, budgets) of two tests, and their differences by (ratio, budget)."""

    budgets: list[float]
    ratios: list[float]
    first: np.ndarray
    second: np.ndarray
    differences: dict[tuple[float, float], Difference]

    @property
    def largest(self) -> tuple[Difference, str]:
        """The largest difference, and where it is."""
        ratio, budget = max(self.differences, key=lambda place: abs(self.differences[place].mean))
        where = f"{ratio:.0%} and {photons_text(budget)} photons"
        return self.differences[(ratio, budget)], where

    def figure(self, names: tuple[str, str], pixels: int | None = None) -> Figure:
        """Contour maps of both accuracies and of their difference; see `contour_figure`."""
        return contour_figure(
            self.first,
            self.second,
            self.budgets,
            self.ratios,
            names,
            pixels=pixels,
            apart=self.apart,
        )

    @property
    def apart(self) -> np.ndarray:
        """Where (ratios, budgets) the difference is larger than its interval."""
        return np.array(
            [
                [
                    (each := self.differences[(ratio, budget)]).low > 0 or each.high < 0
                    for budget in self.budgets
                ]
                for ratio in self.ratios
            ]
        )


def pair(one: Sequence[Point], other: Sequence[Point]) -> Pair:
    """Two tests at the same ratios and budgets: the second less the first."""
    lights, ratios = budgets(one), sorted({point.ratio for point in one})
    there = {(point.ratio, point.photons): point for point in one}
    return Pair(
        lights,
        ratios,
        accuracy_grid(one, lights, ratios),
        accuracy_grid(other, lights, ratios),
        {
            (point.ratio, point.photons): accuracy_difference(
                point, there[(point.ratio, point.photons)]
            )
            for point in other
        },
    )
