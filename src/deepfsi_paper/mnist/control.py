"""The control group over the read noise that its masks were learned under."""

import math

from deepfsi.base.intervals import Difference, accuracy_difference, all_above
from deepfsi.report.style import DESIGN_COLOURS, photons_text
from deepfsi.sweeps.results import Point, Results
from deepfsi_paper.experiment import Experiment, Finding, points
from deepfsi_paper.report.lines import Line, lines_figure
from deepfsi_paper.report.section import Claim, Picture, Table

PAPER = (
    "The control group, masks that were learned under read noise (AGN) with a classifier for "
    "photon noise (PN), is below DeepFSI. The paper does not say at which read noise its masks "
    "were learned."
)

SHADES = ("#cc79a7", "#0072b2", "#009e73", "#e69f00", "#56b4e9", "#7a838d")
"""Colours of budgets."""


def _relative(point: Point) -> float:
    """Read noise σ of the masks over √(Φ / N), at which impulse imaging errs as under PN."""
    sigma = float(point.variant.removeprefix("sigma "))
    return float(f"{sigma / math.sqrt(point.photons * point.ratio / point.masks):.2g}")


def show(results: Results) -> Finding:
    """DeepFSI less the control group, by budget and read noise."""
    learned = {p.photons: p for p in points(results, best=True, design="deepfsi")}
    control = {(_relative(p), p.photons): p for p in points(results, best=True, design="control")}
    lead = {
        place: accuracy_difference(learned[place[1]], point) for place, point in control.items()
    }
    noises = sorted({noise for noise, _ in control})
    claims = tuple(_claim(noise, lead) for noise in noises)
    nearest = {
        photons: min((place for place in lead if place[1] == photons), key=lambda p: lead[p].mean)
        for photons in sorted(learned)
    }
    found = (
        "DeepFSI leads the control group with the read noise that suits it best by "
        + "; ".join(
            f"{lead[place]} at {photons_text(photons)} photons (σ {place[0]:g} √(Φ / N))"
            for photons, place in nearest.items()
        )
    )
    table = Table(
        "Accuracy at the chosen number of masks, DeepFSI's less the control group's; σ in counts",
        ("photons", "σ", "σ / √(Φ/N)", "masks", "control group", "DeepFSI", "difference", "low",
         "high"),
        tuple(
            (photons, float(point.variant.removeprefix("sigma ")), noise, point.masks,
             point.accuracy, learned[photons].accuracy, *_numbers(lead[(noise, photons)]))
            for (noise, photons), point in sorted(control.items(), key=lambda item: item[0][::-1])
        ),
    )  # fmt: skip
    return Finding(f"{found}.", (_picture(lead, sorted(learned)),), claims, (table,))


def _numbers(each: Difference) -> tuple[float, float | None, float | None]:
    ends = each.interval() if math.isfinite(each.error) else (None, None)
    return each.mean, *ends


def _claim(noise: float, lead: dict[tuple[float, float], Difference]) -> Claim:
    own = {photons: each for (other, photons), each in lead.items() if other == noise}
    least = min(own, key=lambda photons: own[photons].low)
    said = "σ = √(Φ / N)" if noise == 1 else f"σ = {noise:g} √(Φ / N)"
    return Claim(
        f"PN: the control group with {said} is below DeepFSI in the dimmer half",
        all_above(own.values()),
        f"lowest: {own[least]} at {photons_text(least)} photons",
    )


def _picture(lead: dict[tuple[float, float], Difference], budgets: list[float]) -> Picture:
    lines = []
    for colour, photons in zip(SHADES, budgets, strict=False):
        own = sorted((noise, each) for (noise, other), each in lead.items() if other == photons)
        across, every = [noise for noise, _ in own], [each for _, each in own]
        whole = all(math.isfinite(each.error) for each in every)
        lines.append(
            Line(
                f"{photons_text(photons)} photons",
                {"color": colour, "marker": "o", "markersize": 4, "linewidth": 1.4},
                across,
                [each.mean for each in every],
                [each.low for each in every] if whole else (),
                [each.high for each in every] if whole else (),
            )
        )
    figure = lines_figure(
        {"read noise of the masks, σ / √(Φ / N)": lines},
        "accuracy: DeepFSI less control group",
        across=lambda value: f"{value:g}",
    )
    figure.axes[0].axhline(0, color=DESIGN_COLOURS["raster"], linewidth=0.8)
    return Picture(
        figure,
        "DeepFSI's lead over the control group against the read noise under which the group's "
        "masks were learned; at 1 both noises give impulse imaging the same error. Bars: 95 % "
        "intervals.",
        "Lead of DeepFSI by read noise, a line for each budget; numbers in the table.",
    )


EXPERIMENT = Experiment(
    name="control",
    title="The control group, by the read noise of its masks",
    paper=PAPER,
    show=show,
)
