"""The output folder of a comparison, as one HTML page that needs nothing else."""

import os
import shlex
from collections.abc import Iterable, Iterator
from itertools import zip_longest
from pathlib import Path
from typing import Any

import numpy as np
from markupsafe import Markup

from deepfsi.base.errors import InputError
from deepfsi.base.files import write_atomically
from deepfsi.base.numeric.intervals import accuracy_difference
from deepfsi.base.quantities import Table, budget_text, plural, rate_text, short_name
from deepfsi.camera.names import LIGHT_LAWS, noise_text
from deepfsi.designfile.design_file import DesignFile
from deepfsi.jobs.designs import ADAPTIVE
from deepfsi.measures.lines import error_text, worst_text
from deepfsi.measures.results import lit_masks, lit_text
from deepfsi.measures.table import MEASURES, main_measure
from deepfsi.report.accuracy import accuracy_figure, count_figure
from deepfsi.report.masks import masks_figure, peak_value, signed, values_figure
from deepfsi.report.rendering import (
    DESIGN_TERMS,
    capital,
    confusion_table,
    english_list,
    flat,
    render,
    share_text,
)
from deepfsi.report.series import DESIGN_AND_OPTICS, Series, noises, shares_light
from deepfsi.report.style import Figures, photons_text
from deepfsi.report.verdict import ComparisonVerdict, better, ranking, uneven_point, verdict_of
from deepfsi.sweeps.results import Data, Point, Results, read_results

MASKS_SHOWN = 12
"""Masks of a design that the page shows at most."""

PagePart = dict[str, Any]
"""Part of a page by the names that its template uses."""


def write_report(folder: str | os.PathLike[str]) -> Path:
    """Write `report.html` and its figures into the output folder of a comparison.

    It holds `results.json` and, for the pictures of masks, `designs/KEY.safetensors`.
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
    data = results.data
    points = results.points
    learned = list(_learned_masks(results, designs, figures))
    verdict = verdict_of(results)
    return render(
        "page.html.jinja",
        results=results,
        title=verdict.title,
        camera=_camera_text(points),
        two_rails=any(p.rails == "dual" for p in points if not p.every_pixel),
        impulse=any(p.every_pixel for p in points),
        bullets=[
            verdict.text,
            _compared_text(results),
            *(summary_text(results, noise) for noise in noises(results)),
            covers_text(results),
        ],
        variants=len(Series.of(results).groups) > len({p.design for p in points}),
        accuracy=list(_accuracy_panels(results, figures)),
        counts=list(_count_panels(results, figures)),
        tables=[_best_table(results, noise) for noise in noises(results)],
        designs=dict.fromkeys((p.title, p.label, DESIGN_TERMS.get(p.design)) for p in points),
        lights=sorted({p.light for p in points}),
        confusions=list(_confusions(results, verdict)),
        learned=learned,
        following=list(_next_steps(results, designs, verdict)),
        learned_missing=not learned and any(p.learned for p in points),
        masks_shown=MASKS_SHOWN,
        scene=_scene_text(data.image_shape),
        answers=f"values: {english_list([*data.values])}"
        if data.values
        else f"{len(data.classes)} classes",
        names=data.classes or data.values,
        measure=main_measure(data.measure),
        further=[
            measure
            for measure in MEASURES.values()
            if measure.averaged
            and measure.column
            and any(point.score(measure.key) is not None for point in points)
        ],
        errors=list(_value_errors(results)),
        optics=_optics_text,
        facts=[
            ("Data", list(flat({k: v for k, v in data.as_dict().items() if k != "classes"}))),
            ("Recipe", list(flat(results.recipe))),
            ("Made with", list(flat(results.provenance.as_dict()))),
        ],
    )


def _compared_text(results: Results) -> str:
    """Say what is compared, and how it is measured."""
    points = [p for p in results.points if not p.every_pixel] or results.points
    designs = len({p.design for p in results.points})
    many = f"{designs} ways to choose a camera’s masks" if designs > 1 else "One choice of masks"
    laws = english_list(sorted({p.light for p in points}))
    scenes = f"{results.data.test} test scenes of {results.data.name}"
    task = main_measure(results.data.measure).task.format(scenes=scenes)
    parts = scenes_text(results.data)
    light = "equal mean light" if any(map(shares_light, points)) else "equal light"
    return f"{many}, at {light} (light law {laws}): {task}. {capital(parts)}."


def _mean_light_text(points: Iterable[Point]) -> str | None:
    """Light that exposures which may end early took in the tests, in words; None without such."""
    taken = [point.further["mean_light"] for point in points if shares_light(point)]
    if not taken:
        return None
    ends = " to ".join(f"{share:.3f}" for share in sorted({min(taken), max(taken)}))
    return (
        "Mean light: exposures end early where a class is sure, or no look is worth its clicks. "
        f"Test scenes took {ends} of the budget."
    )


def scenes_text(data: Data) -> str:
    """Scenes that designs of a comparison were trained and tested on, in words."""
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


def covers_text(results: Results) -> str:
    """Say what impulse imaging and guessing reach, and what the intervals cover."""
    ideal = sorted((p for p in results.points if p.every_pixel and p.best), key=lambda p: p.photons)
    text = ""
    if ideal:
        pixels = int(np.prod(results.data.image_shape))
        text = (
            f"Impulse imaging, with a detector for each of the {pixels} pixels, reaches "
            f"{_ends(ideal)} photons. "
        )
        if any(p.design in ADAPTIVE for p in results.points):
            text += (
                "A network reads it, and a posterior over the training scenes reads adaptive "
                "masks. That may be the better reader, so that adaptive masks can be above impulse "
                "imaging, whose counts tell more. "
            )
    covers = "; ".join(dict.fromkeys(p.covers for p in results.points))
    guessing = main_measure(results.data.measure).guessing
    if (light := _mean_light_text(p for p in results.points if p.best)) is not None:
        text += f"{light} "
    return (
        f"{text}Chance is {share_text(results.data.chance)}, {guessing}. "
        f"The intervals are of 95 % and cover {covers}."
    )


def _with_one_detector(points: Iterable[Point]) -> bool:
    """True if one detector does for every design but impulse imaging."""
    laws = {name for name, law in LIGHT_LAWS.items() if law.in_turn and law.arms == 1}
    return all(p.light in laws and p.detectors == "1x1" for p in points if not p.every_pixel)


def _camera_text(points: Iterable[Point]) -> str:
    """Say how the designs' masks share the light, and what counts it."""
    rows = [p for p in points if not p.every_pixel]
    lights = {p.light for p in rows}
    splitting = {name for name, law in LIGHT_LAWS.items() if not law.in_turn}
    if lights and lights <= splitting:
        return (
            f"Under the light law {min(lights)}, optics split the scene’s Φ photons among all "
            "masks at once, with a detector for each readout, which no single mirror device does."
        )
    if rows and _with_one_detector(rows):
        return (
            "A camera with one detector: each mask in turn sends it a part of the scene’s Φ "
            "photons."
        )
    return "Each mask sends a part of the scene’s Φ photons to a detector."


def _optics_text(point: Point) -> str:
    """Light law and rails of a point, with several detectors and both rails read where it has."""
    parts = [point.light, point.rails]
    if point.detectors != "1x1":
        parts.append(f"{point.detectors} detectors")
    if point.readout == "both":
        parts.append("both read")
    return ", ".join(parts)


def _next_steps(
    results: Results, designs: Path, verdict: ComparisonVerdict
) -> Iterator[tuple[str, str]]:
    """Next steps, in words and as commands: to see an exposure, and to show masks on a device."""
    points = [p for p in results.points if p.best and not p.every_pixel]
    # Of a law that this package does not know, as of a later one, a device is not ruled out
    showable = [p for p in points if p.light not in LIGHT_LAWS or LIGHT_LAWS[p.light].one_device]

    def file(point: Point) -> str | None:
        name = f"{point.keys[0]}.safetensors"
        return f"designs/{name}" if (designs / name).is_file() else None

    played = file(verdict.best)
    if played and not (results.data.values or verdict.best.every_pixel):
        words = f"Watch exposures of {verdict.best.title}, in the folder of this page:"
        yield words, f"deepfsi page {played} -o page.html"
    there = [p for p in showable if file(p) and p.design not in ADAPTIVE]
    if there:
        best = max(there, key=lambda p: (p.photons == verdict.photons, p.photons, p.accuracy))
        words = f"Write the masks of {best.title} for your device, in the folder of this page:"
        yield words, f"deepfsi dmd export {file(best)} --device dlp7000 --exposure 10ms -o patterns"
        return
    name = shlex.quote(str(results.recipe.get("data", results.data.name)))
    if showable:
        words = "Learn one design, whose file the commands for a device take:"
    else:
        light = points[0].light if points else "column"
        words = (
            f"No single device shows masks of the light law {light}. Compare designs that one "
            "shows:"
        )
    design = "design --masks 16 --photons 1e4 -o d.safetensors"
    command = design if showable else "compare -o runs/dmd"
    yield words, f"deepfsi {command} --camera dmd --data {name}"


def _scene_text(shape: tuple[int, ...]) -> str:
    """Scene's size in words."""
    if len(shape) == 1:
        return f"{shape[0]} bands"
    return f"{' × '.join(map(str, shape))} = {int(np.prod(shape))} pixels"


def _chosen(results: Results, noise: str) -> list[Point]:
    """Points at the chosen mask counts under a noise."""
    return [p for p in results.points if p.noise == noise and p.best]


def _leaders(points: list[Point], photons: float) -> list[Point]:
    """The first of a ranking, and all that it is not told apart from on the same test images."""
    first, *others = ranking(points, photons)
    return [first, *(p for p in others if not better(first, p))]


def leader_differences(results: Results) -> Iterator[dict[str, Any]]:
    """Paired differences of the first of each ranking to the others, by noise and budget."""
    for noise in noises(results):
        points = _chosen(results, noise)
        series = Series.of(results, points)
        for photons in sorted({p.photons for p in points}):
            first, *others = ranking(points, photons)
            for other in others:
                difference = accuracy_difference(first, other)
                yield {
                    "noise": noise,
                    "photons": photons,
                    "first": series.name(first),
                    "second": series.name(other),
                    "difference": difference.mean,
                    "low": difference.low,
                    "high": difference.high,
                }


def summary_text(results: Results, noise: str) -> str:
    """Say which designs are the most accurate under a noise, and which cannot be told apart."""
    points = _chosen(results, noise)
    series = Series.of(results, points)
    groups: dict[tuple[str, ...], list[list[Point]]] = {}
    for photons in sorted({p.photons for p in points}):
        leaders = _leaders(points, photons)
        groups.setdefault(tuple(map(series.name, leaders)), []).append(leaders)
    where = " with one detector" if _with_one_detector(points) else ""
    sentences = []
    for best, rows in groups.items():
        first = [row[0] for row in rows]
        at = english_list([photons_text(p.photons) for p in first])
        several = first[0].design in ADAPTIVE  # the name is of masks
        if len(best) > 1:
            scores = [p.accuracy for row in rows for p in row]
            sentences.append(
                f"At {at} photons {english_list([*best])} cannot be told apart on the same test "
                f"scenes: they reach {share_text(min(scores))} to {share_text(max(scores))}."
            )
        elif len(series.groups) == 1:
            sentences.append(f"{best[0]} {'reach' if several else 'reaches'} {_ends(first)}.")
        else:
            most = "most accurate" if results.data.measure == "accuracy" else "best"
            reach = _ends(first) if len(first) > 1 else _reach(first[0])
            verb = "are" if several else "is"
            sentences.append(f"{best[0]} {verb} the {most}{where} at {at} photons: {reach}.")
    sentences += [
        f"{series.name(p)} at {photons_text(p.photons)} photons answers one class only."
        for p in sorted(points, key=lambda p: p.photons)
        if p.one_class
    ]
    return f"Under {noise_text(noise)}: {' '.join(map(capital, sentences))}"


def _ends(rows: list[Point]) -> str:
    """Accuracies and intervals of the first and the last of rows, in the order of their budgets."""
    ends = [rows[0], rows[-1]][: len(rows)]
    return english_list([_reach(p, f" at {photons_text(p.photons)}") for p in ends])


def _reach(point: Point, where: str = "") -> str:
    """Accuracy, interval, place and number of masks of a point."""
    interval = f"({share_text(point.low)}–{share_text(point.high)})"
    masks = "" if point.every_pixel else f" with {plural(point.masks, 'mask')}"
    return f"{share_text(point.accuracy)} {interval}{where}{masks}"


def _accuracy_panels(results: Results, figures: Figures) -> Iterator[PagePart]:
    """Accuracy against photons, a picture for each noise."""
    measure = capital(main_measure(results.data.measure).title)
    for number, noise in enumerate(noises(results), start=1):
        drawn = accuracy_figure(results.with_points(_chosen(results, noise)))
        words = f"{measure} against photon budget under {noise_text(noise)}; numbers in the table."
        picture = figures.add(f"accuracy-{number}", drawn, words)
        yield {"heading": noise_text(noise).capitalize(), "picture": picture}


def _count_panels(results: Results, figures: Figures) -> Iterator[tuple[str, list[PagePart]]]:
    """Accuracy against mask count for each noise and budget, if any design has several counts."""
    counted = Series(results.points, ("noise", *DESIGN_AND_OPTICS)).groups.values()
    if all(len({p.masks for p in rows}) < 2 for rows in counted):
        return
    measure = capital(main_measure(results.data.measure).title)
    for i, noise in enumerate(noises(results), start=1):
        points = [p for p in results.points if p.noise == noise]
        panels = []
        for j, photons in enumerate(sorted({p.photons for p in points}), start=1):
            drawn = count_figure(results.with_points(p for p in points if p.photons == photons))
            where = f"{photons_text(photons)} photons"
            words = f"{measure} against number of masks at {where}; see the last table."
            picture = figures.add(f"count-{i}-{j}", drawn, words)
            panels.append({"heading": where, "picture": picture})
        yield noise_text(noise).capitalize(), panels


def _best_table(results: Results, noise: str) -> PagePart:
    """Chosen mask counts under a noise: a row for each series, a column for each budget."""
    points = _chosen(results, noise)
    series = Series.of(results, points)
    budgets = sorted({p.photons for p in points})
    rows = []
    for members in series.groups.values():
        at = {p.photons: p for p in members}
        row = [at.get(photons) for photons in budgets]
        rows.append((series.name(members[0]), members[0], row))
    return {
        "heading": noise_text(noise).capitalize(),
        "budgets": budgets,
        "rows": rows,
        "leaders": {photons: _leaders(points, photons) for photons in budgets},
    }


def _value_errors(results: Results) -> Iterator[PagePart]:
    """Root mean squared errors of values at the chosen mask counts, by noise, series and budget."""
    for noise in noises(results):
        points = [p for p in _chosen(results, noise) if p.rmse]
        if points:
            series = Series.of(results, points)
            ordered = sorted(points, key=lambda p: (p.photons, -p.accuracy))
            rows = [(series.name(p), p) for p in ordered]
            yield {"heading": noise_text(noise).capitalize(), "rows": rows}


def _confusions(results: Results, verdict: ComparisonVerdict) -> Iterator[PagePart]:
    """Confusion matrices by noise and budget, at the chosen mask counts; that of the verdict open.

    Each has its `budget` in words, and the `matrices` of the designs there, best first.
    """
    classes = results.data.classes
    for noise in noises(results):
        points = [p for p in _chosen(results, noise) if p.confusion]
        if any([*map(len, p.confusion)] != [len(classes)] * len(classes) for p in points):
            raise InputError(
                "a confusion matrix is not of the data's classes: run the comparison again"
            )
        series = Series.of(results, points)
        opened = verdict.best if verdict.best in points else next(iter(points), None)
        for photons in sorted({p.photons for p in points}):
            here = [p for p in points if p.photons == photons]
            yield {
                "budget": f"{photons_text(photons)} photons, {noise_text(noise)}",
                "matrices": [
                    {
                        "name": series.name(point),
                        "open": point == opened,
                        "table": Markup(confusion_table(point.confusion, classes)),
                    }
                    for point in sorted(here, key=lambda p: (p.every_pixel, -p.accuracy))
                ],
            }


def _learned_masks(results: Results, designs: Path, figures: Figures) -> Iterator[PagePart]:
    """Masks and value distributions of every learned design whose files are there, by budget."""
    for i, noise in enumerate(noises(results), start=1):
        series = Series.of(results, [p for p in _chosen(results, noise) if p.learned])
        for j, members in enumerate(series.groups.values(), start=1):
            # the files hold masks before they are quantised for a test
            files = {designs / f"{p.keys[0]}.safetensors": p for p in members if not p.levels}
            there = sorted((p.trained_at, path) for path, p in files.items() if path.is_file())
            panels = [
                _mask_panel(files[path], path, f"{i}-{j}-{number}", figures)
                for number, (_, path) in enumerate(there, start=1)
            ]
            if panels:
                name = series.name(members[0])
                yield {"heading": f"{name}, {noise_text(noise)}", "panels": panels}


def _mask_panel(point: Point, file: Path, number: str, figures: Figures) -> PagePart:
    """Masks of one design at one budget, and the distribution of their values."""
    design = DesignFile.read(file, ("rails",))
    rails = design.rails
    masks = design.masks
    where = f"{photons_text(point.trained_at)} photons"
    lit = lit_masks(rails)
    which = f"the brightest {MASKS_SHOWN} of {masks} masks"
    if lit <= MASKS_SHOWN:
        which = f"all {masks} masks" if masks > 1 else "its one mask"
    if lit < masks:
        most = "the brightest " if lit > MASKS_SHOWN else "these "
        which = f"{lit_text(masks, lit)}; {most}{min(lit, MASKS_SHOWN)}"
    drawn = masks_figure(rails, design.mask_header.mask_shape, count=MASKS_SHOWN)
    spread = values_figure(rails)
    peak = f"{peak_value(signed(rails)):.2g}"
    counted = share_text(point.throughput)
    words = f"Histogram of the mask values learned at {where}."
    return {
        "heading": where,
        "note": f"{which}, peak {peak}, {counted} of the budget counted",
        "drawn": figures.add(f"masks-{number}", drawn, f"Masks learned at {where}, {which}."),
        "spread": figures.add(f"values-{number}", spread, words),
    }


def comparison_lines(results: Results) -> Iterator[str | Table]:
    """A comparison for a terminal: a row for each design, a column for each budget, the verdict."""
    tables = {noise: _best_table(results, noise) for noise in noises(results)}
    budgets = sorted({photons for table in tables.values() for photons in table["budgets"]})
    several = len(tables) > 1
    rows = []
    for noise, table in tables.items():
        for name, _, cells in table["rows"]:
            at = {
                cell.photons: rate_text(cell.accuracy, cell.low, cell.high).replace(" ", "")
                + " *"[cell in table["leaders"][cell.photons]]
                for cell in cells
                if cell
            }
            under = (noise,) if several else ()
            rows.append((name, *under, *(at.get(photons, "– ") for photons in budgets)))
    yield Table(
        f"{main_measure(results.data.measure).title} by photon budget",
        ("design", *("noise",) * several, *(f"{budget_text(photons)} " for photons in budgets)),
        rows,
    )
    best = [point for point in results.points if point.best]
    for point in best:
        if point.one_class:
            yield f"{point.title} at {budget_text(point.photons)} photons answers one class only"
    aside = ", impulse imaging aside" if any(point.every_pixel for point in best) else ""
    yield (
        f"* the highest{aside}, and all that cannot be told apart from it; chance is "
        f"{results.data.chance:.3f}"
    )
    covers = "; ".join(dict.fromkeys(point.covers for point in best))
    yield f"± half of the 95 % interval: {covers}"
    if (light := _mean_light_text(best)) is not None:
        yield light
    if (uneven := uneven_point(best)) is not None:
        worst = worst_text(uneven.worst, results.data.classes[uneven.worst_class])
        yield (
            f"each class counting alike, {uneven.title} at {budget_text(uneven.photons)} photons "
            f"has a balanced accuracy of {uneven.balanced or 0:.3f}, worst class {worst}; the "
            "report has those of all"
        )
    if results.data.values:
        yield _table_of_values(results, best)
    yield verdict_of(results).text


def _table_of_values(results: Results, best: list[Point]) -> Table:
    """Errors of each value, beside those of the best linear estimator."""
    series = Series.of(results, best)
    return Table(
        "root mean squared error (best linear estimator)",
        ("design", "photons", *map(short_name, results.data.values)),
        [
            (
                *(series.name(point), budget_text(point.photons)),
                *(error_text(*each) for each in zip_longest(point.rmse, point.bound)),
            )
            for point in sorted(best, key=lambda point: (point.photons, -point.accuracy))
        ],
    )
