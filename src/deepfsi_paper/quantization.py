"""Cost in accuracy of the grey levels of a DMD."""

import numpy as np

from deepfsi.base.intervals import Difference, all_above, mean_of_trials, signed_text
from deepfsi.sweeps.results import Results
from deepfsi_paper.experiment import Experiment, Finding, points
from deepfsi_paper.report.maps import difference_figure, pair
from deepfsi_paper.report.section import Claim, Picture

LOSS = 0.005
"""Mean loss of accuracy that counts as minimal."""

PAPER = (
    "Masks were quantised to the instrument's accuracy of 1/768. The quantisation has minimal "
    "impact on accuracy."
)


def show(results: Results) -> Finding:
    """Heat maps with continuous masks, with quantised ones, and their difference."""
    levels = max(point.levels for point in results.points)
    both = pair(*(points(results, levels=each) for each in (0, levels)))
    loss = _mean_loss(results, levels)
    most, where = both.largest
    claim = Claim(
        f"{levels} grey levels cost less than {LOSS} on average",
        all_above([-loss], -LOSS),
        f"mean loss {loss}; largest change {most} at {where}",
    )
    found = (
        f"With {levels} grey levels, k/{levels - 1} of each frame's peak, accuracy changes by "
        f"{signed_text(-loss.mean, 4)} on average over the grid. The largest change is "
        f"{most}, at {where}."
    )
    picture = Picture(
        difference_figure(both, ("continuous", f"1/{levels - 1} of the peak")),
        "Accuracy by budget and compression ratio, exact photon noise.",
        "Heat maps of accuracy with and without quantised masks, and of their difference.",
    )
    return Finding(found, (picture,), (claim,))


def _mean_loss(results: Results, levels: int) -> Difference:
    """Loss averaged over the grid, for each trial."""
    one, other = (
        np.array([point.accuracies for point in points(results, levels=level)])
        for level in (0, levels)
    )
    values = (one - other).mean(axis=0).tolist()
    return mean_of_trials(values)


EXPERIMENT = Experiment(
    name="quantization", title="Grey levels of a micromirror device", paper=PAPER, show=show
)
