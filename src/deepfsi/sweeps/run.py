"""Many trials as records on disk: planned, trained and tested here or elsewhere, and summarised.

A sweep that was stopped goes on where it was, a changed recipe reuses what it still shares, and
several processes may work on one folder.
"""

import time
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np

from deepfsi.datasets import Dataset
from deepfsi.errors import InputError
from deepfsi.sweeps.queue import (
    Report,
    SweepContext,
    batches,
    memory,
    tested_record,
    title_of,
    work_off,
    workers_for,
)
from deepfsi.sweeps.recipe import Recipe, Resources
from deepfsi.sweeps.records import Records
from deepfsi.sweeps.results import Results
from deepfsi.sweeps.summary import summarise
from deepfsi.sweeps.trial import Trial, plan


def run(
    trials: Sequence[Trial],
    data: Dataset,
    folder: Path,
    *,
    matrix: np.ndarray | None = None,
    device: str = "auto",
    workers: int | None = 1,
    ray: str | None = None,
    resources: Resources | None = None,
    report: Report | None = None,
) -> list[dict[str, Any]]:
    """Train and test whatever the folder does not hold yet.

    Parameters
    ----------
    trials : sequence of Trial
        From `plan`, for this data and matrix.
    data : Dataset
    folder : Path
        Made if need be. May be stopped at any moment and started again, and several processes may
        work on it: each trains what no other does.
    matrix : array, shape (m, N), optional
        Sensing matrix of "custom" designs.
    device : {"auto", "cpu", "cuda"}
    workers : int, optional
        Processes, each with its share of the cores; None for one a core, or one for a GPU. With
        more than one, a script of yours needs ``if __name__ == "__main__":``.
    ray : str, optional
        Address of a Ray cluster to work on instead, or "auto".
    resources : Resources, optional
        What each batch takes of the cluster.
    report : callable, optional

    Returns
    -------
    list of dict
        The records, in the order of `trials`.
    """
    tell = report or (lambda share, what: None)
    records = Records(folder)
    context = SweepContext(data, trials[0].validation, device, matrix)
    failed: set[str] = set()
    before = 0
    while missing := [t for t in trials if t.key not in failed and records.read(t) is None]:
        if len(missing) == before:
            time.sleep(1)  # another process tests them
        before = len(missing)
        untrained = _without_training(missing, context, records, tell)
        if not untrained:
            continue
        first_of_each = list({trial.design_key: trial for trial in untrained}.values())
        processors = workers or workers_for(context.scenes.device)
        todo = batches(first_of_each, context.scenes, memory(context.scenes.device) / processors)
        count = min(processors, len(todo))
        if ray is not None or count > 1:
            for trial in first_of_each:
                context.scenes.prepare(trial.job.drawn_from)
        lost = work_off(todo, context, records, tell, count, ray, resources or Resources())
        failed |= {t.key for t in trials for each in lost if t.design_key == each.design_key}
        tell(1.0, "done")
    if failed:
        names = sorted({title_of([trial]) for trial in trials if trial.key in failed})
        raise InputError(
            f"training diverged and the others are done: {', '.join(names)}; lower lr and mask_lr"
        )
    found = [(trial, records.read(trial)) for trial in trials]
    # a record is found by what it depends on; its words are those of who asks
    return [{**record, "trial": trial.model_dump(mode="json")} for trial, record in found if record]


def _without_training(
    trials: Sequence[Trial], context: SweepContext, records: Records, tell: Report
) -> list[Trial]:
    """Test the designs that are there already, from other tests; return the other trials."""
    left = []
    for trial in trials:
        design = records.design(trial)
        if design is None or not records.claim([trial]):
            left.append(trial)
            continue
        tell(0.0, f"testing {trial.job.design} again")
        record = tested_record(context, trial, design.to(context.scenes.device))
        records.write(trial, record, None)
    return left


def compare(
    recipe: Recipe,
    data: Dataset,
    folder: Path,
    *,
    command: str,
    matrix: np.ndarray | None = None,
    device: str = "auto",
    workers: int | None = 1,
    ray: str | None = None,
    report: Report | None = None,
) -> tuple[Results, list[dict[str, Any]]]:
    """Plan, run and summarise a recipe; returns the summary and the records."""
    began = time.perf_counter()
    trials = plan(recipe, data, matrix)
    records = run(
        trials,
        data,
        folder,
        matrix=matrix,
        device=device,
        workers=workers,
        ray=ray,
        resources=recipe.resources,
        report=report,
    )
    results = summarise(
        recipe,
        data,
        records,
        command=command,
        seconds=time.perf_counter() - began,
    )
    return results, records
