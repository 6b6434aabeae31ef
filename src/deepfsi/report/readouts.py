"""Figure of a classifier of measured readouts: accuracy by split, and of monitors alone."""

from collections.abc import Sequence

from matplotlib.figure import Figure

from deepfsi.base.numeric import Interval
from deepfsi.report.style import COLOURS, GRID, MUTED, PAGE_WIDTH, styled

Row = tuple[str, Interval | None, Interval | None]
"""What was tested on, and the accuracies of the network and of kernel ridge there."""


@styled
def readouts_figure(title: str, rows: Sequence[Row], chance: float) -> Figure:
    """Accuracies with their 95 % intervals, a row for each test, and that of guessing."""
    figure = Figure(figsize=(0.72 * PAGE_WIDTH, 0.5 * len(rows) + 1.3), layout="constrained")
    ax = figure.subplots()
    looks = (("network", COLOURS["deepfsi"], "o", -0.12), ("RBF ridge", COLOURS["pca"], "s", 0.12))
    for column, (name, colour, marker, off) in enumerate(looks, 1):
        for place, row in enumerate(rows):
            found = row[column]
            if not isinstance(found, Interval):
                continue
            ax.errorbar(
                found.mean,
                place + off,
                xerr=[[found.mean - found.low], [found.high - found.mean]],
                fmt=marker,
                color=colour,
                markersize=5,
                capsize=2,
            )
        ax.plot([], [], marker, color=colour, label=name)
    ax.axvline(chance, color=MUTED, linestyle="--", linewidth=0.9, label="guessing")
    ax.set(
        xlim=(0, 1.02),
        ylim=(len(rows) - 0.5, -0.5),
        yticks=range(len(rows)),
        yticklabels=[row[0] for row in rows],
        xlabel="accuracy, 95 % interval",
    )
    ax.set_title(title, loc="left")
    ax.grid(axis="x", color=GRID)
    figure.legend(loc="outside lower center", ncols=3, frameon=False)
    return figure
