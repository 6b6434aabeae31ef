"""The verdict of a comparison in one sentence: which masks need less light, and how much less."""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

from deepfsi.base.numeric.intervals import Crossing, accuracy_difference, find_crossing
from deepfsi.camera.names import noise_text
from deepfsi.jobs.designs import DESIGNS
from deepfsi.measures.table import main_measure
from deepfsi.report.rendering import capital, share_text
from deepfsi.report.series import DESIGN_AND_OPTICS, Series, noises, shares_light
from deepfsi.report.style import photons_text
from deepfsi.sweeps.results import Point, Results

_SUBJECTS = {"deepfsi": "learned masks (DeepFSI)", "adaptive": "adaptive masks"}
"""Designs whose names in a sentence are masks."""


@dataclass(frozen=True)
class ComparisonVerdict:
    """The verdict of a comparison."""

    title: str  # for a heading: "Learned masks (DeepFSI) need 3 (2 to 4) times less light than PCA"
    text: str  # the same with its numbers, a sentence
    photons: float  # budget at which the designs differ most, of those tested
    best: Point  # of the most accurate design there


def verdict_of(results: Results) -> ComparisonVerdict:
    """The verdict of a comparison, under the first of its noises.

    The most accurate design of a camera is compared with the most accurate one that is neither
    learned nor adaptive, at the budget where they differ most. How many times less light it needs
    is found where the curve of the other meets its accuracy, or where its own meets that of the
    other, within the tested budgets; else the accuracies at that budget are said. Where the
    difference is not above 0 at any budget, the verdict says so.
    """
    noise = noises(results)[0]
    points = [p for p in results.points if p.noise == noise and p.best]
    series = Series.of(results, points)
    budgets = sorted({p.photons for p in points})
    rankings = [ranking(points, photons) for photons in budgets]
    under = f" under {noise_text(noise)}" if len(noises(results)) > 1 else ""
    measure = main_measure(results.data.measure).title

    def name(point: Point) -> str:
        return series.name(point).replace(point.title, _SUBJECTS.get(point.design, point.title), 1)

    pairs = [(first, _rival(others)) for first, *others in rankings if others]
    if not pairs:
        best = rankings[-1][0]
        reached = f"{_verb(best, 'reach')} {measure} {share_text(best.accuracy)}{under}"
        title = f"{capital(name(best))} {reached}"
        return ComparisonVerdict(title, f"{title} at {_photons(best)}.", best.photons, best)
    pairs.sort(key=lambda pair: pair[1].accuracy - pair[0].accuracy)
    clear = [pair for pair in pairs if better(*pair)]
    ratios = [_times(*pair, series, images=results.data.test) for pair in clear]
    index = next((index for index, ratio in enumerate(ratios) if ratio), 0)
    first, other = (clear or pairs)[index]
    one = capital(name(first))
    two = name(other)
    at = (
        f"at {_photons(first)} {measure} is {share_text(first.accuracy)}, and "
        f"{share_text(other.accuracy)} with {two}"
    )
    if not clear:
        pair = "The best designs" if len(budgets) > 1 else f"{one} and {two}"
        where = "any budget" if len(budgets) > 1 else _photons(first)
        title = f"{pair} cannot be told apart at {where}{under}"
        return ComparisonVerdict(title, f"{title}: with {name(first)}, {at}.", first.photons, first)
    if not ratios[index]:
        title = f"{one} {_verb(first, 'are', 'is')} better than {two} at {_photons(first)}{under}"
        return ComparisonVerdict(title, f"{title}: {at}.", first.photons, first)
    light = "mean light" if shares_light(first) or shares_light(other) else "light"
    title = f"{one} {_verb(first, 'need')} {ratios[index]} times less {light} than {two}{under}"
    return ComparisonVerdict(title, f"{title} for the same {measure}: {at}.", first.photons, first)


def ranking(points: Sequence[Point], photons: float) -> list[Point]:
    """Designs at a budget, most accurate first; impulse imaging only if alone."""
    # Of a design that was trained in several ways on the same light, the one that validation chose
    optics: dict[tuple[Any, ...], Point] = {}
    here = [p for p in points if p.photons == photons]
    for p in sorted(here, key=lambda p: -1.0 if p.validation is None else p.validation):
        optics[tuple(getattr(p, axis) for axis in (*DESIGN_AND_OPTICS, "levels", "masks"))] = p
    single = [p for p in optics.values() if not p.every_pixel]
    return sorted(single or optics.values(), key=lambda p: -p.accuracy)


def _rival(points: Sequence[Point]) -> Point:
    """The first of a ranking that is neither learned nor adaptive, or else the first."""
    for point in points:
        code = DESIGNS.get(point.design)
        if code is None or not (code.learns_masks or code.adaptive):
            return point
    return points[0]


def better(first: Point, second: Point) -> bool:
    """True if the first is more accurate than the second on the same test images."""
    return accuracy_difference(first, second).low > 0


def _times(first: Point, other: Point, series: Series, *, images: int) -> str | None:
    """Ratio of the light that two designs need, with its 95 % interval, in words.

    None unless both curves reach the accuracy within the tested budgets, and the interval, too.
    """
    mine, theirs = (
        sorted(series.groups[series.key(point)], key=lambda p: p.photons)
        for point in (first, other)
    )
    for curve, point in ((theirs, first), (mine, other)):
        ends = (point.low, point.accuracy, point.high)
        low, best, high = (_meets(curve, target, images) for target in ends)
        if low.low and best.photons and high.high:
            ratios = [photons / first.photons for photons in (low.low, best.photons, high.high)]
            if curve is mine:
                ratios = [1 / ratio for ratio in reversed(ratios)]
            if ratios[0] < 1.15:  # an interval that begins at 1 says nothing of how many times
                return None
            return "{1} ({0} to {2})".format(*map(_ratio_text, ratios))
    return None


def _meets(curve: Sequence[Point], target: float, images: int) -> Crossing:
    """Where a curve meets a target; of one budget that is not known."""
    if len(curve) < 2:
        return Crossing(None, None, None, "beyond")
    trials = [[max(score, 0.0) for score in p.accuracies] for p in curve]  # R² may lie below 0
    return find_crossing([p.photons for p in curve], trials, images, target)


def _ratio_text(ratio: float) -> str:
    return f"{ratio:.1f}" if ratio < 1.95 else f"{float(f'{ratio:.1g}'):.0f}"


def _photons(point: Point) -> str:
    return f"{photons_text(point.photons)} photons"


def _verb(point: Point, plural: str, singular: str = "") -> str:
    """The verb that a design's name takes."""
    if point.design in _SUBJECTS:
        return plural
    return singular or (f"{plural}es" if plural.endswith("ch") else f"{plural}s")
