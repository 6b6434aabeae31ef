"""Figures of designs that serve many budgets and mask counts, and of exposures that stop early."""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.ticker import FuncFormatter, PercentFormatter

from deepfsi.evaluation.stopping import Stopped
from deepfsi.report.style import (
    ACCURACY_AXIS,
    DESIGN_COLOURS,
    DESIGN_LINES,
    INK,
    MUTED,
    SMALL,
    photons_text,
    styled,
)
from deepfsi_paper.report.lines import Line, draw_lines

LOOKS: dict[str, dict[str, Any]] = {
    "flexible": {"color": DESIGN_COLOURS["control"], "marker": "D", "linewidth": 2.0},
    "deepfsi": {"color": DESIGN_COLOURS["deepfsi"], "marker": "o"},
    "plain": {"color": INK, "marker": "o", "linestyle": (0, (5, 1.6))},
    "nested": {"color": DESIGN_COLOURS["deepfsi"]},
    "looks": {"color": DESIGN_COLOURS["pca"], "linestyle": DESIGN_LINES["hadamard"]},
    "elsewhere": {"color": DESIGN_COLOURS["deepfsi"], "linestyle": (0, (1, 1.5)), "linewidth": 1.0},
    "pca": {"color": DESIGN_COLOURS["pca"], "marker": "o", "linestyle": (0, (5, 1.6))},
    "truncated-hadamard": {
        "color": DESIGN_COLOURS["truncated-hadamard"],
        "marker": "s",
        "linestyle": DESIGN_LINES["truncated-hadamard"],
    },
}
"""Lines by what they show; "elsewhere" is a design for one budget, tested at others."""


@dataclass(frozen=True)
class Stops:
    """Exposures of one kind of design that stop early: name in the key, one of `LOOKS`, trials."""

    name: str
    look: str
    trials: Sequence[Stopped]


@styled
def stopping_figure(stopped: Sequence[Stops], plain: Line) -> Figure:
    """Accuracy against photons used, times of stopping, and accuracy under rejection.

    Three panels: accuracy against mean photons, the share of exposures not yet stopped after each
    part of the masks or looks, and accuracy against the share of answers that are kept.

    `plain` is a design for whole exposures, against photons.
    """
    figure = Figure(figsize=(10.5, 3.4), layout="constrained")
    left, middle, right = figure.subplots(1, 3)
    _used_panel(left, stopped, plain)
    _going_panel(middle, stopped)
    _kept_panel(right, stopped)
    for ax in (left, middle, right):
        ax.grid(visible=True)
        ax.legend(frameon=False, fontsize=SMALL)
    return figure


def _used_panel(ax: Axes, stopped: Sequence[Stops], plain: Line) -> None:
    """Draw accuracy against the mean of photons used."""
    lines = [plain]
    for each in stopped:
        photons, curves = each.trials[0].photons, [trial.curve for trial in each.trials]
        used, accuracy = (
            np.mean([[point[name] for point in curve] for curve in curves], axis=0)
            for name in ("used", "accuracy")
        )
        lines.append(
            Line(each.name, LOOKS[each.look], (used * photons).tolist(), accuracy.tolist())
        )
    draw_lines(ax, lines)
    for each in stopped:
        used, accuracy = (
            np.mean([getattr(trial, name).mean for trial in each.trials])
            for name in ("used", "stopped")
        )
        colour = LOOKS[each.look]["color"]
        ax.plot(used * each.trials[0].photons, accuracy, marker="D", color=colour)
    key: dict[str, Any] = {"marker": "D", "color": MUTED, "linestyle": "none"}
    ax.plot([], [], label="threshold chosen on validation data", **key)
    ax.set_title("accuracy and light used")
    ax.set_xlabel("mean photons used")
    ax.xaxis.set_major_formatter(FuncFormatter(lambda value, _: photons_text(value)))
    ax.set_ylabel(ACCURACY_AXIS)


def _going_panel(ax: Axes, stopped: Sequence[Stops]) -> None:
    """Draw the share of exposures not yet stopped, of each trial thin, their mean bold."""
    for each in stopped:
        look = LOOKS[each.look]
        shown = np.array(each.trials[0].rule.after) / each.trials[0].rule.after[-1]
        going = 1 - np.cumsum([trial.stops for trial in each.trials], axis=1)
        for trial in going:
            ax.step(shown, trial, where="post", color=look["color"], linewidth=0.6, alpha=0.6)
        mean = going.mean(axis=0)
        ax.step(shown, mean, where="post", label=each.name, **(look | {"linewidth": 2.2}))
    ax.plot([], [], color=MUTED, linewidth=0.6, label="thin: each trial")
    ax.set_title("when exposures stop")
    ax.set_xlabel("masks, or looks, shown (share of all)")
    ax.set_ylabel("exposures not yet stopped")
    for axis in (ax.xaxis, ax.yaxis):
        axis.set_major_formatter(PercentFormatter(1))
    ax.set_ylim(0, 1.02)


def _kept_panel(ax: Axes, stopped: Sequence[Stops]) -> None:
    """Draw accuracy against the share of answers that are kept, the surest."""
    for each in stopped:
        accepted = [point["accepted"] for point in each.trials[0].rejection]
        values = np.mean([[p["stopped"] for p in t.rejection] for t in each.trials], axis=0)
        ax.plot(accepted, values, label=each.name, **LOOKS[each.look])
    ax.set_title("accuracy of the surest answers")
    ax.xaxis.set_major_formatter(PercentFormatter(1))
    ax.set_xlabel("answers kept, the surest first (share)")
    ax.set_ylabel("accuracy of the answers kept")
