"""Numbers behind the figures of flexible designs, as `flexible.json` holds them.

The first masks of nested designs, and exposures that stop early.
"""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from pydantic import TypeAdapter

from deepfsi.base.numeric.intervals import accuracy_interval
from deepfsi.base.progress import SILENT, Progress
from deepfsi.datasets.dataset import Dataset
from deepfsi.design.design import Design
from deepfsi.evaluation.accuracy import evaluate
from deepfsi.evaluation.stopping import Stopped, stop
from deepfsi.sweeps.results import Point, Results
from deepfsi_paper.experiment import budgets, points


@dataclass(frozen=True)
class Prefix:
    """Accuracies of the first masks of nested designs, as a point of the results has them.

    Attributes
    ----------
    recipe : str
        Part of the recipe of the designs.
    masks : int
        First masks that are shown.
    ratio : float
        Compression ratio m / N.
    photons : float
    accuracies : sequence of float
        Of each trial.
    accuracy, low, high : float
    """

    recipe: str
    masks: int
    ratio: float
    photons: float
    accuracies: Sequence[float]
    accuracy: float
    low: float
    high: float

    @property
    def terms(self) -> tuple[str, ...]:
        """Values of the images of each trial, which are not kept."""
        return ()


@dataclass(frozen=True)
class Measures:
    """First masks; trials that stop exposures of nested masks, and of several looks, early."""

    prefixes: Sequence[Prefix]
    stopped: Sequence[Stopped]
    looked: Sequence[Stopped]


def measure(
    results: Results, data: Dataset, designs: Path, workers: int | None, report: Progress
) -> dict[str, Any]:
    """Tests of the first masks of nested designs, and of exposures that stop early.

    Parameters as of `Experiment.measure`.
    """
    prefixes: list[Prefix] = []
    for recipe in ("nested", "both"):
        report(0.0, "first masks")
        prefixes += _prefixes(results, recipe, data, designs)
    report(0.5, "stopping")
    stopped, looked = (_stopped(results, recipe, data, designs) for recipe in ("stop", "looks"))
    return TypeAdapter(Measures).dump_python(Measures(prefixes, stopped, looked))


def _prefixes(results: Results, recipe: str, data: Dataset, folder: Path) -> Iterator[Prefix]:
    """First masks of a part's designs, in the numbers for which others were trained."""
    members = points(results, recipe=recipe)
    designs = _load(folder, members[0])
    tested = budgets(members)
    others = [*points(results, recipe="budgets"), *points(results, recipe="counts")]
    for masks in sorted({point.masks for point in others}):
        if not designs[0].fewest_masks <= masks <= designs[0].masks:
            continue
        tests = [
            evaluate(design.first(masks), data, tested, draws=1, seed=seed, report=SILENT)
            for seed, design in enumerate(designs)
        ]
        for photons, *trials in zip(tested, *tests, strict=True):
            accuracies = [test.accuracy for test in trials]
            measured = accuracy_interval(np.array([test.right for test in trials]))
            ratio = masks / data.pixels
            yield Prefix(recipe, masks, ratio, photons, accuracies, *measured)


def _stopped(results: Results, recipe: str, data: Dataset, folder: Path) -> list[Stopped]:
    [point] = points(results, recipe=recipe)
    return [
        stop(design, data, point.photons, held_out=results.data.validation, draws=1, seed=seed)
        for seed, design in enumerate(_load(folder, point))
    ]


def _load(folder: Path, point: Point) -> list[Design]:
    return [Design.load(folder / f"{key}.safetensors") for key in point.keys]
