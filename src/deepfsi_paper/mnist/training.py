"""Effect of the training: the number of epochs, and the dropout that the paper used."""

from collections.abc import Iterable, Sequence

from deepfsi.base.intervals import Difference, accuracy_difference, all_above
from deepfsi.report.style import DESIGN_COLOURS, photons_text
from deepfsi.sweeps.results import Point, Results
from deepfsi_paper.experiment import Experiment, Finding, points
from deepfsi_paper.report.lines import Line, lines_figure
from deepfsi_paper.report.section import Claim, Picture, Table

PAPER = (
    "Dropout after each hidden layer avoids overfitting and enhances generalisation. Its share is "
    "not given."
)


def show(results: Results) -> Finding:
    """Accuracy by epochs, and by dropout, each against none."""
    epochs = sorted(points(results, recipe="epochs", best=True), key=_setting)
    epochs = [point for point in epochs if point.photons == epochs[0].photons]
    dropout = points(results, recipe="dropout", best=True)
    without = {(p.label, p.photons): p for p in dropout if _setting(p) == 0}
    gains = {
        (p.label, p.photons, _setting(p)): accuracy_difference(p, without[(p.label, p.photons)])
        for p in dropout
        if _setting(p) > 0
    }
    first, last = epochs[0], epochs[-1]
    longer = accuracy_difference(last, first)
    found = (
        f"DeepFSI at {photons_text(first.photons)} photons has {first.accuracy:.3f} after "
        f"{_setting(first):g} epochs and {last.accuracy:.3f} after {_setting(last):g}: {longer}. "
        f"{_counts(gains.values())}"
    )
    claims = (
        Claim(
            f"{_setting(last):g} epochs are better than {_setting(first):g}",
            all_above([longer]),
            str(longer),
        ),
        *(_claim(share, gains) for share in sorted({share for *_, share in gains})),
    )
    look = {"color": DESIGN_COLOURS["deepfsi"], "marker": "o", "markersize": 4, "linewidth": 1.4}
    line = Line.through("DeepFSI", look, [(_setting(point), point) for point in epochs])
    picture = Picture(
        lines_figure({f"epochs ({photons_text(first.photons)} photons)": [line]}),
        "DeepFSI by epochs of training, without dropout. Bars: 95 % intervals.",
        "Accuracy of DeepFSI against the number of epochs; numbers in the table.",
    )
    return Finding(found, (picture,), claims, (_epochs(epochs), _dropout(dropout, gains)))


def _setting(point: Point) -> float:
    """Value of the one setting that varies."""
    return float(point.variant.split()[-1])


def _counts(gains: Iterable[Difference]) -> str:
    every = list(gains)
    up, down = sum(each.low > 0 for each in every), sum(each.high < 0 for each in every)
    return (
        f"Dropout raises accuracy in {up} and lowers it in {down} of {len(every)} comparisons with "
        "none; in the others the interval holds 0"
    )


def _claim(share: float, gains: dict[tuple[str, float, float], Difference]) -> Claim:
    own = {place: each for place, each in gains.items() if place[2] == share}
    least, most = (pick(own, key=lambda place: own[place].mean) for pick in (min, max))
    return Claim(
        f"Dropout of {share:g} raises the accuracy of every design",
        all_above(own.values()),
        "; ".join(
            f"{word} {own[place]}, {place[0]} at {photons_text(place[1])} photons"
            for word, place in (("least", least), ("most", most))
        ),
    )


def _epochs(epochs: Sequence[Point]) -> Table:
    return Table(
        "DeepFSI by epochs, at the number of masks that is best on validation images",
        ("photons", "epochs", "masks", "accuracy", "low", "high"),
        tuple((p.photons, _setting(p), p.masks, p.accuracy, p.low, p.high) for p in epochs),
    )


def _dropout(dropout: Sequence[Point], gains: dict[tuple[str, float, float], Difference]) -> Table:
    rows = []
    for point in dropout:
        gain = gains.get((point.label, point.photons, _setting(point)))
        rows.append(
            (point.label, point.masks, point.photons, _setting(point), point.accuracy,
             "" if gain is None else str(gain))
        )  # fmt: skip
    return Table(
        "Accuracy by dropout after each hidden layer, and its gain over none",
        ("design", "masks", "photons", "dropout", "accuracy", "gain"),
        tuple(rows),
    )


EXPERIMENT = Experiment(
    name="training",
    title="What the training adds: epochs and dropout",
    paper=PAPER,
    show=show,
)
