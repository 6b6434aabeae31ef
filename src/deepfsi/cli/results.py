"""Tests of designs as the commands print them."""

import math
from collections.abc import Sequence
from itertools import zip_longest
from typing import TYPE_CHECKING

from deepfsi.base import count_text
from deepfsi.cli import common

if TYPE_CHECKING:
    from deepfsi.design import Design
    from deepfsi.measures import Estimates, Measure, Result


FEW_CLASSES = 5
"""Classes whose names head the columns of a confusion matrix in full."""


def score(result: "Result | Estimates") -> str:
    """Test accuracy, or R² of values."""
    from deepfsi.measures import Estimates

    main, *_ = result.measures()
    words = f"{main.title} {_interval(result, main)}"
    return words if isinstance(result, Estimates) else f"test {words}"


def details(result: "Result | Estimates", classes: Sequence[str]) -> str:
    """Test of each class in words, or of each value."""
    from deepfsi.measures import Estimates

    if isinstance(result, Estimates):
        told = ", ".join(map(" ".join, zip(result.values, _answers(result, ()), strict=True)))
        return f"root mean squared error (of the best linear estimator): {told}"
    _, balanced, *others = (
        f"{each.title} {_interval(result, each)}"
        for each in result.measures()
        if each.interval and result.score(each.key) is not None
    )
    return ", ".join((balanced, f"worst class {_worst(result, classes)}", *others))


def counts_text(result: "Result") -> str:
    """Counts of the detectors in words; of clicks the photons that reach them, too."""
    counts = count_text(result.counts)
    if not result.clicks:
        return f"{counts} counts"
    return f"{counts} clicks of {count_text(result.arriving)} photons that arrive"


def print_full_gates(made: "Design", results: "Sequence[Result | Estimates]") -> None:
    """Say at which budgets nearly all gates click, so that clicks tell little of a scene."""
    from deepfsi.physics import full_gates

    if made.gates is None:
        return
    gates = math.prod(made.counts_shape) * made.gates
    for result in results:
        if result.clicks and (remark := full_gates(result.counts / gates, result.photons)):
            print(f"note: {common.as_options(remark)}")


def print_guesses(made: "Design") -> None:
    """Say that probabilities are no better than guessing, if scenes that were left out say so."""
    test = made.info.get("left_out")
    if not test or not test["guesses"]:
        return
    other = "--clusters" if made.name == "adaptive" else "fewer --masks"
    print(
        f"note: on {test['scenes']} scenes that the training left out the probabilities are no "
        f"better than guessing (log loss {test['log_loss']:.2f} nats, guessing "
        f"{test['guessing']:.2f}): give more scenes, more --photons, {other}, or another --design"
    )


def fewest_lit(results: "Sequence[Result | Estimates]") -> int:
    """Number of masks that have light, at the budget with the fewest of them."""
    return min(sum(light > 0 for light in result.photons_per_mask) for result in results)


def print_lit(results: "Sequence[Result | Estimates]") -> None:
    """Say how many masks have light, where some have none."""
    from deepfsi.report.terms import lit_text

    masks, lit = len(results[0].photons_per_mask), fewest_lit(results)
    if lit < masks:
        print(f"masks: {lit_text(masks, lit)}; give a longer --exposure, or --masks {lit}")


def print_tests(
    made: "Design",
    noise: str,
    tests: "Sequence[Result | Estimates]",
    bounds: "Sequence[Result]" = (),
) -> None:
    """Print the tests of a design, and those of the ideal observer where there are any."""
    from deepfsi.measures import Result

    results = sorted(tests, key=lambda r: r.photons)
    light_heads, light, meaning = common.counted(results)
    measures = [each for each in results[0].measures() if each.column]
    main, *others = (each for each in measures if each.interval)
    last = [each for each in measures if not each.interval]
    rows = [
        (
            common.budget(r.photons),
            _interval(r, main),
            *(_number(r.score(each.key)) for each in others),
            *_answers(r, made.classes),
            *counts,
            f"{r.throughput:.3f}",
            *(_number(r.score(each.key)) for each in last),
        )
        for r, counts in zip(results, light, strict=True)
    ]
    names = map(common.short, made.values.names) if made.values else ("worst class",)
    heads = (*(each.column for each in (main, *others)), *names, *light_heads, "counted")
    heads = ("photons", *heads, *(each.column for each in last))
    common.print_table(f"{made.name}, {common.size(made)}, {noise} noise", heads, rows)
    if made.values:
        print("of each value: root mean squared error (that of the best linear estimator)")
    for result in results:
        if isinstance(result, Result):
            for each in result.measures():
                if each.interval and not each.column and result.score(each.key) is not None:
                    where = f"{common.budget(result.photons)} photons"
                    print(f"{each.title} at {where}: {_interval(result, each)}")
            _print_confusion(result, made.classes)
    if bounds:
        common.print_table(
            "ideal observer of these counts, training scenes as prior",
            ("photons", main.column),
            [
                (common.budget(r.photons), _interval(r, main))
                for r in sorted(bounds, key=lambda r: r.photons)
            ],
        )
    _print_covered(results[0], meaning)
    if not made.values:
        print("ECE: expected calibration error, between probabilities and how often they are right")


def _print_covered(result: "Result | Estimates", meaning: str) -> None:
    """Print what intervals cover, and what counts and shares are."""
    print(f"± half of the 95 % interval: {result.covers}")
    print(meaning)
    reached = "reaches them" if result.clicks else "they count"
    print(f"counted: share of the budget that {reached}, in the mean over training scenes")


def _print_confusion(result: "Result", classes: Sequence[str]) -> None:
    """Print which classes are taken for which; of many, the most frequent mistakes."""
    from deepfsi.base.numeric import MOST_CLASSES, confusion_shares, frequent_confusions

    where = f"at {common.budget(result.photons)} photons, % of the true class"
    if len(classes) > MOST_CLASSES:
        told = [
            (classes[i], classes[j], f"{100 * x:.1f}")
            for i, j, x in frequent_confusions(result.confusion)
        ]
        common.print_table(f"most frequent mistakes {where}", ("true", "answered", "share"), told)
        return
    found = confusion_shares(result.confusion)
    rows = [
        (common.short(name), *(f"{100 * x:.0f}" if x else "" for x in row))
        for name, row in zip(classes, found, strict=True)
    ]
    width = common.NAME_WIDTH if len(classes) <= FEW_CLASSES else 5
    heads = ("true \\ answered", *(common.short(name, width) for name in classes))
    common.print_table(f"answers {where}", heads, rows)


def _interval(result: "Result | Estimates", measure: "Measure") -> str:
    """A measure that has an interval, with half the width of it."""
    return common.share(*(result.score(key) or 0.0 for key in measure.keys))


def _number(value: float | None) -> str:
    """A measure without an interval, of answers that may not have it."""
    return "–" if value is None else f"{value:.3f}"


def _answers(result: "Result | Estimates", classes: Sequence[str]) -> tuple[str, ...]:
    """The worst class; or the error of each value, and that of the best linear estimator."""
    from deepfsi.measures import Estimates

    if isinstance(result, Estimates):
        errors = zip_longest(result.rmse, result.bound or ())
        return tuple(common.error(*each) for each in errors)
    return (_worst(result, classes),)


def _worst(result: "Result", classes: Sequence[str]) -> str:
    return common.worst_class(result.rates[result.worst] or 0.0, classes[result.worst])
