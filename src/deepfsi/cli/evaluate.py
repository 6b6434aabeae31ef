"""Commands that test a design: under simulated light, and on pictures."""

from collections.abc import Iterator, Sequence
from itertools import zip_longest
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

from pydantic import Field

from deepfsi.base import (
    DESIGN_ENDINGS,
    NAME_WIDTH,
    InputError,
    Message,
    Table,
    budget_text,
    count_text,
    rate_text,
    short_name,
    write_atomically,
)
from deepfsi.base.numeric import MOST_CLASSES, confusion_shares, frequent_confusions
from deepfsi.cli.command import Command
from deepfsi.cli.fields import (
    Dark,
    DesignOrPatterns,
    DesignPath,
    Draws,
    Force,
    LightFluctuation,
    NoiseName,
    NoiseSeed,
    Number,
    Numbers,
    Output,
    Sigma,
    Size,
    SkipBad,
    TestData,
    TorchDevice,
    Trust,
    View,
    argument,
    check_sigma,
    check_there,
)
from deepfsi.cli.terminal import Outcome, Terminal
from deepfsi.datasets import check_source
from deepfsi.measures import Estimates, Measure, Result

if TYPE_CHECKING:
    from deepfsi.datasets import Dataset
    from deepfsi.design import Design
    from deepfsi.evaluation import Stopped
    from deepfsi.lab.prediction import Predictions
    from deepfsi.sweeps.results import Data, Point

FEW_CLASSES = 5
"""Classes whose names head the columns of a confusion matrix in full."""


class EvaluateDesign(Command):
    """`deepfsi evaluate`.

    The test scenes are those of the data that it was trained on, which the design remembers.

    Example: deepfsi evaluate digits.safetensors --photons 1e2,1e3,1e4
    """

    file: DesignOrPatterns
    photons: Annotated[Numbers, Field(description="budgets, such as 1e2,1e3,1e4")]
    data: TestData = None
    size: Size = None
    noise: NoiseName = None
    sigma: Sigma = None
    dark: Dark = None
    fluctuation: LightFluctuation = None
    first: Annotated[
        int | None, Field(description="use only this many first masks of a nested design")
    ] = None
    draws: Draws = 3
    ideal: Annotated[
        bool, Field(description="also give the accuracy of the ideal observer of the counts")
    ] = False
    seed: NoiseSeed = 0
    view: View = None
    trust: Trust = False
    device: TorchDevice = "auto"

    def run(self, terminal: Terminal) -> Outcome:
        """Accuracy, or errors of values, at each budget."""
        check_data(self.data, self.view)
        from deepfsi.evaluation import camera_for, evaluate, ideal_observer
        from deepfsi.lab import data_of, open_design
        from deepfsi.physics import torch_device

        design = open_design(self.file, trust=self.trust).to(torch_device(self.device))
        options = self.given("noise", "sigma", "dark", "fluctuation")
        camera = camera_for(design, None, **options)
        check_sigma(options, [camera.noise_name])
        if self.ideal and not camera.noise_facts.exact:
            other = camera.noise_name if camera.noise_facts.steady else "light that fluctuates"
            raise InputError(
                f"the ideal observer is of photon noise, not {other}: leave --ideal out"
            )
        if self.ideal:
            design.exposure.check("ideal observer")
        if self.first is not None:
            design = design.first(self.first)
        scenes, notes = data_of(design, self.data, self.size, self.view)
        how: dict[str, Any] = {"draws": self.draws, "seed": self.seed}
        with terminal.progress("evaluate") as report:
            results = evaluate(design, scenes, self.photons, camera=camera, report=report, **how)
        bounds: list[Result] = []
        if self.ideal:
            with terminal.progress("ideal observer") as report:
                bounds = ideal_observer(design, scenes, self.photons, report=report, **how)
        return Outcome(
            {
                "design": str(self.file),
                "detectors": design.detection.count,
                "readout": design.detection.readout,
                "notes": notes,
                "results": [with_classes(design, result) for result in results],
                "ideal": [with_classes(design, result) for result in bounds],
            },
            [
                *data_lines(scenes, notes),
                *result_lines(design, camera.noise_name, results, bounds),
                *full_gates_lines(design, results),
            ],
        )


class StopEarly(Command):
    """`deepfsi stop`.

    Data and left-out scenes are those that the design remembers.

    Example: deepfsi stop nested.safetensors --photons 1e5
    """

    file: Annotated[DesignPath, argument("design file for one device, nested or of several looks")]
    photons: Annotated[Number, Field(description="budget of a whole exposure")]
    data: TestData = None
    size: Size = None
    hold_out: Annotated[
        int | None,
        Field(
            description="number of last training scenes that the training left out; that of the "
            "design unless given"
        ),
    ] = None
    threshold: Annotated[
        float | None,
        Field(description="confidence above which to stop; chosen on left-out scenes unless given"),
    ] = None
    out: Annotated[
        Path | None,
        Output(DESIGN_ENDINGS),
        Field(description="write the design with this rule, for `camera live`"),
    ] = None
    draws: Draws = 3
    seed: NoiseSeed = 0
    trust: Trust = False
    device: TorchDevice = "auto"
    force: Force = False

    def run(self, terminal: Terminal) -> Outcome:
        """Light that stopped exposures take, and their accuracy."""
        check_data(self.data)
        from deepfsi.design import load_design
        from deepfsi.evaluation import stop, with_rule
        from deepfsi.lab import data_of
        from deepfsi.physics import torch_device

        design = load_design(self.file, torch_device(self.device), trust=self.trust)
        if self.out is not None:
            design.exposure.stopping_at(1.0)
        scenes, notes = data_of(design, self.data, self.size)
        with terminal.progress("stop"):
            stopped = stop(
                design,
                scenes,
                self.photons,
                held_out=self.hold_out,
                threshold=self.threshold,
                draws=self.draws,
                seed=self.seed,
            )
        if self.out is not None:
            with_rule(design, stopped.rule).save(self.out)
        return Outcome(
            {"design": str(self.file), "notes": notes, **stopped.as_dict()},
            [*data_lines(scenes, notes), *self._lines(design, stopped)],
        )

    def _lines(self, design: "Design", stopped: "Stopped") -> Iterator[str | Table]:
        rates = {
            "share of photons used": stopped.used,
            "accuracy, whole exposures": stopped.whole,
            "accuracy, stopped": stopped.stopped,
            "difference, paired": stopped.difference,
        }
        yield Table(
            f"{design.size_text}, {budget_text(stopped.photons)} photons, stopped above "
            f"{stopped.rule.threshold:.5g}",
            ("", "mean", "95 % interval"),
            [
                (head, f"{rate.mean:.4f}", f"[{rate.low:.4f}, {rate.high:.4f}]")
                for head, rate in rates.items()
            ],
        )
        yield (
            f"calibration error of the answers: {stopped.calibration_error:.4f} "
            f"({stopped.uncalibrated_error:.4f} without temperatures)"
        )
        surest = {round(each["accepted"], 2): each["stopped"] for each in stopped.rejection}
        yield (
            f"the surest 90 % of the answers: {surest[0.9]:.4f} right; the surest half: "
            f"{surest[0.5]:.4f}"
        )
        yield f"interval: {stopped.covers}"
        if self.out is not None:
            yield f"saved with this rule: {self.out}"


class PredictClasses(Command):
    """`deepfsi predict`.

    They get the preprocessing of the data that the design was trained on, which it remembers.

    Example: deepfsi predict digits.safetensors pictures/ -o classes.csv
    """

    file: DesignOrPatterns
    pictures: Annotated[
        Path,
        argument(
            "picture, or folder of pictures, with or without a folder for each class, or .csv of "
            "file names and labels"
        ),
    ]
    photons: Annotated[
        Number | None,
        Field(
            description="budget of an exposure, such as 1e4; the light of the design's camera, "
            "which it was trained for, unless given"
        ),
    ] = None
    out: Annotated[
        Path | None,
        Output((".csv",)),
        Field(description="table with a line for each picture, .csv"),
    ] = None
    noise: NoiseName = None
    sigma: Sigma = None
    dark: Dark = None
    skip_bad: SkipBad = False
    seed: NoiseSeed = 0
    trust: Trust = False
    device: TorchDevice = "auto"
    force: Force = False

    def run(self, terminal: Terminal) -> Outcome:
        """Class of each picture."""
        check_there(self.pictures, "a picture, or a folder of pictures")
        from deepfsi.evaluation import camera_for
        from deepfsi.lab import open_design, predict
        from deepfsi.physics import torch_device

        design = open_design(self.file, trust=self.trust).to(torch_device(self.device))
        options = self.given("noise", "sigma", "dark")
        check_sigma(options, [camera_for(design, None, **options).noise_name])
        with terminal.progress("predict"):
            predictions = predict(
                design,
                self.pictures,
                self.photons,
                seed=self.seed,
                skip_bad=self.skip_bad,
                **options,
            )
        if self.out is not None:
            write_atomically(self.out, predictions.as_csv().encode())
        table = None if self.out is None else str(self.out)
        return Outcome(
            {"design": str(self.file), "table": table, **predictions.as_dict()},
            self._lines(design, predictions),
        )

    def _lines(self, design: "Design", predictions: "Predictions") -> Iterator[str | Table]:
        yield f"pictures: {predictions.preprocessing}."
        light = f"{budget_text(predictions.photons)} photons"
        yield Table(
            f"{design.name}, {design.size_text}, {light}, {predictions.noise} noise",
            ("picture", "class", "confidence", "labelled"),
            [
                (each.name, each.predicted, f"{each.confidence:.3f}", each.label or "")
                for each in predictions.pictures
            ],
        )
        labelled = sum(each.label is not None for each in predictions.pictures)
        if foreign := labelled - predictions.score.answers:
            yield (
                f"{foreign} pictures have labels that are none of the design's classes: left out"
            )
        for remark in predictions.remarks:
            yield Message("note: {remark}", remark=remark)
        yield from predictions.score.lines("picture")
        if self.out is not None:
            yield f"table: {self.out}"


def check_data(source: str | None, view: Path | None = None) -> None:
    """Raise `InputError` unless there is such data, if given, and the folder of a camera's view."""
    if source is not None:
        check_source(source)
    if view is not None:
        check_there(view, "the folder of a camera's calibration")


def data_lines(data: "Dataset | Data", notes: Sequence[str] = ()) -> list[str]:
    """Say in one line what was done to the scenes of a data set, and notes on it."""
    return [f"data: {data.name}. {data.preprocessing}", *(f"note: {note}" for note in notes)]


def with_classes(design: "Design", result: Result | Estimates) -> dict[str, Any]:
    """A test as JSON, with the classes that its lists are of."""
    return {"classes": design.classes, **result.as_dict()}


def score_text(result: Result | Estimates) -> str:
    """Test accuracy, or R² of values."""
    main, *_ = result.measures()
    words = f"{main.title} {_interval(result, main)}"
    return words if isinstance(result, Estimates) else f"test {words}"


def details_text(result: Result | Estimates, classes: Sequence[str]) -> str:
    """Test of each class in words, or of each value."""
    if isinstance(result, Estimates):
        told = ", ".join(map(" ".join, zip(result.values, _answers(result, ()), strict=True)))
        return f"root mean squared error (of the best linear estimator): {told}"
    _, balanced, *others = (
        f"{each.title} {_interval(result, each)}"
        for each in result.measures()
        if each.interval and result.score(each.key) is not None
    )
    return ", ".join((balanced, f"worst class {_worst(result, classes)}", *others))


def full_gates_lines(design: "Design", results: Sequence[Result | Estimates]) -> Iterator[str]:
    """Say at which budgets nearly all gates click, so that clicks tell little of a scene."""
    for result in results:
        if result.clicks and (remark := design.full_gates(result.counts, result.photons)):
            yield Message("note: {remark}", remark=remark)


def light_columns(
    tests: "Sequence[Result | Estimates | Point]",
) -> tuple[tuple[str, ...], list[tuple[str, ...]], str]:
    """Heads and cells of what detectors count, and what they mean; of clicks with the photons."""
    if not any(test.clicks for test in tests):
        meaning = "counts: photons that detectors count, in the mean over test scenes"
        return ("counts",), [(count_text(test.counts),) for test in tests], meaning
    meaning = "counts: clicks of the detectors, arriving: photons that reach them"
    cells: list[tuple[str, ...]] = [
        (count_text(test.counts), "–" if test.arriving is None else count_text(test.arriving))
        for test in tests
    ]
    return ("counts", "arriving"), cells, f"{meaning}, in the mean over test scenes"


def result_lines(
    design: "Design",
    noise: str,
    tests: Sequence[Result | Estimates],
    bounds: Sequence[Result] = (),
) -> Iterator[str | Table]:
    """Tests of a design, and those of the ideal observer where there are any.

    Parameters
    ----------
    design : Design
    noise : str
        Of the tests.
    tests, bounds : sequence
        At several budgets.
    """
    results = sorted(tests, key=lambda r: r.photons)
    light_heads, light, meaning = light_columns(results)
    measures = [each for each in results[0].measures() if each.column]
    main, *others = (each for each in measures if each.interval)
    last = [each for each in measures if not each.interval]
    rows = [
        (
            budget_text(r.photons),
            _interval(r, main),
            *(_number(r.score(each.key)) for each in others),
            *_answers(r, design.classes),
            *counts,
            f"{r.throughput:.3f}",
            *(_number(r.score(each.key)) for each in last),
        )
        for r, counts in zip(results, light, strict=True)
    ]
    names = map(short_name, design.values.names) if design.values else ("worst class",)
    heads = (*(each.column for each in (main, *others)), *names, *light_heads, "counted")
    heads = ("photons", *heads, *(each.column for each in last))
    yield Table(f"{design.name}, {design.size_text}, {noise} noise", heads, rows)
    if design.values:
        yield "of each value: root mean squared error (that of the best linear estimator)"
    for result in results:
        if isinstance(result, Result):
            for each in result.measures():
                if each.interval and not each.column and result.score(each.key) is not None:
                    where = f"{budget_text(result.photons)} photons"
                    yield f"{each.title} at {where}: {_interval(result, each)}"
            yield _confusion_table(result, design.classes)
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
    yield meaning
    reached = "reaches them" if results[0].clicks else "they count"
    yield f"counted: share of the budget that {reached}, in the mean over training scenes"
    if not design.values:
        yield "ECE: expected calibration error, between probabilities and how often they are right"


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
    width = NAME_WIDTH if len(classes) <= FEW_CLASSES else 5
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
        return tuple(error_text(*each) for each in errors)
    return (_worst(result, classes),)


def _worst(result: Result, classes: Sequence[str]) -> str:
    return worst_text(result.rates[result.worst] or 0.0, classes[result.worst])


def error_text(rmse: float, bound: float | None) -> str:
    """A root mean squared error, and in brackets a bound where there is one: 0.052 (0.071)."""
    return f"{rmse:.3g}" if bound is None else f"{rmse:.3g} ({bound:.3g})"


def worst_text(rate: float, name: str) -> str:
    """Accuracy of the worst class with its name: 0.083 (oak)."""
    return f"{rate:.3f} ({short_name(name)})"
