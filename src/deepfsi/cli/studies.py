"""Commands that train many designs: compare and sweep."""

from collections.abc import Mapping
from contextlib import nullcontext
from importlib.resources import as_file, files
from importlib.resources.abc import Traversable
from importlib.util import find_spec
from pathlib import Path
from typing import Annotated, Any

from pydantic import Field

from deepfsi.base.errors import InputError, closest_choice
from deepfsi.base.files import read_toml
from deepfsi.base.models import Count
from deepfsi.base.registry import check_report
from deepfsi.camera.camera import Camera
from deepfsi.cli import fields
from deepfsi.cli.command import Command
from deepfsi.cli.evaluate import data_lines
from deepfsi.cli.fields import JOB_OPTIONS
from deepfsi.cli.terminal import Outcome, Terminal
from deepfsi.datasets.dataset import Dataset
from deepfsi.datasets.load import load_dataset
from deepfsi.sweeps.plan import check_settings, with_adaptive
from deepfsi.sweeps.recipe import Recipe, only
from deepfsi.sweeps.results import write_results
from deepfsi.sweeps.run import compare


class _Study(Command):
    """Training of many designs, into one folder."""

    out: Path
    workers: fields.WorkerCount = None
    device: fields.TorchDevice = "auto"

    def study(self, terminal: Terminal, recipe: Recipe, scenes: Dataset, **options: Any) -> Outcome:
        """Train; write the results and their page."""
        from deepfsi.report.comparison_page import (
            comparison_lines,
            scenes_text,
            verdict_of,
            write_report,
        )

        with terminal.progress("trials") as report:
            results, _ = compare(
                recipe,
                scenes,
                self.out,
                command=terminal.command_line,
                device=self.device,
                workers=self.workers,
                report=report,
                **options,
            )
        write_results(self.out / "results.json", results)
        page = write_report(self.out)
        notes = [scenes_text(results.data)]
        # Values of single images would make JSON long
        content = results.as_dict()
        for point in content["points"]:
            point.pop("terms", None)
        return Outcome(
            {"report": str(page), "verdict": verdict_of(results).text, **content, "notes": notes},
            [*data_lines(results.data, notes), *comparison_lines(results), f"report: {page}"],
        )


class CompareDesigns(_Study):
    """The mask count of each design is chosen on validation data; the test set is read once.

    Adaptive masks are among the designs of at most 5000 scenes. A stopped comparison goes on where
    it was when run again with the same output folder. Without ratios, masks and trials: on digits
    the ratios 6, 16 and 36 % with three trials of 30 epochs, else 1, 4, 9, … 100 % with one trial.

    Example: deepfsi compare --data mnist --photons 1e3,1e4 --ratios 0.01,0.04 -o runs/mnist
    """

    settings: Annotated[dict[str, Any], fields.job_options(axes=True, leave=("design", "seed"))]
    out: Annotated[Path, fields.Output()] = fields.option("output folder", Path("runs/compare"))
    data: fields.TrainingData = "digits"
    size: fields.Size = None
    designs: fields.Names | None = fields.option("names, separated by commas")
    ratios: fields.Ratios = None
    trials: Count | None = fields.option("training seeds for each point")
    folds: Annotated[int, Field(ge=1, le=100)] | None = fields.option(
        "parts of the scenes, each tested by designs that are trained on the others; 1 for none; "
        "default: 5 where a test part was drawn from the scenes and has fewer than 300"
    )
    matrix: fields.Matrix = None

    def run(self, terminal: Terminal) -> Outcome:
        check_report()
        chosen = {"data": self.data, **self.explicit(("size", "designs", "folds"))}
        options = dict(self.settings)
        if self.data == "digits" and not (self.ratios or self.trials or "masks" in options):
            chosen |= {"ratios": (0.06, 0.16, 0.36), "trials": 3}
            options = {"epochs": "30", **options}
        chosen |= self.explicit(("ratios", "trials"))
        recipe, scenes = check_settings(chosen | _recipe_settings(options), _load, self.matrix)
        if not self.designs and self.matrix is None:
            recipe = with_adaptive(recipe, scenes)
        return self.study(terminal, recipe, scenes, matrix=self.matrix)


class SweepRecipe(_Study):
    """It may be stopped: run again with the same output folder, it goes on where it was.

    Trials that are still in a changed recipe are used. Several processes may work on one folder.

    Example: deepfsi sweep baseline -o runs/baseline
    """

    recipe: str = fields.argument("name of a recipe, such as mnist, or TOML file; lists are axes")
    part_name: str | None = fields.option("part of a recipe that has several", alias="part")
    quick: bool = fields.option("the recipe's coarse version, where it has one", False)
    out: Annotated[Path, fields.Output()] = fields.option("output folder", Path("runs/sweep"))
    ray: fields.Ray = None

    def run(self, terminal: Terminal) -> Outcome:
        check_report()
        settings = only(read_recipe(self.recipe), self.part_name, self.quick)
        recipe, scenes = check_settings(settings, _load)
        return self.study(terminal, recipe, scenes, ray=self.ray)


# recipes


def _shipped_recipes() -> dict[str, Traversable]:
    """Recipes that come with the package and with the paper's experiments, by name."""
    folders = [files("deepfsi") / "sweeps" / "recipes"]
    if find_spec("deepfsi_paper") is not None:
        folders.append(files("deepfsi_paper") / "recipes")
    return {Path(file.name).stem: file for folder in folders for file in folder.iterdir()}


def read_recipe(source: str) -> dict[str, Any]:
    """Settings of a recipe by its name, or of a file; ``./mnist`` is a file."""
    recipes = _shipped_recipes()
    path = Path(source)
    if source not in recipes and not path.exists():
        advice = closest_choice(source, sorted(recipes))
        raise InputError(f"no recipe at {source}: {advice}; or give a TOML file")
    with as_file(recipes[source]) if source in recipes else nullcontext(path) as file:
        settings = read_toml(file)
    if not settings:
        raise InputError(f"{source} is empty: give a recipe at least one setting, such as designs")
    return settings


def _recipe_settings(options: Mapping[str, str]) -> dict[str, Any]:
    """Settings of a recipe from options of a job, each an axis."""
    settings: dict[str, Any] = {"camera": {}, "training": {}, "exposure": {}}
    for option, text in options.items():
        if option == "camera":
            continue
        heading, name, _ = JOB_OPTIONS[option]
        try:
            axis = fields.split_commas(text)
        except ValueError as error:
            raise InputError(f"--{option}: {error}") from None
        table = settings if heading == "Options" else settings[heading.lower()]
        table[name] = [axis] if name == "hidden" else axis  # widths of one network
    if "camera" in options:
        settings["camera"] = Camera.load(options["camera"]).given_fields | settings["camera"]
    return {name: setting for name, setting in settings.items() if setting}


def _load(recipe: Recipe) -> Dataset:
    names = ("size", "split", "images")
    return load_dataset(recipe.data, **{name: getattr(recipe, name) for name in names})
