"""The effect of the matrix that learned masks start from."""

from typing import Any

from deepfsi.experiments.contrast import difference
from deepfsi.experiments.study import Experiment, Finding, Results
from deepfsi.report.figures import photons_text
from deepfsi.report.studies import starts_figure
from deepfsi.report.study import Claim, Picture, Table

PAPER = (
    "The initial matrix of DeepFSI can affect its performance in the presence of noise; it was "
    "therefore started from the principal components of the training data."
)
MATTERS = 0.005
"""Difference in accuracy that counts as an effect."""


def show(results: Results) -> Finding:
    """Accuracies by start, and paired differences to the start from principal components."""
    points = [
        {**point, "start": point["variant"].removeprefix("start ")} for point in results["points"]
    ]
    at = {(point["start"], point["photons"]): point for point in points}
    rows: list[dict[str, Any]] = []
    for (start, photons), point in at.items():
        if start != "pca":
            each = difference(point, at[("pca", photons)])
            paired = point["trials"] > 1
            rows.append(
                {
                    "noise": point["noise"],
                    "start": start,
                    "photons": photons,
                    "difference": each.mean,
                    "low": each.low if paired else None,
                    "high": each.high if paired else None,
                    "text": str(each),
                    "clear": each.low > 0 or each.high < 0,
                }
            )
    largest = max(rows, key=lambda row: abs(row["difference"]))
    clear = [row for row in rows if row["clear"] and abs(row["difference"]) > MATTERS]
    where = f"{largest['start']} at {photons_text(largest['photons'])} photons"
    found = (
        f"The largest difference to the start from principal components is {largest['text']}, "
        f"{where}; {len(clear)} of {len(rows)} differences exceed {MATTERS} and their own interval."
    )
    claim = Claim(
        f"The initial matrix changes accuracy by more than {MATTERS} somewhere",
        True if clear else None,
        f"largest: {largest['text']}, {where}",
    )
    heads = ("start", "photons", "difference to pca", "low", "high")
    fields = ("start", "photons", "difference", "low", "high")
    table = Table(
        "Accuracy less that of the start from principal components, paired by seed",
        heads,
        tuple(tuple(row[field] for field in fields) for row in rows),
    )
    picture = Picture(
        starts_figure({**results, "points": points, "differences": rows}),
        "Accuracy by the matrix that masks start from, and differences to pca. Bars: 95 % over "
        "trials.",
        "Accuracy of learned masks from three initial matrices; numbers in the table.",
    )
    return Finding(found, (picture,), (claim,), (table,))


EXPERIMENT = Experiment(name="starts", title="Where the masks start from", paper=PAPER, show=show)
