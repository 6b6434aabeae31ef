"""Comparisons: the trials of a recipe, trained, tested and summarised."""

import time
from dataclasses import replace
from itertools import product
from pathlib import Path
from typing import Any

import numpy as np
import torch

from deepfsi.base import SILENT, InputError, Progress
from deepfsi.datasets import Dataset
from deepfsi.physics import library_defaults
from deepfsi.sweeps.context import SweepContext
from deepfsi.sweeps.folds import pooled, together
from deepfsi.sweeps.queue import run_trials
from deepfsi.sweeps.recipe import Recipe
from deepfsi.sweeps.results import Results, read_results
from deepfsi.sweeps.summary import summarise, tested_scenes
from deepfsi.sweeps.trial import plan
from deepfsi.sweeps.workers import HERE, Workers


def check_kept(
    folder: Path, recipe: Recipe, data: Dataset, matrix: np.ndarray | None = None
) -> None:
    """Raise `InputError` if results in a folder would be lost to those of a recipe."""
    # matrix (m, N)
    file = folder / "results.json"
    if not file.is_file():
        return
    try:
        old = read_results(file)
    except InputError as error:
        raise InputError(f"{error}; --force replaces it") from None
    same = old.recipe == recipe.model_dump(mode="json") and old.data.hash == data.hash
    if same and matrix is None:
        return
    kept = {
        (trial.design_key, *test)
        for part in recipe.parts(data)
        for trial in plan(recipe, part, matrix)
        for test in product(trial.test_noise, trial.test_photons, trial.test_levels)
    }
    held = {(key, p.noise, p.photons, p.levels) for p in old.points for key in p.keys}
    if held - kept:
        raise InputError(
            f"{folder} holds results of other settings ({old.command}): give another folder, or "
            "--force to replace its results and report"
        )


@library_defaults(grad=True)
def compare(
    recipe: Recipe,
    data: Dataset,
    folder: Path,
    *,
    command: str,
    matrix: np.ndarray | None = None,
    device: str | torch.device = "auto",
    workers: Workers = HERE,
    report: Progress = SILENT,
) -> tuple[Results, list[dict[str, Any]]]:
    """Results of a recipe, and their records."""
    # A changed recipe reuses what it still shares with the folder. matrix (m, N)
    began = time.perf_counter()
    parts = recipe.parts(data)
    if len(parts) > 1 and workers.ray is None:
        # trainings on few scenes take less than starting processes for each fold
        workers = replace(workers, count=workers.count or 1)
    records = [
        run_trials(
            plan(recipe, part, matrix),
            SweepContext(part, recipe.held_out(part), device, matrix),
            folder,
            replace(workers, resources=recipe.resources),
            span,
        )
        for part, span in zip(parts, report.split(len(parts)), strict=True)
    ]
    seconds = time.perf_counter() - began
    tested = [
        tested_scenes(part, recipe.held_out(part), found)
        for part, found in zip(parts, records, strict=True)
    ]
    results = summarise(
        recipe,
        pooled(data, parts),
        together(records),
        command=command,
        seconds=seconds,
        tested=pooled(data, tested),
    )
    if len(parts) > 1:
        facts = {"hash": data.hash, "folds": len(parts)}
        results = results.model_copy(update={"data": results.data.model_copy(update=facts)})
    return results, [record for part in records for record in part]
