"""The output folder of a comparison, as one HTML page that needs nothing else."""

import os
from collections.abc import Iterable, Iterator, Sequence
from pathlib import Path
from typing import Any, NamedTuple

from deepfsi.base.errors import InputError
from deepfsi.base.files import write_atomically
from deepfsi.base.intervals import find_crossing
from deepfsi.base.quantities import Table, budget_text, rate_text, short_name
from deepfsi.camera.names import noise_text
from deepfsi.designfile.design_file import DesignFile
from deepfsi.evaluation.measures import main_measure
from deepfsi.jobs.designs import ADAPTIVE, DESIGNS
from deepfsi.report.accuracy import (
    DESIGN_AND_OPTICS,
    Series,
    accuracy_figure,
    count_figure,
    noises,
    shares_light,
)
from deepfsi.report.masks import masks_figure, signed
from deepfsi.report.rendering import capital, render
from deepfsi.report.style import Figures, photons_text
from deepfsi.sweeps.results import Data, Point, Results, accuracy_difference, read_results

MASKS_SHOWN = 12
"""Largest number of masks of a design that the page shows."""

PagePart = dict[str, Any]
"""Part of a page by the names that its template uses."""


def write_report(folder: str | os.PathLike[str]) -> Path:
    """Write `report.html` and its figures into the output folder of a comparison.

    It holds `results.json` and, for pictures of masks, `designs/KEY.safetensors`.
    """
    home = Path(folder)
    if not (home / "results.json").is_file():
        raise InputError(f"no results in {home}: make them with `deepfsi compare -o {home}`")
    figures = Figures()
    text = _page_text(read_results(home / "results.json"), home / "designs", figures)
    figures.write(home)
    return write_atomically(home / "report.html", text.encode())


def _page_text(results: Results, designs: Path, figures: Figures) -> str:
    """Text of the page."""
    best = [p for p in results.points if p.best]
    verdict = verdict_of(results)
    return render(
        "page.html.jinja",
        results=results,
        data=results.data,
        names=results.data.classes or results.data.values,
        measure=main_measure(results.data.measure),
        verdict=verdict,
        scenes=scenes_text(results.data),
        mean_light=_mean_light_text(best),
        accuracy=list(_accuracy_panels(results, figures)),
        counts=list(_count_panels(results, figures)),
        tables=[_best_table(results, noise) for noise in noises(results)],
        errors=_errors_table(results, best) if results.data.values else None,
        confused=verdict.best,
        learned=list(_mask_panels(best, verdict.best.photons, designs, figures)),
        adaptive=ADAPTIVE,
    )


def _mean_light_text(points: Iterable[Point]) -> str | None:
    """Sentence on the light that exposures took, if some may end early."""
    taken = [point.further["mean_light"] for point in points if shares_light(point)]
    if not taken:
        return None
    ends = " to ".join(f"{share:.3f}" for share in sorted({min(taken), max(taken)}))
    return (
        "Mean light: exposures end early where a class is sure, or no look is worth its clicks. "
        f"Test scenes took {ends} of the budget."
    )


def scenes_text(data: Data) -> str:
    """Sentence on the scenes that designs were trained and tested on."""
    words = f"trained on {data.train} scenes, tested on {data.test}"
    if data.folds > 1:
        words = (
            f"{data.folds} folds: each of the {data.test} scenes is tested once, by designs that "
            f"were trained on {data.train} others"
        )
    if not data.validation:
        return words
    return (
        f"{words}; {data.validation} more are held out to choose numbers of masks, where "
        "deepfsi design trains on all"
    )


def _chosen(results: Results, noise: str) -> list[Point]:
    """Points at the chosen mask counts under a noise."""
    return [p for p in results.points if p.noise == noise and p.best]


def _mask_panels(
    points: Iterable[Point], photons: float, designs: Path, figures: Figures
) -> Iterator[PagePart]:
    """Masks of the first trial of each learned design at a budget, if its file is there."""
    # Files hold masks before they are quantised for a test
    learned = [p for p in points if p.learned and p.photons == photons and not p.levels]
    paths = [(p, designs / f"{p.keys[0]}.safetensors") for p in learned]
    files = [(point, path) for point, path in paths if path.is_file()]
    for number, (point, path) in enumerate(files, start=1):
        design = DesignFile.read(path, ("rails",))
        header = design.mask_header
        shape = header.exposure.mask_shape(header.image_shape)
        drawn = masks_figure(signed(design.rails), shape, count=MASKS_SHOWN)
        heading = f"{point.title} at {photons_text(photons)} photons"
        words = f"Masks of {heading}, up to {MASKS_SHOWN} of {design.masks}."
        yield {"heading": heading, "picture": figures.add(f"masks-{number}", drawn, words)}


def _accuracy_panels(results: Results, figures: Figures) -> Iterator[PagePart]:
    """Accuracy against photons, a picture for each noise."""
    measure = capital(main_measure(results.data.measure).title)
    for number, noise in enumerate(noises(results), start=1):
        drawn = accuracy_figure(results.with_points(_chosen(results, noise)))
        words = f"{measure} against photon budget under {noise_text(noise)}; numbers in the table."
        picture = figures.add(f"accuracy-{number}", drawn, words)
        yield {"heading": noise_text(noise).capitalize(), "picture": picture}


def _count_panels(results: Results, figures: Figures) -> Iterator[PagePart]:
    """Accuracy against mask count for each noise and budget, if any design has several counts."""
    counted = Series(results.points, ("noise", *DESIGN_AND_OPTICS)).groups.values()
    if all(len({p.masks for p in rows}) < 2 for rows in counted):
        return
    measure = capital(main_measure(results.data.measure).title)
    for i, noise in enumerate(noises(results), start=1):
        points = [p for p in results.points if p.noise == noise]
        for j, photons in enumerate(sorted({p.photons for p in points}), start=1):
            drawn = count_figure(results.with_points(p for p in points if p.photons == photons))
            where = f"{photons_text(photons)} photons, {noise_text(noise)}"
            words = f"{measure} against number of masks at {where}; numbers in results.json."
            yield {"heading": where, "picture": figures.add(f"count-{i}-{j}", drawn, words)}


def _best_table(results: Results, noise: str) -> PagePart:
    """Chosen mask counts under a noise: a row for each series, a column for each budget.

    The leaders of a budget are the first of the ranking, and all designs that the same test images
    do not tell apart from it.
    """
    points = _chosen(results, noise)
    series = Series.of(results, points)
    budgets = sorted({p.photons for p in points})
    rows = []
    for members in series.groups.values():
        by_budget = {p.photons: p for p in members}
        row = [by_budget.get(photons) for photons in budgets]
        rows.append((series.name(members[0]), members[0], row))
    leaders = []
    for photons in budgets:
        first, *rest = _ranking(points, photons)
        leaders += [first, *(p for p in rest if not _better(first, p))]
    heading = noise_text(noise).capitalize()
    return {"heading": heading, "budgets": budgets, "rows": rows, "leaders": leaders}


def _errors_table(results: Results, best: Iterable[Point]) -> Table:
    """Root mean squared errors of each value, a row for each point."""
    series = Series.of(results, best)
    return Table(
        "root mean squared error",
        ("design", "photons", *map(short_name, results.data.values)),
        [
            (
                *(series.name(point), budget_text(point.photons)),
                *(f"{error:.3g}" for error in point.rmse),
            )
            for point in sorted(best, key=lambda point: (point.photons, -point.accuracy))
        ],
    )


def comparison_lines(results: Results) -> Iterator[str | Table]:
    """A comparison for a terminal: a row for each design, a column for each budget, the verdict."""
    measure = main_measure(results.data.measure).title
    for noise in noises(results):
        table = _best_table(results, noise)
        rows = []
        for name, _, points in table["rows"]:
            cells = ["– "] * len(points)
            for column, point in enumerate(points):
                if point:
                    rate = rate_text(point.accuracy, point.low, point.high).replace(" ", "")
                    cells[column] = rate + ("*" if point in table["leaders"] else " ")
            rows.append((name, *cells))
        heads = ("design", *(f"{budget_text(photons)} " for photons in table["budgets"]))
        yield Table(f"{measure} by photon budget, {noise_text(noise)}", heads, rows)
    best = [point for point in results.points if point.best]
    aside = ", impulse imaging aside" if any(point.every_pixel for point in best) else ""
    yield (
        f"* the highest{aside}, and all that cannot be told apart from it; chance is "
        f"{results.data.chance:.3f}"
    )
    covers = "; ".join(dict.fromkeys(point.covers for point in best))
    yield f"± half of the 95 % interval: {covers}"
    if (light := _mean_light_text(best)) is not None:
        yield light
    if results.data.values:
        yield _errors_table(results, best)
    yield verdict_of(results).text


class _Verdict(NamedTuple):
    """The verdict of a comparison."""

    title: str  # a heading: "3 (2 to 4) times less light with DeepFSI than with PCA"
    text: str  # the same with its numbers, as a sentence
    best: Point  # the most accurate design, at the tested budget where designs differ most


def verdict_of(results: Results) -> _Verdict:
    """The verdict of a comparison, under the first of its noises.

    The most accurate design of a camera is compared with the most accurate rival that is neither
    learned nor adaptive, at the budget where they differ most. The ratio of their light is found
    where the rival's curve reaches the accuracy of the design, or where the design's curve reaches
    that of the rival. If neither does within the tested budgets, the verdict gives the accuracies.
    If the difference is not above 0 at any budget, it says that they cannot be told apart.
    """
    noise = noises(results)[0]
    points = _chosen(results, noise)
    series = Series.of(results, points)
    rankings = [_ranking(points, photons) for photons in sorted({p.photons for p in points})]
    under = f" under {noise_text(noise)}" if len(noises(results)) > 1 else ""
    measure = main_measure(results.data.measure).title
    pairs = [(first, _rival(rest)) for first, *rest in rankings if rest]
    if not pairs:
        best = rankings[-1][0]
        title = f"{capital(measure)} {best.accuracy:.3f} with {series.name(best)}{under}"
        return _Verdict(title, f"{title}, at {_photons(best)}.", best)
    pairs.sort(key=lambda pair: pair[1].accuracy - pair[0].accuracy)  # the largest lead first
    clear = [pair for pair in pairs if _better(*pair)]
    ratios = [_light_ratio(*pair, series, images=results.data.test) for pair in clear]
    index = next((index for index, ratio in enumerate(ratios) if ratio), 0)
    first, other = (clear or pairs)[index]
    one = series.name(first)
    two = series.name(other)
    if not clear:
        title = f"The best designs cannot be told apart{under}"
    elif not ratios[index]:
        title = f"{capital(measure)} is higher with {one} than with {two}{under}"
    else:
        light = "mean light" if shares_light(first) or shares_light(other) else "light"
        title = f"{ratios[index]} times less {light} with {one} than with {two}{under}"
    text = (
        f"{title}: at {_photons(first)} {measure} is {first.accuracy:.3f} with {one}, "
        f"{other.accuracy:.3f} with {two}."
    )
    return _Verdict(title, text, first)


def _ranking(points: Sequence[Point], photons: float) -> list[Point]:
    """Designs at a budget, most accurate first; impulse imaging only if it is alone."""
    # A design may be trained in several ways on the same light: validation chooses one
    optics: dict[tuple[Any, ...], Point] = {}
    at_budget = [p for p in points if p.photons == photons]
    for p in sorted(at_budget, key=lambda p: -1.0 if p.validation is None else p.validation):
        optics[tuple(getattr(p, axis) for axis in (*DESIGN_AND_OPTICS, "levels", "masks"))] = p
    single = [p for p in optics.values() if not p.every_pixel]
    return sorted(single or optics.values(), key=lambda p: -p.accuracy)


def _rival(points: Sequence[Point]) -> Point:
    """The first of a ranking that is neither learned nor adaptive, or else the first."""
    for point in points:
        facts = DESIGNS.get(point.design)
        if facts is None or not (facts.learns_masks or facts.adaptive):
            return point
    return points[0]


def _better(first: Point, second: Point) -> bool:
    """True if the first is more accurate than the second on the same test images."""
    return accuracy_difference(first, second).low > 0


def _light_ratio(first: Point, other: Point, series: Series, *, images: int) -> str | None:
    """How many times more light the other design needs, with its 95 % interval.

    None unless a curve reaches the other's accuracy, and both ends of its interval, within the
    tested budgets.
    """
    mine, theirs = (
        sorted(series.groups[series.key(point)], key=lambda p: p.photons)
        for point in (first, other)
    )
    for curve, point in ((theirs, first), (mine, other)):
        if len(curve) < 2:
            continue
        budgets = [p.photons for p in curve]
        trials = [[max(score, 0.0) for score in p.accuracies] for p in curve]  # R² may be below 0
        targets = point.low, point.accuracy, point.high
        # The lower end of the lowest accuracy, the value of the mean, the upper end of the highest
        low, best, high = (
            find_crossing(budgets, trials, images, target)[end]
            for end, target in enumerate(targets)
        )
        if low and best and high:
            ratios = [photons / first.photons for photons in (low, best, high)]
            if curve is mine:
                ratios = [1 / ratio for ratio in reversed(ratios)]
            # An interval that begins near 1 does not say how many times
            if ratios[0] < 1.15:
                return None
            return "{1} ({0} to {2})".format(*map(_ratio_text, ratios))
    return None


def _ratio_text(ratio: float) -> str:
    return f"{ratio:.1f}" if ratio < 1.95 else f"{float(f'{ratio:.1g}'):.0f}"


def _photons(point: Point) -> str:
    return f"{photons_text(point.photons)} photons"
