"""Experiments: recipes, measures beyond accuracies, and the findings that follow from them."""

import io
import tomllib
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import cache
from importlib.resources import files
from pathlib import Path
from typing import Any

import polars

from deepfsi.base.errors import InputError, as_input_error
from deepfsi.base.files import write_atomically
from deepfsi.base.intervals import Difference, all_above
from deepfsi.base.progress import SILENT, Progress
from deepfsi.datasets.dataset import Dataset
from deepfsi.datasets.load import load_dataset
from deepfsi.report.style import photons_text
from deepfsi.sweeps.recipe import Recipe, only, parts
from deepfsi.sweeps.results import Point, Results, accuracy_difference, read_results, write_results
from deepfsi.sweeps.run import compare
from deepfsi.sweeps.summary import provenance_of
from deepfsi_paper.report.section import Claim, Picture, Section, Table, english_list

Measure = Callable[[Results, Dataset, Path, int | None, Progress], dict[str, Any]]


@dataclass(frozen=True)
class Finding:
    """Findings of an experiment, from its numbers."""

    found: str
    pictures: tuple[Picture, ...]
    claims: tuple[Claim, ...] = ()
    tables: tuple[Table, ...] = ()


@dataclass(frozen=True)
class Experiment:
    """One experiment of the paper."""

    name: str  # of its recipe file and its results
    title: str
    paper: str  # findings of the paper
    show: Callable[[Results], Finding]
    # Further numbers, kept in the results as `extra`; the data are those of the first recipe
    measure: Measure | None = None
    prepare: Callable[[Dataset], Dataset] = lambda data: data  # of trainings and tests
    label: str = ""  # of learned designs, where it is another here
    changes: Mapping[str, Any] = field(default_factory=dict, hash=False)  # of the recipes
    part: str | None = None  # the only part to run, where the recipe has several

    def recipes(self, quick: bool, trials: int | None = None) -> dict[str, Recipe]:
        """The recipes, or their coarse versions, by part; a single one has the experiment's name.

        `trials` takes the place of theirs.
        """
        file = files("deepfsi_paper") / "recipes" / f"{self.name}.toml"
        changes = {"folds": 1, **self.changes}  # the paper's split
        if trials is not None:
            changes["trials"] = trials
        content = tomllib.loads(file.read_text("utf-8"))
        if self.part is None:
            every = parts(content, quick)
        else:
            every = {self.part: only(content, self.part, quick)}
        with as_input_error():
            return {
                part or self.name: Recipe.model_validate({**settings, **changes})
                for part, settings in every.items()
            }

    def run(
        self,
        folder: Path,
        *,
        command: str,
        quick: bool = False,
        trials: int | None = None,
        device: str = "auto",
        workers: int | None = 1,
        ray: str | None = None,
        report: Progress = SILENT,
    ) -> Results:
        """Train and test what the folder does not hold yet, and write the numbers.

        The experiments of a study share one folder of records, so that what one has trained
        another only tests. `NAME.json` holds the results, `NAME.csv` a row for each point of the
        figures. Each point says the part that it is of, its `recipe`. Where a recipe names a split,
        its points and the name of the data do, too.
        """
        recipes = self.recipes(quick, trials)
        data = self._data(recipes)
        compared, points, records = list[Results](), list[Point](), list[dict[str, Any]]()
        spans = report.split(len(recipes) + (self.measure is not None))
        for (name, recipe), span in zip(recipes.items(), spans, strict=False):
            part, own = compare(
                recipe,
                data[name],
                folder,
                command=command,
                device=device,
                workers=workers,
                ray=ray,
                report=span,
            )
            compared.append(part)
            points += [self._named(point, name, recipe) for point in part.points]
            records += own
        results = _together(compared, points, records)
        if self.measure:
            first, designs = next(iter(data.values())), folder / "designs"
            extra = self.measure(results, first, designs, workers, spans[-1])
            results = results.model_copy(update={"extra": extra})
        averaged = [
            {name: value for name, value in point.as_dict().items() if not isinstance(value, list)}
            for point in results.points
        ]
        table = io.BytesIO()
        polars.DataFrame(averaged, infer_schema_length=None).write_csv(table)
        write_atomically(folder / f"{self.name}.csv", table.getvalue())
        write_results(folder / f"{self.name}.json", results)
        return results

    def _named(self, point: Point, part: str, recipe: Recipe) -> Point:
        names = {"recipe": part}
        if recipe.split:
            names |= {"data": recipe.data, "split": recipe.split}
        if self.label and point.learned:
            names |= {"label": self.label, "title": self.label}
        return point.model_copy(update=names)

    def _data(self, recipes: Mapping[str, Recipe]) -> dict[str, Dataset]:
        """Prepared data of each recipe, loaded once where recipes share it."""
        load = cache(lambda *source: self.prepare(_load(*source)))
        return {
            name: load(each.data, each.size, each.images, each.split)
            for name, each in recipes.items()
        }

    def section(self, folder: Path) -> Section | None:
        """The experiment's part of the page, or None where it was not run."""
        path = folder / f"{self.name}.json"
        if not path.is_file():
            return None
        try:
            results = read_results(path)
            shown = self.show(results)
        except (ValueError, KeyError) as error:
            raise InputError(
                f"{path} does not hold the results of this version: run the experiment again"
            ) from error
        return Section(
            name=self.name,
            title=self.title,
            found=shown.found,
            paper=self.paper,
            pictures=shown.pictures,
            claims=shown.claims,
            tables=shown.tables,
            files=(f"{self.name}.csv",),
            command=results.command,
            data=results.data.name,
        )


def _together(
    compared: Sequence[Results], points: Iterable[Point], records: Sequence[dict[str, Any]]
) -> Results:
    """Results of all parts: facts of the first, points, devices and times of all."""
    once = {record["key"]: record for record in records}  # parts may share a record
    seconds = sum(part.provenance.seconds for part in compared)
    spent = {"provenance": provenance_of(list(once.values()), seconds)}
    return compared[0].with_points(points).model_copy(update=spent)


def _load(
    name: str, size: tuple[int, int] | None, images: int | None, split: str | None
) -> Dataset:
    data = load_dataset(name, size=size, images=images, split=split)
    return replace(data, name=f"{data.name}, {split} split") if split else data


def points(results: Results, **fields: Any) -> list[Point]:
    """Points of results that have these values."""
    return [
        point
        for point in results.points
        if all(getattr(point, name) == value for name, value in fields.items())
    ]


def best(results: Results, **fields: Any) -> dict[tuple[str, float], Point]:
    """Points at their chosen number of masks, by design and budget."""
    return {(point.design, point.photons): point for point in points(results, best=True, **fields)}


def budgets(chosen: Iterable[Point]) -> list[float]:
    """Budgets of points, rising."""
    return sorted({point.photons for point in chosen})


Compared = dict[float, Difference]
"""Differences of accuracy by budget."""

NOTHING = 0.01
"""Difference in accuracy that counts as no gain."""


def gains(
    chosen: Mapping[tuple[str, float], Point],
    first: str,
    second: str,
    below: float = float("inf"),
) -> Compared:
    """Accuracy of one design less that of another, by rising budgets below a bound."""
    return {
        budget: accuracy_difference(point, chosen[(second, budget)])
        for (design, budget), point in sorted(chosen.items(), key=lambda item: item[0][1])
        if design == first and budget < below and (second, budget) in chosen
    }


def no_gain(label: str, compared: Compared, why: str = "") -> Claim:
    """Claim that a code gains nothing over raster scan at any budget."""
    most = max(compared, key=lambda budget: compared[budget].mean)
    clear = [photons_text(budget) for budget, each in compared.items() if each.low > 0]
    where = f"; above at {english_list(clear)} photons" if clear else ""
    return Claim(
        f"{label} gains nothing over RS (less than {NOTHING})",
        all_above([-each for each in compared.values()], -NOTHING),
        f"{label.split()[-1]} − RS at most {compared[most]} at {photons_text(most)} photons{where}",
        why if clear else "",
    )
