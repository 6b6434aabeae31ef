"""Comparisons: the trials of a recipe, trained, tested and summarised."""

import time
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np

from deepfsi.datasets import Dataset
from deepfsi.progress import SILENT, Report
from deepfsi.sweeps.context import SweepContext
from deepfsi.sweeps.queue import run_trials
from deepfsi.sweeps.recipe import Recipe
from deepfsi.sweeps.results import Results
from deepfsi.sweeps.summary import summarise
from deepfsi.sweeps.trial import plan
from deepfsi.sweeps.workers import HERE, Workers


def compare(
    recipe: Recipe,
    data: Dataset,
    folder: Path,
    *,
    command: str,
    matrix: np.ndarray | None = None,
    device: str = "auto",
    workers: Workers = HERE,
    report: Report = SILENT,
) -> tuple[Results, list[dict[str, Any]]]:
    """Results of a recipe, and their records."""
    # A changed recipe reuses what it still shares with the folder. matrix (m, N)
    began = time.perf_counter()
    context = SweepContext(data, recipe.held_out(data), device, matrix)
    records = run_trials(
        plan(recipe, data, matrix),
        context,
        folder,
        replace(workers, resources=recipe.resources),
        report,
    )
    seconds = time.perf_counter() - began
    return summarise(recipe, data, records, command=command, seconds=seconds), records
