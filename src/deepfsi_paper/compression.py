"""Cost in accuracy of a wrong number of masks, and of a wrong budget."""

from collections.abc import Iterable

import numpy as np

from deepfsi.base.intervals import Difference, all_above, mean_of_trials
from deepfsi.report.style import photons_text
from deepfsi.sweeps.results import Point, Results, accuracy_difference
from deepfsi_paper.experiment import NOTHING, Experiment, Finding, budgets, points
from deepfsi_paper.report.maps import accuracy_grid, heat_figure
from deepfsi_paper.report.section import Claim, Picture

ROBUST = 0.02
"""Loss of accuracy above the training budget that still counts as robust."""

PAPER = (
    "Trained at 10⁵ photons, FSI loses tremendously with an improper number of masks, while "
    "truncated Hadamard and DeepFSI tolerate it, and DeepFSI is no worse than FSI overall. At a "
    "fixed number of masks all models "
    "are robust in brighter light than they were trained for, and drop dramatically in dimmer "
    "light."
)


def show(results: Results) -> Finding:
    """Heat maps of three designs, and the falls that the paper speaks of."""
    trained_at = results.points[0].trained_at
    designs = list(dict.fromkeys(point.design for point in results.points))
    titles = {point.design: point.title for point in results.points}
    lights = budgets(results.points)
    ratios = sorted({point.ratio for point in results.points})
    grids = {
        titles[design]: accuracy_grid(points(results, design=design), lights, ratios)
        for design in designs
    }
    falls = {
        design: _falls(points(results, design=design, photons=trained_at)) for design in designs
    }
    fall = {design: f"{np.mean(values):.3f}" for design, values in falls.items()}
    paired = {
        design: mean_of_trials(np.subtract(falls["pca"], falls[design]).tolist())
        for design in ("deepfsi", "truncated-hadamard")
    }
    theirs = {(p.ratio, p.photons): p for p in points(results, design="pca")}
    apart = {
        (p.ratio, p.photons): accuracy_difference(p, theirs[(p.ratio, p.photons)])
        for p in points(results, design="deepfsi")
    }
    planned = {place: each for place, each in apart.items() if place[1] == trained_at}
    least, lowest = (min(own, key=lambda place: apart[place].low) for own in (planned, apart))
    brighter, dimmer = (_changes(results, trained_at, up) for up in (True, False))
    claims = (
        *(
            Claim(
                f"At {photons_text(trained_at)} photons FSI falls by more across ratios than "
                f"{titles[design]}",
                all_above([each]),
                f"FSI falls by {fall['pca']}, {titles[design]} by {fall[design]}: {each}",
            )
            for design, each in paired.items()
        ),
        Claim(
            f"At {photons_text(trained_at)} photons DeepFSI is no worse than FSI at any ratio "
            f"(loses less than {NOTHING})",
            all_above(planned.values(), -NOTHING),
            f"lowest: {apart[least]} at {least[0]:.0%}; at all budgets: {apart[lowest]} at "
            f"{lowest[0]:.0%} and {photons_text(lowest[1])} photons",
        ),
        Claim(
            f"Above the training budget accuracy is robust (loses less than {ROBUST})",
            all_above(brighter.values(), -ROBUST),
            f"lowest change {min(brighter.values(), key=lambda each: each.low)}",
        ),
        Claim(
            "Below the training budget accuracy falls",
            all_above(-each for each in dimmer.values()),
            f"smallest fall {max(dimmer.values(), key=lambda each: each.high)}",
        ),
    )
    said = ", ".join(f"{titles[design]} by {fall[design]}" for design in designs)
    found = (
        f"Trained and tested at {photons_text(trained_at)} photons, accuracy falls from the best "
        f"to the worst of {len(ratios)} ratios: {said}."
    )
    picture = Picture(
        heat_figure(grids, lights, ratios, trained_at),
        "Accuracy by photon budget of the test and compression ratio, one scale for all; the frame "
        "is the training budget.",
        "Heat maps of accuracy for three designs over test budget and compression ratio.",
    )
    return Finding(found, (picture,), claims)


def _falls(at_one_budget: Iterable[Point]) -> list[float]:
    """Best less worst accuracy over ratios, for each trial."""
    values = np.array([point.accuracies for point in at_one_budget])
    falls: list[float] = (values.max(axis=0) - values.min(axis=0)).tolist()
    return falls


def _changes(
    results: Results, trained_at: float, up: bool
) -> dict[tuple[str, float, float], Difference]:
    """Change of accuracy from the training budget to each beyond it, by design and ratio."""
    own = {(p.design, p.ratio): p for p in points(results, photons=trained_at)}
    return {
        (p.design, p.ratio, p.photons): accuracy_difference(p, own[(p.design, p.ratio)])
        for p in results.points
        if p.photons != trained_at and (p.photons > trained_at) == up
    }


EXPERIMENT = Experiment(
    name="compression",
    title="When the number of masks, or the light, is not what was planned",
    paper=PAPER,
    show=show,
)
