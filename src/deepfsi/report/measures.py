"""Words of a page for what the answers are measured by."""

from dataclasses import dataclass

from deepfsi.datasets.dataset import Measure
from deepfsi.report.style import ACCURACY_AXIS


@dataclass(frozen=True)
class MeasureWords:
    """Words of a page for a measure."""

    name: str  # in headings and tables
    axis: str  # of a figure
    meaning: str  # what it is the share of
    guessing: str  # what guessing gives
    task: str  # what a network does with the photon counts of scenes


WORDS: dict[Measure, MeasureWords] = {
    "accuracy": MeasureWords(
        "accuracy",
        ACCURACY_AXIS,
        "share of test scenes classified correctly",
        "the share of the commonest class",
        "the share of {scenes} that a trained network classifies correctly from the photon counts",
    ),
    "AUC": MeasureWords(
        "AUC",
        "area under the ROC curve (AUC)",
        "probability that an anomaly gets a higher score than a normal scene, the area under the "
        "ROC curve (AUC)",
        "that of scores drawn at random",
        "how well a trained network tells anomalies from normal scenes by the photon counts, on "
        "{scenes}: the area under the ROC curve (AUC), which is the probability that an anomaly "
        "gets the higher score",
    ),
    "R²": MeasureWords(
        "R²",
        "R² of the estimates",
        "share of the variance of the values that the estimates explain (R², in the mean over "
        "values)",
        "that of answering the mean of all scenes",
        "how well a trained network estimates values from the photon counts, on {scenes}: R², the "
        "share of their variance that the estimates explain, in the mean over values",
    ),
}
"""Words for each measure."""
