"""Claims, figures and tables of the camera, beside the numbers that the paper published."""

from dataclasses import dataclass, replace

import numpy as np
from pydantic import TypeAdapter

from deepfsi.base.intervals import Difference, all_above, mean_of_trials
from deepfsi.jobs.designs import DESIGNS
from deepfsi.report.style import photons_text
from deepfsi.sweeps.results import Results
from deepfsi_paper.bootstrap import (
    cluster_bootstrap,
    studentised_bootstrap,
    wilcoxon_signed_rank,
)
from deepfsi_paper.camera.figures import Accuracy, exposure_figure
from deepfsi_paper.camera.laboratory import (
    ASSUMED,
    EXPOSURES,
    FLUX,
    FREE,
    LABELS,
    OURS,
    REPEATS,
    DigitTest,
    Measures,
    measure,
    prepare,
)
from deepfsi_paper.camera.published import (
    PAPER,
    PUBLISHED,
    STUDENTISED,
    WILCOXON,
)
from deepfsi_paper.experiment import Experiment, Finding
from deepfsi_paper.report.section import Claim, Picture, Table

BRIGHT = tuple(exposure for exposure in EXPOSURES if exposure >= 1e-3)
"""Exposures at which DeepFSI is to be first, seconds."""


@dataclass(frozen=True)
class _Comparison:
    """Tests in the laboratory as it is, of designs trained for `ASSUMED`."""

    at: dict[tuple[str, float], DigitTest]  # (design, exposure in s) → test
    labels: dict[str, str]  # of the designs

    @property
    def rivals(self) -> list[str]:
        """Designs with equal dwells other than DeepFSI."""
        return [name for name in self.labels if name not in (OURS, FREE)]

    def lead(self, exposure: float) -> dict[str, Difference]:
        """Accuracy of DeepFSI less that of each rival."""
        return {
            rival: self.at[(OURS, exposure)].less(self.at[(rival, exposure)])
            for rival in self.rivals
        }


def show(results: Results) -> Finding:
    """Figures, claims and tables of the laboratory."""
    measures = TypeAdapter(Measures).validate_python(results.extra)
    compared = _Comparison(
        {(test.design, test.exposure_s): test for test in measures.tests},
        {test.design: test.label for test in measures.tests},
    )
    return Finding(
        _found(compared),
        (_exposure_picture(compared),),
        (_first(compared), _every_digit(compared), _even(compared)),
        (_intervals(compared), _tests(compared)),
    )


def _found(compared: _Comparison) -> str:
    tests = [test for (_, exposure), test in compared.at.items() if exposure == 1e-2]
    order = sorted(tests, key=lambda test: -test.accuracy.mean)
    free = [
        compared.at[(FREE, exposure)].less(compared.at[(OURS, exposure)]) for exposure in EXPOSURES
    ]
    return (
        f"Trained for {photons_text(ASSUMED)} photons and tested over 0.01 s "
        f"({photons_text(FLUX * 1e-2)} photons): "
        + "; ".join(f"{test.label} {test.accuracy.mean:.3f}" for test in order)
        + f". Means over {_trainings_text(order[0])} and {len(order[0].by_draw)} draws of ten "
        f"digits, {REPEATS} exposures each; intervals are Student's over draws, and do not cover "
        f"other trainings. {LABELS[FREE]} (non-negative masks, each with a time of its own) "
        f"differs from {LABELS[OURS]} (signed masks) by {free[0]} at 0.1 s and "
        f"{free[-1]} at 0.0001 s."
    )


def _trainings_text(test: DigitTest) -> str:
    """Number of trained designs behind a test."""
    number = len(test.rates)
    return "one trained design each" if number == 1 else f"{number} trained designs each"


def _first(compared: _Comparison) -> Claim:
    leads = [compared.lead(exposure) for exposure in BRIGHT]
    worst = {
        rival: min((each[rival] for each in leads), key=lambda lead: lead.low)
        for rival in compared.rivals
    }
    nearest = min(worst, key=lambda rival: worst[rival].low)
    return Claim(
        f"{LABELS[OURS]}: first of the equal-dwell designs at every exposure from 0.001 s up",
        all_above(lead for each in leads for lead in each.values()),
        f"nearest: {compared.labels[nearest]}, {worst[nearest]}",
    )


def _every_digit(compared: _Comparison) -> Claim:
    exposure = max(EXPOSURES)
    ours = compared.at[(OURS, exposure)].by_digit
    behind = []
    differences = []
    for rival in compared.rivals:
        theirs = compared.at[(rival, exposure)].by_digit
        for digit, column in enumerate((ours - theirs).T):
            each = mean_of_trials(column.tolist())
            differences.append(each)
            if each.mean <= 0:
                behind.append(f"{digit} ({compared.labels[rival]})")
    least = min(differences, key=lambda each: each.mean)
    said = f"lowest {least}" + (f"; not above in {', '.join(behind)}" if behind else "")
    return Claim(
        f"{LABELS[OURS]}: above every other equal-dwell design in every digit at {exposure:g} s",
        all_above(differences),
        said,
    )


def _even(compared: _Comparison) -> Claim:
    exposure = max(EXPOSURES)
    std = {
        name: np.std(compared.at[(name, exposure)].rates, axis=2, ddof=1).mean(axis=0)
        for name in (OURS, *compared.rivals)
    }
    less = {rival: mean_of_trials((std[rival] - std[OURS]).tolist()) for rival in compared.rivals}
    nearest = min(less, key=lambda rival: less[rival].low)
    return Claim(
        f"{LABELS[OURS]}: varies least between digits at {exposure:g} s",
        all_above(less.values()),
        f"standard deviation over digits lower by {less[nearest]} than "
        f"{compared.labels[nearest]}'s",
    )


def _point(test: DigitTest) -> Accuracy:
    mean = test.accuracy
    return Accuracy(
        test.design,
        test.label,
        LABELS.get(test.design) or DESIGNS[test.design].title,
        test.specific,
        test.exposure_s,
        mean.mean,
        max(mean.low, 0.0),
        min(mean.high, 1.0),
    )


def _exposure_picture(compared: _Comparison) -> Picture:
    points = [_point(test) for test in compared.at.values()]
    published = [
        replace(point, accuracy=mean, low=low, high=high)
        for point in sorted(points, key=lambda point: point.design != OURS)
        if point.design in PUBLISHED
        for mean, low, high in [PUBLISHED[point.design][point.exposure_s]]
    ]
    return Picture(
        exposure_figure(points, published, flux=FLUX),
        "Accuracy of ten digits against exposure; all designs are trained for "
        f"{photons_text(ASSUMED)} photons. Filled: here, mean over trainings and draws with its "
        "95 % interval over draws. Open: published, of one draw, with its interval over the ten "
        "digits, a little to the right of its exposure. Dotted line: chance. Above: photons of a "
        "mean scene on the device in that exposure.",
        "Accuracy against exposure for each design, beside the published values; see tables.",
    )


def _intervals(compared: _Comparison) -> Table:
    rows = []
    for exposure in EXPOSURES:
        for name, label in compared.labels.items():
            test = compared.at[(name, exposure)]
            mean = test.accuracy
            cluster = np.mean([cluster_bootstrap(rates, seed=0) for rates in test.single], axis=0)
            student = np.mean(
                [studentised_bootstrap(rates, seed=0) for rates in test.single], axis=0
            )
            published = PUBLISHED.get(name, {}).get(exposure)
            rows.append(
                (
                    exposure,
                    label,
                    mean.mean,
                    f"{mean.low:.3f} to {mean.high:.3f}",
                    f"{test.by_training.min():.3f} to {test.by_training.max():.3f}",
                    f"{cluster[0]:.3f} to {cluster[1]:.3f}",
                    f"{student[0]:.3f} to {student[1]:.3f}",
                    published[0] if published else None,
                    f"{published[1]:.3f} to {published[2]:.3f}" if published else "",
                    "{:.3f} to {:.3f}".format(*STUDENTISED[name][exposure]) if published else "",
                )
            )
    return Table(
        "Accuracy, mean over trainings and draws, with 95 % intervals: over draws of the digits, "
        "and, for one training and draw, over its ten digits by cluster and by studentised "
        "bootstrap (mean ends), beside the paper's",
        ("exposure (s)", "design", "accuracy", "over draws", "trainings, least to most",
         "cluster", "studentised", "paper", "paper, cluster", "paper, studentised"),
        tuple(rows),
    )  # fmt: skip


def _tests(compared: _Comparison) -> Table:
    rows = []
    for exposure in EXPOSURES:
        ours = compared.at[(OURS, exposure)].single
        for rival in compared.rivals:
            tests = [
                wilcoxon_signed_rank(one, other)
                for one, other in zip(ours, compared.at[(rival, exposure)].single, strict=True)
            ]
            statistic, p, effect = np.median(tests, axis=0)
            clear = float(np.mean([test.pvalue < 0.05 for test in tests]))
            published = WILCOXON[rival][exposure]
            label = compared.labels[rival]
            rows.append((exposure, label, statistic, p, effect, clear, *published))
    return Table(
        f"Two-sided Wilcoxon signed-rank test against {LABELS[OURS]} over the ten digits: medians "
        "over trainings and draws, the share of them with p below 0.05, and the paper's",
        ("exposure (s)", "design", "statistic", "p", "rank-biserial", "share below 0.05",
         "paper: statistic", "paper: p", "paper: rank-biserial"),
        tuple(rows),
    )  # fmt: skip


EXPERIMENT = Experiment(
    name="hardware",
    title="The camera: designs on a micromirror device, read by one photon counter",
    paper=PAPER,
    show=show,
    measure=measure,
    prepare=prepare,
)
