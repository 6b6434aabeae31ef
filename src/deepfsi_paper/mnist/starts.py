"""The effect of the matrix that learned masks start from."""

from deepfsi.base.intervals import CONFIDENCE, Difference, accuracy_difference
from deepfsi.report.style import photons_text
from deepfsi.sweeps.results import Results
from deepfsi_paper.experiment import Experiment, Finding
from deepfsi_paper.mnist.figures import Start, starts_figure
from deepfsi_paper.report.section import Claim, Picture, Table

PAPER = (
    "The initial matrix of DeepFSI can affect its performance in the presence of noise; it was "
    "therefore started from the principal components of the training data."
)
MATTERS = 0.005
"""Difference in accuracy that counts as an effect."""


def show(results: Results) -> Finding:
    """Accuracies by start, and paired differences to the start from principal components."""
    at = {(point.variant.removeprefix("start "), point.photons): point for point in results.points}
    compared = {
        (start, photons): accuracy_difference(point, at[("pca", photons)])
        for (start, photons), point in at.items()
        if start != "pca"
    }
    accuracies = [
        Start(point.noise, start, photons, point.accuracy, point.low, point.high)
        for (start, photons), point in at.items()
    ]
    differences = [
        Start(at[place].noise, *place, each.mean, *_ends(each, at[place].trials))
        for place, each in compared.items()
    ]
    most = max(compared, key=lambda place: abs(compared[place].mean))
    said = f"{compared[most]}, {most[0]} at {photons_text(most[1])} photons"
    clear = [place for place, each in compared.items() if _matters(each, len(compared))]
    found = (
        f"The largest difference to the start from principal components is {said}. {len(clear)} of "
        f"{len(compared)} differences are clearly beyond {MATTERS}, by intervals widened for "
        f"{len(compared)} comparisons."
    )
    claim = Claim(
        f"The initial matrix changes accuracy by more than {MATTERS} somewhere",
        True if clear else None,
        f"largest: {said}; {len(clear)} clearly beyond {MATTERS}",
    )
    table = Table(
        "Accuracy less that of the start from principal components, paired by seed",
        ("start", "photons", "difference to pca", "low", "high"),
        tuple((row.start, row.photons, row.value, row.low, row.high) for row in differences),
    )
    picture = Picture(
        starts_figure(accuracies, differences, 1 / len(results.data.classes)),
        "Accuracy by the matrix that masks start from, and differences to PCA. Bars: 95 % "
        "intervals.",
        "Accuracy of learned masks from three initial matrices; numbers in the table.",
    )
    return Finding(found, (picture,), (claim,), (table,))


def _ends(each: Difference, trials: int) -> tuple[float, float] | tuple[None, None]:
    """Interval of a difference, if several trials give one."""
    return each.interval() if trials > 1 else (None, None)


def _matters(each: Difference, looks: int) -> bool:
    """Test that a difference is beyond `MATTERS`, among that many (Bonferroni)."""
    low, high = each.interval(1 - (1 - CONFIDENCE) / looks)
    return low > MATTERS or high < -MATTERS


EXPERIMENT = Experiment(name="starts", title="Where the masks start from", paper=PAPER, show=show)
