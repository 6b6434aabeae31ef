"""Figures of designs that serve many budgets and mask counts, and of exposures that stop early."""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from matplotlib.figure import Figure
from matplotlib.ticker import FuncFormatter, PercentFormatter

from deepfsi.design.stopping import Stopped
from deepfsi.report.lines import Line, draw_lines
from deepfsi.report.style import COLOURS, LINES, photons_text, styled

LOOKS: dict[str, dict[str, Any]] = {
    "flexible": {"color": COLOURS["control"], "marker": "D", "linewidth": 2.0},
    "deepfsi": {"color": COLOURS["deepfsi"], "marker": "o"},
    "looks": {"color": COLOURS["control"], "linestyle": LINES["hadamard"], "linewidth": 1.6},
    "elsewhere": {"color": COLOURS["deepfsi"], "linestyle": (0, (1, 1.5)), "linewidth": 1.0},
    "pca": {"color": COLOURS["pca"], "marker": "o", "linestyle": (0, (5, 1.6))},
    "truncated-hadamard": {
        "color": COLOURS["truncated-hadamard"],
        "marker": "s",
        "linestyle": LINES["truncated-hadamard"],
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

    Three panels: accuracy against mean photons, the share of exposures still going on after
    each part of the masks or looks, and accuracy against the share of answers accepted.

    `plain` is a design for whole exposures, against photons.
    """
    figure = Figure(figsize=(10.5, 3.4), layout="constrained")
    left, middle, right = figure.subplots(1, 3)
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
    draw_lines(left, lines)
    for each in stopped:
        used, accuracy = (
            np.mean([getattr(trial, name).mean for trial in each.trials])
            for name in ("used", "stopped")
        )
        left.plot(used * photons, accuracy, marker="D", color=LOOKS[each.look]["color"])
    left.set_xlabel("mean photons used")
    left.xaxis.set_major_formatter(FuncFormatter(lambda value, _: photons_text(value)))
    left.set_ylabel("accuracy")
    for each in stopped:
        for trial in each.trials:
            after = np.array(trial.rule.after)
            going = 1 - np.cumsum(trial.stops)
            middle.step(after / after[-1], going, where="post", **LOOKS[each.look])
        accepted = [point["accepted"] for point in each.trials[0].rejection]
        values = np.mean([[p["stopped"] for p in t.rejection] for t in each.trials], axis=0)
        right.plot(accepted, values, label=each.name, **LOOKS[each.look])
    middle.xaxis.set_major_formatter(PercentFormatter(1))
    middle.set_xlabel("masks, or looks, that were shown")
    middle.set_ylabel("exposures that go on")
    middle.yaxis.set_major_formatter(PercentFormatter(1))
    middle.set_ylim(bottom=0)
    right.xaxis.set_major_formatter(PercentFormatter(1))
    right.set_xlabel("answers accepted, the surest")
    right.set_ylabel("accuracy of these")
    right.legend(frameon=False, fontsize=8, loc="lower left")
    for ax in (left, middle, right):
        ax.grid(visible=True)
    return figure
