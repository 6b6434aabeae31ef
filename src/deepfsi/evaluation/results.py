"""Results of tests: how good the answers of a design at one budget are, and their light."""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, field, fields
from typing import Any, ClassVar, Self

import numpy as np

from deepfsi.base.intervals import pack_values, worst_class
from deepfsi.base.quantities import Table, budget_text, count_text, rate_text, short_name
from deepfsi.camera.names import find_noise
from deepfsi.evaluation.measures import MEASURES, Answers, ClassAnswers, Measure, ValueAnswers


@dataclass(frozen=True)
class _AnswerTest:
    """Test of answers, with each measure of `MEASURES` for their kind."""

    kind: ClassVar[type[Answers]]
    legend: ClassVar[str] = ""  # of the table's cells that are of this kind
    photons: float  # budget Φ
    noise: str
    low: float  # interval of the measure that data are judged by
    high: float
    covers: str  # what the intervals cover
    images: int
    draws: int
    counts: float
    arriving: float
    throughput: float
    photons_per_mask: list[float]
    further: dict[str, float | None] = field(default_factory=dict, repr=False, kw_only=True)
    image_terms: dict[str, list[float]] = field(default_factory=dict, repr=False, kw_only=True)

    @property
    def clicks(self) -> bool:
        """Whether detectors click, so that fewer photons count than arrive."""
        return find_noise(self.noise).gates

    @classmethod
    def measures(cls) -> list[Measure]:
        """Measures of such answers, the main one first."""
        return [measure for measure in MEASURES.values() if measure.of is cls.kind]

    def score(self, key: str) -> float | None:
        """A measure by its key; None if the answers do not have it."""
        return self.further.get(key, getattr(self, key, None))

    def as_dict(self) -> dict[str, Any]:
        """JSON types only, without the numbers of each image."""
        declared = {item.name: getattr(self, item.name) for item in fields(self) if item.repr}
        return declared | self.further

    def packed_terms(self) -> dict[str, str]:
        """Numbers of the test images, packed for a record."""
        return {name: pack_values(np.array(terms)) for name, terms in self.image_terms.items()}

    @classmethod
    def _values(cls, answers: Answers) -> dict[str, Any]:
        """Fields that answers of either kind have: the light, and all measures."""
        terms = answers.terms
        scores: dict[str, float | None] = {}
        for measure in cls.measures():
            scores |= zip(measure.keys, measure.values(answers, terms), strict=True)
        own = {field_.name for field_ in fields(cls)} & scores.keys()
        alike = ("photons", "noise", "covers", "draws", "counts", "arriving")
        return {
            **{name: getattr(answers, name) for name in alike},
            "images": len(answers.truth),
            "throughput": sum(answers.shares),
            "photons_per_mask": [answers.photons * share for share in answers.shares],
            "further": {
                key: score for key, score in scores.items() if key not in own and score is not None
            },
            "image_terms": {name: numbers.tolist() for name, numbers in terms.items()},
            **{key: scores[key] for key in own},
        }


@dataclass(frozen=True)
class Result(_AnswerTest):
    """Accuracy and counts of a design at a budget.

    Attributes
    ----------
    accuracy, low, high : float
        Mean over images and noise draws, and its 95 % interval (`accuracy_interval`).
    images, draws : int
        Scenes, and independent noise draws of each.
    balanced, balanced_low, balanced_high : float
        Mean of the classes' accuracies, and its 95 % interval over test images
        (`balanced_interval`).
    rates : list of float or None
        Accuracy of each class (recall); None where the test has no scene of it.
    confusion : list of list of int
        Rows true classes, columns predicted ones, over all draws.
    calibration_error : float
        Mean distance of confidence, the probability of the answer, and accuracy, over 15 groups of
        answers of like confidence, all of one size.
    log_loss : float
        Mean of −ln p of the true class, in nats; a p below 1.2e-7 is taken for that.
    counts : float
        What the detectors count, in the mean over the test scenes: photons without dark counts,
        or clicks.
    arriving : float
        Photons that reach the detectors in the same mean; they equal `counts` unless detectors
        click.
    throughput : float
        Share of the budget that reaches the detectors, averaged over training scenes, before masks
        are quantised for a test.
    photons_per_mask : list of float
        Expected photons of each mask, both rails together, averaged in the same way.

    Examples
    --------
    >>> from deepfsi import evaluate, learn, load_dataset
    >>> digits = load_dataset("digits")
    >>> design = learn(digits, photons=1e4, masks=6, design="pca", training={"epochs": 1})
    >>> [result] = evaluate(design, digits, 1e4, draws=2)
    >>> result.images * result.draws == sum(map(sum, result.confusion))
    True
    """

    kind = ClassAnswers
    accuracy: float
    balanced: float
    balanced_low: float
    balanced_high: float
    rates: list[float | None]
    confusion: list[list[int]]
    calibration_error: float
    log_loss: float

    @classmethod
    def of(cls, answers: ClassAnswers) -> Self:
        """The result of answers."""
        confusion = answers.confusion.tolist()
        return cls(**cls._values(answers), rates=answers.rates, confusion=confusion)

    def cells(self, classes: Sequence[str]) -> list[tuple[str, str]]:
        """Accuracy of the worst class, for a table."""
        worst = worst_class(self.rates)
        return [("worst class", f"{self.rates[worst]:.3f} ({short_name(classes[worst])})")]

    @property
    def right(self) -> list[float]:
        """Share of each test image's draws that is answered right.

        Designs are compared by it on the same images (`paired_difference`).
        """
        return self.image_terms.get("accuracy", [])


@dataclass(frozen=True)
class Estimates(_AnswerTest):
    """A design that estimates q values, at one budget."""

    kind = ValueAnswers
    legend = "of each value: root mean squared error"
    r2: float
    values: list[str]  # names of the values
    r2_each: list[float]  # R² of each value
    rmse: list[float]

    @classmethod
    def of(cls, answers: ValueAnswers, names: Sequence[str]) -> Self:
        """The result of estimates of values with these names."""
        return cls(
            **cls._values(answers),
            values=list(names),
            r2_each=(1 - answers.losses.mean(axis=0)).tolist(),
            rmse=np.sqrt(answers.squares.mean(axis=0)).tolist(),
        )

    def cells(self, classes: Sequence[str]) -> list[tuple[str, str]]:
        """Error of each value, for a table."""
        names = map(short_name, self.values)
        return [(name, f"{error:.3g}") for name, error in zip(names, self.rmse, strict=True)]


def lit_masks(rails_or_matrix: np.ndarray) -> int:
    """Number of masks that have light in any rail, of rails (2 or 1, m, N) or a matrix (m, N)."""
    lit = np.asarray(rails_or_matrix).any(axis=-1)
    return int((lit.any(axis=0) if lit.ndim == 2 else lit).sum())


def lit_text(masks: int, lit: float) -> str:
    """Number of masks asked and lit: 24 asked, 16 lit: 8 have no time under this budget."""
    dark = masks - lit
    have = "has" if dark == 1 else "have"
    return f"{masks} asked, {lit:.3g} lit: {dark:.3g} {have} no time under this budget"


def results_lines(
    tests: Sequence[Result | Estimates], *, title: str, classes: Sequence[str] = ()
) -> Iterator[str | Table]:
    """Tests of a design in a table, and what the numbers mean."""
    results = sorted(tests, key=lambda r: r.photons)
    first = results[0]
    clicks = any(result.clicks for result in results)
    light = ("counts", "arriving") if clicks else ("counts",)
    main, *others = first.measures()
    others = [
        measure
        for measure in others
        if measure.column and any(r.score(measure.key) is not None for r in results)
    ]
    rows = []
    for result in results:
        scores = [result.score(measure.key) for measure in others]
        rows.append(
            (
                budget_text(result.photons),
                rate_text(*(getattr(result, key) for key in main.keys)),
                *("–" if score is None else f"{score:.3f}" for score in scores),
                *(cell for _, cell in result.cells(classes)),
                *(count_text(getattr(result, name)) for name in light),
                f"{result.throughput:.3f}",
            )
        )
    columns = [measure.column for measure in (main, *others)]
    columns += [name for name, _ in first.cells(classes)]
    yield Table(title, ("photons", *columns, *light, "counted"), rows)
    if first.legend:
        yield first.legend
    rates = first.rates if isinstance(first, Result) else []
    if None in rates:
        untested = [name for name, rate in zip(classes, rates, strict=True) if rate is None]
        yield f"never tested, as the test has no scene of it: {', '.join(untested)}"
    yield f"± half of the 95 % interval: {first.covers}"
    yield (
        f"counts: {'clicks' if clicks else 'photons'} of a test scene in the mean; counted: share "
        f"of the budget that {'reaches detectors' if clicks else 'they are'}, over training scenes"
    )
    yield from (measure.legend for measure in others if measure.legend)
