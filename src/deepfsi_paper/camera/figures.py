"""Figure of the camera's accuracy by exposure."""

from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from functools import partial
from operator import attrgetter
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.lines import Line2D
from matplotlib.ticker import FixedLocator, FuncFormatter, NullLocator

from deepfsi.report import style
from deepfsi.report.accuracy import accuracy_axes
from deepfsi_paper.report import scales

BESIDE = 0.028
"""Shift of published values to the right of ours, share of the axis."""


@dataclass(frozen=True)
class Accuracy:
    """Accuracy of a design in the laboratory, with its interval."""

    design: str
    label: str
    title: str
    specific: bool
    exposure_s: float
    accuracy: float
    low: float
    high: float


@style.styled
def exposure_figure(
    points: Iterable[Accuracy],
    published: Iterable[Accuracy] = (),
    *,
    flux: float,
) -> Figure:
    """Accuracy against total exposure: a line for each design, published values open beside it.

    Bars are intervals. Circles are feature-specific designs, squares others.
    """
    own, others = list(points), list(published)
    exposures = sorted({point.exposure_s for point in [*own, *others]})
    figure = Figure(figsize=(5.6, 3.9), layout="constrained")
    ax = figure.subplots()
    accuracy_axes(ax, own, ("design",), attrgetter("exposure_s"), chance=0.1)
    ax.set_xlim(min(exposures) / 1.3, max(exposures) * 1.3)
    _published(ax, own, others, exposures)
    ax.set_xlabel("total exposure (s)")
    ax.xaxis.set_major_locator(FixedLocator(exposures))
    ax.xaxis.set_major_formatter(FuncFormatter(lambda value, _: scales.power_text(value)))
    to_photons, to_seconds = partial(np.multiply, flux), partial(np.multiply, 1 / flux)
    top = ax.secondary_xaxis("top", functions=(to_photons, to_seconds))
    top.set_xlabel("photons Φ of a mean scene on the device")
    top.xaxis.set_major_locator(FixedLocator([exposure * flux for exposure in exposures]))
    top.xaxis.set_minor_locator(NullLocator())
    top.xaxis.set_major_formatter(FuncFormatter(lambda value, _: scales.power_text(value)))
    if others:
        looks: dict[str, Any] = {"color": style.INK, "marker": "o"}
        keys = [
            Line2D([], [], **looks),
            Line2D([], [], **looks, markerfacecolor=style.PAPER, linestyle="none"),
        ]
        words = ["here, with interval", "published, with interval"]
        figure.legend(keys, words, loc="outside lower center", ncols=2, frameon=False, fontsize=8)
    return figure


def _published(
    ax: Axes, own: Sequence[Accuracy], others: Sequence[Accuracy], exposures: Sequence[float]
) -> None:
    """Open markers a little to the right of our own of the same design."""
    order = list(dict.fromkeys(point.design for point in own))
    decades = max(1.0, float(np.log10(exposures[-1] / exposures[0])))
    for point in others:
        shift = BESIDE + 0.008 * (order.index(point.design) - (len(order) - 1) / 2)
        ax.errorbar(
            point.exposure_s * 10 ** (shift * decades),
            point.accuracy,
            yerr=[[point.accuracy - point.low], [point.high - point.accuracy]],
            color=style.DESIGN_COLOURS.get(point.design, style.INK),
            marker="o" if point.specific else "s",
            markerfacecolor=style.PAPER,
            markersize=4.5,
            elinewidth=0.7,
            zorder=2.5,
        )
