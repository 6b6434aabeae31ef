"""Commands that train many designs: compare, sweep, reproduce, report."""

from collections.abc import Mapping
from contextlib import nullcontext
from dataclasses import asdict, replace
from importlib import import_module
from importlib.resources import as_file, files
from importlib.util import find_spec
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import numpy as np

from deepfsi.base.errors import InputError, closest_choice
from deepfsi.base.files import read_toml
from deepfsi.base.models.strict import Count
from deepfsi.base.quantities import Table
from deepfsi.base.registry import check_report
from deepfsi.camera.camera import Camera
from deepfsi.cli import fields
from deepfsi.cli.command import Command
from deepfsi.cli.evaluate import data_lines
from deepfsi.cli.terminal import Outcome, Terminal
from deepfsi.datasets.dataset import Dataset
from deepfsi.datasets.load import load_dataset
from deepfsi.jobs.job import find_table
from deepfsi.jobs.mask_files import read_matrix

if TYPE_CHECKING:
    from importlib.resources.abc import Traversable
    from types import ModuleType

    from deepfsi.sweeps.recipe import Recipe
    from deepfsi.sweeps.results import Results

PAPER_PACKAGE = "deepfsi_paper"
"""The paper's experiments: a package of their own, beside this one, which works without it."""

QUICK: dict[str, Any] = {"ratios": (0.06, 0.16, 0.36), "trials": 3, "training": {"epochs": 30}}
"""Recipe of a comparison on digits, where no ratios, masks or trials are given."""

OF_ONE_DESIGN = ("design", "seed")
"""Settings of a job that a comparison does not have."""

RECIPE_FIELDS = ("size", "skip_bad", "designs", "ratios", "trials", "folds")
"""Fields of a recipe, besides the data, that are options by themselves."""


class CompareDesigns(Command):
    """`deepfsi compare`.

    Adaptive masks are among the designs where the camera can show them and the data has at most
    5000 scenes. Data with values (an .npz whose y are floats) are reported by R².

    The mask count of each design is chosen on validation data, and the test set is read once. A
    stopped comparison goes on where it was when run again with the same output folder.

    Without ratios, masks and trials: on digits the ratios 6, 16 and 36 % with three trials of 30
    epochs, on other data the paper's ratios 1, 4, 9, … 100 % with one trial.

    Example: deepfsi compare --data mnist --photons 1e3,1e4 --ratios 0.01,0.04 -o runs/mnist
    """

    settings: Annotated[dict[str, Any], fields.job_options(axes=True, leave=OF_ONE_DESIGN)]
    out: Annotated[Path, fields.Output()] = fields.option("output folder", Path("runs/compare"))
    data: fields.TrainingData = "digits"
    size: fields.Size = None
    skip_bad: fields.SkipBad = False
    designs: fields.Names | None = fields.option("names, separated by commas")
    ratios: fields.Ratios = None
    trials: Count | None = fields.option("training seeds for each point")
    folds: fields.Folds = None
    matrix: fields.Matrix = None
    recipe: str | None = fields.option(
        "name of a recipe, or TOML file; options given here override it"
    )
    target: fields.Number | None = fields.option(
        "accuracy, such as 0.9: read off the curves the photons and masks that it needs"
    )
    device: fields.TorchDevice = "auto"
    workers: fields.WorkerCount = None
    force: fields.Force = False

    def run(self, terminal: Terminal) -> Outcome:
        """Results, a page of them and the verdict."""
        check_report()
        base: dict[str, Any] = {"data": self.data}
        file = read_recipe(self.recipe) if self.recipe else {}
        from deepfsi.sweeps.plan import with_adaptive
        from deepfsi.sweeps.recipe import only
        from deepfsi.sweeps.run import check_kept, compare
        from deepfsi.sweeps.target import check_target

        matrix = None if self.matrix is None else read_matrix(self.matrix)
        if self.recipe:
            base = only(file)
        elif self.data == "digits" and not (self.ratios or self.trials or "masks" in self.settings):
            base |= QUICK
        unnamed = not (self.designs or self.matrix or "designs" in base)
        chosen = self.explicit(RECIPE_FIELDS)
        if self.data != "digits":
            chosen["data"] = self.data
        recipe, scenes = _checked(_recipe_settings(self.settings, chosen, base), matrix)
        if unnamed:
            recipe = with_adaptive(recipe, scenes)
        if self.target is not None:
            check_target(self.target, recipe, scenes)
        fields.check_sigma(self.settings, (*recipe.noises, *recipe.test_noise))
        if not self.force:
            check_kept(self.out, recipe, scenes, matrix)
        with terminal.progress("compare") as report:
            results, _ = compare(
                recipe,
                scenes,
                self.out,
                command=terminal.command_line,
                matrix=matrix,
                device=self.device,
                workers=self.workers,
                report=report,
            )
        return _results_outcome(results, self.out, self.target)


class SweepRecipe(Command):
    """`deepfsi sweep`.

    It may be stopped at any moment: run again with the same output folder, it goes on where it
    was. After a change of the recipe, trials that are still in it are used; where others would be
    lost, --force is needed. Several processes may work on one folder.

    Example: deepfsi sweep baseline -o runs/baseline --table runs/baseline.csv
    """

    recipe: str = fields.argument("name of a recipe, such as mnist, or TOML file; lists are axes")
    part_name: str | None = fields.option("part of a recipe that has several", alias="part")
    camera: str | None = fields.option(
        "a camera in place of the recipe's: a preset, or a TOML file"
    )
    quick: bool = fields.flag("the recipe's coarse version, where it has one")
    out: Path = fields.option("output folder", Path("runs/sweep"))
    folds: fields.Folds = None
    workers: fields.WorkerCount = None
    ray: fields.Ray = None
    device: fields.TorchDevice = "auto"
    table: Path | None = fields.option("write all records as one table, .csv or .parquet")
    force: fields.Force = False

    def run(self, terminal: Terminal) -> Outcome:
        """Results and a page of them."""
        check_report()
        fields.check_writable(self.out, self.out)
        if self.table is not None:
            fields.check_file(self.table, (".csv", ".parquet"), self.force, made=self.out)
        file = read_recipe(self.recipe)
        from deepfsi.sweeps.recipe import only
        from deepfsi.sweeps.records import write_table
        from deepfsi.sweeps.run import check_kept, compare

        recipe, scenes = _checked(
            {**only(file, self.part_name, self.quick), **self.explicit(("camera", "folds"))}
        )
        if not self.force:
            check_kept(self.out, recipe, scenes)
        with terminal.progress("sweep") as report:
            results, records = compare(
                recipe,
                scenes,
                self.out,
                command=terminal.command_line,
                device=self.device,
                workers=self.workers,
                ray=self.ray,
                report=report,
            )
        outcome = _results_outcome(results, self.out)
        if self.table is None:
            return outcome
        write_table(records, self.table)
        return replace(outcome, lines=[*outcome.lines, f"table: {self.table}"])


class ReproducePaper(Command):
    """`deepfsi reproduce`.

    Experiments in one folder share one page, and the trials that several of them need. A stopped
    experiment goes on when it is run again; with more --trials it adds those that are missing.

    Example: deepfsi reproduce mnist --quick -o runs/paper
    """

    name: str = fields.argument(
        "mnist, compression, mlgauss, quantization, indian-pines, ovit, hardware, or list"
    )
    out: Path = fields.option("output folder", Path("runs/paper"))
    quick: bool = fields.flag("a coarse grid, in a fraction of the time")
    trials: Count | None = fields.option("training seeds for each point, if not the recipe's")
    ratios: fields.Ratios = fields.option("compression ratios, if not the recipe's: 0.01,0.16,1")
    part_name: str | None = fields.option(
        "the only part to run, of a recipe with several parts", alias="part"
    )
    workers: fields.WorkerCount = None
    ray: fields.Ray = None
    device: fields.TorchDevice = "auto"

    def run(self, terminal: Terminal) -> Outcome:
        """The page of the experiments, and which claims hold."""
        studies = _paper_studies()
        if self.name == "list":
            return self._list(studies)
        changes = {} if self.ratios is None else {"ratios": list(self.ratios)}
        experiments = [
            replace(each, changes=changes, part=self.part_name) for each in studies.find(self.name)
        ]
        for experiment in experiments:
            experiment.recipes(self.quick, self.trials)
        fields.check_writable(self.out, self.out)
        for experiment in experiments:
            with terminal.progress(experiment.name) as report:
                experiment.run(
                    self.out,
                    command=terminal.command_line,
                    quick=self.quick,
                    trials=self.trials,
                    device=self.device,
                    workers=self.workers,
                    ray=self.ray,
                    report=report,
                )
        page = studies.page(self.out)
        sections = [section for each in experiments if (section := each.section(self.out))]
        answers = {True: "yes", False: "no", None: "open"}
        return Outcome(
            {
                "report": str(page),
                "claims": {
                    section.name: [
                        {**asdict(claim), "why": claim.reason} for claim in section.claims
                    ]
                    for section in sections
                },
            },
            [
                *(
                    Table(
                        section.title,
                        ("claim", "holds", "measured", "why"),
                        [
                            (claim.text, answers[claim.holds], claim.measured, claim.reason)
                            for claim in section.claims
                        ],
                        sentences=True,
                    )
                    for section in sections
                ),
                f"report: {page}",
            ],
        )

    def _list(self, studies: "ModuleType") -> Outcome:
        """Experiments by name, and their parts."""
        parts = [(study, each) for study, every in studies.STUDIES.items() for each in every]
        return Outcome(
            {
                "experiments": [
                    {"name": study, "part": each.name, "title": each.title} for study, each in parts
                ]
            },
            [
                f"{study if each is studies.STUDIES[study][0] else '':14s}{each.title}"
                for study, each in parts
            ],
            schema="reproduce.list",
        )


class WriteReport(Command):
    """`deepfsi report`.

    Example: deepfsi report runs/paper
    """

    folder: Annotated[Path, fields.existing("the output of compare, sweep or reproduce")] = (
        fields.argument("output of compare, sweep or reproduce")
    )

    def run(self, terminal: Terminal) -> Outcome:
        """The page, written again."""
        from deepfsi.report.comparison_page import write_report

        is_study = _has_paper() and _paper_studies().is_study(self.folder)
        page = _paper_studies().page(self.folder) if is_study else write_report(self.folder)
        return Outcome({"report": str(page)}, [f"report: {page}"])


# recipes


def shipped_recipes() -> "dict[str, Traversable]":
    """Recipes that come with the package and with the paper's experiments, by name."""
    own = (files("deepfsi") / "sweeps" / "recipes").iterdir()
    papers = (files(PAPER_PACKAGE) / "recipes").iterdir() if _has_paper() else ()
    return {Path(each.name).stem: each for each in (*own, *papers)}


def _has_paper() -> bool:
    return find_spec(PAPER_PACKAGE) is not None


def _paper_studies() -> "ModuleType":
    """The paper's experiments by name, or `InputError` where they are missing."""
    if not _has_paper():
        raise InputError(
            f"the paper's experiments are missing: {PAPER_PACKAGE}, which comes with deepfsi, is "
            "not installed; install deepfsi again"
        )
    return import_module(f"{PAPER_PACKAGE}.studies")


def read_recipe(source: str) -> dict[str, Any]:
    """Settings of a recipe with that name, or of a file; ``./mnist`` is a file of that name."""
    recipes = shipped_recipes()
    path = Path(source)
    if source not in recipes and not path.exists():
        advice = closest_choice(source, sorted(recipes))
        raise InputError(f"no recipe at {source}: {advice}; or give a TOML file")
    with as_file(recipes[source]) if source in recipes else nullcontext(path) as file:
        settings = read_toml(file)
    if not settings:
        raise InputError(f"{source} is empty: give a recipe at least one setting, such as designs")
    return settings


def _recipe_settings(
    options: Mapping[str, Any], chosen: Mapping[str, Any], base: Mapping[str, Any]
) -> dict[str, Any]:
    """Settings of the recipe that the options of a command ask for."""
    if "masks" in options and "ratios" in chosen:
        raise InputError("--masks and --ratios are two ways to say one thing: give one, not both")
    given = dict(chosen)
    tables: dict[str, dict[str, Any]] = {"camera": {}, "exposure": {}, "training": {}}
    for name, text in options.items():
        table, key = find_table(name)
        axis: list[Any] = [text]  # of a flag
        if isinstance(text, str):
            axis = fields.parse_option(name, fields.split_commas, text)
        if name == "camera":
            tables["camera"] = Camera.load(text).given_fields
        elif name == "hidden":  # widths of one network
            tables[table][key] = [[_read(name, width) for width in axis]]
        elif table:
            tables[table][key] = axis
        else:
            given[key] = [_read(name, value) for value in axis]
    replaced = {"masks": "ratios", "ratios": "masks"}
    left_out = {replaced[name] for name in given if name in replaced}
    merged = {name: value for name, value in base.items() if name not in left_out} | given
    for table, axes in tables.items():
        if axes and isinstance(of_base := merged.get(table, {}), dict):
            merged[table] = {**of_base, **axes}
    if isinstance(tuned := merged.get("tuned"), dict):
        merged["tuned"] = {
            design: {name: value for name, value in of.items() if name not in tables["training"]}
            if isinstance(of, dict)
            else of
            for design, of in tuned.items()
        }
    return merged


def _read(option: str, text: str) -> float:
    """Number of an option, a whole one of masks and of widths."""
    read = fields.number if option == "photons" else fields.whole_number
    return fields.parse_option(option, read, text)


def _checked(
    settings: Mapping[str, Any], matrix: np.ndarray | None = None
) -> "tuple[Recipe, Dataset]":
    """Recipe of settings and its data, or `InputError` that names every mistake."""
    from deepfsi.sweeps.plan import check_settings

    def load(recipe: "Recipe") -> Dataset:
        names = ("size", "split", "images", "skip_bad")
        return load_dataset(recipe.data, **{name: getattr(recipe, name) for name in names})

    return check_settings(settings, load, matrix)


# results


def _results_outcome(results: "Results", folder: Path, target: float | None = None) -> Outcome:
    """Write the results of trials and their page, and say them, with what a target needs."""
    from deepfsi.report.comparison_page import (
        comparison_lines,
        leader_differences,
        scenes_text,
        write_report,
    )
    from deepfsi.report.verdict import verdict_of
    from deepfsi.sweeps.results import write_results
    from deepfsi.sweeps.target import needs_of, needs_table

    write_results(folder / "results.json", results)
    page = write_report(folder)
    verdict = verdict_of(results)
    notes = [scenes_text(results.data)]
    content = results.as_dict()
    for point in content["points"]:
        point.pop("terms", None)
    needs = [] if target is None else needs_of(results, target)
    return Outcome(
        {
            "report": str(page),
            "verdict": verdict.text,
            **({} if target is None else {"target": target, "needs": needs}),
            **content,
            "notes": notes,
            "differences": list(leader_differences(results)),
        },
        [
            *data_lines(results.data, notes),
            *comparison_lines(results),
            *([] if target is None else [needs_table(target, needs)]),
            f"report: {page}",
        ],
    )
