"""Masks learned under read noise and under photon noise, from dim to bright light."""

from collections.abc import Sequence
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

import numpy as np
from pydantic import TypeAdapter

from deepfsi.base.intervals import Difference, all_above, mean_of_trials
from deepfsi.base.progress import Progress
from deepfsi.datasets.dataset import Dataset
from deepfsi.designfile.design_file import DesignFile
from deepfsi.report.style import photons_text
from deepfsi.sweeps.results import Results
from deepfsi_paper.experiment import Experiment, Finding
from deepfsi_paper.measures import (
    effective_directions,
    matched_similarity,
    throughput,
)
from deepfsi_paper.mnist.figures import (
    LearnedMasks,
    Measure,
    masks_table_figure,
    measures_figure,
)
from deepfsi_paper.report.section import Claim, Picture, Table

SHOWN = (1e3, 1e5, 1e8)
LIGHT, SPAN = "light counted", "independent directions"
MATCHED = "likeness, mask by mask"
PANELS = {
    LIGHT: ("light counted", "share of the budget Φ"),
    SPAN: ("independent directions", "effective rank of the masks"),
    MATCHED: ("likeness, mask by mask", "mean |cosine|, 0 to 1"),
}
"""Heading and axis of each measure."""

NOISES, BOTH = ("gaussian", "poisson"), "AGN and PN"

PAPER = (
    "At low budgets the values of AGN's and PN's masks are distributed differently: PN's masks "
    "look at the essential regions, repeat measurements to raise their signal to noise, and use "
    "less light. As photons increase, both converge to similar masks."
)


@dataclass(frozen=True)
class _Measures:
    """Measures of the learned masks, as `masks.json` holds them."""

    measures: Sequence[Measure]
    masks: Sequence[LearnedMasks]  # of the first trial, at the budgets that are shown

    def at(self, name: str, series: str) -> dict[float, Measure]:
        """One measure of some masks, by budget."""
        rows = [row for row in self.measures if (row.measure, row.series) == (name, series)]
        return {row.photons: row for row in rows}


def measure(
    results: Results, data: Dataset, designs: Path, workers: int | None, report: Progress
) -> dict[str, Any]:
    """Measures of the masks of every trial, and the masks of the first for the figure."""
    mean_scene = data.x_train[: results.data.train].mean(axis=0, dtype=np.float64)
    matrices: dict[tuple[str, float], list[np.ndarray]] = {}
    for point in results.points:
        rails = [
            DesignFile.read(designs / f"{key}.safetensors", ("rails",)).rails for key in point.keys
        ]
        matrices[(point.noise, point.photons)] = [pair[0] - pair[1] for pair in rails]
    rows: list[Measure] = []
    for (noise, photons), trials in matrices.items():
        light = [throughput(matrix, mean_scene) for matrix in trials]
        spanned = [effective_directions(matrix) for matrix in trials]
        rows += [_row(LIGHT, noise, photons, light), _row(SPAN, noise, photons, spanned)]
    for photons in sorted({budget for _, budget in matrices}):
        pairs = list(zip(*(matrices[(noise, photons)] for noise in NOISES), strict=True))
        rows.append(_row(MATCHED, BOTH, photons, [matched_similarity(*pair) for pair in pairs]))
    shown = [
        LearnedMasks(
            photons,
            list(data.image_shape),
            *(np.round(matrices[(noise, photons)][0], 6).tolist() for noise in NOISES),
        )
        for photons in SHOWN
        if all((noise, photons) in matrices for noise in NOISES)
    ]
    return asdict(_Measures(rows, shown))


def _row(name: str, series: str, photons: float, values: list[float]) -> Measure:
    low, high = mean_of_trials(values).interval() if len(values) > 1 else (None, None)
    return Measure(name, series, photons, float(np.mean(values)), low, high, values)


def show(results: Results) -> Finding:
    """Masks, their measures and what these say of the paper's claims."""
    measures = TypeAdapter(_Measures).validate_python(results.extra)
    found = _found(measures, results.points[0].masks)
    heads = ("measure", "noise", "photons", "value", "low", "high")
    rows = [
        (row.measure, row.series, row.photons, row.value, row.low, row.high)
        for row in measures.measures
    ]
    table = Table("Measures of the masks", heads, tuple(rows))
    return Finding(found, _pictures(measures), _claims(measures), (table,))


def _claims(measures: _Measures) -> tuple[Claim, ...]:
    budgets = sorted(measures.at(LIGHT, "poisson"))
    dim, bright = budgets[0], budgets[-1]
    starved = [budget for budget in budgets if budget <= 1e3] or [dim]

    def across(name: str) -> dict[float, Difference]:
        gaussian, poisson = (measures.at(name, noise) for noise in NOISES)
        return {budget: _minus(gaussian[budget], poisson[budget]) for budget in starved}

    likeness = measures.at(MATCHED, BOTH)
    spans = [measures.at(SPAN, noise)[dim].value for noise in NOISES]
    repeated = (
        f"At {photons_text(dim)} photons AGN's masks span {spans[0]:.1f} directions, PN's "
        f"{spans[1]:.1f}: AGN's masks repeat themselves. Under read noise every readout has the "
        "same noise however dim it is, so light is concentrated in a few features that are "
        "measured repeatedly. Under photon noise, with light divided freely among readouts, the "
        "masks divide the scene among them."
    )
    grown = _minus(likeness[bright], likeness[dim])
    spanned = "In dim light PN's masks span fewer independent directions than AGN's"
    return (
        _claim("In dim light PN's masks use less light than AGN's", across(LIGHT)),
        _claim(spanned, across(SPAN), repeated),
        Claim(
            "AGN's and PN's masks become alike as light grows",
            all_above([grown]),
            f"likeness mask by mask {likeness[dim].value:.2f} at {photons_text(dim)} and "
            f"{likeness[bright].value:.2f} at {photons_text(bright)} photons: {grown}",
        ),
    )


def _found(measures: _Measures, masks: int) -> str:
    budgets = sorted(measures.at(LIGHT, "poisson"))
    dim, bright = budgets[0], budgets[-1]

    def ends(name: str, noise: str) -> list[float]:
        by_budget = measures.at(name, noise)
        return [by_budget[budget].value for budget in (dim, bright)]

    pn_span, pn_light = ends(SPAN, "poisson"), ends(LIGHT, "poisson")
    agn_light = ends(LIGHT, "gaussian")
    return (
        f"From {photons_text(dim)} to {photons_text(bright)} photons, {masks} masks learned under "
        f"PN span {pn_span[0]:.1f} to {pn_span[1]:.1f} independent directions and count "
        f"{pn_light[0]:.2f} to {pn_light[1]:.2f} of the light; under AGN they count "
        f"{agn_light[0]:.2f} to {agn_light[1]:.2f}. Directions are the effective rank; likeness "
        "pairs each mask with its best partner by |cosine|, whatever their order and sign. Both "
        "start from the same principal components, so that some of what they share is their "
        "start, and the order of scenes. Masks stay dark where no training image varies, so the "
        "share counted is below 1 for all."
    )


def _pictures(measures: _Measures) -> tuple[Picture, ...]:
    drawn = Picture(
        measures_figure(
            measures.measures, PANELS, {BOTH: "masks of read noise and of photon noise"}
        ),
        "Light, independent directions, and likeness of AGN's and PN's masks. Bars: 95 % "
        "intervals.",
        "Measures of the masks against the photon budget; numbers in the table.",
    )
    if not measures.masks:
        return (drawn,)
    shown = Picture(
        masks_table_figure(measures.masks),
        "The six brightest masks under each noise, and the distributions of all values.",
        "Masks learned under AGN and PN at three budgets.",
    )
    return shown, drawn


def _minus(first: Measure, second: Measure) -> Difference:
    """Difference of two measures, trial by trial; of one trial without an interval."""
    return mean_of_trials(np.subtract(first.values, second.values).tolist())


def _claim(text: str, differences: dict[float, Difference], otherwise: str = "") -> Claim:
    said = "; ".join(
        f"AGN − PN {each} at {photons_text(budget)}" for budget, each in differences.items()
    )
    holds = all_above(differences.values())
    return Claim(text, holds, f"{said} photons", "" if holds else otherwise)


EXPERIMENT = Experiment(
    name="masks",
    title="What the masks look like, and what they do with the light",
    paper=PAPER,
    show=show,
    measure=measure,
)
