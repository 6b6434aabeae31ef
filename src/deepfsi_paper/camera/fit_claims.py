"""Claim, tables and profiles of the fit of the published rates."""

import math

from matplotlib.figure import Figure

from deepfsi.jobs.designs import DESIGNS
from deepfsi.report import style
from deepfsi_paper.camera.rate_fit import LIMIT, Profile, RateFit
from deepfsi_paper.report.section import Claim, Picture, Table

LIKELY = 0.05
"""Share of tables below which the fit does not explain the rates."""

FAR = 2.0
"""Standard deviations from the fit beyond which a rate is named."""

SHOWN = 12.0
"""Highest deviance of the figure."""


def claim(fit: RateFit) -> Claim:
    """Claim that one setting explains all rates."""
    far = [each for each in fit.conditions if abs(each.pull) > FAR]
    named = ", ".join(
        f"{DESIGNS[each.design].label} at {each.exposure_s:g} s ({each.published:.2f}, not "
        f"{each.expected:.2f} ± {each.error:.2f})"
        for each in far
    )
    return Claim(
        f"One setting of the virtual laboratory explains all {len(fit.conditions)} published rates",
        fit.p >= LIKELY,
        f"squared distance {fit.deviance:.1f} where {fit.freedom} are expected, p {fit.p:.3f}; "
        f"{fit.before:.0f} with the laboratory as it is; "
        + (
            f"beyond {FAR:g} standard deviations, given the others: {named}"
            if far
            else f"none beyond {FAR:g} σ"
        ),
    )


def tables(fit: RateFit) -> tuple[Table, Table]:
    """Fitted parameters, and each rate beside its fit."""
    return (
        Table(
            "Settings of the virtual laboratory fitted to the published rates, with 95 % intervals "
            "by the profile of the likelihood",
            ("parameter", "fitted", "low", "high"),
            tuple((each.label, f"{each.best:.3g}", *_ends(each)) for each in fit.profiles),
        ),
        Table(
            f"Published rates and the fit, of {fit.settings} simulated settings: its mean over "
            "pictures, and its expectation given the other rates of the same ten pictures, with "
            "the standard deviation by pictures, exposures, training and emulator",
            ("design", "exposure (s)", "published", "mean", "given the others",
             "standard deviation", "apart", "laboratory as it is"),
            tuple(
                (DESIGNS[each.design].label, each.exposure_s, each.published, each.fitted,
                 each.expected, each.error, each.pull, each.before)
                for each in fit.conditions
            ),
        ),
    )  # fmt: skip


def _ends(profile: Profile) -> tuple[str, str]:
    below, above = profile.bounded
    return (
        f"{profile.low:.3g}" if below else f"below {min(profile.values):.3g}",
        f"{profile.high:.3g}" if above else f"above {max(profile.values):.3g}",
    )


def picture(fit: RateFit) -> Picture:
    """Profiles of all parameters."""
    return Picture(
        profiles_figure(fit),
        "Deviance (twice the log likelihood lost) of each parameter, all others fitted anew. The "
        "dashed line bounds the 95 % interval, which is shaded; the dot is the fit. Of the assumed "
        "budget, whose panel has a scale of its own, only those of the trained designs were tried.",
        "Profiles of the likelihood of five settings of the laboratory; numbers in the table.",
    )


@style.styled
def profiles_figure(fit: RateFit) -> Figure:
    """Deviance of each parameter, a panel each.

    Parameters
    ----------
    fit : RateFit
    """
    count = len(fit.profiles)
    columns = 3
    rows = math.ceil(count / columns)
    figure = Figure(figsize=(style.PAGE_WIDTH, 0.4 + 2.1 * rows), layout="constrained")
    axes = figure.subplots(rows, columns, squeeze=False)
    colour = style.DESIGN_COLOURS["pca"]
    for ax, profile in zip(axes.flat, fit.profiles, strict=False):
        ax.axvspan(profile.low, profile.high, color=colour, alpha=0.12, linewidth=0)
        marks = {"linestyle": "none", "marker": "s", "clip_on": False, "zorder": 3}
        line = marks if profile.levels else {"linewidth": 1.4}
        ax.plot(profile.values, profile.deviance, color=colour, markersize=4, **line)
        ax.axhline(LIMIT, color=style.MUTED, linewidth=0.9, linestyle=(0, (4, 2)))
        ax.plot([profile.best], [0], marker="o", markersize=5, color=colour, clip_on=False)
        if profile.log:
            ax.set_xscale("log")
        ax.set_xlim(min(profile.values), max(profile.values))
        ax.set_ylim(0, 1.1 * max(profile.deviance) if profile.levels else SHOWN)
        ax.set_xlabel(profile.label, fontsize=style.SMALL)
        ax.grid(visible=True, color=style.GRID)
        ax.tick_params(colors=style.MUTED, labelcolor=style.INK)
    for ax in list(axes.flat)[count:]:
        ax.remove()
    figure.supylabel("deviance", fontsize=9)
    return figure
