"""Flexible designs: for a range of budgets, for any number of masks, and to stop early.

One design stands against many that were each trained for one budget or one number of masks, with
the same network and on the same scenes. The targets are our own.
"""

from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Any

import numpy as np
from pydantic import TypeAdapter
from scipy import stats

from deepfsi.base.numeric.intervals import (
    CONFIDENCE,
    Difference,
    accuracy_difference,
    all_above,
    mean_of_trials,
    signed_text,
)
from deepfsi.evaluation.stopping import MeanEstimate, Stopped
from deepfsi.report.style import BUDGET_AXIS, photons_text
from deepfsi.sweeps.results import Point, Results
from deepfsi_paper.experiment import Experiment, Finding, budgets, points
from deepfsi_paper.flexible.figures import LOOKS, Stops, stopping_figure
from deepfsi_paper.flexible.measures import Measures, Prefix, measure
from deepfsi_paper.report.lines import Line, lines_figure
from deepfsi_paper.report.maps import accuracy_grid, heat_figure
from deepfsi_paper.report.section import Claim, Picture, Table

RANGE_LOSS, NESTED_LOSS = 0.01, 0.015
"""Accuracy that one design may lose against each of those that it stands for."""

SAVED, EQUAL = 0.3, 0.002
"""Share of the photons that stopping early is to save, and the loss that still counts as none."""

PAPER = (
    "Not in the paper, which finds that accuracy drops dramatically in dimmer light than a design "
    "was trained for, and that the number of masks matters."
)
"""Finding of the paper."""

LEARNED = "deepfsi"
"""Name of the design that is trained for one budget or one number of masks."""

Place = Any
"""Photon budget or number of masks."""

Text = Callable[[Place], str | int]


@dataclass(frozen=True)
class Rivalry:
    """One design for all places of an axis against designs of their own.

    Attributes
    ----------
    axis : str
        Field of the points: `photons` or `masks`.
    one : dict
        Place → test of the one design.
    own : dict
        (design, place) → test of a design of its own.
    """

    axis: str
    one: Mapping[Place, Point | Prefix]
    own: Mapping[tuple[str, Place], Point]

    @property
    def places(self) -> list[Place]:
        """Places where a learned design of its own was trained."""
        return [place for place in self.one if (LEARNED, place) in self.own]

    @property
    def differences(self) -> dict[Place, Difference]:
        """Accuracy of the one design less that of the learned design of its own."""
        return {
            place: accuracy_difference(self.one[place], self.own[(LEARNED, place)])
            for place in self.places
        }

    @property
    def fixed(self) -> dict[str, str]:
        """Names of the other designs."""
        return {name: p.title for (name, _), p in self.own.items() if name != LEARNED}

    def table(self, caption: str, heads: tuple[str, str], text: Text) -> Table:
        """Accuracies at every place, and the differences.

        Parameters
        ----------
        caption : str
        heads : tuple of str
            Of the places and of the one design.
        text : callable
            How a place is written.
        """
        differences = self.differences
        return Table(
            caption,
            (*heads, "dedicated", "difference", *self.fixed.values()),
            tuple(
                (
                    text(place),
                    self.one[place].accuracy,
                    self.own[(LEARNED, place)].accuracy,
                    str(differences[place]),
                    *(self.own[(name, place)].accuracy for name in self.fixed),
                )
                for place in self.places
            ),
        )

    def lines(self, one: str, own: str) -> list[Line]:
        """The one design, the learned ones of their own, and the others, under these names."""
        named = [(own, LEARNED), *((label, name) for name, label in self.fixed.items())]
        return [
            _line(one, "flexible", self.one.values(), self.axis),
            *(
                _line(text, name, [self.own[(name, place)] for place in self.places], self.axis)
                for text, name in named
            ),
        ]

    def lowest(self, text: Text) -> str:
        """The lowest difference, and where it is."""
        differences = self.differences
        place = min(differences, key=lambda place: differences[place].mean)
        return f"{differences[place]} at {text(place)}"


@dataclass(frozen=True)
class Saving:
    """Share of the photons that stopping early saves, and accuracy that it loses."""

    share: Difference
    loss: Difference


@dataclass(frozen=True)
class Numbers:
    """Numbers that claims, figures and tables share."""

    results: Results

    @cached_property
    def measures(self) -> Measures:
        """Numbers beyond accuracies."""
        return TypeAdapter(Measures).validate_python(self.results.extra)

    @cached_property
    def ranged(self) -> Rivalry:
        """One design for all budgets, against those for one."""
        own = [p for p in points(self.results, recipe="budgets") if p.photons == p.trained_at]
        return Rivalry(
            "photons",
            {p.photons: p for p in points(self.results, recipe="range")},
            {(p.design, p.photons): p for p in own},
        )

    @cached_property
    def nested(self) -> Rivalry:
        """First masks of one design, against designs of so many."""
        members = [p for p in self.measures.prefixes if p.recipe == "nested"]
        own = [p for p in _counts(self.results, members[0].photons) if p.photons == p.trained_at]
        dedicated = {(p.design, p.masks): p for p in own}
        shown = {p.masks: p for p in members if (LEARNED, p.masks) in dedicated}
        return Rivalry("masks", shown, dedicated)

    @property
    def nested_at(self) -> str:
        """Budget of the nested design."""
        return photons_text(points(self.results, recipe="nested")[0].photons)

    @property
    def savings(self) -> tuple[Saving, Saving]:
        """Savings of nested masks and of several looks."""
        return _saving(self.measures.stopped), _saving(self.measures.looked)

    @property
    def stopped_at(self) -> str:
        """Budget of the exposures that stop early."""
        return photons_text(self.measures.stopped[0].photons)


def show(results: Results) -> Finding:
    """Lines against budget and masks, what stopping saves, and heat maps; four claims."""
    numbers = Numbers(results)
    return Finding(
        _found(numbers),
        (
            _lines_picture(numbers),
            _stopping_picture(results, numbers.measures),
            _heat_picture(results, numbers.measures.prefixes),
        ),
        claims_of(numbers),
        tables_of(numbers),
    )


def _counts(results: Results, photons: float) -> list[Point]:
    """Points of designs trained at a budget, of every number of masks."""
    return [
        point
        for name in ("counts", "budgets")
        for point in points(results, recipe=name, trained_at=photons)
    ]


def _saving(stopped: Sequence[Stopped]) -> Saving:
    return Saving(
        mean_rate([replace(each.used, mean=1 - each.used.mean) for each in stopped]),
        mean_rate([replace(each.difference, mean=-each.difference.mean) for each in stopped]),
    )


def mean_rate(rates: Sequence[MeanEstimate]) -> Difference:
    """Mean over trials; of a single one with its interval over images."""
    if len(rates) > 1:
        return mean_of_trials([rate.mean for rate in rates])
    [rate] = rates
    half = (rate.high - rate.low) / 2
    return Difference(rate.mean, half / float(stats.norm.ppf((1 + CONFIDENCE) / 2)))


def _found(numbers: Numbers) -> str:
    saved, by_looks = numbers.savings
    return (
        f"One design for all budgets is at its lowest {numbers.ranged.lowest(photons_text)} "
        "photons, against the one trained for that budget; the first masks of a nested design are "
        f"at their lowest {numbers.nested.lowest(str)} masks, against the design of so many. "
        f"Stopping early saves {saved.share.mean:.0%} of {numbers.stopped_at} photons with nested "
        f"masks and changes accuracy by {signed_text(0.0 - saved.loss.mean, 4)}; with several "
        f"looks, whose counts choose the dwells of the next, {by_looks.share.mean:.0%} and "
        f"{signed_text(0.0 - by_looks.loss.mean, 4)}."
    )


def claims_of(numbers: Numbers) -> tuple[Claim, ...]:
    """Claims on budgets, numbers of masks, and stopping early."""
    ranged, nested = numbers.ranged, numbers.nested
    return (
        Claim(
            f"One design for all budgets loses at most {RANGE_LOSS} against each dedicated one",
            all_above(ranged.differences.values(), -RANGE_LOSS),
            f"lowest {ranged.lowest(photons_text)} photons",
        ),
        Claim(
            f"The first masks of one design lose at most {NESTED_LOSS} against dedicated ones at "
            f"{numbers.nested_at} photons",
            all_above(nested.differences.values(), -NESTED_LOSS),
            f"lowest {nested.lowest(str)} masks",
        ),
        *(
            Claim(
                f"Stopping exposures of {kind} early saves {SAVED:.0%} of the photons and loses "
                f"less than {EQUAL} at {numbers.stopped_at} photons",
                _both(all_above([each.share], SAVED), all_above([-each.loss], -EQUAL)),
                f"saved {each.share}, lost {each.loss}",
            )
            for kind, each in zip(("nested masks", "several looks"), numbers.savings, strict=True)
        ),
    )


def tables_of(numbers: Numbers) -> tuple[Table, ...]:
    """Tables by budget, by number of masks, and of stopping early."""
    return (
        numbers.ranged.table(
            "One design for all budgets, and designs for one budget each, tested at it",
            ("photons", "range"),
            photons_text,
        ),
        numbers.nested.table(
            f"The first masks of one design at {numbers.nested_at} photons, and designs of so many",
            ("masks", "first masks"),
            int,
        ),
        _stop_table(numbers.results, numbers.measures),
    )


def _both(first: bool | None, second: bool | None) -> bool | None:
    if first is False or second is False:
        return False
    return True if first and second else None


def _stop_table(results: Results, measures: Measures) -> Table:
    rows: list[tuple[str, float, float]] = []
    errors = []
    for trials, kind in ((measures.stopped, "nested"), (measures.looked, "several looks")):
        photons = trials[0].photons
        used, whole, stopped, error, raw = np.mean(
            [
                (
                    each.used.mean,
                    each.whole.mean,
                    each.stopped.mean,
                    each.calibration_error,
                    each.uncalibrated_error,
                )
                for each in trials
            ],
            axis=0,
        ).tolist()
        rows += [
            (f"{kind}, whole exposures", photons, whole),
            (f"{kind}, stopped early", used * photons, stopped),
        ]
        errors.append(f"{error:.4f} with {kind} ({raw:.4f} without temperatures)")
    plain = sorted(points(results, recipe="plain"), key=lambda point: -point.photons)
    rows += [("neither, whole exposures", point.photons, point.accuracy) for point in plain]
    return Table(
        f"Stopping early; the calibration error of the answers is {' and '.join(errors)}",
        ("", "mean photons", "accuracy"),
        tuple(rows),
    )


def _lines_picture(numbers: Numbers) -> Picture:
    ranged, nested = numbers.ranged, numbers.nested
    base = points(numbers.results, recipe="budgets", design=LEARNED)
    elsewhere = [
        replace(
            _line(
                "" if number else "those designs at other budgets\n(trained at: left end)",
                "elsewhere",
                [point for point in base if point.trained_at == trained_at],
                "photons",
            ),
            low=(),
            high=(),
            start=photons_text(trained_at),
        )
        for number, trained_at in enumerate(ranged.places)
    ]
    first, own, *fixed = ranged.lines("one design for all budgets", "a design for each budget")
    panels = {
        BUDGET_AXIS: [first, own, *elsewhere, *fixed],
        f"number of masks shown, at {numbers.nested_at} photons": nested.lines(
            "first masks of one design", "a design for each number"
        ),
    }
    return Picture(
        lines_figure(panels),
        "Left: one design for all budgets, against designs for one budget each, tested at that "
        "budget and (dotted) at the others. Right: the first masks of one design at "
        f"{numbers.nested_at} photons, against designs of that many. Bars: 95 % intervals.",
        "Accuracy against budget and against masks; numbers in the tables.",
    )


def _stopping_picture(results: Results, measures: Measures) -> Picture:
    photons = measures.stopped[0].photons
    plain = _line("whole exposures", "plain", points(results, recipe="plain"), "photons")
    stopped = (
        Stops("nested masks, stopped early", "nested", measures.stopped),
        Stops("several looks, stopped early", "looks", measures.looked),
    )
    return Picture(
        stopping_figure(stopped, plain),
        f"Exposures of {photons_text(photons)} photons on one device that stop when their answer "
        "is sure enough. Left: accuracy against the mean of photons used, for all thresholds, and "
        "of a design for whole exposures of that many; diamonds: the threshold chosen on "
        "validation data. Middle: the share of exposures not yet stopped, in the mean (bold) and "
        "in each trial (thin). Right: accuracy of the answers kept, the least sure withheld.",
        "What stopping early saves, when exposures stop, and what rejection gives.",
    )


def _heat_picture(results: Results, prefixes: Iterable[Prefix]) -> Picture:
    photons = points(results, recipe="nested")[0].photons
    members = _counts(results, photons)
    both = [p for p in prefixes if p.recipe == "both"]
    tested = [p for p in budgets(members) if p in set(budgets(both))]
    apart = {f"{p.ratio:.0%}": p.ratio for p in both}  # rows that read alike are one
    ratios = sorted(apart.values())
    grids = {
        point.title: accuracy_grid([p for p in members if p.design == point.design], tested, ratios)
        for point in members
    }
    grids["one design for all"] = accuracy_grid(both, tested, ratios)
    return Picture(
        heat_figure(grids, tested, ratios),
        "Accuracy by budget of the test and compression ratio. The last panel is one design, "
        f"nested and for all budgets; each row of the others is a design of its own, trained at "
        f"{photons_text(photons)} photons.",
        "Heat maps of accuracy over test budget and compression ratio.",
    )


def _line(name: str, look: str, members: Iterable[Point | Prefix], axis: str) -> Line:
    return Line.through(name, LOOKS[look], ((getattr(p, axis), p) for p in members))


EXPERIMENT = Experiment(
    name="flexible",
    title="Flexible designs: any budget, any number of masks, and exposures that stop early",
    paper=PAPER,
    show=show,
    measure=measure,
)
