"""Results of tests in lines and tables, as a terminal shows them."""

from collections.abc import Iterator, Sequence
from itertools import zip_longest

from deepfsi.base.numeric.intervals import MOST_CLASSES, confusion_shares, frequent_confusions
from deepfsi.base.quantities import (
    NAME_WIDTH,
    Table,
    budget_text,
    count_text,
    rate_text,
    short_name,
)
from deepfsi.measures.results import Estimates, Result
from deepfsi.measures.table import MEASURES, Measure


def score_text(result: Result | Estimates) -> str:
    """Test accuracy, or R² of values, with its interval."""
    main, *_ = result.measures()
    words = f"{main.title} {_interval(result, main)}"
    return words if isinstance(result, Estimates) else f"test {words}"


def details_text(result: Result | Estimates, classes: Sequence[str]) -> str:
    """Test of each class in words, or of each value."""
    if isinstance(result, Estimates):
        errors = ", ".join(map(" ".join, zip(result.values, _answers(result, ()), strict=True)))
        return f"root mean squared error (of the best linear estimator): {errors}"
    balanced = MEASURES["balanced"]
    worst = _worst(result, classes)
    return f"{balanced.title} {_interval(result, balanced)}, worst class {worst}"


def results_lines(
    tests: Sequence[Result | Estimates],
    *,
    title: str,
    classes: Sequence[str] = (),
    bounds: Sequence[Result] = (),
) -> Iterator[str | Table]:
    """Tests of a design in a table, its mistakes, and what the numbers mean."""
    results = sorted(tests, key=lambda r: r.photons)
    values = results[0].values if isinstance(results[0], Estimates) else []
    clicks = any(result.clicks for result in results)
    light = ("counts", "arriving") if clicks else ("counts",)
    measures = [
        measure
        for measure in results[0].measures()
        if measure.column
        and (measure.interval or any(r.score(measure.key) is not None for r in results))
    ]
    main, *others = (measure for measure in measures if measure.interval)
    last = [measure for measure in measures if not measure.interval]
    rows = [
        (
            budget_text(r.photons),
            _interval(r, main),
            *(_number(r.score(measure.key)) for measure in others),
            *_answers(r, classes),
            *(count_text(getattr(r, name)) for name in light),
            f"{r.throughput:.3f}",
            *(_number(r.score(measure.key)) for measure in last),
        )
        for r in results
    ]
    names = map(short_name, values) if values else ("worst class",)
    heads = (*(measure.column for measure in (main, *others)), *names, *light, "counted")
    heads = ("photons", *heads, *(measure.column for measure in last))
    yield Table(title, heads, rows)
    if values:
        yield "of each value: root mean squared error (that of the best linear estimator)"
    for result in results:
        if isinstance(result, Result):
            yield _confusion_table(result, classes)
    if bounds:
        yield Table(
            "ideal observer of these counts, training scenes as prior",
            ("photons", main.column),
            [
                (budget_text(r.photons), _interval(r, main))
                for r in sorted(bounds, key=lambda r: r.photons)
            ],
        )
    yield f"± half of the 95 % interval: {results[0].covers}"
    yield (
        "counts: clicks of the detectors, arriving: photons that reach them, in the mean over test "
        "scenes"
        if clicks
        else "counts: photons that detectors count, in the mean over test scenes"
    )
    reached = "reaches them" if clicks else "they count"
    yield f"counted: share of the budget that {reached}, in the mean over training scenes"
    yield from (measure.legend for measure in measures if measure.legend)


def _confusion_table(result: Result, classes: Sequence[str]) -> Table:
    """Which classes are taken for which; of many, the most frequent mistakes."""
    where = f"at {budget_text(result.photons)} photons, % of the true class"
    if len(classes) > MOST_CLASSES:
        mistakes = [
            (classes[i], classes[j], f"{100 * x:.1f}")
            for i, j, x in frequent_confusions(result.confusion)
        ]
        return Table(f"most frequent mistakes {where}", ("true", "answered", "share"), mistakes)
    rows = [
        (short_name(name), *(f"{100 * x:.0f}" if x else "" for x in row))
        for name, row in zip(classes, confusion_shares(result.confusion), strict=True)
    ]
    width = NAME_WIDTH if len(classes) <= 5 else 5
    heads = ("true \\ answered", *(short_name(name, width) for name in classes))
    return Table(f"answers {where}", heads, rows)


def _interval(result: Result | Estimates, measure: Measure) -> str:
    """A measure that has an interval, with half the width of it."""
    return rate_text(*(result.score(key) or 0.0 for key in measure.keys))


def _number(value: float | None) -> str:
    """A measure without an interval, of answers that may not have it."""
    return "–" if value is None else f"{value:.3f}"


def _answers(result: Result | Estimates, classes: Sequence[str]) -> tuple[str, ...]:
    """The worst class; or the error of each value, and that of the best linear estimator."""
    if isinstance(result, Estimates):
        errors = zip_longest(result.rmse, result.bound or ())
        return tuple(error_text(*pair) for pair in errors)
    return (_worst(result, classes),)


def _worst(result: Result, classes: Sequence[str]) -> str:
    return worst_text(result.rates[result.worst] or 0.0, classes[result.worst])


def error_text(rmse: float, bound: float | None) -> str:
    """A root mean squared error, and in brackets a bound where there is one: 0.052 (0.071)."""
    return f"{rmse:.3g}" if bound is None else f"{rmse:.3g} ({bound:.3g})"


def worst_text(rate: float, name: str) -> str:
    """Accuracy of the worst class with its name: 0.083 (oak)."""
    return f"{rate:.3f} ({short_name(name)})"
